//! Cameras as our kernels want them.

use super::ShiftedCamera;
use super::lens::affine_of;
use super::radius_fit::RadiusFit;
use endoscape_core::CameraModel;
use endoscape_core::camera;
use endoscape_kernels::Lens;
use endoscape_kernels::lens::{Curve, KannalaBrandt, Omnidirectional, Pinhole, RadialTangential, Unified};

/// The camera in single precision.
pub fn lens(shifted: &ShiftedCamera) -> Lens {
    let (matrix, centre) = affine_of(shifted);
    let fit = RadiusFit::new(&shifted.camera);
    let widest_rad = fit.as_ref().map_or_else(|| shifted.camera.domain_rad(), |fit| fit.widest_rad);
    let curve = match shifted.camera.model() {
        CameraModel::Pinhole(_) => Curve::Pinhole(Pinhole),
        CameraModel::RadialTangential(lens) => Curve::RadialTangential(RadialTangential {
            above: single([lens.k1, lens.k2, lens.k3]),
            below: single([lens.k4, lens.k5, lens.k6]),
            decentring: single([lens.p1, lens.p2]),
        }),
        CameraModel::KannalaBrandt(lens) => {
            Curve::KannalaBrandt(KannalaBrandt { k: single([lens.k1, lens.k2, lens.k3, lens.k4]) })
        }
        CameraModel::Unified(lens) => Curve::Unified(Unified { xi: lens.xi as f32, k: single([lens.k1, lens.k2]) }),
        CameraModel::Omnidirectional(lens) => Curve::Omnidirectional(omnidirectional(lens, fit.as_ref())),
    };
    Lens { curve, matrix: matrix.map(single), centre: single(centre), cos_widest: widest_rad.cos() as f32 }
}

fn omnidirectional(lens: &camera::Omnidirectional, fit: Option<&RadiusFit>) -> Omnidirectional {
    Omnidirectional {
        height: single(lens.polynomial),
        slope: [1, 2, 3, 4].map(|power| (lens.polynomial[power] * power as f64) as f32),
        start: fit.map_or_else(Vec::new, |fit| fit.coefficients.iter().map(|c| *c as f32).collect()),
        limit: fit.map_or(1.0, RadiusFit::limit) as f32,
    }
}

fn single<const N: usize>(values: [f64; N]) -> [f32; N] {
    values.map(|value| value as f32)
}
