//! The objective's own bias: depth and motion as free variables stay at the truth of a made-up room.
//!
//! What a training cannot reach is then the fault of its networks or its budget, not of the objective.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "test helpers fail by panicking and say what they skip"
)]

mod common;

use burn::module::{Module, Param};
use burn::optim::{AdamConfig, GradientsParams};
use burn::tensor::{Device, Tensor, TensorData};
use common::{SIZE, room_clip};
use endoscape_core::{Pose, Rotation};
use endoscape_nets::network_input;
use endoscape_synthesis::config::Brightness;
use endoscape_synthesis::{
    CameraPyramid, CameraScaling, ObjectiveConfig, Prediction, View, ViewBatch, objective, source_from_target,
};
use endoscape_train::clip::Clip;

const FRAMES: usize = 5;
const TARGETS: usize = FRAMES - 2;
/// Adam moves every number by up to this in a step: a hundred steps can turn the depth into anything.
const RATE: f64 = 0.01;
const STEPS: usize = 100;

/// Disparity of every pixel of every frame, and the motions from each target to its two neighbours.
#[derive(Module, Debug)]
struct Free {
    /// Logarithm of the disparity, `[frames, 1, height, width]`.
    disparity: Param<Tensor<4>>,
    /// `[targets, 2, 6]`.
    motion: Param<Tensor<3>>,
}

impl Free {
    fn at_truth(clip: &Clip, device: &Device) -> Self {
        let disparity: Vec<f32> = true_depths(clip).iter().map(|depth| -depth.ln()).collect();
        let numbers = |motion: &Pose| {
            let (v, r) = (motion.translation.vector, motion.rotation.scaled_axis());
            [v.x, v.y, v.z, r.x, r.y, r.z].map(|number| number as f32)
        };
        let motion: Vec<f32> = true_motions(clip).iter().flat_map(numbers).collect();
        let tensor = |values: Vec<f32>, shape: &[usize]| TensorData::new(values, shape.to_vec());
        Self {
            disparity: Param::from_data(tensor(disparity, &[FRAMES, 1, SIZE.height, SIZE.width]), device),
            motion: Param::from_data(tensor(motion, &[TARGETS, 2, 6]), device),
        }
    }

    fn predict(&self) -> Prediction {
        let disparity = self.disparity.val().exp();
        let of = |first: usize| vec![disparity.clone().narrow(0, first, TARGETS)];
        let motion = |source: usize| self.motion.val().narrow(1, source, 1).squeeze_dim::<2>(1);
        Prediction {
            disparities: of(1),
            source_from_target: (0..2).map(|at| source_from_target(motion(at), Rotation::AxisAngle)).collect(),
            masks: Vec::new(),
            source_disparities: vec![of(0), of(2)],
        }
    }

    /// Errors against the truth: mean of depth, lengths of translation and rotation errors over those of the motions.
    fn errors(&self, clip: &Clip) -> [f64; 3] {
        let truth = true_depths(clip);
        let found: Vec<f32> = self.disparity.val().neg().exp().into_data().iter().collect();
        let judged = SIZE.area()..SIZE.area() * (FRAMES - 1);
        let mut ratios: Vec<f64> = judged.map(|pixel| f64::from(found[pixel] / truth[pixel])).collect();
        ratios.sort_by(f64::total_cmp);
        let scale = 1.0 / ratios[ratios.len() / 2];
        let depth = ratios.iter().map(|ratio| (ratio * scale - 1.0).abs()).sum::<f64>() / ratios.len() as f64;
        let motion: Vec<f32> = self.motion.val().into_data().iter().collect();
        let (mut errors, mut lengths) = ([0.0; 2], [0.0; 2]);
        for (numbers, truth) in motion.chunks_exact(6).zip(true_motions(clip)) {
            let found = Rotation::AxisAngle.pose(std::array::from_fn(|index| f64::from(numbers[index])));
            errors[0] += (found.translation.vector * scale - truth.translation.vector).norm();
            errors[1] += found.rotation.angle_to(&truth.rotation);
            lengths[0] += truth.translation.vector.norm();
            lengths[1] += truth.rotation.angle();
        }
        [depth, errors[0] / lengths[0], errors[1] / lengths[1]]
    }
}

fn true_depths(clip: &Clip) -> Vec<f32> {
    clip.frames.iter().flat_map(|frame| frame.depth.as_ref().unwrap().grid().values().to_vec()).collect()
}

fn true_motions(clip: &Clip) -> Vec<Pose> {
    let pose = |frame: usize| clip.frames[frame].world_from_camera.unwrap();
    let to_neighbours = |target: usize| [target - 1, target + 1].map(|source| pose(source).inverse() * pose(target));
    (1..=TARGETS).flat_map(to_neighbours).collect()
}

fn views(clip: &Clip, device: &Device) -> ViewBatch {
    let image = |frame: usize| network_input(&clip.frames[frame].image, device);
    let view =
        |first: usize| View { image: Tensor::cat((first..first + TARGETS).map(image).collect(), 0), usable: None };
    let cameras = CameraPyramid::new(&[clip.camera; TARGETS], &[SIZE], CameraScaling::Exact, device).unwrap();
    ViewBatch { target: view(1), sources: vec![view(0), view(2)], cameras }
}

#[test]
fn the_truth_is_a_minimum_of_the_objective() {
    let device = Device::flex().autodiff();
    let clip = room_clip(FRAMES);
    let batch = views(&clip, &device);
    // The room is lit by daylight, not by a lamp at the lens.
    let config = ObjectiveConfig {
        auto_mask: false,
        brightness: Brightness::Constant,
        light_weight: 0.0,
        ..ObjectiveConfig::endo()
    };
    let mut free = Free::at_truth(&clip, &device);
    let mut adam = AdamConfig::new().with_epsilon(1e-8).init();
    for step in 0..STEPS {
        let total = objective(&batch, &free.predict(), &config).total;
        let gradients = GradientsParams::from_grads(total.backward(), &free);
        free = adam.step(RATE * (1.0 - step as f64 / STEPS as f64), free, gradients);
    }
    let [depth, translation, rotation] = free.errors(&clip);
    assert!(depth < 0.03 && translation < 0.03 && rotation < 0.03, "{depth} {translation} {rotation}");
    assert!(depth > 1e-4, "nothing moved");
}
