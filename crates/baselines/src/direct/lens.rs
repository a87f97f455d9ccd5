//! A core camera for vectors.

use endoscape_core::Camera;
use nalgebra::{Matrix2x3, Point2, Point3, Vector2, Vector3};

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

    /// Pixel of a point the camera sees, in any unit of length.
    pub fn project(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.camera.project(&Point3::from(*point)).map(|pixel| pixel.coords)
    }

    /// Derivative of [`Lens::project`] by the point.
    pub fn derivative(&self, point: &Vector3<f64>) -> Option<Matrix2x3<f64>> {
        self.camera.project_derivative(&Point3::from(*point))
    }

    /// The ray of a pixel, of depth 1 along the optical axis.
    pub fn ray(&self, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        self.camera.unproject_to_depth(&Point2::from(*pixel), 1.0).map(|point| point.coords)
    }
}
