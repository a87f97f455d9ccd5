//! Rigid motions: the group SE(3) on nalgebra, in f64.
//!
//! A [`Pose`] maps points of the frame on the right of its name to the frame on the left:
//! `world_from_camera * point_in_camera = point_in_world`, and names cancel when poses are multiplied:
//! `world_from_camera * camera_from_capsule = world_from_capsule`.
//!
//! A tangent vector ("twist") is ordered `[v; w]`: translation part in metres, then rotation part in radians.
//! Formulae: J. Sola, J. Deray, D. Atchuthan, "A micro Lie theory for state estimation in robotics" (2018),
//! equations 172 to 180.

use nalgebra::{Isometry3, Matrix3, Matrix6, Rotation3, Translation3, UnitQuaternion, Vector3, Vector6};
use thiserror::Error;

/// A rigid motion; multiply with `*`, invert with `.inverse()`.
pub type Pose = Isometry3<f64>;

/// Below this angle (radians) series replace the closed forms, whose quotients lose all digits there.
const SMALL_ANGLE_RAD: f64 = 1e-4;

/// How far a 3x3 matrix may be from a rotation (largest entry of `R^T R - I`) before it is refused rather than
/// rounded to the nearest rotation; text files with six digits stay below 1e-5.
const ROTATION_TOLERANCE: f64 = 1e-2;

/// Why numbers are not a pose.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum PoseError {
    /// NaN or infinity among the numbers.
    #[error("a pose holds a number that is not finite")]
    NotFinite,
    /// The 3x3 part is no rotation.
    #[error(
        "the 3x3 part is not a rotation (R^T R differs from the identity by {deviation:.2e}, determinant {determinant:.3})"
    )]
    NotRotation {
        /// Largest entry of `R^T R - I`.
        deviation: f64,
        /// Determinant of the 3x3 part.
        determinant: f64,
    },
    /// A quaternion that cannot be normalised.
    #[error("the quaternion has norm {norm:.3e}, so it stands for no rotation")]
    ZeroQuaternion {
        /// Its norm.
        norm: f64,
    },
}

/// The matrix `[w]x` with `[w]x p = w x p`.
pub fn skew(w: &Vector3<f64>) -> Matrix3<f64> {
    w.cross_matrix()
}

/// Exponential map: the motion reached after unit time at constant twist `[v; w]` (equation 172).
pub fn exp(twist: &Vector6<f64>) -> Pose {
    let (v, w) = (twist.fixed_rows::<3>(0).into_owned(), twist.fixed_rows::<3>(3).into_owned());
    let translation = left_jacobian(&w) * v;
    Pose::from_parts(Translation3::from(translation), UnitQuaternion::from_scaled_axis(w))
}

/// Logarithm map, the inverse of [`exp`] for rotation angles below pi (equation 173).
pub fn log(pose: &Pose) -> Vector6<f64> {
    let w = pose.rotation.scaled_axis();
    let v = left_jacobian_inverse(&w) * pose.translation.vector;
    Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
}

/// Adjoint matrix: `exp(adjoint(X) * t) = X * exp(t) * X.inverse()` (equation 175).
pub fn adjoint(pose: &Pose) -> Matrix6<f64> {
    let rotation = pose.rotation.to_rotation_matrix().into_inner();
    let mut matrix = Matrix6::zeros();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    matrix.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    matrix.fixed_view_mut::<3, 3>(0, 3).copy_from(&(skew(&pose.translation.vector) * rotation));
    matrix
}

/// `V(w)` of equation 174: the left Jacobian of SO(3).
fn left_jacobian(w: &Vector3<f64>) -> Matrix3<f64> {
    let (angle, hat) = (w.norm(), skew(w));
    let (a, b) = if angle < SMALL_ANGLE_RAD {
        (0.5 - angle * angle / 24.0, 1.0 / 6.0 - angle * angle / 120.0)
    } else {
        ((1.0 - angle.cos()) / (angle * angle), (angle - angle.sin()) / angle.powi(3))
    };
    Matrix3::identity() + hat * a + hat * hat * b
}

/// Inverse of [`left_jacobian`] (equation 146 of the same text).
fn left_jacobian_inverse(w: &Vector3<f64>) -> Matrix3<f64> {
    let (angle, hat) = (w.norm(), skew(w));
    let b = if angle < SMALL_ANGLE_RAD {
        1.0 / 12.0 + angle * angle / 720.0
    } else {
        // (1 + cos)/(2 angle sin) in the source; the half-angle form keeps its digits near pi.
        1.0 / (angle * angle) - 0.5 / (angle * (0.5 * angle).tan())
    };
    Matrix3::identity() - hat * 0.5 + hat * hat * b
}

/// Rotation angle of a motion in radians, `0 ..= pi`.
pub fn rotation_angle_rad(pose: &Pose) -> f64 {
    pose.rotation.angle()
}

/// Builds a pose from a 3x3 matrix that is a rotation up to rounding, and a translation.
///
/// The matrix is replaced by the nearest rotation in the Frobenius norm.
///
/// # Errors
/// [`PoseError::NotFinite`] or [`PoseError::NotRotation`].
pub fn from_matrix(rotation: &Matrix3<f64>, translation_m: &Vector3<f64>) -> Result<Pose, PoseError> {
    if !rotation.iter().chain(translation_m.iter()).all(|value| value.is_finite()) {
        return Err(PoseError::NotFinite);
    }
    let deviation = (rotation.transpose() * rotation - Matrix3::identity()).amax();
    let determinant = rotation.determinant();
    if deviation > ROTATION_TOLERANCE || determinant < 0.0 {
        return Err(PoseError::NotRotation { deviation, determinant });
    }
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(nearest_rotation(rotation)));
    Ok(Pose::from_parts(Translation3::from(*translation_m), rotation))
}

