//! Errors of all sub-trajectories of given lengths: drift against the path travelled, and against the rotation gone
//! through.
//!
//! The method of the KITTI odometry benchmark (A. Geiger et al., "Are we ready for autonomous driving?", 2012): from
//! each starting frame to the first frame whose path along the truth is longer than the length; the error motion is
//! `estimated_motion^-1 * true_motion`.

use crate::ape::angle_rad;
use crate::poses::{MatrixPose, accumulated, path_steps_m, turn_steps_rad};
use crate::stats::Spread;
use rayon::prelude::*;
use serde::Serialize;

/// Lengths of the capsule paper, metres: 10 to 50 cm.
const CAPSULE_LENGTHS_M: [f64; 5] = [0.1, 0.2, 0.3, 0.4, 0.5];

/// Lengths of the KITTI benchmark, metres.
const KITTI_LENGTHS_M: [f64; 8] = [100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0];

/// The KITTI benchmark starts a segment every tenth frame.
const KITTI_STEP: usize = 10;

/// Rotations errors are listed for, degrees; the capsule paper discusses changes of 5 degrees and more.
const ROTATIONS_DEG: [f64; 6] = [5.0, 10.0, 20.0, 30.0, 60.0, 90.0];

/// Which sub-trajectories are taken.
#[derive(Clone, Debug, PartialEq)]
pub struct SegmentPlan {
    /// Lengths along the true path, metres.
    pub lengths_m: Vec<f64>,
    /// Accumulated true rotations, degrees.
    pub rotations_deg: Vec<f64>,
    /// Frames from one start to the next, at least 1.
    pub step: usize,
}

impl SegmentPlan {
    /// What suits a path: the KITTI benchmark's from 100 m on, the capsule paper's from 10 cm on, tenths of shorter ones.
    pub fn for_path(path_m: f64) -> Self {
        let (lengths_m, step) = if path_m > KITTI_LENGTHS_M[0] {
            (KITTI_LENGTHS_M.to_vec(), KITTI_STEP)
        } else if path_m > CAPSULE_LENGTHS_M[0] {
            (CAPSULE_LENGTHS_M.to_vec(), 1)
        } else {
            (CAPSULE_LENGTHS_M.map(|length| length * path_m).to_vec(), 1)
        };
        Self { lengths_m, rotations_deg: ROTATIONS_DEG.to_vec(), step }
    }
}

/// Errors over all sub-trajectories of one length. Lengths that never occur are left out of the list.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LengthErrors {
    /// Length along the true path, metres.
    pub length_m: f64,
    /// Number of sub-trajectories.
    pub count: usize,
    /// Mean translational error at the end, metres.
    pub translation_m: f64,
    /// Its standard deviation.
    pub translation_m_std: f64,
    /// 95 % interval of its mean.
    pub translation_m_ci95: [f64; 2],
    /// Mean translational error as a share of the length, percent.
    pub translation_percent: f64,
    /// Mean rotational error at the end, degrees.
    pub rotation_deg: f64,
    /// Its standard deviation.
    pub rotation_deg_std: f64,
    /// 95 % interval of its mean.
    pub rotation_deg_ci95: [f64; 2],
    /// Mean rotational error per metre, degrees.
    pub rotation_deg_per_m: f64,
}

/// Errors over all sub-trajectories that go through one amount of rotation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TurnErrors {
    /// Rotation of the truth accumulated from frame to frame, degrees.
    pub turned_deg: f64,
    /// Number of sub-trajectories.
    pub count: usize,
    /// Mean translational error at the end, metres.
    pub translation_m: f64,
    /// Its standard deviation.
    pub translation_m_std: f64,
    /// Mean rotational error at the end, degrees.
    pub rotation_deg: f64,
    /// Its standard deviation.
    pub rotation_deg_std: f64,
    /// 95 % interval of its mean.
    pub rotation_deg_ci95: [f64; 2],
}

/// The mean over all sub-trajectories of all lengths: the two figures KITTI ranks by.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SegmentMean {
    /// Translational error, percent of the length.
    pub translation_percent: f64,
    /// Rotational error, degrees per metre.
    pub rotation_deg_per_m: f64,
}

/// Sub-trajectories of a truth, ready to judge several estimates.
#[derive(Clone, Debug)]
pub struct Segments {
    lengths: Vec<(f64, Vec<(usize, usize)>)>,
    turns: Vec<(f64, Vec<(usize, usize)>)>,
    step: usize,
}

