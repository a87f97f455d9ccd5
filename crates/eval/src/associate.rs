//! Which pose of the estimate belongs to which pose of the truth, and how much of the truth is answered at all.

use crate::EvalError;
use crate::poses::{MatrixPose, Poses, Stamps};
use nalgebra::{Translation3, UnitQuaternion};

/// Half the distance of frames at 50 Hz; what evo uses by default.
pub const DEFAULT_TOLERANCE_S: f64 = 0.01;

/// Two neighbouring pairs further apart than this many median distances have lost frames between them.
const GAP: f64 = 1.5;

/// How poses are paired.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Association {
    /// Each pose of the shorter trajectory with the nearest in time of the longer, at most `tolerance_s` away.
    Nearest {
        /// Largest difference in time, seconds.
        tolerance_s: f64,
    },
    /// Each pose of the estimate with the truth interpolated at its time, where a true pose is at most `tolerance_s`
    /// away.
    Interpolate {
        /// Largest difference in time to a true pose, seconds.
        tolerance_s: f64,
    },
    /// First with first, second with second, as long as both last.
    Order,
}

/// Poses that belong together, in order.
#[derive(Clone, Debug, PartialEq)]
pub struct Pairs {
    /// Estimated poses.
    pub estimate: Vec<MatrixPose>,
    /// True poses, as many.
    pub truth: Vec<MatrixPose>,
    /// Position of each true pose in the truth; of the nearest one where the truth is interpolated.
    pub truth_index: Vec<usize>,
    /// Whether frames are missing between a pair and the one before it; the first is `false`.
    pub after_gap: Vec<bool>,
    /// Poses the estimate has.
    pub estimate_frames: usize,
    /// Poses the truth has.
    pub truth_frames: usize,
    /// Share of the truth that is answered, 0 to 1; see [`associate`].
    pub completeness: f64,
}

impl Pairs {
    /// Number of pairs.
    pub const fn len(&self) -> usize {
        self.estimate.len()
    }

    /// Whether nothing matched.
    pub const fn is_empty(&self) -> bool {
        self.estimate.is_empty()
    }
}

/// Pairs the poses of two trajectories.
///
/// Completeness is the number of pairs divided by the number of true poses. Where the truth is sampled more densely
/// than the estimate (motion capture at 100 Hz beside a camera at 30 Hz), it is divided by the number of poses the
/// estimate would have over the duration of the truth at its own (median) rate.
///
/// # Errors
/// [`EvalError::NoOverlap`] if nothing matches in time; [`EvalError::Counts`] if there are no times and the counts
/// differ; [`EvalError::Setting`] for a tolerance that is no positive number.
pub fn associate(estimate: &Poses, truth: &Poses, association: Association) -> Result<Pairs, EvalError> {
    match (association, estimate.stamps(), truth.stamps()) {
        (Association::Order, _, _) => Ok(by_order(estimate, truth)),
        (Association::Nearest { tolerance_s }, Stamps::Seconds(a), Stamps::Seconds(b)) => {
            let matches = nearest(a, b, checked(tolerance_s)?);
            timed(estimate, truth, &matches, tolerance_s, (a, b), |(_, j)| truth.world_from_camera()[j])
        }
        (Association::Interpolate { tolerance_s }, Stamps::Seconds(a), Stamps::Seconds(b)) => {
            let mut matches = nearest_of(a, b, checked(tolerance_s)?);
            // Nothing is extrapolated.
            matches.retain(|(i, _)| b[0] <= a[*i] && a[*i] <= b[b.len() - 1]);
            timed(estimate, truth, &matches, tolerance_s, (a, b), |(i, _)| interpolated(truth, b, a[i]))
        }
        (_, Stamps::Seconds(_), _) | (_, _, Stamps::Seconds(_)) | (_, Stamps::Order, Stamps::Order) => {
            let (estimate_frames, truth_frames) = (estimate.len(), truth.len());
            if estimate_frames != truth_frames {
                return Err(EvalError::Counts { estimate: estimate_frames, truth: truth_frames });
            }
            Ok(by_order(estimate, truth))
        }
        _ => by_frame(estimate, truth),
    }
}

fn checked(tolerance_s: f64) -> Result<f64, EvalError> {
    if tolerance_s >= 0.0 && tolerance_s.is_finite() {
        return Ok(tolerance_s);
    }
    Err(EvalError::Setting {
        what: format!("{tolerance_s} s is no tolerance in time"),
        remedy: "give 0 or more seconds",
    })
}

/// Index pairs (of `estimate`, of `truth`); the shorter list asks, each of its stamps once.
fn nearest(estimate: &[f64], truth: &[f64], tolerance_s: f64) -> Vec<(usize, usize)> {
    if estimate.len() > truth.len() {
        let swapped = nearest_of(truth, estimate, tolerance_s);
        return swapped.into_iter().map(|(j, i)| (i, j)).collect();
    }
    nearest_of(estimate, truth, tolerance_s)
}

