//! How far the network's motions are from the truth, streamed over whole stretches as at work.

use super::clip::{PosedClip, PosedFrame};
use super::draw::Passage;
use super::loss::MotionLoss;
use crate::error::TrainError;
use burn::tensor::{Device, Tensor};
use endoscape_nets::{Memory, RecurrentVo};
use std::collections::BTreeMap;

/// Pairs shown to the network at once; more bring nothing and cost memory.
const AT_ONCE: usize = 16;

/// What a validation found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MotionScores {
    /// Mean of what training minimises.
    pub loss: f64,
    /// Summed length of the translation errors over that of the true translations; standing still has 1.
    pub translation: f64,
    /// The same of the rotations.
    pub rotation: f64,
}

impl MotionScores {
    /// The figures by name.
    pub fn named(&self) -> BTreeMap<String, f64> {
        let figures = [("loss", self.loss), ("translation", self.translation), ("rotation", self.rotation)];
        figures.map(|(name, value)| (name.to_owned(), value)).into()
    }
}

/// Sums over pairs, in the order: squared errors, error lengths and true lengths of translation, then of rotation.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    pairs: usize,
    of: [f64; 6],
}

impl Sums {
    /// # Shapes
    /// - `motion`, `truth`: `[1, time, 6]`
    fn add(&mut self, motion: &Tensor<3>, truth: &Tensor<3>) -> Result<(), TrainError> {
        let MotionLoss { translation, rotation, .. } = MotionLoss::new(motion.clone(), truth.clone(), 0.0);
        let time = truth.dims()[1];
        let length = |vectors: Tensor<3>, first: usize| vectors.narrow(2, first, 3).square().sum_dim(2).sqrt().sum();
        let sums = |squared: Tensor<1>, first: usize| {
            let error = length(motion.clone() - truth.clone(), first);
            [squared.mul_scalar(time as f64), error, length(truth.clone(), first)]
        };
        let figures = Tensor::cat([sums(translation, 0), sums(rotation, 3)].concat(), 0);
        let unreadable = |error| TrainError::config("device", format!("failed during validation: {error:?}"));
        let figures = figures.try_into_data().map_err(unreadable)?;
        self.pairs += time;
        self.of.iter_mut().zip(figures.iter::<f32>()).for_each(|(sum, figure)| *sum += f64::from(figure));
        Ok(())
    }

    fn scores(&self, rotation_weight: f64) -> MotionScores {
        let [squared_t, error_t, true_t, squared_w, error_w, true_w] = self.of;
        let share = |error: f64, truth: f64| if truth > 0.0 { error / truth } else { error };
        MotionScores {
            loss: (squared_t + rotation_weight * squared_w) / self.pairs.max(1) as f64,
            translation: share(error_t, true_t),
            rotation: share(error_w, true_w),
        }
    }
}

/// Streams the network over the begin of every stretch, together at most about `most_frames` frames; `device` is one
/// without gradients, and so is the network's.
///
/// # Errors
/// [`TrainError::Config`] if the device fails.
pub fn measure(
    net: &RecurrentVo,
    clips: &[PosedClip],
    (unit_m, rotation_weight): (f64, f64),
    most_frames: usize,
    device: &Device,
) -> Result<MotionScores, TrainError> {
    let stretches: Vec<&Vec<PosedFrame>> = clips.iter().flat_map(|clip| &clip.stretches).collect();
    let each = (most_frames / stretches.len().max(1)).max(2);
    let mut sums = Sums::default();
    for stretch in stretches {
        let frames = &stretch[..stretch.len().min(each)];
        let mut memory: Option<Memory> = None;
        for first in (0..frames.len() - 1).step_by(AT_ONCE) {
            let last = (first + AT_ONCE).min(frames.len() - 1);
            let Passage { pairs, truth } = Passage::plain(&frames[first..=last], unit_m, device);
            let (motion, next) = net.forward(pairs, memory);
            sums.add(&motion, &truth)?;
            memory = Some(next);
        }
    }
    Ok(sums.scores(rotation_weight))
}
