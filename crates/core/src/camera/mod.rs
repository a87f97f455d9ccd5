//! Cameras: from a point in front of the lens to a pixel and back.
//!
//! Camera axes are OpenCV's: x right, y down, z along the optical axis into the scene. Pixel centres lie at integer
//! coordinates, so the picture covers `-0.5 ..= width - 0.5`.
//!
//! | model | for | source |
//! |---|---|---|
//! | [`Pinhole`] | rectified pictures | |
//! | [`RadialTangential`] | ordinary lenses | OpenCV, 5 or 8 parameters (Brown 1966) |
//! | [`KannalaBrandt`] | fisheye | OpenCV `fisheye` (Kannala and Brandt 2006) |
//! | [`Omnidirectional`] | wide endoscopes | Scaramuzza et al. 2006, as C3VD publishes it |
//! | [`Unified`] | catadioptric and wide lenses | Geyer and Daniilidis 2000, Mei and Rives 2007 |
//!
//! Every model has a domain: the cone of directions it images one to one, found once as the range in which the image
//! radius grows with the angle off the axis. Outside it [`Camera::project`] answers `None` instead of a plausible
//! wrong pixel.

mod domain;
mod kannala_brandt;
mod omnidirectional;
mod pinhole;
mod radial_tangential;
mod unified;

pub use kannala_brandt::KannalaBrandt;
pub use omnidirectional::Omnidirectional;
pub use pinhole::{Intrinsics, Pinhole};
pub use radial_tangential::RadialTangential;
pub use unified::Unified;

use crate::{Rect, Size};
use nalgebra::{Matrix2, Matrix2x3, Point2, Point3, Vector2, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Why numbers are no camera.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum CameraError {
    /// NaN or infinity among the parameters.
    #[error("camera parameter {name} is not a finite number")]
    NotFinite {
        /// Name of the parameter as written in camera files.
        name: &'static str,
    },
    /// A focal length (or the leading polynomial coefficient) that is zero or negative.
    #[error("camera parameter {name} is {value}, but it must be above zero")]
    NotPositive {
        /// Name of the parameter as written in camera files.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// A picture without pixels.
    #[error("a camera of {0} has no pixels")]
    Empty(Size),
    /// A crop that reaches outside the picture.
    #[error("the block at ({}, {}) of {} does not fit into {size}", rect.x, rect.y, rect.size)]
    Outside {
        /// The block asked for.
        rect: Rect,
        /// The size of the picture.
        size: Size,
    },
    /// A field of view no pinhole has.
    #[error("a pinhole cannot have a field of view of {degrees} degrees; choose one between 1 and 170")]
    FieldOfView {
        /// The angle asked for, in degrees.
        degrees: f64,
    },
}

/// One of the five projection models, without a picture size.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "model", rename_all = "kebab-case")]
pub enum CameraModel {
    /// No distortion.
    Pinhole(Pinhole),
    /// OpenCV's polynomial distortion.
    RadialTangential(RadialTangential),
    /// OpenCV's fisheye.
    KannalaBrandt(KannalaBrandt),
    /// Scaramuzza's polynomial.
    Omnidirectional(Omnidirectional),
    /// Sphere and plane.
    Unified(Unified),
}

/// What each model file provides; the affine part (pixels) stays apart from the curved part (directions).
trait Projection {
    /// Distance from the distortion centre at which a ray of angle `theta` off the axis is imaged, in the model's own
    /// units, without tangential terms. Used to find the domain.
    fn radius(&self, theta_rad: f64) -> f64;
    /// Largest angle the model could image if its radius kept growing.
    fn widest_rad(&self) -> f64;
    /// Pixel of a point inside the domain.
    fn project(&self, point: &Vector3<f64>) -> Vector2<f64>;
    /// The same with its derivative by the point.
    fn linearise(&self, point: &Vector3<f64>) -> (Vector2<f64>, Matrix2x3<f64>);
    /// Direction (any length) imaged at a pixel, `None` if no direction within `widest` is.
    fn unproject(&self, pixel: &Vector2<f64>, widest_rad: f64) -> Option<Vector3<f64>>;
    /// Replaces pixel coordinates `p` by `scale * p + shift`, component by component.
    fn moved(&self, scale: [f64; 2], shift: [f64; 2]) -> Self;
    /// Refuses numbers that are no camera.
    fn check(&self) -> Result<(), CameraError>;
}

/// Runs the same expression on whichever model is inside.
macro_rules! each_model {
    ($model:expr, $inner:ident => $body:expr) => {
        match $model {
            CameraModel::Pinhole($inner) => $body,
            CameraModel::RadialTangential($inner) => $body,
            CameraModel::KannalaBrandt($inner) => $body,
            CameraModel::Omnidirectional($inner) => $body,
            CameraModel::Unified($inner) => $body,
        }
    };
}

impl CameraModel {
    /// Name as written in camera files and reports.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Pinhole(_) => "pinhole",
            Self::RadialTangential(_) => "radial-tangential",
            Self::KannalaBrandt(_) => "kannala-brandt",
            Self::Omnidirectional(_) => "omnidirectional",
            Self::Unified(_) => "unified",
        }
    }
}

