//! Projection through every lens of the camera models, and its derivatives.
//!
//! Each formula is written once over [`Real`], for plain numbers and for numbers that carry their derivatives by the
//! three coordinates of the point. Models, parameters and formulae are those of the camera models in `endoscape-core`.

use std::ops::{Add, Div, Mul, Sub};

/// A number with or without derivatives.
pub trait Real:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    /// A number that does not depend on the point.
    fn constant(value: f32) -> Self;
    /// The number alone.
    fn value(self) -> f32;
    /// Its square root.
    fn sqrt(self) -> Self;
    /// The angle with this tangent.
    fn atan(self) -> Self;
}

impl Real for f32 {
    fn constant(value: f32) -> Self {
        value
    }
    fn value(self) -> f32 {
        self
    }
    fn sqrt(self) -> Self {
        self.sqrt()
    }
    fn atan(self) -> Self {
        self.atan()
    }
}

/// A number and its derivatives by x, y and z of the point.
#[derive(Clone, Copy, Debug)]
pub struct Dual {
    /// The number.
    pub value: f32,
    /// Its derivatives.
    pub slope: [f32; 3],
}

impl Dual {
    fn chain(self, value: f32, derivative: f32) -> Self {
        Self { value, slope: self.slope.map(|slope| derivative * slope) }
    }

    fn join(self, other: Self, value: f32, [by_self, by_other]: [f32; 2]) -> Self {
        Self { value, slope: [0, 1, 2].map(|axis| by_self * self.slope[axis] + by_other * other.slope[axis]) }
    }
}

impl Add for Dual {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        self.join(other, self.value + other.value, [1.0, 1.0])
    }
}

impl Sub for Dual {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self.join(other, self.value - other.value, [1.0, -1.0])
    }
}

impl Mul for Dual {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        self.join(other, self.value * other.value, [other.value, self.value])
    }
}

impl Div for Dual {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let (inverse, value) = (1.0 / other.value, self.value / other.value);
        self.join(other, value, [inverse, -value * inverse])
    }
}

impl Real for Dual {
    fn constant(value: f32) -> Self {
        Self { value, slope: [0.0; 3] }
    }
    fn value(self) -> f32 {
        self.value
    }
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.chain(root, 0.5 / root)
    }
    fn atan(self) -> Self {
        self.chain(self.value.atan(), 1.0 / (1.0 + self.value * self.value))
    }
}

/// From a point in the camera frame to the image plane; polynomials from their lowest coefficient.
#[derive(Clone, Debug, PartialEq)]
pub enum Curve {
    /// `(x, y) / z`.
    Pinhole,
    /// OpenCV: radial `(1 + r^2 above(r^2)) / (1 + r^2 below(r^2))` and decentring.
    RadialTangential {
        /// k1, k2, k3.
        above: [f32; 3],
        /// k4, k5, k6.
        below: [f32; 3],
        /// p1, p2.
        decentring: [f32; 2],
    },
    /// OpenCV's fisheye: `theta (1 + k1 theta^2 + ...)`.
    KannalaBrandt {
        /// k1 to k4.
        k: [f32; 4],
    },
    /// Sphere and pinhole, with radial distortion.
    Unified {
        /// Distance of the pinhole from the sphere's centre.
        xi: f32,
        /// k1, k2.
        k: [f32; 2],
    },
    /// Scaramuzza: the height of the ray over the distance from the centre.
    Omnidirectional {
        /// The polynomial.
        height: [f32; 5],
        /// Its derivative.
        slope: [f32; 4],
        /// First guess of `distance / q` as a Chebyshev series in `2 q / limit - 1`, `q = tan(angle / 2)`.
        start: Vec<f32>,
        /// Where the series ends.
        limit: f32,
    },
}

/// A camera's projection.
#[derive(Clone, Debug, PartialEq)]
pub struct Lens {
    /// To the image plane.
    pub curve: Curve,
    /// From there to pixels: `matrix * plane + centre`.
    pub matrix: [[f32; 2]; 2],
    /// The pixel of the optical axis.
    pub centre: [f32; 2],
    /// Cosine of the widest angle off the axis that the model images.
    pub cos_widest: f32,
}

