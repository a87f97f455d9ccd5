//! Kernels beside their references: values and gradients.

use super::*;
use crate::photometric::photometric_error_reference;
use crate::warp::sample_bilinear_reference;
use burn::tensor::{Device, Distribution, Gradients};
use proptest::prelude::*;

fn uniform(shape: [usize; 4], low: f64, high: f64) -> Tensor<4> {
    Tensor::random(shape, Distribution::Uniform(low, high), &Device::flex().autodiff()).require_grad()
}

/// Largest difference, relative to the largest value expected.
fn error(actual: Tensor<4>, expected: Tensor<4>) -> f32 {
    assert_eq!(actual.dims(), expected.dims());
    let largest = expected.clone().abs().max().into_scalar::<f32>().max(1e-3);
    (actual - expected).abs().max().into_scalar::<f32>() / largest
}

/// Compares results and the gradients of both inputs, every pixel having a weight of its own.
fn compare(inputs: [&Tensor<4>; 2], [actual, expected]: [Tensor<4>; 2]) -> Result<(), TestCaseError> {
    let weights = uniform(expected.dims(), -1.0, 1.0).detach();
    let gradients = |output: &Tensor<4>| (output.clone() * weights.clone()).sum().backward();
    let (of_ours, of_theirs) = (gradients(&actual), gradients(&expected));
    prop_assert!(error(actual, expected) < 1e-5);
    for input in inputs {
        let of = |gradients: &Gradients| input.grad(gradients).unwrap();
        prop_assert!(error(of(&of_ours), of(&of_theirs)) < 1e-3);
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn sampling_is_that_of_the_reference(
        batch in 1_usize..3,
        channels in 1_usize..4,
        size in [1_usize..20, 1_usize..20],
        read in [1_usize..60, 1_usize..60],
    ) {
        let picture = uniform([batch, channels, size[0], size[1]], -1.0, 1.0);
        // A few positions lie outside.
        let largest = size[0].max(size[1]) as f64;
        let pixels = uniform([batch, 2, read[0], read[1]], -0.1 * largest, 1.1 * largest);
        let actual = sample_bilinear(&picture, &pixels).unwrap();
        let expected = sample_bilinear_reference(picture.clone(), pixels.clone());
        compare([&picture, &pixels], [actual, expected])?;
    }

    #[test]
    fn photometric_errors_are_those_of_the_reference(
        batch in 1_usize..3,
        channels in 1_usize..4,
        size in [1_usize..40, 1_usize..40],
        ssim_weight in prop::sample::select(vec![0.0, 0.5, 0.85, 1.0]),
    ) {
        let shape = [batch, channels, size[0], size[1]];
        let (a, b) = (uniform(shape, -1.0, 1.0), uniform(shape, -1.0, 1.0));
        let actual = photometric_error(&a, &b, ssim_weight).unwrap();
        let expected = photometric_error_reference(a.clone(), b.clone(), ssim_weight);
        compare([&a, &b], [actual, expected])?;
    }
}

#[test]
fn double_precision_is_left_to_the_reference() {
    let device = Device::flex();
    let picture = Tensor::<4>::ones([1, 1, 4, 4], (&device, DType::F64));
    assert!(photometric_error(&picture, &picture, 0.85).is_none());
    assert!(sample_bilinear(&picture, &Tensor::zeros([1, 2, 3, 3], (&device, DType::F64))).is_none());
}
