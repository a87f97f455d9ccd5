//! For tests: an estimate laid onto the truth, as errors up to scale are stated.

use endoscape_core::Pose;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// Poses after the best similarity of their places onto those of the truth (S. Umeyama, 1991).
pub fn aligned(poses: &[Pose], truths: &[Pose]) -> Vec<Pose> {
    let place = |pose: &Pose| pose.translation.vector;
    let mean = |poses: &[Pose]| poses.iter().map(place).sum::<Vector3<f64>>() / poses.len() as f64;
    let (from, to) = (mean(poses), mean(truths));
    let pairs = || poses.iter().map(place).zip(truths.iter().map(place)).map(|(p, t)| (p - from, t - to));
    let svd = pairs().map(|(p, t)| t * p.transpose()).sum::<Matrix3<f64>>().svd(true, true);
    let (Some(u), Some(v)) = (svd.u, svd.v_t) else { return Vec::new() };
    let sign = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v).determinant().signum()));
    let scale = (sign * Matrix3::from_diagonal(&svd.singular_values)).trace()
        / pairs().map(|(p, _)| p.norm_squared()).sum::<f64>();
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * sign * v));
    let moved = |pose: &Pose| Pose::from_parts((turn * (place(pose) - from) * scale + to).into(), turn * pose.rotation);
    poses.iter().map(moved).collect()
}