/// For each stamp of `asking` the nearest of the sorted `answering`, the earlier one if both are equally near.
fn nearest_of(asking: &[f64], answering: &[f64], tolerance_s: f64) -> Vec<(usize, usize)> {
    let nearest = |(index, stamp): (usize, &f64)| {
        let after = answering.partition_point(|other| other <= stamp);
        let later = answering.get(after).map_or(f64::INFINITY, |other| other - stamp);
        let earlier = after.checked_sub(1).map_or(f64::INFINITY, |before| stamp - answering[before]);
        let (distance, best) = if later < earlier { (later, after) } else { (earlier, after.saturating_sub(1)) };
        (distance <= tolerance_s).then_some((index, best))
    };
    asking.iter().enumerate().filter_map(nearest).collect()
}

fn timed(
    estimate: &Poses,
    truth: &Poses,
    matches: &[(usize, usize)],
    tolerance_s: f64,
    (estimate_s, truth_s): (&[f64], &[f64]),
    true_pose: impl Fn((usize, usize)) -> MatrixPose,
) -> Result<Pairs, EvalError> {
    if matches.is_empty() {
        let range = |stamps: &[f64]| format!("{} to {} s", stamps[0], stamps[stamps.len() - 1]);
        return Err(EvalError::NoOverlap { estimate: range(estimate_s), truth: range(truth_s), tolerance_s });
    }
    let times_s: Vec<f64> = matches.iter().map(|(i, _)| estimate_s[*i]).collect();
    Ok(Pairs {
        estimate: matches.iter().map(|(i, _)| estimate.world_from_camera()[*i]).collect(),
        truth: matches.iter().map(|pair| true_pose(*pair)).collect(),
        truth_index: matches.iter().map(|(_, j)| *j).collect(),
        after_gap: gaps(&times_s),
        estimate_frames: estimate.len(),
        truth_frames: truth.len(),
        completeness: matches.len() as f64 / expected(estimate_s, truth_s).max(matches.len() as f64),
    })
}

/// Poses a complete estimate would have.
fn expected(estimate_s: &[f64], truth_s: &[f64]) -> f64 {
    let (own, dense) = (median_step(estimate_s), median_step(truth_s));
    match (own, dense) {
        (Some(own), Some(dense)) if own > GAP * dense => {
            ((truth_s[truth_s.len() - 1] - truth_s[0]) / own).floor() + 1.0
        }
        _ => truth_s.len() as f64,
    }
}

fn median_step(stamps: &[f64]) -> Option<f64> {
    let steps: Vec<f64> = stamps.windows(2).map(|pair| pair[1] - pair[0]).collect();
    crate::stats::median(&steps)
}

fn gaps(stamps: &[f64]) -> Vec<bool> {
    let usual = median_step(stamps).unwrap_or(f64::INFINITY);
    let after = stamps.windows(2).map(|pair| pair[1] - pair[0] > GAP * usual);
    std::iter::once(false).chain(after).collect()
}

fn by_order(estimate: &Poses, truth: &Poses) -> Pairs {
    let count = estimate.len().min(truth.len());
    Pairs {
        estimate: estimate.world_from_camera()[..count].to_vec(),
        truth: truth.world_from_camera()[..count].to_vec(),
        truth_index: (0..count).collect(),
        after_gap: vec![false; count],
        estimate_frames: estimate.len(),
        truth_frames: truth.len(),
        completeness: count as f64 / truth.len() as f64,
    }
}

/// Equal frame numbers belong together; a trajectory without numbers counts its poses from 0.
fn by_frame(estimate: &Poses, truth: &Poses) -> Result<Pairs, EvalError> {
    let numbers = |poses: &Poses| match poses.stamps() {
        Stamps::Frames(frames) => frames.clone(),
        _ => (0..poses.len() as u64).collect(),
    };
    let (mine, theirs) = (numbers(estimate), numbers(truth));
    let find = |(i, frame): (usize, &u64)| theirs.binary_search(frame).ok().map(|j| (i, j));
    let matches: Vec<(usize, usize)> = mine.iter().enumerate().filter_map(find).collect();
    if matches.is_empty() {
        let range = |frames: &[u64]| format!("frames {} to {}", frames[0], frames[frames.len() - 1]);
        return Err(EvalError::NoOverlap { estimate: range(&mine), truth: range(&theirs), tolerance_s: 0.0 });
    }
    let frames: Vec<f64> = matches.iter().map(|(i, _)| mine[*i] as f64).collect();
    Ok(Pairs {
        estimate: matches.iter().map(|(i, _)| estimate.world_from_camera()[*i]).collect(),
        truth: matches.iter().map(|(_, j)| truth.world_from_camera()[*j]).collect(),
        truth_index: matches.iter().map(|(_, j)| *j).collect(),
        after_gap: gaps(&frames),
        estimate_frames: estimate.len(),
        truth_frames: truth.len(),
        completeness: matches.len() as f64 / truth.len() as f64,
    })
}

