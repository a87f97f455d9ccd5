//! Numbers that carry their derivatives along: `endoscape_kernels::lens::Dual` on a CubeCL device.

use burn::cubecl;
use cubecl::prelude::*;

/// A function's value at a point and its derivatives by the point's three coordinates.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Dual {
    /// The value.
    pub value: f32,
    /// Its derivative by the first coordinate.
    pub x: f32,
    /// By the second.
    pub y: f32,
    /// By the third.
    pub z: f32,
}

/// A number that does not depend on the point.
#[cube]
pub fn fixed(value: f32) -> Dual {
    Dual { value, x: 0.0, y: 0.0, z: 0.0 }
}

#[cube]
impl Dual {
    /// A function of this, by its value and its derivative.
    pub fn chain(self, value: f32, slope: f32) -> Dual {
        Dual { value, x: slope * self.x, y: slope * self.y, z: slope * self.z }
    }

    /// `self + other`.
    pub fn plus(self, other: Dual) -> Dual {
        Dual { value: self.value + other.value, x: self.x + other.x, y: self.y + other.y, z: self.z + other.z }
    }

    /// `self - other`.
    pub fn minus(self, other: Dual) -> Dual {
        Dual { value: self.value - other.value, x: self.x - other.x, y: self.y - other.y, z: self.z - other.z }
    }

    /// `self * other`.
    pub fn times(self, other: Dual) -> Dual {
        Dual {
            value: self.value * other.value,
            x: self.x * other.value + other.x * self.value,
            y: self.y * other.value + other.y * self.value,
            z: self.z * other.value + other.z * self.value,
        }
    }

    /// `self / other`.
    pub fn over(self, other: Dual) -> Dual {
        let inverse = 1.0 / other.value;
        let quotient = self.value * inverse;
        Dual {
            value: quotient,
            x: (self.x - quotient * other.x) * inverse,
            y: (self.y - quotient * other.y) * inverse,
            z: (self.z - quotient * other.z) * inverse,
        }
    }

    /// `self + number`.
    pub fn raised(self, number: f32) -> Dual {
        Dual { value: self.value + number, x: self.x, y: self.y, z: self.z }
    }

    /// `self * factor`.
    pub fn scaled(self, factor: f32) -> Dual {
        self.chain(self.value * factor, factor)
    }

    /// Square root.
    pub fn root(self) -> Dual {
        let root = self.value.sqrt();
        self.chain(root, 0.5 / root)
    }

    /// Arc tangent.
    pub fn arc_tangent(self) -> Dual {
        self.chain(self.value.atan(), 1.0 / (1.0 + self.value * self.value))
    }
}
