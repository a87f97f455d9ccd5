//! A core camera with the derivative of its projection.

use endoscape_core::{Camera, CameraModel};
use nalgebra::{Matrix2x3, Point2, Point3, Vector2, Vector3};

/// Step of the central difference as a share of the point's distance: near the cube root of f64's precision.
const STEP: f64 = 1e-5;

/// A camera at one level of a pyramid.
#[derive(Clone, Copy, Debug)]
pub struct Lens {
    camera: Camera,
}

impl Lens {
    /// Takes a camera as it is.
    pub const fn new(camera: Camera) -> Self {
        Self { camera }
    }

    /// The camera inside.
    pub const fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Pixel of a point in front of the camera, in any unit of length.
    pub fn project(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        match self.camera.model() {
            CameraModel::Pinhole(pinhole) => {
                let k = pinhole.intrinsics;
                (point.z > f64::EPSILON).then(|| {
                    let (x, y) = (point.x / point.z, point.y / point.z);
                    Vector2::new(k.fx * x + k.skew * y + k.cx, k.fy * y + k.cy)
                })
            }
            _ => self.camera.project(&Point3::from(*point)).map(|pixel| pixel.coords),
        }
    }

    /// Derivative of [`Lens::project`] by the point: in closed form for a pinhole, by central differences for others.
    pub fn derivative(&self, point: &Vector3<f64>) -> Option<Matrix2x3<f64>> {
        if let CameraModel::Pinhole(pinhole) = self.camera.model() {
            let (k, inverse_z) = (pinhole.intrinsics, 1.0 / point.z);
            let (x, y) = (point.x * inverse_z, point.y * inverse_z);
            let (fx, fy, skew) = (k.fx * inverse_z, k.fy * inverse_z, k.skew * inverse_z);
            return Some(Matrix2x3::new(fx, skew, -fx * x - skew * y, 0.0, fy, -fy * y));
        }
        let h = STEP * point.norm();
        let column = |axis| {
            let step = Vector3::ith(axis, h);
            Some((self.project(&(point + step))? - self.project(&(point - step))?) / (2.0 * h))
        };
        Some(Matrix2x3::from_columns(&[column(0)?, column(1)?, column(2)?]))
    }

    /// The ray of a pixel, of depth 1 along the optical axis.
    pub fn ray(&self, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        self.camera.unproject_to_depth(&Point2::from(*pixel), 1.0).map(|point| point.coords)
    }
}
