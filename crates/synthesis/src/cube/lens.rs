//! The projection models of `endoscape_kernels::lens`, with derivatives, on a CubeCL device.
//!
//! A batch of cameras of one model is a table of numbers, one row each; which model is known when a kernel is compiled.

use super::dual::{Dual, fixed};
use super::maps::{CubeTensor, table};
use burn::cubecl;
use cubecl::prelude::*;
use endoscape_kernels::Lens;
use endoscape_kernels::lens::Curve;

/// Keeps the root of a squared length off zero, where it has no derivative; below rounding everywhere else.
const SMALLEST_SQUARE: f32 = 1e-12;

/// Where a row's entries begin: the rows of the matrix, the centre, the cosine of the widest angle, the model's own.
const MATRIX: usize = 0;
const CENTRE: usize = 4;
const COS_WIDEST: usize = 6;
const OWN: usize = 7;

/// The omnidirectional model's own entries: the height's polynomial, its derivative's, the limit of the first guess and
/// the series of that.
const SLOPE: usize = OWN + 5;
const LIMIT: usize = SLOPE + 4;
const START: usize = LIMIT + 1;

/// A projection model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Model {
    /// No distortion.
    Pinhole,
    /// OpenCV's distortion.
    RadialTangential,
    /// Equidistant fisheye with a polynomial.
    KannalaBrandt,
    /// Scaramuzza's polynomial of the ray's height.
    Omnidirectional,
    /// A sphere, seen from beside its centre.
    Unified,
}

/// The cameras' model and their table, on the device of `like`; `None` if their models differ.
pub fn lenses(lenses: &[Lens], like: &CubeTensor) -> Option<(Model, CubeTensor)> {
    let rows: Vec<(Model, Vec<f32>)> = lenses.iter().map(row).collect();
    let (model, _) = *rows.first()?;
    // Series of different lengths end in zeros.
    let columns = rows.iter().map(|(_, row)| row.len()).max()?;
    let mut numbers = Vec::new();
    for (other, mut row) in rows {
        if other != model {
            return None;
        }
        row.resize(columns, 0.0);
        numbers.extend(row);
    }
    Some((model, table(like, &numbers, [lenses.len(), columns])))
}

fn row(lens: &Lens) -> (Model, Vec<f32>) {
    let Lens { curve, matrix, centre, cos_widest } = lens;
    let (model, own) = match curve {
        Curve::Pinhole(_) => (Model::Pinhole, Vec::new()),
        Curve::RadialTangential(lens) => {
            (Model::RadialTangential, [&lens.above[..], &lens.below, &lens.decentring].concat())
        }
        Curve::KannalaBrandt(lens) => (Model::KannalaBrandt, lens.k.to_vec()),
        Curve::Omnidirectional(lens) => {
            (Model::Omnidirectional, [&lens.height[..], &lens.slope, &[lens.limit], &lens.start].concat())
        }
        Curve::Unified(lens) => (Model::Unified, vec![lens.xi, lens.k[0], lens.k[1]]),
    };
    (model, [matrix.as_flattened(), centre, &[*cos_widest], &own].concat())
}

/// A point, or a point of a plane, with derivatives by a point's coordinates.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Plane {
    /// Across.
    pub x: Dual,
    /// Down.
    pub y: Dual,
}

/// A point of a camera's frame.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Point {
    /// Across.
    pub x: f32,
    /// Down.
    pub y: f32,
    /// Along the axis.
    pub z: f32,
}

/// Whether a camera images a point that is at least `nearest` away; false for what is no point.
#[cube]
pub fn images(lenses: &Tensor<f32>, camera: usize, point: Point, nearest: f32, #[comptime] model: Model) -> bool {
    let length = (point.x * point.x + point.y * point.y + point.z * point.z).sqrt();
    let perspective = comptime!(matches!(model, Model::Pinhole | Model::RadialTangential));
    let distance = if perspective { point.z } else { length };
    let within = point.z - length * entry(lenses, camera, COS_WIDEST) >= 0.0;
    within && distance > nearest && !length.is_inf()
}

/// The pixel of a point that a camera images.
#[cube]
pub fn project(lenses: &Tensor<f32>, camera: usize, point: Point, #[comptime] model: Model) -> Plane {
    let x = Dual { value: point.x, x: 1.0, y: 0.0, z: 0.0 };
    let y = Dual { value: point.y, x: 0.0, y: 1.0, z: 0.0 };
    let z = Dual { value: point.z, x: 0.0, y: 0.0, z: 1.0 };
    let plane = match model {
        Model::Pinhole => Plane { x: x.over(z), y: y.over(z) },
        Model::RadialTangential => radial_tangential(lenses, camera, x.over(z), y.over(z)),
        Model::KannalaBrandt => kannala_brandt(lenses, camera, half_tangent(x, y, z)),
        Model::Omnidirectional => omnidirectional(lenses, camera, half_tangent(x, y, z)),
        Model::Unified => unified(lenses, camera, x, y, z),
    };
    let across = plane.x.scaled(entry(lenses, camera, MATRIX));
    let skew = plane.y.scaled(entry(lenses, camera, MATRIX + 1));
    let turn = plane.x.scaled(entry(lenses, camera, MATRIX + 2));
    let down = plane.y.scaled(entry(lenses, camera, MATRIX + 3));
    Plane {
        x: across.plus(skew).raised(entry(lenses, camera, CENTRE)),
        y: turn.plus(down).raised(entry(lenses, camera, CENTRE + 1)),
    }
}

#[cube]
fn entry(lenses: &Tensor<f32>, camera: usize, #[comptime] entry: usize) -> f32 {
    lenses[camera * lenses.stride(0) + entry * lenses.stride(1)]
}