/// Position linear, rotation along the shortest arc; `time_s` must lie inside `stamps`.
fn interpolated(poses: &Poses, stamps: &[f64], time_s: f64) -> MatrixPose {
    let after = stamps.partition_point(|stamp| *stamp < time_s).min(stamps.len() - 1);
    let (left, right) = (after.saturating_sub(1), after);
    let span = stamps[right] - stamps[left];
    let share = if span > 0.0 { ((time_s - stamps[left]) / span).clamp(0.0, 1.0) } else { 1.0 };
    let (a, b) = (&poses.world_from_camera()[left], &poses.world_from_camera()[right]);
    let quaternion = |pose: &MatrixPose| UnitQuaternion::from_rotation_matrix(&pose.rotation);
    let (from, to) = (quaternion(a), quaternion(b));
    // Half turns have no shortest arc; the nearer end stands in.
    let rotation = from.try_slerp(&to, share, 1e-9).unwrap_or(if share < 0.5 { from } else { to });
    let position = a.translation.vector.lerp(&b.translation.vector, share);
    MatrixPose::from_parts(Translation3::from(position), rotation.to_rotation_matrix())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::poses::Duplicates;

    fn along_x(stamps: &[f64]) -> Poses {
        let poses = stamps.iter().map(|stamp| MatrixPose::translation(*stamp, 0.0, 0.0)).collect();
        Poses::new(Stamps::Seconds(stamps.to_vec()), poses, Duplicates::Keep).unwrap()
    }

    #[test]
    fn the_earlier_of_two_equally_near_stamps_wins() {
        assert_eq!(nearest(&[1.5], &[1.0, 2.0], 1.0), [(0, 0)]);
        assert_eq!(nearest(&[0.0, 1.4, 9.0], &[0.0, 1.0, 2.0, 3.0], 0.5), [(0, 0), (1, 1)]);
        assert_eq!(nearest(&[0.0, 1.0, 2.0], &[1.1], 0.2), [(1, 0)]);
    }

    #[test]
    fn lost_frames_show_as_gaps_and_missing_completeness() {
        let truth = along_x(&[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
        let estimate = along_x(&[0.0, 1.0, 2.0, 5.0, 6.0, 7.0]);
        let pairs = associate(&estimate, &truth, Association::Nearest { tolerance_s: 0.1 }).unwrap();
        assert_eq!(pairs.after_gap, [false, false, false, true, false, false]);
        assert_eq!(pairs.completeness, 0.75);
    }

    #[test]
    fn a_dense_truth_does_not_make_an_estimate_incomplete() {
        let truth = along_x(&(0..=1000).map(|i| f64::from(i) * 0.01).collect::<Vec<_>>());
        let estimate = along_x(&(0..=100).map(|i| f64::from(i) * 0.1).collect::<Vec<_>>());
        let pairs = associate(&estimate, &truth, Association::Nearest { tolerance_s: 0.001 }).unwrap();
        assert_eq!((pairs.len(), pairs.completeness), (101, 1.0));
    }

    #[test]
    fn the_truth_is_interpolated_and_never_extrapolated() {
        let pairs = associate(
            &along_x(&[-0.2, 0.25, 1.5, 2.2]),
            &along_x(&[0.0, 1.0, 2.0]),
            Association::Interpolate { tolerance_s: 0.6 },
        );
        let pairs = pairs.unwrap();
        let x: Vec<f64> = pairs.truth.iter().map(|pose| pose.translation.x).collect();
        assert_eq!(x, [0.25, 1.5]);
    }

    #[test]
    fn without_times_the_counts_must_agree() {
        let count = |n: usize| Poses::new(Stamps::Order, vec![MatrixPose::identity(); n], Duplicates::Refuse).unwrap();
        let nearest = Association::Nearest { tolerance_s: 0.01 };
        assert!(matches!(associate(&count(3), &count(4), nearest), Err(EvalError::Counts { .. })));
        assert_eq!(associate(&count(3), &count(4), Association::Order).unwrap().completeness, 0.75);
        let numbered = Poses::new(Stamps::Frames(vec![1, 3]), vec![MatrixPose::identity(); 2], Duplicates::Refuse);
        assert_eq!(associate(&numbered.unwrap(), &count(4), nearest).unwrap().len(), 2);
        assert!(matches!(associate(&along_x(&[9.0]), &along_x(&[1.0]), nearest), Err(EvalError::NoOverlap { .. })));
    }
}
