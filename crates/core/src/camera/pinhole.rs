//! The pinhole and the affine part all models but the omnidirectional one share.

use super::{CameraError, Projection, finite};
use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// Focal lengths, principal point and skew, in pixels: `u = fx x + skew y + cx`, `v = fy y + cy`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Horizontal focal length.
    pub fx: f64,
    /// Vertical focal length.
    pub fy: f64,
    /// Column of the principal point.
    pub cx: f64,
    /// Row of the principal point.
    pub cy: f64,
    /// Shear of the pixel grid; 0 for nearly every sensor.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub skew: f64,
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde hands over a reference")]
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

impl Intrinsics {
    /// Pixel of a point on the plane z = 1.
    pub(super) fn pixel(&self, plane: Vector2<f64>) -> Vector2<f64> {
        Vector2::new(self.fx * plane.x + self.skew * plane.y + self.cx, self.fy * plane.y + self.cy)
    }

    /// Derivative of [`Intrinsics::pixel`] by the plane.
    pub(super) const fn stretch(&self) -> Matrix2<f64> {
        Matrix2::new(self.fx, self.skew, 0.0, self.fy)
    }

    /// Point on the plane z = 1 of a pixel.
    pub(super) fn plane(&self, pixel: &Vector2<f64>) -> Vector2<f64> {
        let y = (pixel.y - self.cy) / self.fy;
        Vector2::new((pixel.x - self.cx - self.skew * y) / self.fx, y)
    }

    pub(super) fn moved(&self, scale: [f64; 2], shift: [f64; 2]) -> Self {
        Self {
            fx: scale[0] * self.fx,
            fy: scale[1] * self.fy,
            cx: scale[0] * self.cx + shift[0],
            cy: scale[1] * self.cy + shift[1],
            skew: scale[0] * self.skew,
        }
    }

    pub(super) fn check(&self) -> Result<(), CameraError> {
        let Self { fx, fy, cx, cy, skew } = *self;
        finite(&[("fx", fx), ("fy", fy), ("cx", cx), ("cy", cy), ("skew", skew)])?;
        match [("fx", fx), ("fy", fy)].into_iter().find(|(_, value)| *value <= 0.0) {
            Some((name, value)) => Err(CameraError::NotPositive { name, value }),
            None => Ok(()),
        }
    }
}

/// Straight lines stay straight: `(x, y, z) -> (x / z, y / z)`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pinhole {
    /// Pixels of the plane z = 1.
    #[serde(flatten)]
    pub intrinsics: Intrinsics,
}

/// Derivative of `(x / z, y / z)` by the point.
pub(super) fn plane_derivative(point: &Vector3<f64>) -> Matrix2x3<f64> {
    let inverse_z = 1.0 / point.z;
    let plane = point.xy() * inverse_z;
    Matrix2x3::new(inverse_z, 0.0, -plane.x * inverse_z, 0.0, inverse_z, -plane.y * inverse_z)
}

/// Just short of 90 degrees: beyond, a pinhole's pixels run off to infinity.
pub(super) const PINHOLE_WIDEST_RAD: f64 = 89.9 / 180.0 * std::f64::consts::PI;

impl Projection for Pinhole {
    fn radius(&self, theta_rad: f64) -> f64 {
        theta_rad.tan()
    }

    fn widest_rad(&self) -> f64 {
        PINHOLE_WIDEST_RAD
    }

    fn project(&self, point: &Vector3<f64>) -> Vector2<f64> {
        self.intrinsics.pixel(point.xy() / point.z)
    }

    fn derivative(&self, point: &Vector3<f64>) -> Matrix2x3<f64> {
        self.intrinsics.stretch() * plane_derivative(point)
    }

    fn unproject(&self, pixel: &Vector2<f64>, _widest_rad: f64) -> Option<Vector3<f64>> {
        Some(self.intrinsics.plane(pixel).push(1.0))
    }

    fn moved(&self, scale: [f64; 2], shift: [f64; 2]) -> Self {
        Self { intrinsics: self.intrinsics.moved(scale, shift) }
    }

    fn check(&self) -> Result<(), CameraError> {
        self.intrinsics.check()
    }
}
