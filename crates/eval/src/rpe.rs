//! Relative pose errors: drift over a given distance (J. Sturm et al. 2012), with the choice of pairs evo makes.

use crate::EvalError;
use crate::ape::{PoseErrors, angle_rad};
use crate::poses::{MatrixPose, accumulated, path_steps_m, turn_steps_rad};
use rayon::prelude::*;
use serde::{Serialize, Serializer};
use std::f64::consts::PI;
use std::str::FromStr;

/// All pairs within this share of the distance asked for count; evo's default.
const RELATIVE_TOLERANCE: f64 = 0.1;

/// All pairs by angle compares every pose with every other; beyond this many poses that takes hours.
const MOST_POSES_ALL_ANGLES: usize = 100_000;

/// What the distance between the poses of a pair is measured in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeltaUnit {
    /// Frames.
    Frames,
    /// Metres along the path.
    Metres,
    /// Degrees of rotation.
    Degrees,
    /// Radians of rotation.
    Radians,
}

impl DeltaUnit {
    /// Letter on the command line and in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Frames => "f",
            Self::Metres => "m",
            Self::Degrees => "d",
            Self::Radians => "r",
        }
    }
}

impl FromStr for DeltaUnit {
    type Err = EvalError;

    fn from_str(text: &str) -> Result<Self, EvalError> {
        [Self::Frames, Self::Metres, Self::Degrees, Self::Radians]
            .into_iter()
            .find(|unit| unit.name() == text)
            .ok_or_else(|| EvalError::Setting {
                what: format!("`{text}` is no unit of distance"),
                remedy: "choose f (frames), m (metres), d (degrees) or r (radians)",
            })
    }
}

impl Serialize for DeltaUnit {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

/// Which pairs of poses are compared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Delta {
    /// Distance between the poses of a pair.
    pub value: f64,
    /// Its unit.
    pub unit: DeltaUnit,
    /// Every pair at that distance, overlapping; otherwise pairs that follow one another.
    pub all_pairs: bool,
    /// Leave out the pair that starts at the first pose, as evo did for consecutive pairs in metres in older versions.
    pub skip_first: bool,
}

impl Default for Delta {
    fn default() -> Self {
        Self { value: 1.0, unit: DeltaUnit::Frames, all_pairs: false, skip_first: false }
    }
}

/// Index pairs at the distance `delta`, measured on `poses`.
///
/// Consecutive pairs end where the path (or the rotation) gone through since the start of the pair reaches the
/// distance. Of all pairs in metres each pose gets the one whose path length comes nearest, if it is within a tenth; in
/// angles every pair whose direct rotation is within a tenth.
///
/// # Errors
/// [`EvalError::Setting`] for a distance without meaning, [`EvalError::NoPairs`] if there is none.
pub fn pairs(poses: &[MatrixPose], delta: Delta) -> Result<Vec<(usize, usize)>, EvalError> {
    check(delta, poses.len())?;
    let angle_rad = if delta.unit == DeltaUnit::Degrees { delta.value.to_radians() } else { delta.value };
    let mut pairs = match (delta.unit, delta.all_pairs) {
        (DeltaUnit::Frames, all) => by_index(poses.len(), delta.value as usize, all),
        (DeltaUnit::Metres, true) => nearest_by_path(&accumulated(&path_steps_m(poses)), delta.value),
        (DeltaUnit::Metres, false) => consecutive(&path_steps_m(poses), delta.value),
        (_, true) => all_by_angle(poses, angle_rad),
        (_, false) => consecutive(&turn_steps_rad(poses), angle_rad),
    };
    if delta.skip_first {
        pairs.retain(|(start, _)| *start > 0);
    }
    if pairs.is_empty() {
        return Err(EvalError::NoPairs { delta: delta.value, unit: delta.unit.name() });
    }
    Ok(pairs)
}

fn check(delta: Delta, poses: usize) -> Result<(), EvalError> {
    let refused = |what: String, remedy| Err(EvalError::Setting { what, remedy });
    let Delta { value, unit, all_pairs, .. } = delta;
    let angular = matches!(unit, DeltaUnit::Degrees | DeltaUnit::Radians);
    if !(value > 0.0 && value.is_finite()) {
        return refused(format!("{value} is no distance between poses"), "give a positive --rpe-delta");
    }
    if unit == DeltaUnit::Frames && value.fract() != 0.0 {
        return refused(format!("{value} is no whole number of frames"), "give a whole --rpe-delta or another unit");
    }
    if angular && value > if unit == DeltaUnit::Degrees { 180.0 } else { PI } {
        return refused(format!("{value} is more than half a turn"), "give a smaller --rpe-delta");
    }
    if angular && all_pairs && poses > MOST_POSES_ALL_ANGLES {
        let what = format!("all pairs by angle of {poses} poses would take hours");
        return refused(what, "leave --all-pairs out or thin the trajectory");
    }
    Ok(())
}

