//! Networks as plans beside the networks themselves.

use super::*;
use endoscape_nets::{MaskHead, NetsConfig};

fn picture(size: Size, seed: usize) -> Image {
    let value = |x: usize, y: usize, channel: usize| ((x * 37 + y * 91 + channel * 53 + seed * 17) * 29 % 256) as u8;
    Image::from_fn(size, |x, y| [0, 1, 2].map(|channel| value(x, y, channel)))
}

#[track_caller]
fn assert_close<'a>(actual: impl IntoIterator<Item = &'a f32>, expected: &[f32]) {
    let actual: Vec<f32> = actual.into_iter().copied().collect();
    assert_eq!(actual.len(), expected.len());
    let largest = expected.iter().fold(0.0_f32, |largest, value| largest.max(value.abs()));
    for (actual, expected) in actual.iter().zip(expected) {
        assert!((actual - expected).abs() <= 1e-4 * largest, "{actual} instead of {expected}");
    }
}

#[test]
fn on_the_processor_depth_is_that_of_the_network() {
    let device = Device::flex();
    let config = NetsConfig::endo().disp.with_width(0.125);
    let network = DepthNetwork::new(Some(config.init(0, &device).unwrap()), &device).unwrap();
    // The size changes and comes back.
    for (seed, [width, height]) in [[96, 64], [50, 37], [96, 64]].into_iter().enumerate() {
        let image = picture(Size::new(width, height), seed);
        let expected = values(network.net.forward(network_input(&image, &device)).depth(0));
        assert_close(network.depth(&image).grid().values(), &expected);
        assert!(network.plan.plan.borrow().is_some());
    }
}

#[test]
fn on_the_processor_motions_are_those_of_the_network() {
    let device = Device::flex();
    for mask in [MaskHead::None, MaskHead::Sigmoid, MaskHead::Softmax] {
        let config = endoscape_nets::PoseMaskNetConfig { mask, ..NetsConfig::endo().pose.with_width(0.25) };
        let network = MotionNetwork::new(Some(config.init(0, &device).unwrap()), &device).unwrap();
        let pictures = [0, 1, 2].map(|seed| picture(Size::new(70, 45), seed));
        let sources = [&pictures[1], &pictures[2]];
        let (motions, reliability) = network.seen_by_device(&pictures[0], &sources);
        let seen = network.motions(&pictures[0], &sources);
        for (pose, motion) in seen.source_from_target.iter().zip(motions) {
            let expected = network.net.rotation().pose(motion);
            assert!((pose.to_homogeneous() - expected.to_homogeneous()).norm() < 1e-5);
        }
        assert_eq!(seen.reliability.is_some(), mask != MaskHead::None);
        let found = seen.reliability.iter().flat_map(|grid| grid.values());
        assert_close(found, &reliability.unwrap_or_default());
    }
}
