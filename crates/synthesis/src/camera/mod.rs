//! Cameras as tensors: rays of all pixels, and a differentiable projection, for every model of [`endoscape_core`].
//!
//! Rays come from the exact inverse of each model in double precision and are constants; only the projection is
//! differentiated. Depth is measured along the optical axis, so rays are scaled to `z = 1`; directions close to or
//! beyond 90 degrees have no such depth and are marked as not seen.

mod chebyshev;
mod kernel;
mod lens;
mod radius_fit;
#[cfg(test)]
pub(crate) mod tests;

pub use lens::{Lens, Projected};

use crate::error::SynthesisError;
use burn::tensor::{Int, Tensor, TensorCreationOptions, TensorData};
use endoscape_core::{Camera, CameraError, Size};
use nalgebra::Point2;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Cosine of the widest angle (87 degrees) at which a depth along the axis still makes sense.
const SMALLEST_RAY_COSINE: f64 = 0.05;

/// How a camera changes when its picture is shrunk for a coarser scale.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CameraScaling {
    /// Edges map to edges: `p' = s (p + 1/2) - 1/2`, what area resizing does to a picture.
    #[default]
    Exact,
    /// `p' = s p`: intrinsics divided by the scale factor, as SfMLearner does; off by up to half a pixel.
    Divided,
}

/// The cameras of a batch of pictures of one size.
#[derive(Clone, Debug)]
pub struct CameraBatch {
    size: Size,
    rays: Tensor<4>,
    seen: Tensor<4>,
    groups: Vec<Group>,
    /// The same cameras for our kernels, in the order of the rays.
    lenses: Arc<[endoscape_kernels::Lens]>,
}

/// A camera whose pixels are moved by a constant, which is not zero for [`CameraScaling::Divided`] alone.
#[derive(Clone, Copy, Debug)]
struct ShiftedCamera {
    camera: Camera,
    /// Right and down, in pixels.
    shift: [f64; 2],
}

impl ShiftedCamera {
    fn scaled(camera: &Camera, size: Size, scaling: CameraScaling) -> Result<Self, CameraError> {
        // Resizing gives p' = s p + s / 2 - 1 / 2.
        let undo = |from: usize, to: usize| 0.5 - 0.5 * to as f64 / from as f64;
        let shift = match scaling {
            CameraScaling::Exact => [0.0, 0.0],
            CameraScaling::Divided => [undo(camera.size().width, size.width), undo(camera.size().height, size.height)],
        };
        Ok(Self { camera: camera.scaled_to(size)?, shift })
    }

    /// `(x / z, y / z)` of the direction imaged at a pixel.
    fn ray(&self, pixel: Point2<f64>) -> Option<[f64; 2]> {
        let direction = self.camera.unproject(&Point2::new(pixel.x - self.shift[0], pixel.y - self.shift[1]))?;
        (direction.z >= SMALLEST_RAY_COSINE).then(|| [direction.x / direction.z, direction.y / direction.z])
    }
}

/// Pictures of the batch whose cameras share a projection model.
#[derive(Clone, Debug)]
struct Group {
    items: Vec<usize>,
    lens: Lens,
}

impl CameraBatch {
    /// Cameras of a batch, one per picture, read out at `size`.
    ///
    /// Equal cameras are kept once and broadcast. `options` names the device and, where not the device's default, the
    /// floating-point type.
    ///
    /// # Errors
    /// [`SynthesisError::NoCamera`] for an empty batch; [`SynthesisError::Camera`] for a size without pixels.
    pub fn new(
        cameras: &[Camera],
        size: Size,
        scaling: CameraScaling,
        options: impl Into<TensorCreationOptions>,
    ) -> Result<Self, SynthesisError> {
        let options = options.into();
        let first = cameras.first().ok_or(SynthesisError::NoCamera)?;
        let distinct = if cameras.iter().all(|camera| camera == first) { &cameras[..1] } else { cameras };
        let scaled = |camera: &Camera| ShiftedCamera::scaled(camera, size, scaling);
        let cameras = distinct.iter().map(scaled).collect::<Result<Vec<_>, _>>()?;
        let (rays, seen) = rays_of(&cameras, size, &options);
        let lenses = cameras.iter().map(kernel::lens).collect();
        Ok(Self { size, rays, seen, groups: group(&cameras, &options), lenses })
    }

    /// Size of the pictures.
    pub const fn size(&self) -> Size {
        self.size
    }

    /// Rays of all pixels with `z = 1`, `[batch or 1, 3, height, width]`; `(0, 0, 1)` where nothing is seen.
    pub fn rays(&self) -> Tensor<4> {
        self.rays.clone()
    }

    /// 1 where a pixel has a ray, 0 in the dark corners of a fisheye picture, `[batch or 1, 1, height, width]`.
    pub fn seen(&self) -> Tensor<4> {
        self.seen.clone()
    }

    pub(crate) fn lenses(&self) -> Arc<[endoscape_kernels::Lens]> {
        Arc::clone(&self.lenses)
    }

