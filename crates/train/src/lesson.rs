//! What labels teach beside the pictures: the networks learn to say at once what a run found out with patience.
//!
//! At work the motions of the network are sharpened by aligning pictures, and depth is measured over many of them
//! (`endoscape-odometry`). Both are better than what the networks say alone, and both are known for the training video as
//! soon as a run has gone over it: labels that nobody drew. Their depth has one unit over a whole video, which the
//! photometric loss does not ask for: there every picture may have its own.
//!
//! The run must have looked through the camera that the training assumes.
//!
//! ```text
//! train --data VIDEO -> run VIDEO -> train --data VIDEO --labels RUN --init ...
//! ```
//! - depth: mean over pixels of `|log depth - log depth_label|`, scale included
//! - alignment: [`crate::alignment`]
//! - motion: mean over snippets and sources of `|t - t_label|_1 + |R - R_label|_1 / 2`; translation is in the unit of depth,
//!   of the order of the distance to the scene, so that it and the angle weigh alike

use crate::alignment::Start;
use crate::augment::turn::Turn;
use crate::augment::view::ViewChange;
use crate::clip::{ClipFrame, Label};
use crate::dataset::Item;
use crate::error::TrainError;
use burn::tensor::{Device, Tensor, TensorData};
use endoscape_core::{Pose, Size};
use endoscape_synthesis::Prediction;
use rand::Rng;
use serde::{Deserialize, Serialize};

/// How much labels count beside the photometric loss.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LessonConfig {
    /// Weight of the depth. Default 1.
    pub depth_weight: f64,
    /// Weight of the motions. Default 20: an error of a tenth of a usual motion, 0.005, then costs as much as one of a
    /// tenth of the depth.
    pub motion_weight: f64,
    /// Whether the alignment network learns, and nothing else: it shares nothing with the others and takes many more steps
    /// in the same time. Default off.
    pub alignment: bool,
}

impl Default for LessonConfig {
    fn default() -> Self {
        Self { depth_weight: 1.0, motion_weight: 20.0, alignment: false }
    }
}

impl LessonConfig {
    /// # Errors
    /// [`TrainError::Config`] for a weight that is no number from 0 on.
    pub fn validate(&self) -> Result<(), TrainError> {
        let weights = [("depth_weight", self.depth_weight), ("motion_weight", self.motion_weight)];
        match weights.into_iter().find(|(_, weight)| !(weight.is_finite() && *weight >= 0.0)) {
            Some((name, weight)) => {
                Err(TrainError::config(format!("lesson.{name}"), format!("is {weight} but must be 0 or above")))
            }
            None => Ok(()),
        }
    }
}

/// What the labels of a snippet say.
#[derive(Clone, Debug)]
pub struct Lesson {
    /// Of the target, 0 where unknown, row after row.
    depth: Vec<f32>,
    /// Of each source in time order.
    source_from_target: Vec<Pose>,
    /// See [`typical`].
    typical_depth: f64,
    /// For each source, where the alignment network begins.
    starts: Vec<Start>,
}

impl Lesson {
    /// The labels of a snippet, target first, as the changed and turned camera sees them; `None` unless every frame has one.
    pub fn of(frames: &[&ClipFrame], change: &ViewChange, turns: &[Option<Turn>], rng: &mut impl Rng) -> Option<Self> {
        let labels: Vec<&Label> = frames.iter().map(|frame| frame.label.as_ref()).collect::<Option<_>>()?;
        let (target, sources) = labels.split_first()?;
        let motion = |(source, turn): (&&Label, &Option<Turn>)| {
            let motion = change.motion(&(source.world_from_camera.inverse() * target.world_from_camera));
            turn.as_ref().map_or(motion, |turn| turn.motion(&motion))
        };
        let source_from_target: Vec<Pose> = sources.iter().zip(turns.iter().skip(1)).map(motion).collect();
        let depth = change.depth(&target.depth);
        let typical_depth = typical(&depth);
        let starts = source_from_target.iter().map(|label| Start::draw(label, typical_depth, rng)).collect();
        Some(Self { depth, source_from_target, typical_depth, starts })
    }
}

/// The lessons of a batch on a device; snippets without one have depth 0 and do not count.
#[derive(Clone, Debug)]
pub struct Lessons {
    /// `[batch, 1, height, width]`, 0 where unknown.
    depth: Tensor<4>,
    /// Of each source, `[batch, 3, 4]`.
    pub(crate) source_from_target: Vec<Tensor<3>>,
    /// Geometric mean of the known depths, `[batch, 1, 1]`.
    pub(crate) typical_depth: Tensor<3>,
    /// For each source, the motion that the alignment network begins with, `[batch, 3, 4]`.
    pub(crate) starts: Vec<Tensor<3>>,
    /// For each source, what is missing from it, `[batch, 6]`.
    pub(crate) left: Vec<Tensor<2>>,
    /// `[batch, 1, 1]`, 1 for snippets with a lesson, else 0.
    pub(crate) given: Tensor<3>,
}

