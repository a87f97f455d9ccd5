//! Where the pixels of one view lie in another, with derivatives: one unit of the device per pixel.
//!
//! The counterpart of `endoscape_kernels::Correspondence`, with its rules: pixels without a sane depth are treated as
//! if theirs was 1, points that the lens does not image as if they lay on its axis, so that their gradients are zero
//! and everything stays finite. What is summed over pixels, the gradient of the motion, is summed by Burn.

use super::lens::{Model, Point, images, project};
use super::maps::{CubeTensor, Pixel, Units, index, own_pixel, pixels, unwritten, write};
use burn::backend::ops::FloatTensorOps;
use burn::backend::{Cube, Slice, TensorMetadata};
use burn::cubecl;
use cubecl::prelude::*;
use endoscape_kernels::correspondence::Limits;
use std::ops::Range;

/// Two views and what lies between them.
///
/// # Shapes
/// - `rays`: `[cameras, 3, rows, columns]`, the third plane is 1
/// - `seen`: `[cameras, 1, rows, columns]`, 1 where there is a ray, else 0
/// - `lenses`: a row per camera; there are as many cameras as pictures, or one
#[derive(Clone, Debug)]
pub struct Views {
    /// Directions of the pixels.
    pub rays: CubeTensor,
    /// Which pixels have one.
    pub seen: CubeTensor,
    /// Both views' cameras.
    pub lenses: CubeTensor,
    /// Of what model those are.
    pub model: Model,
    /// What counts.
    pub limits: Limits,
}

/// What is known about the pixels of the first view, as planes of one tensor: few devices promise a kernel more than
/// eight buffers.
pub struct Found(CubeTensor);

impl Found {
    /// `[batch, 2, rows, columns]`: column and row in the second picture.
    pub fn positions(&self) -> CubeTensor {
        planes(&self.0, 0..2)
    }

    /// `[batch, 1, rows, columns]`: depth along the second camera's axis, 1 where not defined.
    pub fn depth(&self) -> CubeTensor {
        planes(&self.0, 2..3)
    }

    /// `[batch, 1, rows, columns]`: 1 where the pixel has a ray, a sane depth and a point that the lens images, else 0.
    pub fn defined(&self) -> CubeTensor {
        planes(&self.0, 3..4)
    }

    /// `[batch, 1, rows, columns]`: 1 where the position lies in the second picture besides, else 0.
    pub fn in_view(&self) -> CubeTensor {
        planes(&self.0, 4..5)
    }
}

/// Derivatives at every pixel, as planes of one tensor: of the depth, of the moved point, and the point before it was
/// moved, followed by a one.
pub struct Slopes(CubeTensor);

impl Slopes {
    /// The gradient of the depth, `[batch, 1, rows, columns]`.
    pub fn of_depth(&self) -> CubeTensor {
        planes(&self.0, 0..1)
    }

    /// The gradient of the motion, `[batch, 3, 4]`: that of the moved points times the points before.
    ///
    /// Not by a matrix product, which tensor cores compute with ten bits of these numbers.
    pub fn of_motion(&self) -> CubeTensor {
        let [batch, _, rows, columns] = self.0.shape().dims();
        let list = |range, shape: [usize; 4]| Cube::float_reshape(planes(&self.0, range), shape.into());
        let of_moved = list(1..4, [batch, 3, 1, rows * columns]);
        let before = list(4..8, [batch, 1, 4, rows * columns]);
        let sums = Cube::float_sum_dim(Cube::float_mul(of_moved, before), 3);
        Cube::float_reshape(sums, [batch, 3, 4].into())
    }
}

/// What of the found a gradient is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Part {
    /// [`Found::positions`].
    Positions,
    /// [`Found::depth`].
    Depth,
}

impl Views {
    /// Finds the pixels in the second view.
    ///
    /// # Shapes
    /// - `depth`: `[batch, 1, rows, columns]`, along the axis
    /// - `motion`: `[batch, 3, 4]`, the matrix `[R | t]`
    pub fn find(&self, depth: CubeTensor, motion: CubeTensor) -> Found {
        let [batch, _, rows, columns] = depth.shape().dims();
        let found = unwritten(&depth, [batch, 5, rows, columns]);
        let units = Units::new(&depth, &[&self.rays, &found]);
        find_kernel::launch(
            &found.client,
            units.count,
            units.dim,
            units.address,
            self.scene(depth, motion),
            found.clone().into_tensor_arg(),
            self.limits.border_slack,
            self.model,
        );
        Found(found)
    }