impl Segments {
    /// Cuts the truth according to the plan.
    pub fn of(truth: &[MatrixPose], plan: &SegmentPlan) -> Self {
        let step = plan.step.max(1);
        let travelled_m = accumulated(&path_steps_m(truth));
        let turned_rad = accumulated(&turn_steps_rad(truth));
        let lengths = plan.lengths_m.iter().map(|length| (*length, cut(&travelled_m, *length, step))).collect();
        let turns = plan.rotations_deg.iter().map(|deg| (*deg, cut(&turned_rad, deg.to_radians(), step))).collect();
        Self { lengths, turns, step }
    }

    /// Errors by length, shortest first as planned.
    pub fn by_length(&self, estimate: &[MatrixPose], truth: &[MatrixPose]) -> Vec<LengthErrors> {
        self.lengths.iter().filter_map(|(length, pairs)| self.length_errors(*length, pairs, estimate, truth)).collect()
    }

    /// Errors by accumulated rotation.
    pub fn by_turn(&self, estimate: &[MatrixPose], truth: &[MatrixPose]) -> Vec<TurnErrors> {
        self.turns.iter().filter_map(|(turned, pairs)| self.turn_errors(*turned, pairs, estimate, truth)).collect()
    }

    fn length_errors(
        &self,
        length_m: f64,
        pairs: &[(usize, usize)],
        estimate: &[MatrixPose],
        truth: &[MatrixPose],
    ) -> Option<LengthErrors> {
        let (translation, rotation) = self.spreads(pairs, estimate, truth)?;
        Some(LengthErrors {
            length_m,
            count: pairs.len(),
            translation_m: translation.mean,
            translation_m_std: translation.std,
            translation_m_ci95: translation.ci95,
            translation_percent: 100.0 * translation.mean / length_m,
            rotation_deg: rotation.mean,
            rotation_deg_std: rotation.std,
            rotation_deg_ci95: rotation.ci95,
            rotation_deg_per_m: rotation.mean / length_m,
        })
    }

    fn turn_errors(
        &self,
        turned_deg: f64,
        pairs: &[(usize, usize)],
        estimate: &[MatrixPose],
        truth: &[MatrixPose],
    ) -> Option<TurnErrors> {
        let (translation, rotation) = self.spreads(pairs, estimate, truth)?;
        Some(TurnErrors {
            turned_deg,
            count: pairs.len(),
            translation_m: translation.mean,
            translation_m_std: translation.std,
            rotation_deg: rotation.mean,
            rotation_deg_std: rotation.std,
            rotation_deg_ci95: rotation.ci95,
        })
    }

    /// Translation in metres, rotation in degrees.
    fn spreads(
        &self,
        pairs: &[(usize, usize)],
        estimate: &[MatrixPose],
        truth: &[MatrixPose],
    ) -> Option<(Spread, Spread)> {
        let (translation_m, rotation_deg) = errors(pairs, estimate, truth);
        // Segments that start within one another's extent share frames.
        let frames: usize = pairs.iter().map(|(start, end)| end - start).sum();
        let overlap = frames / pairs.len().max(1) / self.step + 1;
        Some((Spread::of(&translation_m, overlap)?, Spread::of(&rotation_deg, overlap)?))
    }
}

/// The mean over all sub-trajectories, weighted by their number as KITTI does; `None` if there are none.
pub fn overall(lengths: &[LengthErrors]) -> Option<SegmentMean> {
    let count: usize = lengths.iter().map(|errors| errors.count).sum();
    let weighted = |figure: fn(&LengthErrors) -> f64| {
        lengths.iter().map(|errors| figure(errors) * errors.count as f64).sum::<f64>() / count as f64
    };
    (count > 0).then(|| SegmentMean {
        translation_percent: weighted(|errors| errors.translation_percent),
        rotation_deg_per_m: weighted(|errors| errors.rotation_deg_per_m),
    })
}

/// From every `step`-th pose to the first one more than `length` further along.
fn cut(travelled: &[f64], length: f64, step: usize) -> Vec<(usize, usize)> {
    let end_of = |start: usize| {
        let end = travelled.partition_point(|distance| *distance <= travelled[start] + length);
        (end < travelled.len()).then_some((start, end))
    };
    (0..travelled.len()).step_by(step).map_while(end_of).collect()
}

/// Translational errors in metres and rotational ones in degrees.
fn errors(pairs: &[(usize, usize)], estimate: &[MatrixPose], truth: &[MatrixPose]) -> (Vec<f64>, Vec<f64>) {
    let error = |(start, end): &(usize, usize)| {
        let estimated = estimate[*start].inv_mul(&estimate[*end]);
        let error = estimated.inv_mul(&truth[*start].inv_mul(&truth[*end]));
        (error.translation.vector.norm(), angle_rad(&error).to_degrees())
    };
    pairs.par_iter().map(error).unzip()
}
