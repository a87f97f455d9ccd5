//! The five projection models as tensor operations, for several cameras of one model at once.
//!
//! Every model is written as a point of its image plane followed by an affine map to pixels, like in
//! [`endoscape_core::camera`]. Parameters are `[cameras, 1, 1, 1]`, so that pictures whose intrinsics differ (random
//! crops) still run in one go. Points outside a model's domain are moved onto the optical axis before anything is
//! computed from them: no later operation meets a value it cannot take, and their gradient is exactly zero.
//!
//! Wide models use `q = (x, y) / (z + |p|)`, whose length is the tangent of half the angle off the axis: unlike the
//! angle itself it needs no special case on the axis and stays finite beyond 90 degrees.

use super::ShiftedCamera;
use super::radius_fit::{RadiusFit, RadiusStart};
use burn::tensor::{Bool, Tensor, TensorCreationOptions, TensorData};
use endoscape_core::CameraModel;
use endoscape_core::camera::{Intrinsics, KannalaBrandt, RadialTangential, Unified};

/// A parameter of several cameras, `[cameras, 1, 1, 1]`.
pub type Parameter = Tensor<4>;

/// Several cameras of one projection model.
#[derive(Clone, Debug)]
pub struct Lens {
    curve: Curve,
    affine: Affine,
    /// Cosine of the widest angle off the axis that the model images.
    cos_widest: Parameter,
}

/// From a point in the camera frame to the image plane; polynomials from their lowest coefficient.
#[derive(Clone, Debug)]
enum Curve {
    Pinhole,
    /// Radial `(1 + r^2 above(r^2)) / (1 + r^2 below(r^2))` and decentring.
    RadialTangential {
        above: Vec<Parameter>,
        below: Vec<Parameter>,
        decentring: Box<[Parameter; 2]>,
    },
    KannalaBrandt {
        k: Vec<Parameter>,
    },
    /// The height of the ray over the distance from the centre, and its derivative.
    Omnidirectional {
        height: Vec<Parameter>,
        slope: Vec<Parameter>,
        start: RadiusStart,
    },
    Unified {
        xi: Parameter,
        k: Vec<Parameter>,
    },
}

/// `pixel = matrix * plane + centre`.
#[derive(Clone, Debug)]
struct Affine {
    matrix: [[Parameter; 2]; 2],
    centre: [Parameter; 2],
}

/// Pixels of projected points and which of them mean something.
pub struct Projected {
    /// `[batch, 2, height, width]`: column, then row, in pixels; finite everywhere.
    pub pixels: Tensor<4>,
    /// `[batch, 1, height, width]`: whether the point lies inside the model's domain.
    pub in_domain: Tensor<4, Bool>,
}

impl Lens {
    /// Collects the parameters of `cameras`, which must all be of the model of the first.
    pub(super) fn new(cameras: &[ShiftedCamera], options: &TensorCreationOptions) -> Self {
        let models: Vec<CameraModel> = cameras.iter().map(|shifted| *shifted.camera.model()).collect();
        let fits: Vec<RadiusFit> = cameras.iter().filter_map(|shifted| RadiusFit::new(&shifted.camera)).collect();
        let widest: Vec<f64> = if fits.is_empty() {
            cameras.iter().map(|shifted| shifted.camera.domain_rad()).collect()
        } else {
            fits.iter().map(|fit| fit.widest_rad).collect()
        };
        Self {
            curve: Curve::new(&models, &fits, options),
            affine: Affine::new(cameras, options),
            cos_widest: parameter(&widest, options, |angle| angle.cos()),
        }
    }

    /// Pixels of points.
    ///
    /// # Shapes
    /// - `points`: `[batch, 3, height, width]`, camera frame, any unit; `batch` is the number of cameras, or anything
    ///   for a single camera
    /// - `nearest`: `[batch, 1, height, width]`, the smallest distance in that unit that counts as in front of the lens
    pub fn project(&self, points: Tensor<4>, nearest: Tensor<4>) -> Projected {
        let in_domain = self.images(points.clone().detach(), nearest);
        let points = onto_axis_outside(points, &in_domain);
        Projected { pixels: self.affine.pixels(self.curve.plane(points)), in_domain }
    }

    /// Whether points lie inside the domain; false for NaN.
    fn images(&self, points: Tensor<4>, nearest: Tensor<4>) -> Tensor<4, Bool> {
        let length = points.clone().square().sum_dim(1).sqrt();
        let height = points.narrow(1, 2, 1);
        let far_enough = if self.curve.is_perspective() { height.clone() } else { length.clone() };
        let inside = (height - length.clone() * self.cos_widest.clone()).greater_equal_scalar(0.0);
        inside.bool_and(far_enough.greater(nearest)).bool_and(length.is_finite())
    }
}

