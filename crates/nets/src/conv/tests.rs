//! Our kernels beside Burn's own convolutions: values and gradients.

use super::{
    Activation, activate, concatenate, convolve, convolve_up, join, logistic_reference, unary, upsample_reference,
};
use crate::layers::{LayerFactory, Padding, crop};
use burn::module::{Module, Param};
use burn::tensor::{Device, Distribution, Gradients, Tensor};
use proptest::prelude::*;

fn noise<const D: usize>(shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::random(shape, Distribution::Uniform(-1.0, 1.0), device)
}

/// Largest difference, relative to the largest value expected.
fn error<const D: usize>(actual: Tensor<D>, expected: Tensor<D>) -> f32 {
    assert_eq!(actual.dims(), expected.dims());
    let largest = expected.clone().abs().max().into_scalar::<f32>().max(1e-3);
    (actual - expected).abs().max().into_scalar::<f32>() / largest
}

/// Compares a layer's output and the gradients of its input, weight and bias.
fn compare(
    [input, weight]: [Tensor<4>; 2],
    bias: &Tensor<1>,
    [ours, theirs]: [&dyn Fn(Tensor<4>) -> Tensor<4>; 2],
) -> Result<(), TestCaseError> {
    let input = input.require_grad();
    let (actual, expected) = (ours(input.clone()), theirs(input.clone()));
    // A weighted sum: every output pixel has a gradient of its own.
    let weights = noise(expected.dims(), &input.device());
    let gradients = |output: &Tensor<4>| (output.clone() * weights.clone()).sum().backward();
    let (of_ours, of_theirs) = (gradients(&actual), gradients(&expected));
    prop_assert!(error(actual, expected) < 1e-5);
    let difference = |tensor: &Tensor<4>| {
        let of = |gradients: &Gradients| tensor.grad(gradients).unwrap();
        error(of(&of_ours), of(&of_theirs))
    };
    prop_assert!(difference(&input) < 1e-5);
    prop_assert!(difference(&weight) < 1e-4);
    let of = |gradients: &Gradients| bias.grad(gradients).unwrap();
    prop_assert!(error(of(&of_ours), of(&of_theirs)) < 1e-4);
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn concatenation_is_that_of_burn(
        channels in prop::collection::vec(1_usize..9, 2..4),
        size in [1_usize..9, 1_usize..9],
        batch in 1_usize..4,
    ) {
        let device = Device::flex().autodiff();
        let part = |channels: &usize| noise([batch, *channels, size[0], size[1]], &device).require_grad();
        let parts: Vec<Tensor<4>> = channels.iter().map(part).collect();
        prop_assert!(join::concatenate(&parts).is_some());
        let (ours, theirs) = (concatenate(parts.clone()), Tensor::cat(parts.clone(), 1));
        let weights = noise(theirs.dims(), &device);
        let gradients = |joined: &Tensor<4>| (joined.clone() * weights.clone()).sum().backward();
        let (of_ours, of_theirs) = (gradients(&ours), gradients(&theirs));
        prop_assert_eq!(error(ours, theirs), 0.0);
        for part in &parts {
            prop_assert_eq!(error(part.grad(&of_ours).unwrap(), part.grad(&of_theirs).unwrap()), 0.0);
        }
    }

    #[test]
    fn enlarging_and_the_logistic_function_are_those_of_burn(
        channels in 1_usize..4,
        size in [1_usize..20, 1_usize..20],
        cut in [0_usize..2, 0_usize..2],
        batch in 1_usize..4,
    ) {
        let device = Device::flex().autodiff();
        let picture = (noise([batch, channels, size[0], size[1]], &device) * 10.0).detach().require_grad();
        let large = [2 * size[0] - cut[0], 2 * size[1] - cut[1]];
        let enlarged = [unary::doubled(&picture, large).unwrap(), upsample_reference(picture.clone(), large)];
        let logistic = [unary::logistic(&picture, 9.0, 0.5).unwrap(), logistic_reference(picture.clone(), 9.0, 0.5)];
        for [actual, expected] in [enlarged, logistic] {
            let weights = noise(expected.dims(), &device);
            let gradient = |output: &Tensor<4>| picture.grad(&(output.clone() * weights.clone()).sum().backward()).unwrap();
            prop_assert!(error(gradient(&actual), gradient(&expected)) < 1e-5);
            prop_assert!(error(actual, expected) < 1e-5);
        }
    }

    #[test]
    fn convolutions_are_those_of_burn(
        channels in [1_usize..20, 1_usize..20],
        kernel in prop::sample::select(vec![1_usize, 3, 5, 7]),
        stride in 1_usize..3,
        same in any::<bool>(),
        relu in any::<bool>(),
        size in [1_usize..20, 1_usize..40],
        batch in 1_usize..4,
    ) {
        let device = Device::flex().autodiff();
        let padding = if same { Padding::Same } else { Padding::Symmetric };
        let layers = LayerFactory::new(padding, false, Some(0), &device);
        let mut layer = layers.conv(channels, kernel, stride);
        layer.bias = Some(Param::from_tensor(noise([channels[1]], &device)));
        let activation = if relu { Activation::Relu } else { Activation::None };
        let input = noise([batch, channels[0], size[0], size[1]], &device);
        let (weight, bias) = (layer.weight.val(), layer.bias.as_ref().unwrap().val());
        compare([input, weight], &bias, [
            &|input| convolve(&layer, input, activation),
            &|input| activate(layer.forward(input), activation),
        ])?;
    }

    #[test]
    fn up_convolutions_are_those_of_burn(
        channels in [1_usize..20, 1_usize..20],
        kernel in prop::sample::select(vec![3_usize, 4, 5, 7]),
        same in any::<bool>(),
        relu in any::<bool>(),
        size in [1_usize..20, 1_usize..40],
        batch in 1_usize..4,
    ) {
        let device = Device::flex().autodiff();
        let padding = if same { Padding::Same } else { Padding::Symmetric };
        let layers = LayerFactory::new(padding, false, Some(0), &device);
        let mut layer = layers.up_block(channels, kernel).conv;
        layer.bias = Some(Param::from_tensor(noise([channels[1]], &device)));
        let activation = if relu { Activation::Relu } else { Activation::None };
        let small = size.map(|length| length.div_ceil(2));
        let input = noise([batch, channels[0], small[0], small[1]], &device);
        let (weight, bias) = (layer.weight.val(), layer.bias.as_ref().unwrap().val());
        compare([input, weight], &bias, [
            &|input| convolve_up(&layer, input, size, activation),
            &|input| activate(crop(layer.forward(input), size), activation),
        ])?;
    }
}

#[test]
fn views_of_larger_tensors_are_read_correctly() {
    let device = Device::flex();
    let layers = LayerFactory::new(Padding::Symmetric, false, Some(0), &device);
    let layer = layers.conv([3, 5], 3, 1).no_grad();
    let picture = noise([2, 7, 9, 11], &device);
    for view in [picture.clone().narrow(1, 2, 3), picture.narrow(0, 1, 1).narrow(1, 0, 3).swap_dims(2, 3)] {
        let expected = layer.forward(view.clone());
        assert!(error(convolve(&layer, view, Activation::None), expected) < 1e-5);
    }
}

#[test]
fn recycled_weights_take_no_running_statistics_along() {
    let device = Device::flex().autodiff();
    let layers = LayerFactory::new(Padding::Symmetric, true, Some(0), &device);
    let old = layers.block([3, 8], 3, 2);
    let successor = old.clone();
    crate::recycle(old);
    // On a thread of its own, which has no newer statistics than those all threads share.
    let forward = move || successor.forward(noise([2, 3, 8, 8], &device)).into_data();
    let features = std::thread::spawn(forward).join().unwrap();
    assert!(features.iter::<f32>().all(f32::is_finite));
}
