//! OpenCV's default lens model, with 5 or 8 parameters.

use super::domain::invert_monotone;
use super::pinhole::{PINHOLE_WIDEST_RAD, plane_derivative};
use super::{CameraError, Intrinsics, Projection, finite};
use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// Radial polynomial (rational with `k4..k6`) and decentring terms on the plane z = 1; OpenCV documentation,
/// "Camera Calibration and 3D Reconstruction", distortion equations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RadialTangential {
    /// Pixels of the distorted plane.
    #[serde(flatten)]
    pub intrinsics: Intrinsics,
    /// Radial, second order.
    pub k1: f64,
    /// Radial, fourth order.
    pub k2: f64,
    /// Decentring.
    #[serde(default)]
    pub p1: f64,
    /// Decentring.
    #[serde(default)]
    pub p2: f64,
    /// Radial, sixth order.
    #[serde(default)]
    pub k3: f64,
    /// Denominator, second order.
    #[serde(default)]
    pub k4: f64,
    /// Denominator, fourth order.
    #[serde(default)]
    pub k5: f64,
    /// Denominator, sixth order.
    #[serde(default)]
    pub k6: f64,
}

impl RadialTangential {
    /// Takes distortion in OpenCV's order `k1 k2 p1 p2 [k3 [k4 k5 k6]]`; missing ones are 0, further ones ignored.
    pub fn from_opencv(intrinsics: Intrinsics, distortion: &[f64]) -> Self {
        let d = |index: usize| distortion.get(index).copied().unwrap_or(0.0);
        Self { intrinsics, k1: d(0), k2: d(1), p1: d(2), p2: d(3), k3: d(4), k4: d(5), k5: d(6), k6: d(7) }
    }

    fn radial(&self, r2: f64) -> f64 {
        let above = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        let below = 1.0 + r2 * (self.k4 + r2 * (self.k5 + r2 * self.k6));
        // A denominator that has passed zero would bring far points back into the picture.
        if below > 0.0 { above / below } else { -1.0 }
    }

    fn distort(&self, p: Vector2<f64>) -> Vector2<f64> {
        let (r2, xy) = (p.norm_squared(), p.x * p.y);
        let decentring = Vector2::new(
            2.0 * self.p1 * xy + self.p2 * (r2 + 2.0 * p.x * p.x),
            self.p1 * (r2 + 2.0 * p.y * p.y) + 2.0 * self.p2 * xy,
        );
        p * self.radial(r2) + decentring
    }

    /// Derivative of [`Self::distort`].
    fn distort_derivative(&self, p: Vector2<f64>) -> Matrix2<f64> {
        let r2 = p.norm_squared();
        let above = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        let below = 1.0 + r2 * (self.k4 + r2 * (self.k5 + r2 * self.k6));
        let above_slope = self.k1 + r2 * (2.0 * self.k2 + r2 * 3.0 * self.k3);
        let below_slope = self.k4 + r2 * (2.0 * self.k5 + r2 * 3.0 * self.k6);
        let radial_slope = (above_slope * below - above * below_slope) / (below * below);
        let cross = 2.0 * (self.p1 * p.x + self.p2 * p.y);
        let (by_x, by_y) = (2.0 * self.p1 * p.y + 6.0 * self.p2 * p.x, 6.0 * self.p1 * p.y + 2.0 * self.p2 * p.x);
        Matrix2::identity() * self.radial(r2)
            + p * p.transpose() * (2.0 * radial_slope)
            + Matrix2::new(by_x, cross, cross, by_y)
    }

    /// Newton's rule on the plane.
    fn undistort(&self, distorted: Vector2<f64>, start: Vector2<f64>) -> Option<Vector2<f64>> {
        let mut p = start;
        for _ in 0..20 {
            let residual = self.distort(p) - distorted;
            if residual.amax() < 1e-14 {
                break;
            }
            p -= self.distort_derivative(p).lu().solve(&residual)?;
        }
        ((self.distort(p) - distorted).amax() < 1e-9).then_some(p)
    }
}

impl Projection for RadialTangential {
    fn radius(&self, theta_rad: f64) -> f64 {
        let r = theta_rad.tan();
        r * self.radial(r * r)
    }

    fn widest_rad(&self) -> f64 {
        PINHOLE_WIDEST_RAD
    }

    fn project(&self, point: &Vector3<f64>) -> Vector2<f64> {
        self.intrinsics.pixel(self.distort(point.xy() / point.z))
    }

    fn derivative(&self, point: &Vector3<f64>) -> Matrix2x3<f64> {
        let distortion = self.distort_derivative(point.xy() / point.z);
        self.intrinsics.stretch() * distortion * plane_derivative(point)
    }

    fn unproject(&self, pixel: &Vector2<f64>, widest_rad: f64) -> Option<Vector3<f64>> {
        let distorted = self.intrinsics.plane(pixel);
        // The radial part alone gives a start inside the domain, from which the decentring is a small correction.
        let radius = distorted.norm();
        let reachable = radius.min(self.radius(widest_rad));
        let theta = invert_monotone(reachable, 0.0, widest_rad, |theta| self.radius(theta))?;
        let start = distorted.try_normalize(0.0).map_or(distorted, |unit| unit * theta.tan());
        let plane = self.undistort(distorted, start)?;
        (plane.norm() <= widest_rad.tan()).then(|| plane.push(1.0))
    }

    fn moved(&self, scale: [f64; 2], shift: [f64; 2]) -> Self {
        Self { intrinsics: self.intrinsics.moved(scale, shift), ..*self }
    }

    fn check(&self) -> Result<(), CameraError> {
        let Self { intrinsics, k1, k2, p1, p2, k3, k4, k5, k6 } = *self;
        intrinsics.check()?;
        finite(&[("k1", k1), ("k2", k2), ("p1", p1), ("p2", p2), ("k3", k3), ("k4", k4), ("k5", k5), ("k6", k6)])
    }
}
