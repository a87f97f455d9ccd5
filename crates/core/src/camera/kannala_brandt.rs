//! OpenCV's fisheye model.

use super::domain::invert_monotone;
use super::{CameraError, Intrinsics, Projection, finite, radial};
use nalgebra::{Matrix2x3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// Image radius as an odd polynomial of the angle off the axis:
/// `theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)`; J. Kannala, S. Brandt, PAMI 2006, as in OpenCV
/// `cv::fisheye`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct KannalaBrandt {
    /// Pixels per unit of distorted angle.
    #[serde(flatten)]
    pub intrinsics: Intrinsics,
    /// Third order.
    pub k1: f64,
    /// Fifth order.
    pub k2: f64,
    /// Seventh order.
    pub k3: f64,
    /// Ninth order.
    pub k4: f64,
}

impl KannalaBrandt {
    /// Derivative of the radius by the angle.
    fn slope(&self, theta: f64) -> f64 {
        let t2 = theta * theta;
        1.0 + t2 * (3.0 * self.k1 + t2 * (5.0 * self.k2 + t2 * (7.0 * self.k3 + t2 * 9.0 * self.k4)))
    }

    /// The angle at which a ray has a radius: by Newton's method, which takes three or four steps, and by bracketing
    /// where that leaves the domain.
    fn angle(&self, radius: f64, widest_rad: f64) -> Option<f64> {
        let mut theta = radius.min(widest_rad);
        for _ in 0..8 {
            let next = theta - (self.radius(theta) - radius) / self.slope(theta);
            if !(0.0..=widest_rad).contains(&next) {
                break;
            }
            if (next - theta).abs() <= 4.0 * f64::EPSILON * next {
                return Some(next);
            }
            theta = next;
        }
        invert_monotone(radius, 0.0, widest_rad, |theta| self.radius(theta))
    }
}

impl Projection for KannalaBrandt {
    fn radius(&self, theta: f64) -> f64 {
        let t2 = theta * theta;
        theta * (1.0 + t2 * (self.k1 + t2 * (self.k2 + t2 * (self.k3 + t2 * self.k4))))
    }

    fn widest_rad(&self) -> f64 {
        std::f64::consts::PI
    }

    fn project(&self, point: &Vector3<f64>) -> Vector2<f64> {
        let off_axis = point.xy().norm();
        let radius = self.radius(off_axis.atan2(point.z));
        // On the axis the direction in the image plane is undefined and does not matter.
        let direction = point.xy().try_normalize(0.0).unwrap_or_default();
        self.intrinsics.pixel(direction * radius)
    }

    fn linearise(&self, point: &Vector3<f64>) -> (Vector2<f64>, Matrix2x3<f64>) {
        let theta = point.xy().norm().atan2(point.z);
        let (plane, derivative) = radial(point, self.radius(theta), self.slope(theta));
        (self.intrinsics.pixel(plane), self.intrinsics.stretch() * derivative)
    }

    fn unproject(&self, pixel: &Vector2<f64>, widest_rad: f64) -> Option<Vector3<f64>> {
        let plane = self.intrinsics.plane(pixel);
        let theta = self.angle(plane.norm(), widest_rad)?;
        let direction = plane.try_normalize(0.0).unwrap_or_default();
        Some((direction * theta.sin()).push(theta.cos()))
    }

    fn moved(&self, scale: [f64; 2], shift: [f64; 2]) -> Self {
        Self { intrinsics: self.intrinsics.moved(scale, shift), ..*self }
    }

    fn check(&self) -> Result<(), CameraError> {
        let Self { intrinsics, k1, k2, k3, k4 } = *self;
        intrinsics.check()?;
        finite(&[("k1", k1), ("k2", k2), ("k3", k3), ("k4", k4)])
    }
}
