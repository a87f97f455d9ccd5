//! Absolute pose errors: how far each aligned pose is from its true one (J. Sturm et al., "A benchmark for the
//! evaluation of RGB-D SLAM systems", 2012; the names and the three parts follow the evaluation package evo).

use crate::poses::MatrixPose;
use nalgebra::{Matrix3, Matrix4, Vector3};
use rayon::prelude::*;

/// A product of rotations further from orthogonal than this is rounded to the nearest rotation before its angle is
/// taken; matrices read from files with few digits are.
const ORTHOGONAL: f64 = 1e-12;

/// One error per pose.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseErrors {
    /// Length of the translation, metres.
    pub translation_m: Vec<f64>,
    /// Angle of the rotation, radians, 0 to pi.
    pub rotation_rad: Vec<f64>,
    /// Frobenius norm of the 4x4 matrix minus the identity (metres and radians mixed; for comparison with evo).
    pub full: Vec<f64>,
}

impl PoseErrors {
    /// Splits error motions into their parts.
    pub(crate) fn of(motions: impl ParallelIterator<Item = MatrixPose>) -> Self {
        let parts: Vec<(f64, (f64, f64))> = motions.map(|error| parts(&error)).collect();
        let (translation_m, (rotation_rad, full)) = parts.into_par_iter().unzip();
        Self { translation_m, rotation_rad, full }
    }
}

fn parts(error: &MatrixPose) -> (f64, (f64, f64)) {
    let full = (error.to_homogeneous() - Matrix4::identity()).norm();
    (error.translation.vector.norm(), (angle_rad(error), full))
}

/// Errors of an aligned estimate, pose by pose: `estimate^-1 * truth`.
pub fn absolute_errors(estimate: &[MatrixPose], truth: &[MatrixPose]) -> PoseErrors {
    let both = || estimate.par_iter().zip(truth);
    // The distance itself: rotations with few digits would stretch the translation of the error motion.
    let translation_m = both().map(|(a, b)| (a.translation.vector - b.translation.vector).norm()).collect();
    PoseErrors { translation_m, ..PoseErrors::of(both().map(|(estimate, truth)| estimate.inv_mul(truth))) }
}

/// Rotation angle in radians, 0 to pi.
///
/// Sine from the antisymmetric part and cosine from the trace; the quotient keeps its digits near 0 and near pi.
pub fn angle_rad(motion: &MatrixPose) -> f64 {
    let mut r = *motion.rotation.matrix();
    if (r.transpose() * r - Matrix3::identity()).amax() > ORTHOGONAL {
        r = nearest_rotation(&r);
    }
    let sine = 0.5 * Vector3::new(r[(2, 1)] - r[(1, 2)], r[(0, 2)] - r[(2, 0)], r[(1, 0)] - r[(0, 1)]).norm();
    sine.atan2(0.5 * (r.trace() - 1.0))
}

/// The orthogonal factor of the polar decomposition by Newton-Schulz steps (N. Higham, "Functions of Matrices", 2008,
/// section 8.3); from the 1e-2 that readers let pass, each step squares the distance.
fn nearest_rotation(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    (0..5).fold(*matrix, |r, _| r * (Matrix3::identity() * 3.0 - r.transpose() * r) * 0.5)
}
