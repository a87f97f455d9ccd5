//! Inputs no network should produce and some will: the loss and every gradient stay finite.
#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "test helpers fail by panicking and say what they skip")]

mod common;

use burn::tensor::Tensor;
use common::{SIZE, cameras, noise, noise_tensor, number, options, tensor, values};
use endoscape_core::Camera;
use endoscape_synthesis::motion::{Rotation, source_from_target};
use endoscape_synthesis::{CameraPyramid, LossTerms, ObjectiveConfig, Prediction, View, ViewBatch, objective, pyramid};

const SHAPE: [usize; 4] = [1, 1, SIZE.height, SIZE.width];
const POISON: [f64; 7] = [0.0, -1.0, 1e-30, 1e30, f64::NAN, f64::INFINITY, f64::NEG_INFINITY];

struct Inputs {
    disparities: Tensor<4>,
    source_disparities: Tensor<4>,
    mask: Tensor<4>,
    motion: Tensor<2>,
}

impl Inputs {
    fn sane() -> Self {
        let map = |seed| noise_tensor(seed, SHAPE, 0.5, 2.0);
        let motion = noise_tensor(3, [1, 6], -0.1, 0.1);
        Self { disparities: map(1), source_disparities: map(2), mask: map(4) * 0.4, motion }
    }
}

fn view(seed: u64, usable: Option<f64>) -> View {
    let image = noise_tensor(seed, [1, 3, SIZE.height, SIZE.width], -1.0, 1.0);
    View { image, usable: usable.map(|value| tensor(vec![value; SIZE.area()], SHAPE)) }
}

fn assert_finite(name: &str, camera: Camera, inputs: &Inputs, usable: Option<f64>) {
    for config in [ObjectiveConfig::paper(), ObjectiveConfig::port(), ObjectiveConfig::endo()] {
        let sizes = pyramid::sizes(SIZE, 1);
        let cameras = CameraPyramid::new(&[camera], &sizes, config.camera_scaling, options()).unwrap();
        let batch = ViewBatch { target: view(5, usable), sources: vec![view(6, usable)], cameras };
        let track = |map: &Tensor<4>| map.clone().autodiff().require_grad();
        let maps = [&inputs.disparities, &inputs.source_disparities, &inputs.mask].map(track);
        let motion = inputs.motion.clone().autodiff().require_grad();
        let prediction = Prediction {
            disparities: vec![maps[0].clone()],
            source_from_target: vec![source_from_target(motion.clone(), Rotation::AxisAngle)],
            masks: vec![maps[2].clone()],
            source_disparities: vec![vec![maps[1].clone()]],
        };
        let LossTerms { total, .. } = objective(&batch, &prediction, &config);
        assert!(number(total.clone().inner()).is_finite(), "{name}: {config:?}");
        let gradients = total.backward();
        let of_maps = maps.iter().filter_map(|map| map.grad(&gradients)).flat_map(values);
        let of_motion = motion.grad(&gradients).into_iter().flat_map(values);
        assert!(of_maps.chain(of_motion).all(f64::is_finite), "{name}: a gradient is not finite under {config:?}");
    }
}

/// Poison in every second pixel.
fn poisoned(value: f64) -> Tensor<4> {
    let mut numbers = noise(7, SIZE.area(), 0.5, 2.0);
    numbers.iter_mut().step_by(2).for_each(|number| *number = value);
    tensor(numbers, SHAPE)
}

#[test]
fn poisoned_depth() {
    for (name, camera) in cameras() {
        for value in POISON {
            let disparities = poisoned(value);
            let source_disparities = poisoned(value);
            let inputs = Inputs { disparities, source_disparities, ..Inputs::sane() };
            assert_finite(&format!("{name} with {value}"), camera, &inputs, None);
        }
    }
}

#[test]
fn nothing_but_poison() {
    let (_, camera) = cameras()[0];
    for value in POISON {
        let all = || tensor(vec![value; SIZE.area()], SHAPE);
        let inputs = Inputs { disparities: all(), source_disparities: all(), ..Inputs::sane() };
        assert_finite(&format!("all {value}"), camera, &inputs, None);
    }
}

#[test]
fn huge_motions() {
    for (name, camera) in cameras() {
        for values in [[1e6, -1e6, 1e6, 0.0, 0.0, 0.0], [0.0, 0.0, -50.0, 3.0, -3.0, 3.0], [0.0; 6]] {
            let inputs = Inputs { motion: tensor(values.to_vec(), [1, 6]), ..Inputs::sane() };
            assert_finite(&format!("{name} moved by {values:?}"), camera, &inputs, None);
        }
    }
}

#[test]
fn empty_and_dead_masks() {
    let (name, camera) = cameras()[3];
    assert_finite(name, camera, &Inputs::sane(), Some(0.0));
    for value in [0.0, 1.0] {
        let inputs = Inputs { mask: tensor(vec![value; SIZE.area()], SHAPE), ..Inputs::sane() };
        assert_finite(&format!("mask of {value}"), camera, &inputs, Some(1.0));
    }
}

#[test]
fn black_pictures() {
    let (_, camera) = cameras()[0];
    let config = ObjectiveConfig::endo();
    let cameras = CameraPyramid::new(&[camera], &[SIZE], config.camera_scaling, options()).unwrap();
    let black = || View { image: tensor(vec![-1.0; 3 * SIZE.area()], [1, 3, SIZE.height, SIZE.width]), usable: None };
    let sane = Inputs::sane();
    let disparity = sane.disparities.autodiff().require_grad();
    let prediction = Prediction {
        disparities: vec![disparity.clone()],
        source_from_target: vec![source_from_target(sane.motion, Rotation::Euler)],
        masks: Vec::new(),
        source_disparities: Vec::new(),
    };
    let total = objective(&ViewBatch { target: black(), sources: vec![black()], cameras }, &prediction, &config).total;
    assert!(number(total.clone().inner()).is_finite());
    assert!(values(disparity.grad(&total.backward()).unwrap()).iter().all(|gradient| gradient.is_finite()));
}
