//! Scaramuzza's polynomial model, the one C3VD is calibrated with.

use super::domain::invert_monotone;
use super::{CameraError, Projection, finite, radial_derivative};
use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// A pixel is `[u v] = stretch [x y] + [cx cy]`, and `(x, y)` is imaged from the direction
/// `(x, y, a0 + a1 rho + a2 rho^2 + a3 rho^3 + a4 rho^4)` with `rho = |(x, y)|`;
/// D. Scaramuzza, A. Martinelli, R. Siegwart, ICVS 2006. The sign is chosen so that z points into the scene.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Omnidirectional {
    /// Column of the distortion centre.
    pub cx: f64,
    /// Row of the distortion centre.
    pub cy: f64,
    /// Polynomial in `rho`, constant term first; the constant plays the part of the focal length.
    pub polynomial: [f64; 5],
    /// Rows of the affine matrix, `[[c, d], [e, 1]]` in the calibration toolbox.
    pub stretch: [[f64; 2]; 2],
}

impl Omnidirectional {
    fn height(&self, rho: f64) -> f64 {
        self.polynomial.iter().rev().fold(0.0, |sum, a| sum * rho + a)
    }

    /// Derivative of [`Self::height`].
    fn height_slope(&self, rho: f64) -> f64 {
        let [_, a1, a2, a3, a4] = self.polynomial;
        a1 + rho * (2.0 * a2 + rho * (3.0 * a3 + rho * 4.0 * a4))
    }

    fn stretch(&self) -> Matrix2<f64> {
        let [[a, b], [c, d]] = self.stretch;
        Matrix2::new(a, b, c, d)
    }

    /// Angle off the axis of the direction imaged at distance `rho` from the centre.
    fn angle(&self, rho: f64) -> f64 {
        rho.atan2(self.height(rho))
    }

    /// Distance from the centre up to which the angle grows: where the model ends.
    fn rim(&self) -> f64 {
        // Ten focal lengths is farther out than any picture reaches.
        super::domain::monotone_limit(10.0 * self.polynomial[0], |rho| self.angle(rho))
    }

    /// Solves `angle(rho) = theta` by Newton steps on `rho cos(theta) - height(rho) sin(theta)`, which is smooth and
    /// nearly linear; a bracketed search takes over in the rare case that they leave the model.
    fn rho(&self, sin: f64, cos: f64) -> Option<f64> {
        let a0 = self.polynomial[0];
        let mut rho = if cos > 0.3 { a0 * sin / cos } else { a0 };
        for _ in 0..12 {
            let slope = cos - sin * self.height_slope(rho);
            let step = (rho * cos - self.height(rho) * sin) / slope;
            rho -= step;
            if step.abs() < 1e-12 * a0 {
                let on_branch = rho >= 0.0 && slope > 0.0;
                return if on_branch { Some(rho) } else { self.rho_by_bracket(sin.atan2(cos)) };
            }
        }
        self.rho_by_bracket(sin.atan2(cos))
    }

    fn rho_by_bracket(&self, theta: f64) -> Option<f64> {
        invert_monotone(theta, 0.0, self.rim(), |rho| self.angle(rho))
    }
}

impl Projection for Omnidirectional {
    fn radius(&self, theta_rad: f64) -> f64 {
        theta_rad
    }

    fn widest_rad(&self) -> f64 {
        self.angle(self.rim())
    }

    fn project(&self, point: &Vector3<f64>) -> Vector2<f64> {
        let (off_axis, length) = (point.xy().norm(), point.norm());
        let rho = self.rho(off_axis / length, point.z / length).unwrap_or(f64::NAN);
        let direction = point.xy().try_normalize(0.0).unwrap_or_default();
        self.stretch() * (direction * rho) + Vector2::new(self.cx, self.cy)
    }

    fn derivative(&self, point: &Vector3<f64>) -> Matrix2x3<f64> {
        let length = point.norm();
        let (sin, cos) = (point.xy().norm() / length, point.z / length);
        let rho = self.rho(sin, cos).unwrap_or(f64::NAN);
        // Of rho cos(theta) = height(rho) sin(theta), by theta.
        let slope = (rho * sin + self.height(rho) * cos) / (cos - sin * self.height_slope(rho));
        self.stretch() * radial_derivative(point, rho, slope)
    }

    fn unproject(&self, pixel: &Vector2<f64>, widest_rad: f64) -> Option<Vector3<f64>> {
        let plane = self.stretch().try_inverse()? * (pixel - Vector2::new(self.cx, self.cy));
        let rho = plane.norm();
        let inside = self.angle(rho) <= widest_rad && rho <= 10.0 * self.polynomial[0];
        inside.then(|| plane.push(self.height(rho)))
    }

    fn moved(&self, scale: [f64; 2], shift: [f64; 2]) -> Self {
        let [u, v] = self.stretch;
        Self {
            cx: scale[0] * self.cx + shift[0],
            cy: scale[1] * self.cy + shift[1],
            stretch: [u.map(|x| scale[0] * x), v.map(|x| scale[1] * x)],
            ..*self
        }
    }

    fn check(&self) -> Result<(), CameraError> {
        let [a0, a1, a2, a3, a4] = self.polynomial;
        let [[c, d], [e, f]] = self.stretch;
        finite(&[("cx", self.cx), ("cy", self.cy), ("a0", a0), ("a1", a1), ("a2", a2), ("a3", a3), ("a4", a4)])?;
        finite(&[("stretch", c), ("stretch", d), ("stretch", e), ("stretch", f)])?;
        let determinant = self.stretch().determinant();
        match [("polynomial[0]", a0), ("determinant of stretch", determinant)].into_iter().find(|(_, x)| *x <= 0.0) {
            Some((name, value)) => Err(CameraError::NotPositive { name, value }),
            None => Ok(()),
        }
    }
}
