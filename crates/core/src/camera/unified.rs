//! The unified (sphere) model, with Mei's distortion.

use super::domain::invert_monotone;
use super::{CameraError, Intrinsics, Projection, finite};
use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// A point is put on the unit sphere, seen from `xi` behind its centre, then distorted radially:
/// `m = (x, y) / (z + xi |p|)`, `m (1 + k1 |m|^2 + k2 |m|^4)`; C. Geyer, K. Daniilidis, ECCV 2000, and C. Mei,
/// P. Rives, ICRA 2007.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Unified {
    /// Pixels of the distorted plane.
    #[serde(flatten)]
    pub intrinsics: Intrinsics,
    /// Distance of the projection centre from the sphere's centre; 0 is a pinhole.
    pub xi: f64,
    /// Radial, second order.
    #[serde(default)]
    pub k1: f64,
    /// Radial, fourth order.
    #[serde(default)]
    pub k2: f64,
}

impl Projection for Unified {
    fn radius(&self, theta_rad: f64) -> f64 {
        let m = theta_rad.sin() / (theta_rad.cos() + self.xi);
        m * (1.0 + m * m * (self.k1 + m * m * self.k2))
    }

    fn widest_rad(&self) -> f64 {
        // The radius turns back where the ray touches the sphere (xi > 1) or runs off to infinity (xi <= 1).
        let limit = if self.xi > 1.0 { (-1.0 / self.xi).acos() } else { (-self.xi).acos() };
        0.999 * limit
    }

    fn project(&self, point: &Vector3<f64>) -> Vector2<f64> {
        let m = point.xy() / (point.z + self.xi * point.norm());
        let r2 = m.norm_squared();
        self.intrinsics.pixel(m * (1.0 + r2 * (self.k1 + r2 * self.k2)))
    }

    fn derivative(&self, point: &Vector3<f64>) -> Matrix2x3<f64> {
        let (xy, distance) = (point.xy(), point.norm());
        let below = point.z + self.xi * distance;
        let m = xy / below;
        let below_by_point = point * (self.xi / distance) + Vector3::z();
        let plane: Matrix2x3<f64> = (Matrix2x3::identity() - m * below_by_point.transpose()) / below;
        let r2 = m.norm_squared();
        let radial = 1.0 + r2 * (self.k1 + r2 * self.k2);
        let distortion = Matrix2::identity() * radial + m * m.transpose() * (2.0 * self.k1 + 4.0 * self.k2 * r2);
        self.intrinsics.stretch() * distortion * plane
    }

    fn unproject(&self, pixel: &Vector2<f64>, widest_rad: f64) -> Option<Vector3<f64>> {
        let plane = self.intrinsics.plane(pixel);
        let theta = invert_monotone(plane.norm(), 0.0, widest_rad, |theta| self.radius(theta))?;
        let direction = plane.try_normalize(0.0).unwrap_or_default();
        Some((direction * theta.sin()).push(theta.cos()))
    }

    fn moved(&self, scale: [f64; 2], shift: [f64; 2]) -> Self {
        Self { intrinsics: self.intrinsics.moved(scale, shift), ..*self }
    }

    fn check(&self) -> Result<(), CameraError> {
        let Self { intrinsics, xi, k1, k2 } = *self;
        intrinsics.check()?;
        finite(&[("xi", xi), ("k1", k1), ("k2", k2)])?;
        if xi < 0.0 { Err(CameraError::NotPositive { name: "xi", value: xi }) } else { Ok(()) }
    }
}