/// The cameras of one model, as that model's own type.
macro_rules! lenses_of {
    ($models:expr, $name:ident) => {{
        let lens = |model: &CameraModel| if let CameraModel::$name(lens) = model { Some(*lens) } else { None };
        $models.iter().filter_map(lens).collect::<Vec<_>>()
    }};
}

impl Curve {
    fn new(models: &[CameraModel], fits: &[RadiusFit], options: &TensorCreationOptions) -> Self {
        match models.first() {
            None | Some(CameraModel::Pinhole(_)) => Self::Pinhole,
            Some(CameraModel::RadialTangential(_)) => {
                let lenses = lenses_of!(models, RadialTangential);
                let of = |value: fn(&RadialTangential) -> f64| parameter(&lenses, options, value);
                Self::RadialTangential {
                    above: vec![of(|l| l.k1), of(|l| l.k2), of(|l| l.k3)],
                    below: vec![of(|l| l.k4), of(|l| l.k5), of(|l| l.k6)],
                    decentring: Box::new([of(|l| l.p1), of(|l| l.p2)]),
                }
            }
            Some(CameraModel::KannalaBrandt(_)) => {
                let lenses = lenses_of!(models, KannalaBrandt);
                let of = |value: fn(&KannalaBrandt) -> f64| parameter(&lenses, options, value);
                Self::KannalaBrandt { k: vec![of(|l| l.k1), of(|l| l.k2), of(|l| l.k3), of(|l| l.k4)] }
            }
            Some(CameraModel::Unified(_)) => {
                let lenses = lenses_of!(models, Unified);
                let of = |value: fn(&Unified) -> f64| parameter(&lenses, options, value);
                Self::Unified { xi: of(|l| l.xi), k: vec![of(|l| l.k1), of(|l| l.k2)] }
            }
            Some(CameraModel::Omnidirectional(_)) => {
                let lenses = lenses_of!(models, Omnidirectional);
                let coefficient = |k: usize| parameter(&lenses, options, |lens| lens.polynomial[k]);
                Self::Omnidirectional {
                    height: (0..5).map(coefficient).collect(),
                    slope: (1..5).map(|k| coefficient(k) * k as f64).collect(),
                    start: RadiusStart::new(fits, options),
                }
            }
        }
    }

    /// Whether the model divides by z, so that points must lie in front of the plane of the lens.
    const fn is_perspective(&self) -> bool {
        matches!(self, Self::Pinhole | Self::RadialTangential { .. })
    }

    /// Image plane coordinates, `[batch, 2, height, width]`, of points inside the domain.
    fn plane(&self, points: Tensor<4>) -> Tensor<4> {
        match self {
            Self::Pinhole => perspective(points),
            Self::RadialTangential { above, below, decentring } => {
                distort(perspective(points), [above, below], decentring)
            }
            Self::KannalaBrandt { k } => {
                let (q, q_length) = half_tangent(points);
                q * (fisheye_radius(q_length.clone(), k) / q_length)
            }
            Self::Omnidirectional { height, slope, start } => {
                let (q, q_length) = half_tangent(points);
                q * (omnidirectional_radius(q_length.clone(), [height, slope], start) / q_length)
            }
            Self::Unified { xi, k } => {
                let reach = points.clone().narrow(1, 2, 1) + length(points.clone()) * xi.clone();
                let m = points.narrow(1, 0, 2) / reach;
                let r2 = m.clone().square().sum_dim(1);
                m * (horner(k, &r2) * r2 + 1.0)
            }
        }
    }
}

impl Affine {
    fn new(cameras: &[ShiftedCamera], options: &TensorCreationOptions) -> Self {
        let maps: Vec<([[f64; 2]; 2], [f64; 2])> = cameras.iter().map(affine_of).collect();
        let entry = |row: usize, column: usize| parameter(&maps, options, |(matrix, _)| matrix[row][column]);
        let centre = |row: usize| parameter(&maps, options, |(_, centre)| centre[row]);
        Self { matrix: [[entry(0, 0), entry(0, 1)], [entry(1, 0), entry(1, 1)]], centre: [centre(0), centre(1)] }
    }

    fn pixels(&self, plane: Tensor<4>) -> Tensor<4> {
        let (x, y) = (plane.clone().narrow(1, 0, 1), plane.narrow(1, 1, 1));
        let row = |row: usize| {
            let [a, b] = self.matrix[row].clone();
            x.clone() * a + y.clone() * b + self.centre[row].clone()
        };
        Tensor::cat(vec![row(0), row(1)], 1)
    }
}

/// The affine part of a model: rows of the matrix, then the centre.
pub(super) fn affine_of(ShiftedCamera { camera, shift: [right, down] }: &ShiftedCamera) -> ([[f64; 2]; 2], [f64; 2]) {
    let from = |i: &Intrinsics| ([[i.fx, i.skew], [0.0, i.fy]], [i.cx + right, i.cy + down]);
    match camera.model() {
        CameraModel::Pinhole(lens) => from(&lens.intrinsics),
        CameraModel::RadialTangential(lens) => from(&lens.intrinsics),
        CameraModel::KannalaBrandt(lens) => from(&lens.intrinsics),
        CameraModel::Unified(lens) => from(&lens.intrinsics),
        CameraModel::Omnidirectional(lens) => (lens.stretch, [lens.cx + right, lens.cy + down]),
    }
}

