//! The field of a point dipole and its derivatives.
//!
//! Source: J. D. Jackson, "Classical Electrodynamics", 3rd edition (1999), equation 5.56, in SI units. A permanent
//! magnet of radius a differs from a point by a share of order (a / r)^2 of its field at distance r.

use nalgebra::{Matrix3, Point3, Vector3};

/// Magnetic constant over 4 pi in T m / A (CODATA 2018: 1e-7 to within 6e-10 of itself).
pub const MU_0_OVER_4_PI: f64 = 1e-7;

/// A point magnet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dipole {
    /// Where it is, metres.
    pub position_m: Point3<f64>,
    /// Magnetic moment, from south pole to north pole, in A m^2.
    pub moment_a_m2: Vector3<f64>,
}

impl Dipole {
    /// Flux density in tesla at a point of the same frame:
    /// `B(r) = mu_0 / (4 pi |r|^3) (3 e e^T - I) m`, with `r = at - position` and `e = r / |r|`.
    ///
    /// Not finite at the dipole itself.
    pub fn field_tesla(&self, at_m: &Point3<f64>) -> Vector3<f64> {
        Self::field_per_moment(&(at_m - self.position_m)) * self.moment_a_m2
    }

    /// The symmetric matrix that takes a moment in A m^2 to the field in tesla at `offset_m` from the dipole.
    pub fn field_per_moment(offset_m: &Vector3<f64>) -> Matrix3<f64> {
        let r = offset_m.norm();
        let e = offset_m / r;
        (e * e.transpose() * 3.0 - Matrix3::identity()) * (MU_0_OVER_4_PI / r.powi(3))
    }

    /// Derivative of [`Dipole::field_tesla`] by the point `at_m`, in T / m; by the dipole's position it is the
    /// negative:
    /// `3 mu_0 / (4 pi |r|^4) ((e m) I + m e^T + e m^T - 5 (e m) e e^T)`.
    ///
    /// Symmetric and without trace, as Maxwell's equations demand outside currents.
    pub fn field_gradient(&self, at_m: &Point3<f64>) -> Matrix3<f64> {
        let (offset, m) = (at_m - self.position_m, self.moment_a_m2);
        let r = offset.norm();
        let e = offset / r;
        let along = e.dot(&m);
        let shape =
            Matrix3::identity() * along + m * e.transpose() + e * m.transpose() - e * e.transpose() * (5.0 * along);
        shape * (3.0 * MU_0_OVER_4_PI / r.powi(4))
    }
}
