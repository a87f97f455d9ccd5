//! Plans beside the networks they were made from.

use super::*;
use crate::config::NetsConfig;
use burn::tensor::{Device, Distribution, Tensor};

fn assert_close(actual: impl IntoIterator<Item = f64>, expected: Tensor<1>) {
    let expected: Vec<f32> = expected.into_data().iter().collect();
    let actual: Vec<f64> = actual.into_iter().collect();
    assert_eq!(actual.len(), expected.len());
    let largest = expected.iter().fold(0.0_f64, |largest, value| largest.max(f64::from(value.abs())));
    for (actual, expected) in actual.iter().zip(&expected) {
        assert!((actual - f64::from(*expected)).abs() < 1e-4 * largest, "{actual} instead of {expected}");
    }
}

fn floats(tensor: Tensor<4>) -> Vec<f32> {
    tensor.into_data().iter().collect()
}

fn flat<const D: usize>(tensor: Tensor<D>) -> Tensor<1> {
    let count = tensor.shape().num_elements();
    tensor.reshape([count])
}

#[test]
fn plans_give_what_the_networks_give() {
    let device = Device::flex();
    for config in [NetsConfig::paper(), NetsConfig::endo()] {
        let config = NetsConfig { disp: config.disp.with_width(0.125), pose: config.pose.with_width(0.25), ..config };
        let mut checkpoint = Checkpoint::init(config, 0, &device).unwrap();
        disturb_norms(&mut checkpoint);
        for size in [[128, 160], [37, 90], [1, 3]] {
            let shape = [1, 9, size[0], size[1]];
            let snippet = Tensor::<4>::random(shape, Distribution::Uniform(-1.0, 1.0), &device);
            let mut plan = InferencePlan::new(&checkpoint, size, true).unwrap();
            // Twice: buffers of the first run must not matter to the second.
            plan.depth_and_motion(&vec![0.3; 9 * size[0] * size[1]]);
            let (disparity, motion) = plan.depth_and_motion(&floats(snippet.clone()));
            let [expected, ..] = checkpoint.disp.as_ref().unwrap().forward(snippet.clone().narrow(1, 0, 3)).scales;
            assert_close(disparity.iter().copied().map(f64::from), flat(expected));
            let seen = checkpoint.pose.as_ref().unwrap().forward_snippet(snippet);
            assert_close(motion.into_iter().flatten(), flat(seen.motion));
            let [mask, ..] = seen.mask.unwrap();
            let found = plan.motion.as_ref().unwrap().mask().unwrap();
            assert_close(found.iter().copied().map(f64::from), flat(mask));
        }
    }
}

/// Gives every normalisation statistics of its own, as training would.
fn disturb_norms(checkpoint: &mut Checkpoint) {
    use burn::module::{Module, ModuleMapper, Param};
    struct Disturb;
    impl ModuleMapper for Disturb {
        fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
            let (id, tensor, mapper) = param.consume();
            let change = tensor.random_like(Distribution::Uniform(0.8, 1.2));
            Param::from_mapped_value(id, tensor * change.clone() + (change - 1.0) * 0.1, mapper)
        }
    }
    checkpoint.disp = checkpoint.disp.take().map(|net| net.map(&mut Disturb));
    checkpoint.pose = checkpoint.pose.take().map(|net| net.map(&mut Disturb));
}

#[test]
fn a_picture_without_pixels_is_refused() {
    let checkpoint = Checkpoint::init(NetsConfig::fast(), 0, &Device::flex()).unwrap();
    let message = InferencePlan::new(&checkpoint, [0, 4], false).unwrap_err().to_string();
    assert_eq!(message, "the network setting `size` is 4x0 but needs at least one pixel");
}
