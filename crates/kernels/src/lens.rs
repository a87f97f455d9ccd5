//! The projection models of cameras, with derivatives.
//!
//! A model maps a point of the camera's frame to a point of its image plane; an affine map leads from there to pixels.
//! Each is written once, over any [`Number`]: plain ones give the value, [`Dual`] ones its derivatives as well.
//! Formulae and their sources are those of `endoscape_core::camera`. Points must lie inside the model's domain.

mod number;

pub use number::{Dual, Number};

/// Keeps the root of a squared length off zero, where it has no derivative; below rounding everywhere else.
const SMALLEST_SQUARE: f32 = 1e-12;

/// A camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Lens {
    /// Its projection model.
    pub curve: Curve,
    /// From the image plane to pixels: rows of the matrix.
    pub matrix: [[f32; 2]; 2],
    /// Where the axis meets the picture: column, row.
    pub centre: [f32; 2],
    /// Cosine of the widest angle off the axis that the model images.
    pub cos_widest: f32,
}

/// A projection model; polynomials from their lowest coefficient.
#[derive(Clone, Debug, PartialEq)]
pub enum Curve {
    /// No distortion.
    Pinhole(Pinhole),
    /// OpenCV's distortion.
    RadialTangential(RadialTangential),
    /// Equidistant fisheye with a polynomial.
    KannalaBrandt(KannalaBrandt),
    /// Scaramuzza's polynomial of the ray's height.
    Omnidirectional(Omnidirectional),
    /// A sphere, seen from beside its centre.
    Unified(Unified),
}

impl Curve {
    /// Whether the model divides by z, so that points must lie in front of the plane of the lens.
    pub const fn is_perspective(&self) -> bool {
        matches!(self, Self::Pinhole(_) | Self::RadialTangential(_))
    }

    /// Hands the model to `visitor` as its own type, so that inner loops know it.
    #[inline(always)]
    pub(crate) fn visit<V: Visitor>(&self, visitor: V) -> V::Output {
        match self {
            Self::Pinhole(model) => visitor.visit(model),
            Self::RadialTangential(model) => visitor.visit(model),
            Self::KannalaBrandt(model) => visitor.visit(model),
            Self::Omnidirectional(model) => visitor.visit(model),
            Self::Unified(model) => visitor.visit(model),
        }
    }
}

/// Work to be done with whatever model there is.
pub(crate) trait Visitor {
    type Output;

    fn visit(self, model: &impl Projection) -> Self::Output;
}

/// From points inside the domain to the image plane.
pub(crate) trait Projection {
    fn plane<T: Number>(&self, point: [T; 3]) -> [T; 2];
}

/// `(x, y) / z`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pinhole;

impl Projection for Pinhole {
    #[inline(always)]
    fn plane<T: Number>(&self, [x, y, z]: [T; 3]) -> [T; 2] {
        [x / z, y / z]
    }
}

/// Radial `(1 + r^2 above(r^2)) / (1 + r^2 below(r^2))` and decentring, after the pinhole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RadialTangential {
    /// `k1, k2, k3`.
    pub above: [f32; 3],
    /// `k4, k5, k6`.
    pub below: [f32; 3],
    /// `p1, p2`.
    pub decentring: [f32; 2],
}

impl Projection for RadialTangential {
    #[inline(always)]
    fn plane<T: Number>(&self, point: [T; 3]) -> [T; 2] {
        let [x, y] = Pinhole.plane(point);
        let r2 = x * x + y * y;
        let one = T::from(1.0);
        let radial = (horner(&self.above, r2) * r2 + one) / (horner(&self.below, r2) * r2 + one);
        let (p1, p2, two) = (T::from(self.decentring[0]), T::from(self.decentring[1]), T::from(2.0));
        let twice_xy = x * y * two;
        [x * radial + twice_xy * p1 + (x * x * two + r2) * p2, y * radial + (y * y * two + r2) * p1 + twice_xy * p2]
    }
}