    /// What the gradients of depth and motion follow from, from that of a part of what was found.
    pub fn differentiate(&self, depth: CubeTensor, motion: CubeTensor, part: Part, of_part: CubeTensor) -> Slopes {
        let [batch, _, rows, columns] = depth.shape().dims();
        let slopes = unwritten(&depth, [batch, 8, rows, columns]);
        let units = Units::new(&depth, &[&self.rays, &of_part, &slopes]);
        differentiate_kernel::launch(
            &slopes.client,
            units.count,
            units.dim,
            units.address,
            self.scene(depth, motion),
            of_part.into_tensor_arg(),
            slopes.clone().into_tensor_arg(),
            part,
            self.model,
        );
        Slopes(slopes)
    }

    fn scene(&self, depth: CubeTensor, motion: CubeTensor) -> SceneLaunch {
        SceneLaunch::new(
            self.rays.clone().into_tensor_arg(),
            self.seen.clone().into_tensor_arg(),
            self.lenses.clone().into_tensor_arg(),
            depth.into_tensor_arg(),
            motion.into_tensor_arg(),
            self.limits.depth[0],
            self.limits.depth[1],
            self.limits.nearest,
        )
    }
}

/// Some planes of maps.
fn planes(maps: &CubeTensor, range: Range<usize>) -> CubeTensor {
    Cube::float_slice(maps.clone(), &[Slice::full(), range.into()])
}

/// [`Views`], depth and motion, as kernels know them.
#[derive(CubeType, CubeLaunch)]
struct Scene {
    rays: OwnedTensor<f32>,
    seen: OwnedTensor<f32>,
    lenses: OwnedTensor<f32>,
    depth: OwnedTensor<f32>,
    motion: OwnedTensor<f32>,
    lowest_depth: f32,
    highest_depth: f32,
    nearest: f32,
}

/// A pixel's way to the other camera.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Way {
    camera: usize,
    /// Its direction in the first camera's frame, 1 along the axis.
    ray: Point,
    /// 1 where the given one is not sane.
    depth: f32,
    sane: bool,
    /// The point in the second camera's frame, on its axis where the lens does not image it.
    to: Point,
    in_domain: bool,
    known: bool,
}

#[cube(launch, address_type = "dynamic")]
fn find_kernel(scene: &Scene, found: &mut Tensor<f32>, border_slack: f32, #[comptime] model: Model) {
    if ABSOLUTE_POS >= pixels(&*found) {
        terminate!();
    }
    let pixel = own_pixel(&*found);
    let way = way(scene, pixel, model);
    let place = project(&scene.lenses, way.camera, way.to, model);
    let (column, row) = (place.x.value, place.y.value);
    let inside = within(column, found.shape(3), border_slack) && within(row, found.shape(2), border_slack);
    write(found, 0, pixel, column);
    write(found, 1, pixel, row);
    write(found, 2, pixel, select(way.known, way.to.z, 1.0));
    write(found, 3, pixel, select(way.known, 1.0f32, 0.0f32));
    write(found, 4, pixel, select(way.known && inside, 1.0f32, 0.0f32));
}

