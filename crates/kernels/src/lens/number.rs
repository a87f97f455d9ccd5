//! Plain numbers, and numbers that carry their derivatives along.

use std::ops::{Add, Div, Mul, Sub};

/// What formulae can be written in.
pub trait Number:
    Copy + From<f32> + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    /// The number alone.
    fn value(self) -> f32;

    /// Square root.
    fn sqrt(self) -> Self;

    /// Arc tangent.
    fn atan(self) -> Self;
}

impl Number for f32 {
    #[inline(always)]
    fn value(self) -> f32 {
        self
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        self.sqrt()
    }

    #[inline(always)]
    fn atan(self) -> Self {
        self.atan()
    }
}

/// A function's value at a point and its derivatives by the point's three coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dual {
    /// The value.
    pub value: f32,
    /// Its derivatives.
    pub slopes: [f32; 3],
}

impl Dual {
    /// The coordinates of a point.
    #[inline(always)]
    pub fn coordinates([x, y, z]: [f32; 3]) -> [Self; 3] {
        [
            Self { value: x, slopes: [1.0, 0.0, 0.0] },
            Self { value: y, slopes: [0.0, 1.0, 0.0] },
            Self { value: z, slopes: [0.0, 0.0, 1.0] },
        ]
    }

    /// A function of this, by its value and its derivative.
    #[inline(always)]
    fn chain(self, value: f32, slope: f32) -> Self {
        let [x, y, z] = self.slopes;
        Self { value, slopes: [slope * x, slope * y, slope * z] }
    }

    #[inline(always)]
    fn with(self, other: Self, value: f32, slope: impl Fn(f32, f32) -> f32) -> Self {
        let ([x, y, z], [u, v, w]) = (self.slopes, other.slopes);
        Self { value, slopes: [slope(x, u), slope(y, v), slope(z, w)] }
    }
}

impl From<f32> for Dual {
    #[inline(always)]
    fn from(value: f32) -> Self {
        Self { value, slopes: [0.0; 3] }
    }
}

impl Add for Dual {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.with(other, self.value + other.value, |a, b| a + b)
    }
}

impl Sub for Dual {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.with(other, self.value - other.value, |a, b| a - b)
    }
}

impl Mul for Dual {
    type Output = Self;

    #[expect(clippy::suspicious_arithmetic_impl, reason = "the product rule adds")]
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.with(other, self.value * other.value, |a, b| a * other.value + b * self.value)
    }
}

impl Div for Dual {
    type Output = Self;

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        let (inverse, quotient) = (1.0 / other.value, self.value / other.value);
        self.with(other, quotient, |a, b| (a - quotient * b) * inverse)
    }
}

impl Number for Dual {
    #[inline(always)]
    fn value(self) -> f32 {
        self.value
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.chain(root, 0.5 / root)
    }

    #[inline(always)]
    fn atan(self) -> Self {
        self.chain(self.value.atan(), 1.0 / (1.0 + self.value * self.value))
    }
}
