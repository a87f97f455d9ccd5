//! A first guess for the projection of the omnidirectional model, which has no closed form.
//!
//! The model gives the angle at which a pixel sees, `theta(rho)`; projection needs its inverse. The distance from the
//! centre over `q = tan(theta / 2)` is a smooth function of `q`, so a short Chebyshev series in `q` meets it to within
//! a pixel, good enough for Newton's rule to finish the work on the device.

use super::chebyshev;
use super::lens::{Parameter, parameter};
use burn::tensor::{Tensor, TensorCreationOptions};
use endoscape_core::camera::Omnidirectional;
use endoscape_core::{Camera, CameraModel, Size};
use nalgebra::{Point2, Point3};

/// Wanted accuracy of the guess, in pixels of the calibrated picture.
const TOLERANCE_PX: f64 = 0.5;

/// The guess for one camera.
pub struct RadiusFit {
    /// Chebyshev coefficients of `rho / q` in `2 q / limit - 1`.
    pub coefficients: Vec<f64>,
    /// Half-angle up to which the fit holds; the picture ends before.
    pub widest_rad: f64,
}

impl RadiusFit {
    /// `None` for cameras of other models.
    pub fn new(camera: &Camera) -> Option<Self> {
        let CameraModel::Omnidirectional(lens) = camera.model() else { return None };
        let curve = Omnidirectional { cx: 0.0, cy: 0.0, stretch: [[1.0, 0.0], [0.0, 1.0]], ..*lens };
        let curve = Camera::new(camera.size(), curve.into()).ok()?;
        let widest_rad = widest_in_picture(camera);
        let limit = (0.5 * widest_rad).tan();
        let quotient = |scaled: f64| {
            let q = 0.5 * (scaled + 1.0) * limit;
            let angle = 2.0 * q.atan();
            let rho = curve.project(&Point3::new(angle.sin(), 0.0, angle.cos())).map(|pixel| pixel.x);
            // On the axis rho = a0 tan(theta) = 2 a0 q to first order.
            rho.filter(|_| q > 1e-9).map_or(2.0 * lens.polynomial[0], |rho| rho / q)
        };
        let coefficients = chebyshev::fit(TOLERANCE_PX / limit, quotient);
        Some(Self { coefficients, widest_rad })
    }

    /// Largest `q` of the fit.
    pub fn limit(&self) -> f64 {
        (0.5 * self.widest_rad).tan()
    }
}

/// The widest angle a pixel of the picture sees with a twentieth to spare, within the model's domain.
fn widest_in_picture(camera: &Camera) -> f64 {
    let Size { width, height } = camera.size();
    let corners = [(0, 0), (width, 0), (0, height), (width, height)];
    let angle = |(x, y): (usize, usize)| {
        let ray = camera.unproject(&Point2::new(x as f64 - 0.5, y as f64 - 0.5))?;
        Some(ray.xy().norm().atan2(ray.z))
    };
    let widest = corners.into_iter().map(angle).try_fold(0.0, |widest: f64, angle| Some(widest.max(angle?)));
    // At the very end of the domain the curve has a vertical tangent, which no series follows.
    let domain = 0.98 * camera.domain_rad();
    widest.map_or(domain, |widest| (1.05 * widest).min(domain))
}

/// The guesses for several cameras, as tensors.
#[derive(Clone, Debug)]
pub struct RadiusStart {
    coefficients: Vec<Parameter>,
    limit: Parameter,
}

impl RadiusStart {
    /// Collects fits; shorter ones end in zeros.
    pub fn new(fits: &[RadiusFit], options: &TensorCreationOptions) -> Self {
        let terms = fits.iter().map(|fit| fit.coefficients.len()).max().unwrap_or(0);
        let coefficient = |k: usize| move |fit: &RadiusFit| fit.coefficients.get(k).copied().unwrap_or(0.0);
        Self {
            coefficients: (0..terms).map(|k| parameter(fits, options, coefficient(k))).collect(),
            limit: parameter(fits, options, RadiusFit::limit),
        }
    }

    /// Distance from the centre at `q`, `[batch, 1, height, width]`, by Clenshaw's recurrence.
    pub fn radius(&self, q: Tensor<4>) -> Tensor<4> {
        let x = q.clone() / self.limit.clone() * 2.0 - 1.0;
        let (mut next, mut after) = (x.zeros_like(), x.zeros_like());
        for c in self.coefficients.iter().skip(1).rev() {
            let this = x.clone() * next.clone() * 2.0 - after + c.clone();
            (next, after) = (this, next);
        }
        let constant = self.coefficients.iter().take(1).cloned();
        constant.fold(x * next - after, |sum, c| sum + c) * q
    }
}
