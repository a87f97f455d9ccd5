//! What a method must beat: answers that look at no picture.
//!
//! | baseline | answer |
//! |---|---|
//! | zero | the camera never moves |
//! | constant | the camera repeats one mean motion |
//! | previous | the camera repeats its true motion of the frame before |
//!
//! Each is a whole trajectory, so that every metric applies to it.

use crate::poses::MatrixPose;
use endoscape_core::{Pose, se3};
use nalgebra::Vector6;
use serde::Serialize;

/// One value per baseline.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Baselines<T> {
    /// No motion.
    pub zero: T,
    /// Mean motion.
    pub constant: T,
    /// Previous motion.
    pub previous: T,
}

impl<T> Baselines<T> {
    /// Applies a function that may fail to each.
    ///
    /// # Errors
    /// The first error of the function.
    pub fn try_map<U, E>(self, function: impl Fn(T) -> Result<U, E>) -> Result<Baselines<U>, E> {
        Ok(Baselines {
            zero: function(self.zero)?,
            constant: function(self.constant)?,
            previous: function(self.previous)?,
        })
    }

    /// Applies a function to each.
    pub fn map<U>(self, function: impl Fn(T) -> U) -> Baselines<U> {
        Baselines { zero: function(self.zero), constant: function(self.constant), previous: function(self.previous) }
    }
}

/// The baselines' trajectories for a truth.
///
/// `constant_motion` (`previous_from_next`, metres per frame) should come from training data; `None` takes the mean
/// motion of the truth itself, which no honest method could know.
pub fn of(truth: &[MatrixPose], constant_motion: Option<&MatrixPose>) -> Baselines<Vec<MatrixPose>> {
    let motion = constant_motion.copied().unwrap_or_else(|| mean_motion(truth));
    let steps: Vec<MatrixPose> = truth.windows(2).map(|pair| pair[0].inv_mul(&pair[1])).collect();
    // Before the second frame no motion is known.
    let known = std::iter::once(MatrixPose::identity()).chain(steps.iter().copied());
    Baselines {
        zero: vec![MatrixPose::identity(); truth.len()],
        constant: chain(steps.iter().map(|_| motion)),
        previous: chain(known.take(steps.len())),
    }
}

/// Mean motion from a pose to the next: the mean of the twists, as a motion; the identity for fewer than two poses.
pub fn mean_motion(poses: &[MatrixPose]) -> MatrixPose {
    let twist = |pair: &[MatrixPose]| {
        let step = pair[0].inv_mul(&pair[1]);
        let rotation = nalgebra::UnitQuaternion::from_rotation_matrix(&step.rotation);
        se3::log(&Pose::from_parts(step.translation, rotation))
    };
    let sum: Vector6<f64> = poses.windows(2).map(twist).sum();
    nalgebra::convert(se3::exp(&(sum / poses.len().saturating_sub(1).max(1) as f64)))
}

fn chain(steps: impl Iterator<Item = MatrixPose>) -> Vec<MatrixPose> {
    let mut world_from_camera = MatrixPose::identity();
    let mut poses = vec![world_from_camera];
    for step in steps {
        world_from_camera *= step;
        poses.push(world_from_camera);
    }
    poses
}
