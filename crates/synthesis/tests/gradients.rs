//! Every differentiable function against central differences in double precision.
#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "test helpers fail by panicking and say what they skip")]

mod common;

use burn::tensor::Tensor;
use common::{SIZE, assert_gradient, batch_of, cameras, noise_tensor, options, tensor, weighted_sum};
use endoscape_core::Camera;
use endoscape_synthesis::brightness::align_brightness;
use endoscape_synthesis::geometry::depth_disagreement;
use endoscape_synthesis::light::distance_disagreement;
use endoscape_synthesis::mask_loss::reliability_cross_entropy;
use endoscape_synthesis::motion::{Rotation, source_from_target};
use endoscape_synthesis::photometric::{self, Average};
use endoscape_synthesis::pyramid::{self, enlarge};
use endoscape_synthesis::smoothness::{Smoothness, smoothness};
use endoscape_synthesis::warp::{correspond, sample_bilinear};
use endoscape_synthesis::{
    CameraPyramid, CameraScaling, LossTerms, ObjectiveConfig, OutOfView, Prediction, View, ViewBatch, objective,
    synthesize,
};

const POLICIES: [OutOfView; 3] = [OutOfView::Grey, OutOfView::Masked, OutOfView::Border];

fn picture(seed: u64, batch: usize) -> Tensor<4> {
    noise_tensor(seed, [batch, 3, SIZE.height, SIZE.width], -1.0, 1.0)
}

fn map(seed: u64, batch: usize, low: f64, high: f64) -> Tensor<4> {
    noise_tensor(seed, [batch, 1, SIZE.height, SIZE.width], low, high)
}

fn motion(seed: u64, batch: usize, size: f64) -> Tensor<4> {
    noise_tensor(seed, [batch, 1, 1, 6], -size, size)
}

fn transform(motion: &Tensor<4>, rotation: Rotation) -> Tensor<3> {
    let [batch, _, _, _] = motion.dims();
    source_from_target(motion.clone().reshape([batch, 6]), rotation)
}

#[test]
fn rigid_transforms() {
    for rotation in [Rotation::Euler, Rotation::Quaternion, Rotation::AxisAngle] {
        // No motion at all, small enough for the series, just above their limit, and large.
        for (seed, size) in [(1, 0.0), (2, 1e-4), (3, 0.15), (4, 2.0)] {
            let name = format!("{rotation:?} {size}");
            assert_gradient(&name, &[motion(seed, 2, size)], |x| weighted_sum(transform(&x[0], rotation)));
        }
    }
}

#[test]
fn projection_through_every_lens() {
    for (name, camera) in cameras() {
        let batch = batch_of(&[camera], SIZE);
        let inputs = [map(5, 1, 0.5, 2.0), motion(6, 1, 0.1)];
        assert_gradient(name, &inputs, |x| {
            let found = correspond(x[0].clone(), transform(&x[1], Rotation::AxisAngle), &batch);
            weighted_sum(found.pixels) + weighted_sum(found.depth)
        });
    }
}

#[test]
fn projection_of_a_mixed_batch() {
    let cameras: Vec<Camera> = cameras().into_iter().map(|(_, camera)| camera).collect();
    let batch = batch_of(&cameras, SIZE);
    let inputs = [map(7, cameras.len(), 0.5, 2.0), motion(8, cameras.len(), 0.1)];
    assert_gradient("mixed", &inputs, |x| {
        weighted_sum(correspond(x[0].clone(), transform(&x[1], Rotation::Euler), &batch).pixels)
    });
}

#[test]
fn synthesis_under_every_policy_and_lens() {
    for (name, camera) in cameras() {
        let batch = batch_of(&[camera], SIZE);
        for policy in POLICIES {
            // Far enough that part of the picture leaves the view.
            let inputs = [map(9, 1, 0.6, 1.8), motion(10, 1, 0.25)];
            assert_gradient(&format!("{name} {policy:?}"), &inputs, |x| {
                let motion = transform(&x[1], Rotation::Euler);
                let synthesized = synthesize(picture(11, 1), x[0].clone(), motion, &batch, policy);
                weighted_sum(synthesized.image * synthesized.valid)
            });
        }
    }
}

#[test]
fn sampling_in_position_and_picture() {
    let inside = noise_tensor(12, [1, 2, 3, 4], 0.1, 3.9);
    let around = noise_tensor(13, [1, 2, 3, 4], -2.0, 8.0);
    for pixels in [inside, around] {
        assert_gradient("sample", &[picture(14, 1), pixels], |x| {
            weighted_sum(sample_bilinear(x[0].clone(), x[1].clone()))
        });
    }
}

#[test]
fn photometric_errors() {
    for weight in [0.0, 0.85, 1.0] {
        assert_gradient(&format!("error {weight}"), &[picture(15, 2), picture(16, 2)], |x| {
            weighted_sum(photometric::photometric_error(x[0].clone(), x[1].clone(), weight))
        });
    }
}

