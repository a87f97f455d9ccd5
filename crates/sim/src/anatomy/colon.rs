//! The colon: rectum, sigmoid loop, left flexure, transverse part, right flexure, caecum.

use super::{Crescent, Motions, Tube, crests, curve};
use crate::anatomy::Axis;
use crate::deformation::{Breathing, Peristalsis};
use crate::random::Key;
use nalgebra::Vector3;
use std::f64::consts::TAU;

pub(super) const MOTIONS: Motions = Motions {
    peristalsis: Peristalsis { depth: 0.16, wavelength_m: 0.11, width_m: 0.022, speed_m_s: 0.0015 },
    breathing: Breathing { amplitude_m: 0.003, period_s: 4.2 },
};

/// Middle of the lumen from the anus to the caecum, metres.
const COURSE: [[f64; 3]; 17] = [
    [0.000, 0.160, 0.000],
    [0.000, 0.100, 0.000],
    [0.030, 0.052, 0.030],
    [0.082, 0.062, 0.050],
    [0.130, 0.085, 0.025],
    [0.158, 0.045, 0.000],
    [0.162, -0.020, -0.005],
    [0.164, -0.090, -0.010],
    [0.135, -0.152, -0.005],
    [0.075, -0.145, 0.030],
    [0.000, -0.112, 0.048],
    [-0.075, -0.122, 0.030],
    [-0.132, -0.140, 0.000],
    [-0.160, -0.090, -0.010],
    [-0.160, -0.020, -0.005],
    [-0.156, 0.050, 0.000],
    [-0.150, 0.105, 0.005],
];

pub(super) fn tube(key: Key) -> Tube {
    let mut series = key.of("course").series();
    let mut shifted = |[x, y, z]: [f64; 3]| {
        let mut shift = || series.range(-0.008, 0.008);
        Vector3::new(x + shift(), y + shift(), z + shift())
    };
    let axis = Axis::through(&COURSE.map(&mut shifted));
    let length_m = axis.length_m();
    let stations = stations(key.of("haustra"), length_m);
    let crescents = crescents(key.of("folds"), &stations);
    let width = key.of("width").range(0.92, 1.08);
    let radius = move |along_m: f64, around_rad: f64| {
        let share = along_m / length_m;
        let calibre_m = width
            * curve(&[(0.0, 0.020), (0.12, 0.023), (0.3, 0.019), (0.55, 0.023), (0.85, 0.026), (0.97, 0.031)], share);
        let fold = crests(&crescents, along_m, around_rad);
        // Haustra bulge between the folds, and three bands of muscle pull the cross-section triangular.
        let next = stations.partition_point(|place| *place < along_m).clamp(1, stations.len() - 1);
        let within = (along_m - stations[next - 1]) / (stations[next] - stations[next - 1]);
        let bulge = 0.12 * (std::f64::consts::PI * within.clamp(0.0, 1.0)).sin();
        let bands = 0.055 * (3.0 * around_rad + 2.0 * share).cos();
        (calibre_m * (1.0 + bulge + bands - fold), (fold / 0.22).min(1.0) as f32)
    };
    Tube { axis, radius: Box::new(radius), spacing_m: 0.0008, usual_radius_m: 0.022, closing_m: [0.012, 0.026] }
}

/// Places of the folds along the colon, metres.
fn stations(key: Key, length_m: f64) -> Vec<f64> {
    let mut series = key.series();
    let mut places = vec![0.0];
    let mut place_m = 0.03;
    while place_m < length_m - 0.02 {
        places.push(place_m);
        place_m += series.range(0.019, 0.033);
    }
    places.push(length_m);
    places
}

/// Two or three crescents per station, staggered around the tube.
fn crescents(key: Key, stations: &[f64]) -> Vec<Crescent> {
    let mut crescents = Vec::new();
    for (i, station_m) in stations.iter().enumerate().skip(1).take(stations.len().saturating_sub(2)) {
        let mut series = key.at(i as u64).series();
        let turn = series.range(0.0, TAU / 3.0);
        for part in 0..3 {
            if series.range(0.0, 1.0) < 0.22 {
                continue;
            }
            crescents.push(Crescent {
                along_m: station_m + series.range(-0.0045, 0.0045),
                around_rad: turn + TAU * f64::from(part) / 3.0 + series.range(-0.25, 0.25),
                reach_rad: series.range(0.95, 1.7),
                width_m: series.range(0.0022, 0.0036),
                depth: series.range(0.24, 0.50),
                lean_m: series.range(-0.004, 0.004),
            });
        }
    }
    crescents.sort_by(|a, b| a.along_m.total_cmp(&b.along_m));
    crescents
}