/// Writes the planes of [`Slopes`].
#[cube(launch, address_type = "dynamic")]
fn differentiate_kernel(
    scene: &Scene,
    of_part: &Tensor<f32>,
    slopes: &mut Tensor<f32>,
    #[comptime] part: Part,
    #[comptime] model: Model,
) {
    if ABSOLUTE_POS >= pixels(&*slopes) {
        terminate!();
    }
    let pixel = own_pixel(&*slopes);
    let way = way(scene, pixel, model);
    let of_to = match part {
        Part::Positions => of_moved(scene, way, of_part, pixel, model),
        Part::Depth => Point { x: 0.0, y: 0.0, z: select(way.known, of_part[index(of_part, 0, pixel)], 0.0) },
    };
    let along = way.ray.x * back(&scene.motion, 0, pixel.item, of_to)
        + way.ray.y * back(&scene.motion, 1, pixel.item, of_to)
        + way.ray.z * back(&scene.motion, 2, pixel.item, of_to);
    write(slopes, 0, pixel, select(way.sane, along, 0.0));
    write(slopes, 1, pixel, of_to.x);
    write(slopes, 2, pixel, of_to.y);
    write(slopes, 3, pixel, of_to.z);
    write(slopes, 4, pixel, way.ray.x * way.depth);
    write(slopes, 5, pixel, way.ray.y * way.depth);
    write(slopes, 6, pixel, way.ray.z * way.depth);
    write(slopes, 7, pixel, 1.0);
}

#[cube]
fn way(scene: &Scene, pixel: Pixel, #[comptime] model: Model) -> Way {
    // A single camera serves all pictures.
    let camera = pixel.item % scene.lenses.shape(0);
    let of_camera = Pixel { item: camera, row: pixel.row, column: pixel.column };
    let given = scene.depth[index(&scene.depth, 0, pixel)];
    // False for NaN.
    let sane = given > scene.lowest_depth && given < scene.highest_depth;
    let depth = select(sane, given, 1.0);
    let ray = Point {
        x: scene.rays[index(&scene.rays, 0, of_camera)],
        y: scene.rays[index(&scene.rays, 1, of_camera)],
        z: scene.rays[index(&scene.rays, 2, of_camera)],
    };
    let from = Point { x: ray.x * depth, y: ray.y * depth, z: ray.z * depth };
    let x = moved(&scene.motion, 0, pixel.item, from);
    let y = moved(&scene.motion, 1, pixel.item, from);
    let z = moved(&scene.motion, 2, pixel.item, from);
    let in_domain = images(&scene.lenses, camera, Point { x, y, z }, depth * scene.nearest, model);
    Way {
        camera,
        ray,
        depth,
        sane,
        to: Point { x: select(in_domain, x, 0.0), y: select(in_domain, y, 0.0), z: select(in_domain, z, 1.0) },
        in_domain,
        known: in_domain && sane && scene.seen[index(&scene.seen, 0, of_camera)] > 0.5,
    }
}

/// A coordinate of a moved point, `R p + t`.
#[cube]
fn moved(motion: &Tensor<f32>, row: usize, item: usize, point: Point) -> f32 {
    let first = item * motion.stride(0) + row * motion.stride(1);
    let step = motion.stride(2);
    motion[first] * point.x
        + motion[first + step] * point.y
        + motion[first + 2 * step] * point.z
        + motion[first + 3 * step]
}

/// A coordinate of the gradient of a point from that of the moved one.
#[cube]
fn back(motion: &Tensor<f32>, column: usize, item: usize, of_moved: Point) -> f32 {
    let first = item * motion.stride(0) + column * motion.stride(2);
    let step = motion.stride(1);
    motion[first] * of_moved.x + motion[first + step] * of_moved.y + motion[first + 2 * step] * of_moved.z
}

/// The gradient of the moved point from that of its position in the picture.
#[cube]
fn of_moved(scene: &Scene, way: Way, of_positions: &Tensor<f32>, pixel: Pixel, #[comptime] model: Model) -> Point {
    let place = project(&scene.lenses, way.camera, way.to, model);
    let of_column = of_positions[index(of_positions, 0, pixel)];
    let of_row = of_positions[index(of_positions, 1, pixel)];
    Point {
        x: select(way.in_domain, of_column * place.x.x + of_row * place.y.x, 0.0),
        y: select(way.in_domain, of_column * place.x.y + of_row * place.y.y, 0.0),
        z: select(way.in_domain, of_column * place.x.z + of_row * place.y.z, 0.0),
    }
}

/// Whether a coordinate lies between the outermost pixel centres of an axis of `length`, or hardly beyond.
#[cube]
fn within(coordinate: f32, length: usize, border_slack: f32) -> bool {
    let slack = border_slack * f32::cast_from(length);
    coordinate >= -slack && coordinate <= f32::cast_from(length - 1) + slack
}
