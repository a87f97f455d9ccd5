//! An estimate laid over its truth, pose by pose: what figures show and paired tests compare.

use crate::EvalError;
use crate::align::{Alignment, Similarity, align};
use crate::ape::{PoseErrors, absolute_errors};
use crate::associate::{Association, associate};
use crate::poses::{MatrixPose, Poses, Stamps, accumulated, path_steps_m};
use crate::rpe::relative_errors;

/// One entry per matched pose, in order.
#[derive(Clone, Debug, PartialEq)]
pub struct Trace {
    /// Position of each pose in the truth.
    pub truth_index: Vec<usize>,
    /// Stamps of the true poses: seconds if `in_seconds`, else numbers of frames.
    pub stamps: Vec<f64>,
    /// Whether the stamps are times.
    pub in_seconds: bool,
    /// Whether frames are missing before a pose.
    pub after_gap: Vec<bool>,
    /// Way along the true path, metres.
    pub travelled_m: Vec<f64>,
    /// True poses.
    pub truth: Vec<MatrixPose>,
    /// What the alignment corrects.
    pub truth_from_estimate: Similarity,
    /// Estimated poses in the frame and scale of the truth.
    pub aligned: Vec<MatrixPose>,
    /// Errors of the poses.
    pub absolute: PoseErrors,
    /// Errors of the motion that led to each pose; one entry less, none for the first pose.
    pub steps: PoseErrors,
}

/// Pairs, aligns and compares pose by pose, with the same choices as [`crate::trajectory::evaluate`].
///
/// # Errors
/// As [`associate`] and [`align`].
pub fn trace(
    estimate: &Poses,
    truth: &Poses,
    association: Association,
    alignment: Alignment,
) -> Result<Trace, EvalError> {
    let pairs = associate(estimate, truth, association)?;
    let truth_from_estimate = align(&pairs.estimate, &pairs.truth, alignment)?;
    let aligned = truth_from_estimate.apply_all(&pairs.estimate);
    let neighbours: Vec<(usize, usize)> = (1..aligned.len()).map(|end| (end - 1, end)).collect();
    Ok(Trace {
        stamps: pairs.truth_index.iter().map(|index| stamp(truth, *index)).collect(),
        in_seconds: matches!(truth.stamps(), Stamps::Seconds(_)),
        travelled_m: accumulated(&path_steps_m(&pairs.truth)),
        absolute: absolute_errors(&aligned, &pairs.truth),
        steps: relative_errors(&aligned, &pairs.truth, &neighbours),
        truth_index: pairs.truth_index,
        after_gap: pairs.after_gap,
        truth: pairs.truth,
        truth_from_estimate,
        aligned,
    })
}

fn stamp(poses: &Poses, index: usize) -> f64 {
    match poses.stamps() {
        Stamps::Seconds(times_s) => times_s[index],
        Stamps::Frames(frames) => frames[index] as f64,
        Stamps::Order => index as f64,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::poses::Duplicates;
    use nalgebra::{Translation3, UnitQuaternion};

    fn poses(stamps: &[f64]) -> Poses {
        let pose = |time: &f64| {
            let position = Translation3::new(time.sin(), time.cos(), 0.1 * time);
            MatrixPose::from_parts(position, UnitQuaternion::from_euler_angles(0.0, 0.0, *time).to_rotation_matrix())
        };
        Poses::new(Stamps::Seconds(stamps.to_vec()), stamps.iter().map(pose).collect(), Duplicates::Refuse).unwrap()
    }

    #[test]
    fn stamps_positions_and_gaps_are_those_of_the_truth() {
        let truth = poses(&[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        let estimate = poses(&[1.0, 2.0, 3.0, 5.0, 6.0]);
        let association = Association::Nearest { tolerance_s: 0.01 };
        let trace = trace(&estimate, &truth, association, Alignment::None).unwrap();
        assert_eq!(trace.truth_index, [1, 2, 3, 5, 6]);
        assert_eq!(trace.stamps, [1.0, 2.0, 3.0, 5.0, 6.0]);
        assert_eq!(trace.after_gap, [false, false, false, true, false]);
        assert!(trace.in_seconds && trace.steps.translation_m.len() == 4);
        assert!(trace.absolute.translation_m.iter().all(|error| *error == 0.0));
        assert!(trace.travelled_m.windows(2).all(|pair| pair[1] > pair[0]));
    }
}
