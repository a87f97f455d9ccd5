//! The stomach: fundus, body with rugae, angular notch, antrum, pylorus and the first of the duodenum.

use super::{Motions, Tube, curve};
use crate::anatomy::Axis;
use crate::deformation::{Breathing, Peristalsis};
use crate::random::{Key, turbulence};
use nalgebra::Vector3;
use std::f64::consts::TAU;

pub(super) const MOTIONS: Motions = Motions {
    peristalsis: Peristalsis { depth: 0.24, wavelength_m: 0.052, width_m: 0.013, speed_m_s: 0.0026 },
    breathing: Breathing { amplitude_m: 0.005, period_s: 4.2 },
};

/// Middle of the lumen from the top of the fundus to the duodenal bulb, metres.
const COURSE: [[f64; 3]; 8] = [
    [0.045, -0.115, 0.010],
    [0.052, -0.070, 0.000],
    [0.052, -0.020, -0.010],
    [0.035, 0.030, -0.020],
    [0.000, 0.064, -0.025],
    [-0.046, 0.066, -0.020],
    [-0.082, 0.046, -0.005],
    [-0.112, 0.026, 0.010],
];

/// Radius in metres by the share of the way.
const CALIBRE: [(f64, f64); 10] = [
    (0.00, 0.040),
    (0.12, 0.041),
    (0.35, 0.037),
    (0.55, 0.031),
    (0.70, 0.025),
    (0.80, 0.020),
    (0.865, 0.0125),
    (0.895, 0.0075),
    (0.925, 0.012),
    (0.96, 0.015),
];

pub(super) fn tube(key: Key) -> Tube {
    let mut series = key.of("course").series();
    let mut shifted = |[x, y, z]: [f64; 3]| {
        let mut shift = || series.range(-0.005, 0.005);
        Vector3::new(x + shift(), y + shift(), z + shift())
    };
    let axis = Axis::through(&COURSE.map(&mut shifted));
    let length_m = axis.length_m();
    let width = key.of("width").range(0.9, 1.1);
    let rugae = Rugae { key: key.of("rugae"), count: key.of("count").range(9.0, 14.0).floor(), length_m };
    let radius = move |along_m: f64, around_rad: f64| {
        let share = along_m / length_m;
        let calibre_m = width * curve(&CALIBRE, share);
        let fold = rugae.height(along_m, around_rad);
        // Flattened from front to back, as it lies.
        let flat = 0.10 * (2.0 * around_rad + 0.6).cos() * curve(&[(0.1, 1.0), (0.8, 0.2)], share);
        (calibre_m * (1.0 + flat - fold), (fold / 0.12).min(1.0) as f32)
    };
    Tube { axis, radius: Box::new(radius), spacing_m: 0.0008, usual_radius_m: 0.032, closing_m: [0.036, 0.012] }
}

/// Winding ridges along the body that fade towards the antrum.
struct Rugae {
    key: Key,
    count: f64,
    length_m: f64,
}

impl Rugae {
    /// Height as a share of the radius.
    fn height(&self, along_m: f64, around_rad: f64) -> f64 {
        let share = along_m / self.length_m;
        let strength = curve(&[(0.02, 0.3), (0.15, 1.0), (0.5, 1.0), (0.72, 0.08), (0.85, 0.0)], share);
        let place = |along: f64, around: f64| {
            Vector3::new(along_m / along, around * around_rad.cos(), around * around_rad.sin())
        };
        let winding =
            1.5 * turbulence(self.key, &place(0.028, 1.6)) + 0.5 * turbulence(self.key.at(1), &place(0.011, 3.0));
        let swell = 0.75 + 0.45 * turbulence(self.key.at(2), &place(0.02, 2.4));
        let ridge = 0.5 + 0.5 * (self.count * around_rad + winding * 1.9 + 0.3 * TAU * share).cos();
        // Round crests with narrow valleys between them.
        0.23 * strength * swell * (1.0 - (1.0 - ridge).powf(1.4))
    }
}
