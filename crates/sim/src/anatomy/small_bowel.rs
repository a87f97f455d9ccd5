//! A stretch of jejunum: a tight, winding lumen with circular folds every few millimetres.

use super::{Crescent, Motions, Tube, crests, curve};
use crate::anatomy::Axis;
use crate::deformation::{Breathing, Peristalsis};
use crate::random::Key;
use nalgebra::Vector3;
use std::f64::consts::TAU;

pub(super) const MOTIONS: Motions = Motions {
    peristalsis: Peristalsis { depth: 0.3, wavelength_m: 0.07, width_m: 0.012, speed_m_s: 0.010 },
    breathing: Breathing { amplitude_m: 0.003, period_s: 4.2 },
};

pub(super) fn tube(key: Key) -> Tube {
    let mut series = key.of("course").series();
    let (phase_x, phase_y) = (series.range(0.0, TAU), series.range(0.0, TAU));
    let knot = |i: i32| {
        let way = f64::from(i);
        let (x, y) = (0.034 * (0.85 * way + phase_x).sin(), 0.026 * (0.62 * way + phase_y).cos());
        Vector3::new(x, y, 0.029 * (way - 7.0))
    };
    let knots: Vec<Vector3<f64>> = (0..15).map(knot).collect();
    let axis = Axis::through(&knots);
    let length_m = axis.length_m();
    let crescents = crescents(key.of("folds"), length_m);
    let width = key.of("width").range(0.93, 1.1);
    let wave = series.range(0.0, TAU);
    let radius = move |along_m: f64, around_rad: f64| {
        let share = along_m / length_m;
        let calibre_m = width * 0.0138 * (1.0 + 0.07 * (TAU * along_m / 0.06 + wave).sin());
        let fold = crests(&crescents, along_m, around_rad);
        let bend = 0.05 * (2.0 * around_rad + 9.0 * share).cos();
        let ends = curve(&[(0.0, 0.9), (0.1, 1.0)], share);
        (calibre_m * ends * (1.0 + bend - fold), (fold / 0.12).min(1.0) as f32)
    };
    Tube { axis, radius: Box::new(radius), spacing_m: 0.0005, usual_radius_m: 0.0138, closing_m: [0.01, 0.01] }
}

/// Circular folds, most of them not all the way around.
fn crescents(key: Key, length_m: f64) -> Vec<Crescent> {
    let mut series = key.series();
    let mut crescents = Vec::new();
    let mut place_m = 0.008;
    while place_m < length_m - 0.008 {
        crescents.push(Crescent {
            along_m: place_m,
            around_rad: series.range(0.0, TAU),
            reach_rad: series.range(1.6, 3.6),
            width_m: series.range(0.0010, 0.0015),
            depth: series.range(0.14, 0.30),
            lean_m: series.range(-0.0035, 0.0035),
        });
        place_m += series.range(0.0036, 0.0072);
    }
    crescents
}