/// Radial `(1 + r^2 above(r^2)) / (1 + r^2 below(r^2))` and decentring, after the pinhole.
#[cube]
fn radial_tangential(lenses: &Tensor<f32>, camera: usize, x: Dual, y: Dual) -> Plane {
    let r2 = x.times(x).plus(y.times(y));
    let above = horner(lenses, camera, OWN, 3usize, r2).times(r2).raised(1.0);
    let below = horner(lenses, camera, OWN + 3, 3usize, r2).times(r2).raised(1.0);
    let radial = above.over(below);
    let p1 = entry(lenses, camera, OWN + 6);
    let p2 = entry(lenses, camera, OWN + 7);
    let twice_xy = x.times(y).scaled(2.0);
    let wide = x.times(x).scaled(2.0).plus(r2);
    let high = y.times(y).scaled(2.0).plus(r2);
    Plane {
        x: x.times(radial).plus(twice_xy.scaled(p1)).plus(wide.scaled(p2)),
        y: y.times(radial).plus(high.scaled(p1)).plus(twice_xy.scaled(p2)),
    }
}

/// `q = (x, y) / (z + |p|)`, whose length is the tangent of half the angle off the axis.
#[cube]
fn half_tangent(x: Dual, y: Dual, z: Dual) -> Plane {
    let length = x.times(x).plus(y.times(y)).plus(z.times(z)).root();
    let reach = z.plus(length);
    Plane { x: x.over(reach), y: y.over(reach) }
}

/// The length of `q`.
#[cube]
fn length(q: Plane) -> Dual {
    q.x.times(q.x).plus(q.y.times(q.y)).raised(SMALLEST_SQUARE).root()
}

/// `theta (1 + k1 theta^2 + ...)` from the centre, `theta` being the angle off the axis.
#[cube]
fn kannala_brandt(lenses: &Tensor<f32>, camera: usize, q: Plane) -> Plane {
    let length = length(q);
    let theta = length.arc_tangent().scaled(2.0);
    let squared = theta.times(theta);
    let scale = theta.times(horner(lenses, camera, OWN, 4usize, squared).times(squared).raised(1.0)).over(length);
    Plane { x: q.x.times(scale), y: q.y.times(scale) }
}

/// The distance `rho` from the centre with `rho / height(rho) = tan(theta)`: two of Newton's steps from a guess, the
/// last of which alone is differentiated. By the implicit function theorem its derivative is that of the exact solution.
#[cube]
fn omnidirectional(lenses: &Tensor<f32>, camera: usize, q: Plane) -> Plane {
    let length = length(q);
    let fixed_length = fixed(length.value);
    let rho = newton(lenses, camera, fixed(guess(lenses, camera, length.value)), fixed_length);
    let scale = newton(lenses, camera, fixed(rho.value), length).over(length);
    Plane { x: q.x.times(scale), y: q.y.times(scale) }
}

/// The first guess of `rho`: a Chebyshev series in `2 q / limit - 1`, by Clenshaw's recurrence.
#[cube]
fn guess(lenses: &Tensor<f32>, camera: usize, q: f32) -> f32 {
    let x = q / entry(lenses, camera, LIMIT) * 2.0 - 1.0;
    let start = camera * lenses.stride(0) + START * lenses.stride(1);
    let last = lenses.shape(1) - START - 1;
    let mut next = 0.0f32;
    let mut after = 0.0f32;
    for passed in 0..last {
        let this = x * next * 2.0 - after + lenses[start + (last - passed) * lenses.stride(1)];
        after = next;
        next = this;
    }
    (x * next - after + lenses[start]) * q
}

/// Towards `rho (1 - q^2) - 2 q height(rho) = 0`, the condition times the positive `1 + q^2`.
#[cube]
fn newton(lenses: &Tensor<f32>, camera: usize, rho: Dual, q: Dual) -> Dual {
    let along = fixed(1.0f32).minus(q.times(q));
    let twice = q.scaled(2.0);
    let residual = rho.times(along).minus(twice.times(horner(lenses, camera, OWN, 5usize, rho)));
    let derivative = along.minus(twice.times(horner(lenses, camera, SLOPE, 4usize, rho)));
    rho.minus(residual.over(derivative))
}

/// `m (1 + k1 |m|^2 + k2 |m|^4)` with `m = (x, y) / (z + xi |p|)`.
#[cube]
fn unified(lenses: &Tensor<f32>, camera: usize, x: Dual, y: Dual, z: Dual) -> Plane {
    let length = x.times(x).plus(y.times(y)).plus(z.times(z)).root();
    let reach = z.plus(length.scaled(entry(lenses, camera, OWN)));
    let (x, y) = (x.over(reach), y.over(reach));
    let r2 = x.times(x).plus(y.times(y));
    let scale = horner(lenses, camera, OWN + 1, 2usize, r2).times(r2).raised(1.0);
    Plane { x: x.times(scale), y: y.times(scale) }
}

/// The polynomial whose `count` coefficients begin at `first`, from the lowest, by Horner's rule, which gives its
/// derivative beside it.
#[cube]
fn horner(lenses: &Tensor<f32>, camera: usize, #[comptime] first: usize, #[comptime] count: usize, x: Dual) -> Dual {
    let mut value = 0.0f32;
    let mut slope = 0.0f32;
    #[unroll]
    for passed in 0..count {
        slope = slope * x.value + value;
        value = value * x.value + entry(lenses, camera, comptime!(first + count - 1 - passed));
    }
    x.chain(value, slope)
}