/// One number per camera.
pub fn parameter<T>(cameras: &[T], options: &TensorCreationOptions, value: impl Fn(&T) -> f64) -> Parameter {
    let values: Vec<f64> = cameras.iter().map(value).collect();
    let shape = [values.len(), 1, 1, 1];
    Tensor::from_data(TensorData::new(values, shape), options.clone())
}

/// Replaces points outside the domain by a point on the axis.
fn onto_axis_outside(points: Tensor<4>, in_domain: &Tensor<4, Bool>) -> Tensor<4> {
    let shape = points.dims();
    let [batch, _, height, width] = shape;
    let outside = in_domain.clone().bool_not();
    let plane = points.clone().narrow(1, 0, 2).mask_fill(outside.clone().expand([batch, 2, height, width]), 0.0);
    let height_above = points.narrow(1, 2, 1).mask_fill(outside, 1.0);
    Tensor::cat(vec![plane, height_above], 1)
}

/// `(x, y) / z`.
fn perspective(points: Tensor<4>) -> Tensor<4> {
    points.clone().narrow(1, 0, 2) / points.narrow(1, 2, 1)
}

/// `q = (x, y) / (z + |p|)` and its length, kept off zero, where the square root has no gradient.
///
/// Radii are odd functions of that length and enter divided by it, so the offset changes them less than rounding does.
fn half_tangent(points: Tensor<4>) -> (Tensor<4>, Tensor<4>) {
    let reach = points.clone().narrow(1, 2, 1) + length(points.clone());
    let q = points.narrow(1, 0, 2) / reach;
    let q_length = (q.clone().square().sum_dim(1) + 1e-12).sqrt();
    (q, q_length)
}

fn length(points: Tensor<4>) -> Tensor<4> {
    points.square().sum_dim(1).sqrt()
}

/// `c0 + c1 x + c2 x^2 + ...`.
fn horner(coefficients: &[Parameter], x: &Tensor<4>) -> Tensor<4> {
    let highest = x.zeros_like();
    coefficients.iter().rev().fold(highest, |sum, c| sum * x.clone() + c.clone())
}

/// OpenCV's radial and decentring terms.
fn distort(plane: Tensor<4>, [above, below]: [&[Parameter]; 2], [p1, p2]: &[Parameter; 2]) -> Tensor<4> {
    let (x, y) = (plane.clone().narrow(1, 0, 1), plane.clone().narrow(1, 1, 1));
    let r2 = plane.clone().square().sum_dim(1);
    let radial = (horner(above, &r2) * r2.clone() + 1.0) / (horner(below, &r2) * r2.clone() + 1.0);
    let twice_xy = x.clone() * y.clone() * 2.0;
    let decentring_x = twice_xy.clone() * p1.clone() + (x.square() * 2.0 + r2.clone()) * p2.clone();
    let decentring_y = (y.square() * 2.0 + r2) * p1.clone() + twice_xy * p2.clone();
    plane * radial + Tensor::cat(vec![decentring_x, decentring_y], 1)
}

/// `theta (1 + k1 theta^2 + ...)` with `theta = 2 atan |q|`.
fn fisheye_radius(q_length: Tensor<4>, k: &[Parameter]) -> Tensor<4> {
    let theta = q_length.atan() * 2.0;
    let t2 = theta.clone().square();
    theta * (horner(k, &t2) * t2 + 1.0)
}

/// Distance `rho` from the centre with `rho / height(rho) = tan(theta)`, `theta = 2 atan |q|`.
///
/// The model has no closed form in this direction. A fitted curve gives a start within a pixel; two Newton steps on
/// `rho (1 - q^2) - 2 q height(rho) = 0` (the condition times the positive `1 + q^2`) square that error twice. Only the
/// last step is differentiated: by the implicit function theorem its derivative is that of the exact solution.
fn omnidirectional_radius(q: Tensor<4>, curve: [&[Parameter]; 2], start: &RadiusStart) -> Tensor<4> {
    let fixed = q.clone().detach();
    let rho = newton_step(start.radius(fixed.clone()), fixed, curve);
    newton_step(rho, q, curve)
}

fn newton_step(rho: Tensor<4>, q: Tensor<4>, [height, slope]: [&[Parameter]; 2]) -> Tensor<4> {
    let along = -q.clone().square() + 1.0;
    let twice = q * 2.0;
    let residual = rho.clone() * along.clone() - twice.clone() * horner(height, &rho);
    let derivative = along - twice * horner(slope, &rho);
    rho - residual / derivative
}