/// The orthogonal polar factor of a matrix close to a rotation, by Newton's iteration `R <- (R + R^-T) / 2`
/// (N. Higham, "Computing the polar decomposition", 1986), which squares the deviation in each step and, unlike a 3x3
/// singular value decomposition through `R^T R`, keeps all digits.
fn nearest_rotation(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    let mut rotation = *matrix;
    for _ in 0..6 {
        let Some(inverse) = rotation.try_inverse() else { break };
        rotation = 0.5 * (rotation + inverse.transpose());
    }
    rotation
}

/// Builds a pose from a translation and a quaternion that is normalised on the way.
///
/// # Errors
/// [`PoseError::NotFinite`] or [`PoseError::ZeroQuaternion`].
pub fn from_quaternion(translation_m: [f64; 3], xyzw: [f64; 4]) -> Result<Pose, PoseError> {
    if !translation_m.iter().chain(xyzw.iter()).all(|value| value.is_finite()) {
        return Err(PoseError::NotFinite);
    }
    let quaternion = nalgebra::Quaternion::new(xyzw[3], xyzw[0], xyzw[1], xyzw[2]);
    let norm = quaternion.norm();
    // Files write unit quaternions with few digits; one this far off is something else.
    if !(0.5..=2.0).contains(&norm) {
        return Err(PoseError::ZeroQuaternion { norm });
    }
    // A quaternion already normal to the last bit stays as it is, so that writing and reading a file is the identity.
    let rotation = if (norm - 1.0).abs() < 4.0 * f64::EPSILON {
        UnitQuaternion::new_unchecked(quaternion)
    } else {
        UnitQuaternion::new_normalize(quaternion)
    };
    Ok(Pose::from_parts(Translation3::from(Vector3::from(translation_m)), rotation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn twist() -> impl Strategy<Value = Vector6<f64>> {
        let angle = prop_oneof![Just(0.0), 1e-12..1e-3, 1e-3..3.1_f64];
        (prop::array::uniform3(-10.0..10.0), prop::array::uniform3(-1.0..1.0_f64), angle).prop_map(
            |(v, axis, angle)| {
                let axis = Vector3::from(axis) + Vector3::new(1e-3, 0.0, 0.0);
                let w = axis.normalize() * angle;
                Vector6::new(v[0], v[1], v[2], w.x, w.y, w.z)
            },
        )
    }

    proptest! {
        #[test]
        fn log_undoes_exp(t in twist()) {
            prop_assert!((log(&exp(&t)) - t).amax() < 1e-8 * (1.0 + t.amax()));
        }

        #[test]
        fn exp_of_negative_is_inverse(t in twist()) {
            let identity = exp(&t) * exp(&-t);
            prop_assert!(identity.translation.vector.amax() < 1e-9);
            prop_assert!(identity.rotation.angle() < 1e-7);
        }

        #[test]
        fn adjoint_moves_twists_across(x in twist(), t in twist()) {
            let (x, t) = (exp(&x), t * 0.1);
            let left = exp(&(adjoint(&x) * t));
            let right = x * exp(&t) * x.inverse();
            prop_assert!((left.to_homogeneous() - right.to_homogeneous()).amax() < 1e-8);
        }

        #[test]
        fn adjoint_is_a_homomorphism(a in twist(), b in twist()) {
            let (a, b) = (exp(&a), exp(&b));
            prop_assert!((adjoint(&(a * b)) - adjoint(&a) * adjoint(&b)).amax() < 1e-9);
        }

        #[test]
        fn exp_integrates_its_twist(t in twist()) {
            // d/ds exp(s t) at s = 1/2 by central differences equals t as seen in the body frame.
            let h = 1e-6;
            let step = exp(&(t * (0.5 - h))).inverse() * exp(&(t * (0.5 + h)));
            prop_assert!((log(&step) / (2.0 * h) - t).amax() < 1e-5 * (1.0 + t.amax()));
        }

        #[test]
        fn matrices_with_few_digits_are_accepted(t in twist()) {
            let pose = exp(&t);
            let rounded = pose.rotation.to_rotation_matrix().into_inner().map(|x| (x * 1e6).round() / 1e6);
            let again = from_matrix(&rounded, &pose.translation.vector).unwrap();
            prop_assert!(again.rotation.angle_to(&pose.rotation) < 1e-5);
            let exact = from_matrix(&pose.rotation.to_rotation_matrix().into_inner(), &pose.translation.vector).unwrap();
            prop_assert!((exact.to_homogeneous() - pose.to_homogeneous()).amax() < 1e-14);
        }
    }

    #[test]
    fn matrices_that_are_no_rotations_are_refused() {
        let zero = Vector3::zeros();
        assert!(matches!(from_matrix(&Matrix3::zeros(), &zero), Err(PoseError::NotRotation { .. })));
        assert!(matches!(from_matrix(&-Matrix3::identity(), &zero), Err(PoseError::NotRotation { .. })));
        let nan = Matrix3::from_element(f64::NAN);
        assert_eq!(from_matrix(&nan, &zero), Err(PoseError::NotFinite));
        assert!(matches!(from_quaternion([0.0; 3], [0.0; 4]), Err(PoseError::ZeroQuaternion { .. })));
    }
}
