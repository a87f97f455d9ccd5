//! From six numbers of a network to a rigid motion.

use crate::se3::Pose;
use nalgebra::{Quaternion, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// What the three rotation numbers of a motion mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Rotation {
    /// Angles in radians about x, y and z: `R = Rx * Ry * Rz` (SfMLearner).
    #[default]
    Euler,
    /// Vector part of the quaternion `1 + rx i + ry j + rz k`, normalised (option of the PyTorch port).
    Quaternion,
    /// Axis times angle in radians: the exponential map of SO(3).
    AxisAngle,
}

impl Rotation {
    /// The rigid motion `source_from_target` of six numbers: a translation in the unit of depth, then three that say
    /// the rotation. View synthesis has the same maps as tensor operations.
    pub fn pose(self, motion: [f64; 6]) -> Pose {
        let [tx, ty, tz, rx, ry, rz] = motion;
        let about = |axis: Vector3<f64>, angle_rad: f64| UnitQuaternion::from_scaled_axis(axis * angle_rad);
        let rotation = match self {
            Self::Euler => about(Vector3::x(), rx) * about(Vector3::y(), ry) * about(Vector3::z(), rz),
            Self::Quaternion => UnitQuaternion::from_quaternion(Quaternion::new(1.0, rx, ry, rz)),
            Self::AxisAngle => UnitQuaternion::from_scaled_axis(Vector3::new(rx, ry, rz)),
        };
        Pose::from_parts(Translation3::new(tx, ty, tz), rotation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn a_quarter_turn_about_z_takes_x_to_y_in_every_parametrisation() {
        let half_pi = std::f64::consts::FRAC_PI_2;
        for (rotation, rz) in [(Rotation::Euler, half_pi), (Rotation::AxisAngle, half_pi), (Rotation::Quaternion, 1.0)]
        {
            let moved = rotation.pose([1.0, 2.0, 3.0, 0.0, 0.0, rz]) * Point3::new(1.0, 0.0, 0.0);
            assert!((moved - Point3::new(1.0, 3.0, 3.0)).norm() < 1e-12, "{rotation:?}: {moved}");
        }
    }

    #[test]
    fn euler_angles_turn_about_z_first() {
        let half_pi = std::f64::consts::FRAC_PI_2;
        // Rz takes y to -x, which Ry then takes to z, which Rx then takes to -y.
        let moved = Rotation::Euler.pose([0.0, 0.0, 0.0, half_pi, half_pi, half_pi]) * Point3::new(0.0, 1.0, 0.0);
        assert!((moved - Point3::new(0.0, -1.0, 0.0)).norm() < 1e-12, "{moved}");
    }
}
