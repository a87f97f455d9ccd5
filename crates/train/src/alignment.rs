//! Teaching the alignment network: from motions that are wrong on purpose to those of the labels.
//!
//! A motion network that is shown the pictures of a few recordings can recall how the camera moved where. This one is
//! shown what is wrong with a motion that was drawn at random around the label, so there is nothing to recall: to say what
//! is left it has to measure. Errors of all sizes are drawn, from a whole motion down to a fiftieth of one, because at
//! work the network looks again after each of its answers.

use crate::batch::SnippetBatch;
use crate::lesson::Lessons;
use burn::tensor::{Tensor, TensorData};
use endoscape_core::Pose;
use endoscape_nets::AlignNet;
use endoscape_synthesis::alignment::{self, Alignment, contrast};
use nalgebra::Vector3;
use rand::{Rng, RngExt};

// What one crate makes the other reads.
const _: () = assert!(alignment::EVIDENCE_CHANNELS == endoscape_nets::EVIDENCE_CHANNELS);

/// Share of the starts that take the camera to stand still.
const REST: f64 = 0.25;
/// The largest errors of a start: translation in typical depths, rotation in radians; each moves a picture by some
/// hundredths of its width, as motions within a snippet do.
const LARGEST: [f64; 6] = [0.1, 0.1, 0.1, 0.03, 0.03, 0.03];
/// The smallest errors, as a share of the largest.
const SMALLEST: f64 = 0.02;
/// Errors below this share of the largest count no more than if they had that size: labels are no better.
const NOISE: f64 = 0.03;
/// How often the network looks when it is measured.
const LOOKS: usize = 3;

/// A motion to begin with, and what is missing from it.
#[derive(Clone, Copy, Debug)]
pub struct Start {
    /// The wrong motion, translation in the unit of depth.
    pub source_from_target: Pose,
    /// What comes after it: translation in typical depths, then axis times angle.
    pub left: [f64; 6],
}

impl Start {
    /// Draws a start for a labelled motion, translation in a unit in which depth is typically `typical_depth`.
    pub fn draw(label: &Pose, typical_depth: f64, rng: &mut impl Rng) -> Self {
        let size = SMALLEST.powf(rng.random());
        let error: [f64; 6] = std::array::from_fn(|k| size * LARGEST[k] * rng.random_range(-2.0..2.0));
        let [x, y, z, rx, ry, rz] = error;
        let error = Pose::new(Vector3::new(x, y, z) * typical_depth, Vector3::new(rx, ry, rz));
        let start = if rng.random_bool(REST) { Pose::identity() } else { error * label };
        Self::new(start, label, typical_depth)
    }

    fn new(source_from_target: Pose, label: &Pose, typical_depth: f64) -> Self {
        let left = label * source_from_target.inverse();
        let (t, w) = (left.translation.vector / typical_depth, left.rotation.scaled_axis());
        Self { source_from_target, left: [t.x, t.y, t.z, w.x, w.y, w.z] }
    }
}

/// How far the network's answers are from what is left, relative to it, `[1]`: 1 where it says that nothing is.
///
/// The network sees `depth` as the depth network has it, errors and all, as it will at work.
///
/// # Shapes
/// - `depth`: of the targets, `[batch, 1, height, width]`, without a gradient
pub fn alignment_loss(net: &AlignNet, batch: &SnippetBatch, lessons: &Lessons, depth: Tensor<4>) -> Tensor<1> {
    let (alignment, unit) = prepared(batch, lessons, depth);
    let evidence = |(start, source): (&Tensor<3>, &Tensor<4>)| {
        alignment.evidence(contrast(source.clone()), in_unit(start.clone(), unit.clone()))
    };
    let evidence: Vec<_> = lessons.starts.iter().zip(&batch.depth_inputs[1..]).map(evidence).collect();
    let answers = net.forward(Tensor::cat(evidence, 0));
    let left = Tensor::cat(lessons.left.clone(), 0);
    let size = in_largest(left.clone()) + NOISE;
    let error = in_largest(answers - left) / size;
    let given = lessons.given.clone().reshape([lessons.given.dims()[0], 1]).repeat_dim(0, lessons.starts.len());
    (error * given.clone()).sum() / given.sum().clamp_min(1.0)
}

/// What is left of the labelled motions after the network has looked from rest, as a share of them, `[1]`.
///
/// # Shapes
/// - as [`alignment_loss`]
pub fn alignment_error(net: &AlignNet, batch: &SnippetBatch, lessons: &Lessons, depth: Tensor<4>) -> Tensor<1> {
    let (alignment, unit) = prepared(batch, lessons, depth);
    let (mut error, mut whole) = (Vec::new(), Vec::new());
    for (label, source) in lessons.source_from_target.iter().zip(&batch.depth_inputs[1..]) {
        let label = in_unit(label.clone(), unit.clone());
        let source = contrast(source.clone());
        let rest = Tensor::<2>::eye(4, &label.device()).narrow(0, 0, 3).cast(label.dtype()).unsqueeze::<3>();
        let rest = rest.expand(label.dims());
        let look = |motion: Tensor<3>| {
            let left = net.forward(alignment.evidence(source.clone(), motion.clone()));
            alignment.corrected(left, motion)
        };
        let found = (0..LOOKS).fold(rest.clone(), |motion, _| look(motion));
        let distance =
            |motion: Tensor<3>| (alignment.distance(motion, label.clone()) * lessons.given.clone().flatten(0, 2)).sum();
        error.push(distance(found));
        whole.push(distance(rest));
    }
    let sum = |parts: Vec<Tensor<1>>| Tensor::cat(parts, 0).sum();
    sum(error) / sum(whole).clamp_min(f64::from(f32::MIN_POSITIVE))
}

/// The targets, and the unit of the labels in that of `depth`, `[batch, 1, 1]`: both maps are typically as deep.
fn prepared(batch: &SnippetBatch, lessons: &Lessons, depth: Tensor<4>) -> (Alignment, Tensor<3>) {
    let alignment = Alignment::new(batch.depth_inputs[0].clone(), depth, &batch.views.cameras.levels()[0]);
    let unit = alignment.typical_depth().unsqueeze_dim(2) / lessons.typical_depth.clone();
    (alignment, unit)
}

/// A motion with its translation in another unit.
fn in_unit(motion: Tensor<3>, unit: Tensor<3>) -> Tensor<3> {
    let translation = motion.clone().narrow(2, 3, 1) * unit;
    Tensor::cat(vec![motion.narrow(2, 0, 3), translation], 2)
}

/// Mean size of the parts of a motion, each in its [`LARGEST`], `[batch, 1]`.
fn in_largest(motion: Tensor<2>) -> Tensor<2> {
    let parts: Vec<f32> = LARGEST.iter().map(|largest| 1.0 / *largest as f32).collect();
    let parts = Tensor::<2>::from_data(TensorData::new(parts, [1, 6]), &motion.device()).cast(motion.dtype());
    (motion.abs() * parts).mean_dim(1)
}

#[cfg(test)]
mod tests;
