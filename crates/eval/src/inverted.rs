//! Finds estimates that are good but written the wrong way round.
//!
//! Two mistakes are common: writing `camera_from_world` where `world_from_camera` is meant, and chaining every motion
//! from frame to frame inverted. Snippet errors see neither.

use crate::align::umeyama;
use crate::poses::{MatrixPose, path_steps_m};

/// The inverse has to fit this much better before a warning is worth reading.
const MUCH_BETTER: f64 = 0.5;

/// Misfits below this share of the path are rounding.
const EXACT: f64 = 1e-6;

/// How an estimate seems to be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inversion {
    /// Each pose is the inverse of what it should be.
    Poses,
    /// Each motion from frame to frame is.
    Motions,
}

/// An inverse that fits much better than the estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inverted {
    /// What has to be inverted.
    pub inversion: Inversion,
    /// Misfit of the estimate: RMSE after the best similarity, metres; or of its steps where the path is straight.
    pub misfit_m: f64,
    /// The same of the inverse.
    pub inverse_misfit_m: f64,
}

impl std::fmt::Display for Inverted {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let what = match self.inversion {
            Inversion::Poses => "the inverse of each pose",
            Inversion::Motions => "the chain of inverted motions",
        };
        write!(
            formatter,
            "{what} fits the truth much better ({:.3e} m instead of {:.3e} m): the estimate seems to hold camera_from_world where world_from_camera is meant",
            self.inverse_misfit_m, self.misfit_m
        )
    }
}

/// Looks for an inverse that fits much better, by position or by the motions from frame to frame.
pub fn detect(estimate: &[MatrixPose], truth: &[MatrixPose]) -> Option<Inverted> {
    let floor = EXACT * path_steps_m(truth).iter().sum::<f64>();
    let misfits = [position_misfit, motion_misfit].map(|misfit| (misfit, misfit(estimate, truth)));
    let candidates = [(Inversion::Poses, inverse_poses(estimate)), (Inversion::Motions, inverse_motions(estimate))];
    let better = candidates.iter().flat_map(|(inversion, inverse)| {
        misfits.iter().filter_map(|(misfit, misfit_m)| {
            let inverse_misfit_m = misfit(inverse, truth);
            (*misfit_m > floor && inverse_misfit_m < MUCH_BETTER * misfit_m).then_some(Inverted {
                inversion: *inversion,
                misfit_m: *misfit_m,
                inverse_misfit_m,
            })
        })
    });
    let gain = |inverted: &Inverted| inverted.inverse_misfit_m / inverted.misfit_m;
    better.min_by(|a, b| gain(a).total_cmp(&gain(b)))
}

fn inverse_poses(poses: &[MatrixPose]) -> Vec<MatrixPose> {
    poses.iter().map(MatrixPose::inverse).collect()
}

fn inverse_motions(poses: &[MatrixPose]) -> Vec<MatrixPose> {
    let mut inverse = poses.first().copied().into_iter().collect::<Vec<_>>();
    let mut last = inverse.first().copied().unwrap_or_else(MatrixPose::identity);
    for pair in poses.windows(2) {
        last *= pair[1].inv_mul(&pair[0]);
        inverse.push(last);
    }
    inverse
}

/// RMSE of positions after the best similarity.
fn position_misfit(estimate: &[MatrixPose], truth: &[MatrixPose]) -> f64 {
    let fit = umeyama(estimate, truth, true).similarity;
    let square = |(estimate, truth): (&MatrixPose, &MatrixPose)| {
        (fit.apply(estimate).translation.vector - truth.translation.vector).norm_squared()
    };
    (estimate.iter().zip(truth).map(square).sum::<f64>() / estimate.len().max(1) as f64).sqrt()
}

/// RMSE of the steps from frame to frame, each seen from its own first frame, after the best positive scale.
fn motion_misfit(estimate: &[MatrixPose], truth: &[MatrixPose]) -> f64 {
    let step = |pair: &[MatrixPose]| pair[0].inv_mul(&pair[1]).translation.vector;
    let steps: Vec<_> = estimate.windows(2).map(step).zip(truth.windows(2).map(step)).collect();
    let squares: f64 = steps.iter().map(|(p, _)| p.norm_squared()).sum();
    let scale = (steps.iter().map(|(p, g)| p.dot(g)).sum::<f64>() / squares).max(0.0);
    let scale = if scale.is_finite() { scale } else { 0.0 };
    (steps.iter().map(|(p, g)| (g - p * scale).norm_squared()).sum::<f64>() / steps.len().max(1) as f64).sqrt()
}