/// A projection model with the size of the picture it belongs to, checked on construction.
///
/// ```
/// use endoscape_core::{Camera, CameraModel, Size, camera::{Intrinsics, Pinhole}};
/// let intrinsics = Intrinsics { fx: 360.0, fy: 360.0, cx: 319.5, cy: 255.5, skew: 0.0 };
/// let camera = Camera::new(Size::new(640, 512), CameraModel::Pinhole(Pinhole { intrinsics }))?;
/// let pixel = camera.project(&nalgebra::Point3::new(0.0, 0.0, 0.05)).unwrap();
/// assert_eq!((pixel.x, pixel.y), (319.5, 255.5));
/// # Ok::<(), endoscape_core::CameraError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "CameraFile", into = "CameraFile")]
pub struct Camera {
    size: Size,
    model: CameraModel,
    /// Half-angle of the cone imaged one to one, radians.
    widest_rad: f64,
    /// Its cosine: what tells quickly whether a point lies in the cone.
    widest_cos: f64,
}

/// The camera as it stands in `camera.toml`.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct CameraFile {
    width: usize,
    height: usize,
    #[serde(flatten)]
    model: CameraModel,
}

impl TryFrom<CameraFile> for Camera {
    type Error = CameraError;

    fn try_from(file: CameraFile) -> Result<Self, CameraError> {
        Self::new(Size::new(file.width, file.height), file.model)
    }
}

impl From<Camera> for CameraFile {
    fn from(camera: Camera) -> Self {
        Self { width: camera.size.width, height: camera.size.height, model: camera.model }
    }
}

impl Camera {
    /// Checks the parameters and finds the model's domain.
    ///
    /// # Errors
    /// [`CameraError`] for an empty picture, numbers that are not finite, or focal lengths that are not positive.
    pub fn new(size: Size, model: CameraModel) -> Result<Self, CameraError> {
        if size.area() == 0 {
            return Err(CameraError::Empty(size));
        }
        each_model!(&model, inner => inner.check())?;
        let widest_rad = each_model!(&model, inner => domain::monotone_limit(inner.widest_rad(), |t| inner.radius(t)));
        Ok(Self { size, model, widest_rad, widest_cos: widest_rad.cos() })
    }

    /// A pinhole centred in a picture of `size` that sees `horizontal_rad` from its left to its right edge.
    ///
    /// For rectification, and for videos without calibration, where the field of view is a stated assumption.
    ///
    /// # Errors
    /// [`CameraError::FieldOfView`] outside 1 to 170 degrees, [`CameraError::Empty`] for a picture without pixels.
    pub fn from_field_of_view(size: Size, horizontal_rad: f64) -> Result<Self, CameraError> {
        let degrees = horizontal_rad.to_degrees();
        if !(1.0..=170.0).contains(&degrees) {
            return Err(CameraError::FieldOfView { degrees });
        }
        let f = 0.5 * size.width as f64 / (0.5 * horizontal_rad).tan();
        let (cx, cy) = (0.5 * size.width as f64 - 0.5, 0.5 * size.height as f64 - 0.5);
        Self::new(size, CameraModel::Pinhole(Pinhole { intrinsics: Intrinsics { fx: f, fy: f, cx, cy, skew: 0.0 } }))
    }

    /// Size of the picture in pixels.
    pub const fn size(&self) -> Size {
        self.size
    }

    /// The projection model and its parameters, in pixels of [`Camera::size`].
    pub const fn model(&self) -> &CameraModel {
        &self.model
    }

    /// Half-angle in radians of the cone of directions this model images one to one.
    pub const fn domain_rad(&self) -> f64 {
        self.widest_rad
    }

    /// Pixel at which a point (camera frame, any length unit) is imaged; it may lie outside the picture.
    ///
    /// `None` for points outside the model's domain: behind a pinhole, at the lens itself, or beyond the angle where
    /// the distortion polynomial turns back.
    pub fn project(&self, point_in_camera: &Point3<f64>) -> Option<Point2<f64>> {
        let point = &point_in_camera.coords;
        if !self.sees(point) {
            return None;
        }
        let pixel = each_model!(&self.model, inner => inner.project(point));
        (pixel.x.is_finite() && pixel.y.is_finite()).then(|| Point2::from(pixel))
    }

    /// [`Camera::project`] with its derivative by the point (camera frame): rows are column and row of the pixel, columns
    /// the axes of the point, pixels per unit of its length. `None` where the projection is.
    pub fn project_with_derivative(&self, point_in_camera: &Point3<f64>) -> Option<(Point2<f64>, Matrix2x3<f64>)> {
        let point = &point_in_camera.coords;
        if !self.sees(point) {
            return None;
        }
        let (pixel, derivative) = each_model!(&self.model, inner => inner.linearise(point));
        (pixel.x.is_finite() && pixel.y.is_finite()).then(|| (Point2::from(pixel), derivative))
    }