#[test]
fn minima_and_averages() {
    let weights = || tensor((0..30).map(|at| f64::from(u8::from(at % 3 != 0))).collect(), [1, 1, 5, 6]);
    for by in [Average::ValidPixels, Average::AllPixels] {
        assert_gradient("minimum", &[map(17, 1, 0.0, 1.0), map(18, 1, 0.0, 1.0)], |x| {
            let valid = vec![weights(), weights().flip([3])];
            let (error, valid) = photometric::minimum_over_sources(x.to_vec(), valid);
            photometric::average(error, valid, by)
        });
    }
}

#[test]
fn regularisers() {
    for kind in [Smoothness::SecondOrderDisparity, Smoothness::SecondOrderDepth, Smoothness::EdgeAware] {
        assert_gradient(&format!("{kind:?}"), &[map(19, 2, 0.5, 3.0)], |x| {
            smoothness(x[0].clone(), &picture(20, 2), kind)
        });
    }
    let masks = noise_tensor(21, [2, 2, SIZE.height, SIZE.width], 0.05, 0.95);
    assert_gradient("mask", &[masks], |x| reliability_cross_entropy(x[0].clone()));
    assert_gradient("geometry", &[map(22, 1, 0.5, 3.0), map(23, 1, 0.5, 3.0)], |x| {
        weighted_sum(depth_disagreement(x[0].clone(), x[1].clone()))
    });
}

#[test]
fn brightness_alignment_and_enlarging() {
    let valid = tensor((0..60).map(|at| f64::from(u8::from(at % 4 != 0))).collect(), [2, 1, 5, 6]);
    assert_gradient("brightness", &[picture(24, 2), picture(25, 2)], |x| {
        weighted_sum(align_brightness(x[0].clone(), x[1].clone(), valid.clone()))
    });
    assert_gradient("enlarge", &[map(26, 1, 0.0, 1.0)], |x| weighted_sum(enlarge(x[0].clone(), [9, 11])));
}

/// Two pictures with two sources, two scales and masks; small numbers, all terms at work.
fn snippet(camera: Camera, count: usize, scaling: CameraScaling) -> ViewBatch {
    let usable = || Some(tensor((0..60).map(|at| f64::from(u8::from(at % 11 != 0))).collect(), [2, 1, 5, 6]));
    let view = |seed: u64| View { image: picture(seed, 2), usable: usable() };
    let sizes = pyramid::sizes(SIZE, count);
    let cameras = CameraPyramid::new(&[camera; 2], &sizes, scaling, options()).unwrap();
    ViewBatch { target: view(30), sources: vec![view(31), view(32)], cameras }
}

fn terms_of(x: &[Tensor<4>], batch: &ViewBatch, config: &ObjectiveConfig) -> LossTerms {
    let prediction = Prediction {
        disparities: x[0..2].to_vec(),
        masks: x[2..4].to_vec(),
        source_from_target: vec![transform(&x[4], Rotation::Euler), transform(&x[5], Rotation::Euler)],
        source_disparities: vec![x[6..8].to_vec(), x[8..10].to_vec()],
    };
    objective(batch, &prediction, config)
}

#[test]
fn distance_against_light() {
    for (name, camera) in cameras() {
        let batch = batch_of(&[camera], SIZE);
        let expected = noise_tensor(51, [1, 1, SIZE.height - 2, SIZE.width - 2], -1.0, 1.0);
        let usable = map(52, 1, 0.0, 1.0).greater_scalar(0.2).float().cast(expected.dtype());
        assert_gradient(name, &[map(53, 1, 0.5, 2.0)], |x| {
            distance_disagreement(x[0].clone(), expected.clone(), Some(usable.clone()), &batch)
        });
    }
}

#[test]
fn the_whole_objective_under_every_preset() {
    let coarse = |seed: u64, low: f64, high: f64| noise_tensor(seed, [2, 1, 3, 3], low, high);
    let inputs = [
        map(40, 2, 0.6, 1.6),
        coarse(41, 0.6, 1.6),
        noise_tensor(42, [2, 2, SIZE.height, SIZE.width], 0.2, 0.9),
        noise_tensor(43, [2, 2, 3, 3], 0.2, 0.9),
        motion(44, 2, 0.15),
        motion(45, 2, 0.15),
        map(46, 2, 0.6, 1.6),
        coarse(47, 0.6, 1.6),
        map(48, 2, 0.6, 1.6),
        coarse(49, 0.6, 1.6),
    ];
    let (_, camera) = cameras()[3];
    // Agreement of depths also weighs pixels, and normals decide what light says, deliberately without gradient; so the
    // default's total goes without both, and the terms are checked alone.
    let endo = ObjectiveConfig::endo();
    let without_agreement = ObjectiveConfig { geometry_weight: 0.0, light_weight: 0.0, ..ObjectiveConfig::endo() };
    for config in [ObjectiveConfig::paper(), ObjectiveConfig::port(), without_agreement] {
        let batch = snippet(camera, 2, config.camera_scaling);
        assert_gradient(&format!("{config:?}"), &inputs, |x| terms_of(x, &batch, &config).total);
    }
    let batch = snippet(camera, 2, endo.camera_scaling);
    assert_gradient("geometry of endo", &inputs, |x| terms_of(x, &batch, &endo).geometry);
}
