//! How far off the end is, and whether scale changes on the way.

use crate::poses::{MatrixPose, accumulated, path_steps_m};
use serde::Serialize;

/// Parts the path is cut into to look at the scale of each.
const PARTS: usize = 10;

/// Distance of the end points when the first poses are laid over each other, as a percentage of the true path.
///
/// `estimate` must have the scale it is to be judged with. `None` for a truth that does not move.
pub fn endpoint_percent(estimate: &[MatrixPose], truth: &[MatrixPose]) -> Option<f64> {
    let motion = |poses: &[MatrixPose]| Some(poses.first()?.inv_mul(poses.last()?));
    let path_m: f64 = path_steps_m(truth).iter().sum();
    let miss = motion(estimate)?.translation.vector - motion(truth)?.translation.vector;
    (path_m > 0.0).then(|| 100.0 * miss.norm() / path_m)
}

/// Scale of one part of the path.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PartScale {
    /// Where the part begins along the true path, metres.
    pub from_m: f64,
    /// Where it ends.
    pub to_m: f64,
    /// Factor the estimate has to be multiplied by there.
    pub scale: f64,
}

/// The scale along the path, in ten parts of equal length: the ratio of the spreads of true and estimated positions,
/// which needs no rotation (B. Horn, "Closed-form solution of absolute orientation using unit quaternions", 1987).
///
/// Parts in which either camera stands still are left out.
pub fn scale_along(estimate: &[MatrixPose], truth: &[MatrixPose]) -> Vec<PartScale> {
    let travelled = accumulated(&path_steps_m(truth));
    let length = travelled.last().copied().unwrap_or_default();
    let at = |part: usize| length * part as f64 / PARTS as f64;
    let index = |metres: f64| travelled.partition_point(|distance| *distance < metres);
    let part = |part: usize| {
        let range = index(at(part))..=index(at(part + 1)).min(travelled.len().checked_sub(1)?);
        let ratio = spread(truth.get(range.clone())?) / spread(estimate.get(range)?);
        let scale = ratio.sqrt();
        (scale.is_finite() && scale > 0.0).then_some(PartScale { from_m: at(part), to_m: at(part + 1), scale })
    };
    (0..PARTS).filter_map(part).collect()
}

/// Sum of squared distances from the mean position.
fn spread(poses: &[MatrixPose]) -> f64 {
    let positions = || poses.iter().map(|pose| pose.translation.vector);
    let mean = positions().sum::<nalgebra::Vector3<f64>>() / poses.len().max(1) as f64;
    positions().map(|position| (position - mean).norm_squared()).sum()
}