    /// Points at `depth` along the optical axis, `P = D ray` (Eq. 1 of docs/math.md).
    ///
    /// # Shapes
    /// - `depth`: `[batch, 1, height, width]`, any unit
    /// - returns: `[batch, 3, height, width]`, in that unit, camera frame
    pub fn backproject(&self, depth: Tensor<4>) -> Tensor<4> {
        self.rays() * depth
    }

    /// Pixels of points in the camera frame; see [`Lens::project`] for the shapes.
    pub fn project(&self, points: Tensor<4>, nearest: Tensor<4>) -> Projected {
        match self.groups.as_slice() {
            [only] => only.lens.project(points, nearest),
            groups => project_groups(groups, &points, &nearest),
        }
    }
}

/// One [`CameraBatch`] per scale, finest first.
#[derive(Clone, Debug)]
pub struct CameraPyramid {
    levels: Vec<CameraBatch>,
}

impl CameraPyramid {
    /// Cameras at each of `sizes`; [`crate::pyramid::sizes`] gives those of the networks' outputs.
    ///
    /// # Errors
    /// As [`CameraBatch::new`].
    pub fn new(
        cameras: &[Camera],
        sizes: &[Size],
        scaling: CameraScaling,
        options: impl Into<TensorCreationOptions>,
    ) -> Result<Self, SynthesisError> {
        let options = options.into();
        let level = |size: &Size| CameraBatch::new(cameras, *size, scaling, options.clone());
        let levels = sizes.iter().map(level).collect::<Result<Vec<_>, _>>()?;
        if levels.is_empty() { Err(SynthesisError::NoScale) } else { Ok(Self { levels }) }
    }

    /// The scales, finest first; never empty.
    pub fn levels(&self) -> &[CameraBatch] {
        &self.levels
    }
}

/// Groups cameras by projection model, keeping the order inside each group.
fn group(cameras: &[ShiftedCamera], options: &TensorCreationOptions) -> Vec<Group> {
    let name = |item: usize| cameras[item].camera.model().name();
    let mut names: Vec<&str> = (0..cameras.len()).map(name).collect();
    names.sort_unstable();
    names.dedup();
    let members = |wanted: &&str| {
        let items: Vec<usize> = (0..cameras.len()).filter(|item| name(*item) == *wanted).collect();
        let members: Vec<ShiftedCamera> = items.iter().map(|item| cameras[*item]).collect();
        Group { items, lens: Lens::new(&members, options) }
    };
    names.iter().map(members).collect()
}

/// Projects each group with its own model and puts the pictures back into order.
fn project_groups(groups: &[Group], points: &Tensor<4>, nearest: &Tensor<4>) -> Projected {
    let device = points.device();
    let indices = |items: &[usize]| {
        let items: Vec<i64> = items.iter().map(|item| *item as i64).collect();
        Tensor::<1, Int>::from_data(items.as_slice(), &device)
    };
    // Positions and their flags travel as one tensor, to be put into order once.
    let project = |group: &Group| {
        let items = indices(&group.items);
        let points = points.clone().select(0, items.clone());
        let Projected { pixels, in_domain } = group.lens.project(points, nearest.clone().select(0, items));
        let flags = in_domain.float().cast(pixels.dtype());
        Tensor::cat(vec![pixels, flags], 1)
    };
    let grouped: Vec<usize> = groups.iter().flat_map(|group| group.items.iter().copied()).collect();
    let mut place = vec![0; grouped.len()];
    for (position, item) in grouped.iter().enumerate() {
        place[*item] = position;
    }
    let ordered = Tensor::cat(groups.iter().map(project).collect(), 0).select(0, indices(&place));
    Projected { pixels: ordered.clone().narrow(1, 0, 2), in_domain: ordered.narrow(1, 2, 1).greater_scalar(0.5) }
}

/// Rays with `z = 1` and where they exist, one picture per camera.
fn rays_of(cameras: &[ShiftedCamera], size: Size, options: &TensorCreationOptions) -> (Tensor<4>, Tensor<4>) {
    let pixel = |index: usize| Point2::new((index % size.width) as f64, (index / size.width) as f64);
    let (mut rays, mut seen) = (Vec::new(), Vec::new());
    for camera in cameras {
        let picture: Vec<_> = (0..size.area()).map(|index| camera.ray(pixel(index))).collect();
        rays.extend(picture.iter().map(|ray| ray.map_or(0.0, |[x, _]| x)));
        rays.extend(picture.iter().map(|ray| ray.map_or(0.0, |[_, y]| y)));
        rays.extend(picture.iter().map(|_| 1.0));
        seen.extend(picture.iter().map(|ray| if ray.is_some() { 1.0 } else { 0.0 }));
    }
    let shape = |channels: usize| [cameras.len(), channels, size.height, size.width];
    (
        Tensor::from_data(TensorData::new(rays, shape(3)), options.clone()),
        Tensor::from_data(TensorData::new(seen, shape(1)), options.clone()),
    )
}