/// `theta (1 + k1 theta^2 + ...)` from the centre, `theta` being the angle off the axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KannalaBrandt {
    /// `k1` to `k4`.
    pub k: [f32; 4],
}

impl Projection for KannalaBrandt {
    #[inline(always)]
    fn plane<T: Number>(&self, point: [T; 3]) -> [T; 2] {
        let ([x, y], length) = half_tangent(point);
        let theta = length.atan() * T::from(2.0);
        let squared = theta * theta;
        let scale = theta * (horner(&self.k, squared) * squared + T::from(1.0)) / length;
        [x * scale, y * scale]
    }
}

/// The distance `rho` from the centre with `rho / height(rho) = tan(theta)`.
#[derive(Clone, Debug, PartialEq)]
pub struct Omnidirectional {
    /// The height of the ray over the distance from the centre.
    pub height: [f32; 5],
    /// Its derivative.
    pub slope: [f32; 4],
    /// A first guess of `rho / q`, a Chebyshev series in `2 q / limit - 1`, `q` being the tangent of half the angle.
    pub start: Vec<f32>,
    /// Largest `q` the guess is made for.
    pub limit: f32,
}

impl Projection for Omnidirectional {
    /// Two of Newton's steps from the guess, of which the last alone is differentiated: by the implicit function
    /// theorem its derivative is that of the exact solution.
    #[inline(always)]
    fn plane<T: Number>(&self, point: [T; 3]) -> [T; 2] {
        let ([x, y], q) = half_tangent(point);
        let fixed = q.value();
        let rho = self.newton(self.guess(fixed), fixed);
        let scale = self.newton(T::from(rho), q) / q;
        [x * scale, y * scale]
    }
}

impl Omnidirectional {
    /// Clenshaw's recurrence.
    #[inline(always)]
    fn guess(&self, q: f32) -> f32 {
        let x = q / self.limit * 2.0 - 1.0;
        let (mut next, mut after) = (0.0, 0.0);
        for c in self.start.iter().skip(1).rev() {
            (next, after) = (x * next * 2.0 - after + c, next);
        }
        (x * next - after + self.start.first().unwrap_or(&0.0)) * q
    }

    /// Towards `rho (1 - q^2) - 2 q height(rho) = 0`, the condition times the positive `1 + q^2`.
    #[inline(always)]
    fn newton<T: Number>(&self, rho: T, q: T) -> T {
        let (along, twice) = (T::from(1.0) - q * q, q * T::from(2.0));
        let residual = rho * along - twice * horner(&self.height, rho);
        rho - residual / (along - twice * horner(&self.slope, rho))
    }
}

/// `m (1 + k1 |m|^2 + k2 |m|^4)` with `m = (x, y) / (z + xi |p|)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unified {
    /// Distance of the second centre from that of the sphere.
    pub xi: f32,
    /// `k1, k2`.
    pub k: [f32; 2],
}

impl Projection for Unified {
    #[inline(always)]
    fn plane<T: Number>(&self, [x, y, z]: [T; 3]) -> [T; 2] {
        let reach = z + (x * x + y * y + z * z).sqrt() * T::from(self.xi);
        let (x, y) = (x / reach, y / reach);
        let r2 = x * x + y * y;
        let scale = horner(&self.k, r2) * r2 + T::from(1.0);
        [x * scale, y * scale]
    }
}

/// `q = (x, y) / (z + |p|)`, whose length is the tangent of half the angle off the axis, and that length.
#[inline(always)]
fn half_tangent<T: Number>([x, y, z]: [T; 3]) -> ([T; 2], T) {
    let reach = z + (x * x + y * y + z * z).sqrt();
    let (x, y) = (x / reach, y / reach);
    ([x, y], (x * x + y * y + T::from(SMALLEST_SQUARE)).sqrt())
}

#[inline(always)]
fn horner<T: Number>(coefficients: &[f32], x: T) -> T {
    coefficients.iter().rev().fold(T::from(0.0), |sum, c| sum * x + T::from(*c))
}
