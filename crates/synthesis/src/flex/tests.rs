//! Kernels beside their references: values and gradients.

use super::*;
use crate::camera::{CameraScaling, tests::cameras};
use crate::mask_loss::{SMALLEST_RELIABILITY, cross_entropy_reference};
use crate::motion::{Rotation, source_from_target};
use crate::photometric::{average_reference, photometric_error_reference};
use crate::smoothness::second_order_reference;
use crate::warp::{self, DISPARITY_RANGE, correspond_reference, finite_disparity_reference, sample_bilinear_reference};
use burn::tensor::{DType, Device, Distribution, Gradients};
use endoscape_core::Size;
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

/// Compares results and the gradients of the inputs, every pixel having a weight of its own.
fn compare(inputs: &[&Tensor<4>], results: [Tensor<4>; 2]) -> Result<(), TestCaseError> {
    compare_to(1e-5, inputs, results)
}

/// [`compare`] with the relative error that results may have.
fn compare_to(limit: f32, inputs: &[&Tensor<4>], [actual, expected]: [Tensor<4>; 2]) -> Result<(), TestCaseError> {
    let weights = uniform(expected.dims(), -1.0, 1.0).detach();
    let gradients = |output: &Tensor<4>| (output.clone() * weights.clone()).sum().backward();
    let (of_ours, of_theirs) = (gradients(&actual), gradients(&expected));
    prop_assert!(error(actual, expected) < limit);
    for input in inputs {
        // A map of one pixel has no differences, so its reference no gradient: that is zero.
        let of = |gradients: &Gradients| input.grad(gradients).unwrap_or_else(|| Tensor::clone(input).inner() * 0.0);
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
        let expected = || sample_bilinear_reference(picture.clone(), pixels.clone());
        compare(&[&picture, &pixels], [sample_bilinear(&picture, &pixels, None).unwrap(), expected()])?;
        let shown = uniform([batch, 1, read[0], read[1]], 0.0, 2.0).detach().int().float();
        let actual = sample_bilinear(&picture, &pixels, Some(&shown)).unwrap();
        compare(&[&picture, &pixels], [actual, expected() * shown])?;
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
        // Variances that nearly vanish leave SSIM few digits.
        compare_to(1e-4, &[&a, &b], [actual, expected])?;
    }

    #[test]
    fn maps_become_the_numbers_of_their_references(batch in 1_usize..3, size in [1_usize..40, 1_usize..60]) {
        let shape = [batch, 2, size[0], size[1]];
        let map = uniform(shape, -0.2, 1.0);
        let weights = uniform(shape, 0.0, 2.0).detach().int().float();
        let whole = |number: Tensor<1>| number.reshape([1, 1, 1, 1]);
        for by in [Average::ValidPixels, Average::AllPixels] {
            let actual = average(&map, &weights, by).unwrap();
            compare(&[&map], [actual, average_reference(map.clone(), weights.clone(), by)].map(whole))?;
        }
        let actual = cross_entropy(&map, SMALLEST_RELIABILITY).unwrap();
        compare(&[&map], [actual, cross_entropy_reference(map.clone())].map(whole))?;
        let actual = second_order(&map).unwrap();
        compare(&[&map], [actual, second_order_reference(map.clone())].map(whole))?;
    }

    #[test]
    fn depths_are_those_of_the_reference(size in [1_usize..40, 1_usize..60]) {
        // Half of them are no disparities.
        let disparity = uniform([1, 1, size[0], size[1]], -1.0, 1.0);
        let expected = || finite_disparity_reference(disparity.clone());
        compare(&[&disparity], [within(&disparity, DISPARITY_RANGE).unwrap(), expected()])?;
        compare(&[&disparity], [inverse_within(&disparity, DISPARITY_RANGE).unwrap(), expected().recip()])?;
    }

    #[test]
    fn correspondences_are_those_of_the_reference(
        one in any::<bool>(),
        size in [1_usize..30, 1_usize..40],
    ) {
        let cameras = if one { vec![cameras()[0]; 2] } else { cameras() };
        let device = Device::flex().autodiff();
        let batch = CameraBatch::new(&cameras, Size::new(size[1], size[0]), CameraScaling::Exact, &device).unwrap();
        let motion = Tensor::random([cameras.len(), 6], Distribution::Uniform(-0.2, 0.2), &device).require_grad();
        // Points nearly in the lens have few digits; some depths are none.
        let shape = [cameras.len(), 1, size[0], size[1]];
        let depth = uniform(shape, 0.5, 2.0);
        let holes = uniform(shape, 0.0, 1.1).detach().int().float() * 5.0;
        let seen = || depth.clone() - holes.clone();
        let matrix = || source_from_target(motion.clone(), Rotation::Euler);
        for part in [|found: Correspondence| found.pixels, |found: Correspondence| found.depth] {
            let ours = warp::correspond(seen(), matrix(), &batch);
            let theirs = correspond_reference(seen(), matrix(), &batch);
            // Rounding may move a pixel over the border of what is defined.
            let both = ours.defined.clone() * theirs.defined.clone();
            let differ = |a: &Tensor<4>, b: &Tensor<4>| (a.clone() - b.clone()).abs().sum().into_scalar::<f32>();
            let few = 1.0 + 0.01 * both.dims().iter().product::<usize>() as f32;
            prop_assert!(differ(&ours.defined, &theirs.defined) < few);
            prop_assert!(differ(&ours.in_view, &theirs.in_view) < few);
            let (actual, expected) = (part(ours) * both.clone(), part(theirs) * both);
            let weights = uniform(expected.dims(), -1.0, 1.0).detach();
            let gradients = |output: &Tensor<4>| (output.clone() * weights.clone()).sum().backward();
            let (of_ours, of_theirs) = (gradients(&actual), gradients(&expected));
            prop_assert!(error(actual, expected) < 1e-4);
            prop_assert!(error(depth.grad(&of_ours).unwrap(), depth.grad(&of_theirs).unwrap()) < 1e-3);
            let of = |gradients: &Gradients| motion.grad(gradients).unwrap().reshape([1, 1, 6, cameras.len()]);
            prop_assert!(error(of(&of_ours), of(&of_theirs)) < 1e-3);
        }
    }
}

#[test]
fn double_precision_is_left_to_the_reference() {
    let device = Device::flex();
    let picture = Tensor::<4>::ones([1, 1, 4, 4], (&device, DType::F64));
    assert!(photometric_error(&picture, &picture, 0.85).is_none());
    assert!(sample_bilinear(&picture, &Tensor::zeros([1, 2, 3, 3], (&device, DType::F64)), None).is_none());
    assert!(second_order(&picture).is_none());
}

#[test]
fn pictures_outside_the_graph_are_constants_beside_the_others() {
    let random =
        |shape, low, high, device: &Device| Tensor::<4>::random(shape, Distribution::Uniform(low, high), device);
    let picture = random([1, 3, 6, 8], 0.0, 1.0, &Device::flex());
    let pixels = random([1, 2, 6, 8], 1.0, 4.0, &Device::flex().autodiff()).require_grad();
    let read = sample_bilinear(&picture, &pixels, None).unwrap();
    let gradient = pixels.grad(&read.sum().backward()).unwrap();
    assert!(gradient.abs().sum().into_scalar::<f32>() > 0.0);
}