    /// Unit direction (camera frame) imaged at a pixel; the inverse of [`Camera::project`].
    ///
    /// `None` where no direction of the domain is imaged, such as the dark corners of a fisheye picture.
    pub fn unproject(&self, pixel: &Point2<f64>) -> Option<Vector3<f64>> {
        if !(pixel.x.is_finite() && pixel.y.is_finite()) {
            return None;
        }
        let widest = self.widest_rad;
        let direction = each_model!(&self.model, inner => inner.unproject(&pixel.coords, widest))?;
        // Astronomically far pixels overflow the norm; they are no directions either.
        direction.try_normalize(f64::MIN_POSITIVE).filter(|unit| (unit.norm() - 1.0).abs() < 1e-9)
    }

    /// Point at depth `depth` along the optical axis (not along the ray) imaged at a pixel, in the unit of `depth`.
    ///
    /// `None` where [`Camera::unproject`] is, and for directions at or beyond 90 degrees, which have no such depth.
    pub fn unproject_to_depth(&self, pixel: &Point2<f64>, depth: f64) -> Option<Point3<f64>> {
        let direction = self.unproject(pixel)?;
        (direction.z > 1e-6).then(|| Point3::from(direction * (depth / direction.z)))
    }

    /// Whether a pixel lies on the picture.
    pub fn contains(&self, pixel: &Point2<f64>) -> bool {
        let inside = |value: f64, extent: usize| value >= -0.5 && value <= extent as f64 - 0.5;
        inside(pixel.x, self.size.width) && inside(pixel.y, self.size.height)
    }

    /// The same lens read out at another size: the whole picture resized to `size`.
    ///
    /// # Errors
    /// [`CameraError::Empty`] for a size without pixels.
    pub fn scaled_to(&self, size: Size) -> Result<Self, CameraError> {
        let scale = [size.width as f64 / self.size.width as f64, size.height as f64 / self.size.height as f64];
        // Edges map to edges, so with centres at integers p' + 1/2 = scale (p + 1/2).
        let shift = scale.map(|scale| 0.5 * scale - 0.5);
        Self::new(size, each_model!(&self.model, inner => inner.moved(scale, shift).into()))
    }

    /// The same lens with only a block of the picture kept.
    ///
    /// # Errors
    /// [`CameraError::Outside`] if the block reaches outside, [`CameraError::Empty`] if it has no pixels.
    pub fn cropped(&self, rect: Rect) -> Result<Self, CameraError> {
        if !rect.fits(self.size) {
            return Err(CameraError::Outside { rect, size: self.size });
        }
        let shift = [-(rect.x as f64), -(rect.y as f64)];
        Self::new(rect.size, each_model!(&self.model, inner => inner.moved([1.0, 1.0], shift).into()))
    }

    /// Angle in radians between the rays at the left and right edge of the middle row; `None` where an edge sees
    /// nothing.
    pub fn horizontal_field_of_view_rad(&self) -> Option<f64> {
        let row = 0.5 * self.size.height as f64 - 0.5;
        let left = self.unproject(&Point2::new(-0.5, row))?;
        let right = self.unproject(&Point2::new(self.size.width as f64 - 0.5, row))?;
        // Angles from the axis add up, also beyond 180 degrees in all.
        let off_axis = |ray: &Vector3<f64>| ray.xy().norm().atan2(ray.z);
        Some(off_axis(&left) + off_axis(&right))
    }

    fn sees(&self, point: &Vector3<f64>) -> bool {
        let distance = point.norm();
        distance > 0.0 && point.z >= distance * self.widest_cos
    }
}

macro_rules! into_model {
    ($($name:ident),*) => {$(
        impl From<$name> for CameraModel {
            fn from(model: $name) -> Self {
                Self::$name(model)
            }
        }
    )*};
}
into_model!(Pinhole, RadialTangential, KannalaBrandt, Omnidirectional, Unified);

/// `radius(theta)` along the direction of `(x, y)` with its derivative by the point, `theta` being the point's angle off
/// the axis and `slope` the derivative of the radius by it.
fn radial(point: &Vector3<f64>, radius: f64, slope: f64) -> (Vector2<f64>, Matrix2x3<f64>) {
    let (off_axis, squared) = (point.xy().norm(), point.norm_squared());
    let Some(direction) = point.xy().try_normalize(1e-9 * squared.sqrt()) else {
        let scale = slope / point.z;
        return (point.xy() * scale, Matrix2x3::new(scale, 0.0, 0.0, 0.0, scale, 0.0));
    };
    let (along, across) = (slope * point.z / squared, radius / off_axis);
    let by_plane = Matrix2::identity() * across + direction * direction.transpose() * (along - across);
    let by_axis = direction * (-slope * off_axis / squared);
    (direction * radius, Matrix2x3::from_columns(&[by_plane.column(0).into(), by_plane.column(1).into(), by_axis]))
}

/// Refuses the first parameter that is not finite.
fn finite(parameters: &[(&'static str, f64)]) -> Result<(), CameraError> {
    match parameters.iter().find(|(_, value)| !value.is_finite()) {
        Some((name, _)) => Err(CameraError::NotFinite { name }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests;