fn by_index(count: usize, delta: usize, all: bool) -> Vec<(usize, usize)> {
    let starts = 0..count.saturating_sub(delta);
    starts.step_by(if all { 1 } else { delta }).map(|start| (start, start + delta)).collect()
}

/// Pairs whose steps in between add up to `delta` or just more, each starting where the last one ended.
fn consecutive(steps: &[f64], delta: f64) -> Vec<(usize, usize)> {
    let (mut pairs, mut start, mut travelled) = (Vec::new(), 0, 0.0);
    for (index, step) in steps.iter().enumerate() {
        travelled += step;
        if travelled >= delta {
            pairs.push((start, index + 1));
            (start, travelled) = (index + 1, 0.0);
        }
    }
    pairs
}

/// For each pose the later one whose distance along the path is nearest to `delta`, the first of equally near ones.
fn nearest_by_path(distances: &[f64], delta: f64) -> Vec<(usize, usize)> {
    let pair = |start: usize| {
        let later = &distances[start + 1..];
        let miss = |distance: &f64| (distance - distances[start]) - delta;
        let above = later.partition_point(|distance| miss(distance) < 0.0);
        let below = above.checked_sub(1).map(|last| {
            // A camera at rest repeats a distance; the first pose there counts.
            later.partition_point(|distance| miss(distance) < miss(&later[last]))
        });
        let (nearest, distance) = [below, Some(above)]
            .into_iter()
            .flatten()
            .filter_map(|index| later.get(index).map(|distance| (index, miss(distance).abs())))
            .min_by(|a, b| a.1.total_cmp(&b.1))?;
        (distance <= delta * RELATIVE_TOLERANCE).then_some((start, start + 1 + nearest))
    };
    (0..distances.len().saturating_sub(1)).into_par_iter().filter_map(pair).collect()
}

fn all_by_angle(poses: &[MatrixPose], delta_rad: f64) -> Vec<(usize, usize)> {
    let tolerance = delta_rad * RELATIVE_TOLERANCE;
    let range = delta_rad - tolerance..=delta_rad + tolerance;
    let matching = |start: usize| {
        let angle = |end: usize| angle_rad(&poses[start].inv_mul(&poses[end]));
        let ends = (start + 1..poses.len()).filter(|end| range.contains(&angle(*end)));
        ends.map(|end| (start, end)).collect::<Vec<_>>()
    };
    (0..poses.len()).into_par_iter().flat_map_iter(matching).collect()
}

/// Errors of the motions between the poses of each pair: `truth_motion^-1 * estimated_motion`.
pub fn relative_errors(estimate: &[MatrixPose], truth: &[MatrixPose], pairs: &[(usize, usize)]) -> PoseErrors {
    PoseErrors::of(pairs.par_iter().map(|(start, end)| {
        let estimated = estimate[*start].inv_mul(&estimate[*end]);
        truth[*start].inv_mul(&truth[*end]).inv_mul(&estimated)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_follow_one_another_or_overlap() {
        assert_eq!(by_index(6, 2, false), [(0, 2), (2, 4)]);
        assert_eq!(by_index(4, 2, true), [(0, 2), (1, 3)]);
        assert_eq!(by_index(1, 3, true), []);
        assert_eq!(consecutive(&[1.0, 0.5, 0.7, 2.0], 1.2), [(0, 2), (2, 4)]);
    }

    #[test]
    fn the_nearest_by_path_is_the_first_of_a_rest() {
        let distances = [0.0, 1.0, 1.0, 1.0, 2.0];
        assert_eq!(nearest_by_path(&distances, 1.0), [(0, 1), (1, 4), (2, 4), (3, 4)]);
        assert_eq!(nearest_by_path(&distances, 5.0), []);
    }

    #[test]
    fn distances_without_meaning_are_refused() {
        let poses = [MatrixPose::identity(); 3];
        for (value, unit) in [(0.0, DeltaUnit::Metres), (1.5, DeltaUnit::Frames), (200.0, DeltaUnit::Degrees)] {
            let delta = Delta { value, unit, ..Delta::default() };
            assert!(matches!(pairs(&poses, delta), Err(EvalError::Setting { .. })));
        }
        let far = Delta { value: 9.0, ..Delta::default() };
        assert_eq!(pairs(&poses, far), Err(EvalError::NoPairs { delta: 9.0, unit: "f" }));
    }
}