/// How far a prediction is from the labels, each `[1]`.
#[derive(Clone, Debug)]
pub struct LessonLoss {
    /// Mean difference in logarithm of depth.
    pub depth: Tensor<1>,
    /// Mean difference of the motions.
    pub motion: Tensor<1>,
}

impl Lessons {
    /// Lays the lessons of snippets of one size and length side by side; `None` if there are none.
    pub fn new(items: &[Item], size: Size, device: &Device) -> Option<Self> {
        let lessons: Vec<Option<&Lesson>> = items.iter().map(|item| item.snippet.lesson.as_ref()).collect();
        let sources = lessons.iter().flatten().map(|lesson| lesson.source_from_target.len()).next()?;
        let batch = items.len();
        let depth =
            |lesson: &Option<&Lesson>| lesson.map_or_else(|| vec![0.0; size.area()], |known| known.depth.clone());
        let depth: Vec<f32> = lessons.iter().flat_map(depth).collect();
        let transforms = |of: &dyn Fn(&Lesson) -> Option<Pose>| {
            let rows = lessons.iter().flat_map(|lesson| rows(&lesson.and_then(of).unwrap_or_default()));
            Tensor::from_data(TensorData::new(rows.collect::<Vec<f32>>(), [batch, 3, 4]), device)
        };
        let motion = |source: usize| transforms(&|lesson| lesson.source_from_target.get(source).copied());
        let start = |source: usize| transforms(&|lesson| Some(lesson.starts.get(source)?.source_from_target));
        let left = |source: usize| {
            let start = |lesson: &Option<&Lesson>| lesson.and_then(|known| known.starts.get(source).copied());
            let numbers = lessons.iter().flat_map(|lesson| start(lesson).map_or([0.0; 6], |start| start.left));
            let numbers: Vec<f32> = numbers.map(|number| number as f32).collect();
            Tensor::from_data(TensorData::new(numbers, [batch, 6]), device)
        };
        let typical: Vec<f32> =
            lessons.iter().map(|lesson| lesson.map_or(1.0, |known| known.typical_depth as f32)).collect();
        let given: Vec<f32> = lessons.iter().map(|lesson| f32::from(u8::from(lesson.is_some()))).collect();
        Some(Self {
            depth: Tensor::from_data(TensorData::new(depth, [batch, 1, size.height, size.width]), device),
            source_from_target: (0..sources).map(motion).collect(),
            typical_depth: Tensor::from_data(TensorData::new(typical, [batch, 1, 1]), device),
            starts: (0..sources).map(start).collect(),
            left: (0..sources).map(left).collect(),
            given: Tensor::from_data(TensorData::new(given, [batch, 1, 1]), device),
        })
    }

    /// Compares what the networks say with the labels.
    pub fn loss(&self, prediction: &Prediction) -> LessonLoss {
        LessonLoss { depth: self.depth_loss(prediction), motion: self.motion_loss(prediction) }
    }

    fn depth_loss(&self, prediction: &Prediction) -> Tensor<1> {
        let Some(disparity) = prediction.disparities.first() else {
            return self.given.zeros_like().mean();
        };
        let known = self.depth.clone().greater_scalar(0.0).float().cast(self.depth.dtype());
        // Where nothing is known the logarithm is that of 1, which the mask takes out again.
        let label = (self.depth.clone() + (-known.clone() + 1.0)).log();
        let error = (disparity.clone().log() + label).abs() * known.clone();
        error.sum() / known.sum().clamp_min(1.0)
    }

    fn motion_loss(&self, prediction: &Prediction) -> Tensor<1> {
        // Rotation in the first three columns, translation in the last.
        let weights: Vec<f32> = (0..12).map(|entry| if entry % 4 == 3 { 1.0 } else { 0.5 }).collect();
        let weights = Tensor::<3>::from_data(TensorData::new(weights, [1, 3, 4]), &self.given.device());
        let pairs = prediction.source_from_target.iter().zip(&self.source_from_target);
        let errors =
            pairs.map(|(said, label)| ((said.clone() - label.clone()).abs() * weights.clone()).sum_dims(&[1, 2]));
        let error = Tensor::cat(errors.collect(), 1).mean_dim(1) * self.given.clone().mean_dim(1);
        error.sum() / self.given.clone().sum().clamp_min(1.0)
    }
}

impl LessonLoss {
    /// Both by their weights, `[1]`.
    pub fn weighted(&self, config: &LessonConfig) -> Tensor<1> {
        self.depth.clone() * config.depth_weight + self.motion.clone() * config.motion_weight
    }
}

/// The geometric mean of the depths that are known; 1 where none is.
fn typical(depth: &[f32]) -> f64 {
    let known = || depth.iter().filter(|depth| **depth > 0.0).map(|depth| f64::from(*depth).ln());
    (known().sum::<f64>() / known().count().max(1) as f64).exp()
}

/// `[R | t]` row after row.
fn rows(pose: &Pose) -> Vec<f32> {
    let matrix = pose.to_homogeneous();
    (0..12).map(|entry| matrix[(entry / 4, entry % 4)] as f32).collect()
}

#[cfg(test)]
mod tests;