impl Lens {
    /// Whether a point lies in the model's domain and farther away than `nearest`; false for NaN.
    pub fn images(&self, [x, y, z]: [f32; 3], nearest: f32) -> bool {
        let length = (x * x + y * y + z * z).sqrt();
        let perspective = matches!(self.curve, Curve::Pinhole | Curve::RadialTangential { .. });
        let distance = if perspective { z } else { length };
        z - length * self.cos_widest >= 0.0 && distance > nearest && length.is_finite()
    }

    /// Column and row of a point of the domain.
    #[inline]
    pub fn project<T: Real>(&self, point: [T; 3]) -> [T; 2] {
        let [x, y] = self.plane(point);
        [0, 1].map(|row| {
            let [a, b] = self.matrix[row].map(T::constant);
            x * a + y * b + T::constant(self.centre[row])
        })
    }

    #[inline]
    fn plane<T: Real>(&self, [x, y, z]: [T; 3]) -> [T; 2] {
        match &self.curve {
            Curve::Pinhole => [x / z, y / z],
            Curve::RadialTangential { above, below, decentring } => distort([x / z, y / z], [above, below], *decentring),
            Curve::KannalaBrandt { k } => {
                let (q, length) = half_tangent([x, y, z]);
                let theta = length.atan() * T::constant(2.0);
                let squared = theta * theta;
                let radius = theta * (horner(k, squared) * squared + T::constant(1.0));
                q.map(|q| q * (radius / length))
            }
            Curve::Omnidirectional { height, slope, start, limit } => {
                let (q, length) = half_tangent([x, y, z]);
                let guess = series(start, length.value() / limit * 2.0 - 1.0) * length.value();
                let closer = newton_step(guess, length.value(), height, slope);
                // Only the last step is differentiated: by the implicit function theorem its derivative is that of the
                // exact solution.
                let radius = newton_step(T::constant(closer), length, height, slope);
                q.map(|q| q * (radius / length))
            }
            Curve::Unified { xi, k } => {
                let reach = z + (x * x + y * y + z * z).sqrt() * T::constant(*xi);
                let m = [x / reach, y / reach];
                let squared = m[0] * m[0] + m[1] * m[1];
                let factor = horner(k, squared) * squared + T::constant(1.0);
                m.map(|m| m * factor)
            }
        }
    }
}

/// `q = (x, y) / (z + |p|)` and its length, kept off zero, where the square root has no gradient.
fn half_tangent<T: Real>([x, y, z]: [T; 3]) -> ([T; 2], T) {
    let reach = z + (x * x + y * y + z * z).sqrt();
    let q = [x / reach, y / reach];
    (q, (q[0] * q[0] + q[1] * q[1] + T::constant(1e-12)).sqrt())
}

/// `c0 + c1 x + c2 x^2 + ...`.
fn horner<T: Real>(coefficients: &[f32], x: T) -> T {
    coefficients.iter().rev().fold(T::constant(0.0), |sum, c| sum * x + T::constant(*c))
}

/// OpenCV's radial and decentring terms.
fn distort<T: Real>([x, y]: [T; 2], [above, below]: [&[f32; 3]; 2], [p1, p2]: [f32; 2]) -> [T; 2] {
    let (one, two) = (T::constant(1.0), T::constant(2.0));
    let (p1, p2) = (T::constant(p1), T::constant(p2));
    let squared = x * x + y * y;
    let radial = (horner(above, squared) * squared + one) / (horner(below, squared) * squared + one);
    let twice = x * y * two;
    [
        x * radial + twice * p1 + (x * x * two + squared) * p2,
        y * radial + (y * y * two + squared) * p1 + twice * p2,
    ]
}

/// A Chebyshev series by Clenshaw's recurrence.
fn series(coefficients: &[f32], x: f32) -> f32 {
    let (mut next, mut after) = (0.0, 0.0);
    for c in coefficients.iter().skip(1).rev() {
        (next, after) = (c + 2.0 * x * next - after, next);
    }
    coefficients.first().copied().unwrap_or(0.0) + x * next - after
}

/// One step of Newton's rule on `rho (1 - q^2) - 2 q height(rho) = 0`.
fn newton_step<T: Real>(rho: T, q: T, height: &[f32], slope: &[f32]) -> T {
    let along = T::constant(1.0) - q * q;
    let twice = q * T::constant(2.0);
    let residual = rho * along - twice * horner(height, rho);
    rho - residual / (along - twice * horner(slope, rho))
}
