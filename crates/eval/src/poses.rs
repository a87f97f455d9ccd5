//! Poses to be compared, as the numbers that were written down.
//!
//! [`endoscape_core::Trajectory`] holds unit quaternions. Files in the KITTI format hold matrices that are rotations
//! only up to the digits printed; rounding them to a quaternion changes errors in the seventh digit, and other tools do
//! not round. So evaluation keeps matrices.

use crate::EvalError;
use endoscape_core::{TimedPose, Trajectory};
use nalgebra::IsometryMatrix3;
use rayon::prelude::*;

/// Largest number a pose may hold: sums of its squares are still finite.
const LARGEST: f64 = 1e100;

/// A rigid motion as a matrix; the rotation is orthogonal up to the digits it was written with.
pub type MatrixPose = IsometryMatrix3<f64>;

/// What tells poses of two trajectories which belong together.
#[derive(Clone, Debug, PartialEq)]
pub enum Stamps {
    /// Times in seconds.
    Seconds(Vec<f64>),
    /// Numbers of frames.
    Frames(Vec<u64>),
    /// Nothing but the order.
    Order,
}

/// What to do with poses that share a stamp.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Duplicates {
    /// They are an error.
    #[default]
    Refuse,
    /// They stay.
    Keep,
}

/// At least one pose with stamps in order.
#[derive(Clone, Debug, PartialEq)]
pub struct Poses {
    stamps: Stamps,
    world_from_camera: Vec<MatrixPose>,
}

impl Poses {
    /// Takes poses in the order of their stamps.
    ///
    /// # Errors
    /// [`EvalError::Empty`], [`EvalError::Unpaired`], [`EvalError::NotFinite`], [`EvalError::Unsorted`], and
    /// [`EvalError::Duplicate`] unless those are kept.
    pub fn new(stamps: Stamps, world_from_camera: Vec<MatrixPose>, duplicates: Duplicates) -> Result<Self, EvalError> {
        if world_from_camera.is_empty() {
            return Err(EvalError::Empty);
        }
        let finite = |pose: &MatrixPose| {
            let rotation = pose.rotation.matrix();
            pose.translation.vector.iter().chain(rotation.iter()).all(|number| number.abs() <= LARGEST)
        };
        if let Some(index) = world_from_camera.iter().position(|pose| !finite(pose)) {
            return Err(EvalError::NotFinite { index });
        }
        match &stamps {
            Stamps::Seconds(times_s) => check_order(times_s, world_from_camera.len(), duplicates)?,
            Stamps::Frames(frames) => {
                let numbers: Vec<f64> = frames.iter().map(|frame| *frame as f64).collect();
                check_order(&numbers, world_from_camera.len(), duplicates)?;
            }
            Stamps::Order => {}
        }
        Ok(Self { stamps, world_from_camera })
    }

    /// Timed poses, for example as a text format gave them.
    ///
    /// # Errors
    /// As [`Poses::new`].
    pub fn from_timed(timed: &[TimedPose], duplicates: Duplicates) -> Result<Self, EvalError> {
        let times_s = timed.iter().map(|pose| pose.time_s).collect();
        let matrix = |pose: &TimedPose| nalgebra::convert(pose.world_from_camera);
        Self::new(Stamps::Seconds(times_s), timed.iter().map(matrix).collect(), duplicates)
    }

    /// A trajectory of ours.
    ///
    /// # Errors
    /// [`EvalError::Empty`].
    pub fn from_trajectory(trajectory: &Trajectory) -> Result<Self, EvalError> {
        Self::from_timed(trajectory.poses(), Duplicates::Refuse)
    }

    /// Number of poses, at least one.
    #[allow(clippy::len_without_is_empty, reason = "never empty by construction")]
    pub const fn len(&self) -> usize {
        self.world_from_camera.len()
    }

    /// What pairs these poses with those of another trajectory.
    pub const fn stamps(&self) -> &Stamps {
        &self.stamps
    }

    /// The poses in order, metres.
    pub fn world_from_camera(&self) -> &[MatrixPose] {
        &self.world_from_camera
    }
}

fn check_order(stamps: &[f64], poses: usize, duplicates: Duplicates) -> Result<(), EvalError> {
    if stamps.len() != poses {
        return Err(EvalError::Unpaired { stamps: stamps.len(), poses });
    }
    if let Some(index) = stamps.iter().position(|stamp| !stamp.is_finite()) {
        return Err(EvalError::NotFinite { index });
    }
    for (index, pair) in stamps.windows(2).enumerate() {
        let (previous, stamp) = (pair[0], pair[1]);
        if stamp < previous {
            return Err(EvalError::Unsorted { index: index + 1, stamp, previous });
        }
        if stamp == previous && duplicates == Duplicates::Refuse {
            return Err(EvalError::Duplicate { index: index + 1, stamp });
        }
    }
    Ok(())
}

/// Distance in metres from each pose to the next.
pub(crate) fn path_steps_m(poses: &[MatrixPose]) -> Vec<f64> {
    poses.windows(2).map(|pair| (pair[1].translation.vector - pair[0].translation.vector).norm()).collect()
}

/// Rotation angle in radians from each pose to the next.
pub(crate) fn turn_steps_rad(poses: &[MatrixPose]) -> Vec<f64> {
    poses.par_windows(2).map(|pair| crate::ape::angle_rad(&pair[0].inv_mul(&pair[1]))).collect()
}

/// Running sum of steps, starting from 0.
pub(crate) fn accumulated(steps: &[f64]) -> Vec<f64> {
    let mut sums = Vec::with_capacity(steps.len() + 1);
    let mut sum = 0.0;
    sums.push(sum);
    for step in steps {
        sum += step;
        sums.push(sum);
    }
    sums
}
