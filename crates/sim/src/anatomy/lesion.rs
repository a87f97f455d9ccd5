//! What is wrong with the wall: places with a kind, a size and, on grown organs, a shape.

use super::wrapped;
use crate::mucosa::{Chart, Label};
use crate::random::Key;
use crate::surface::Wall;
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Distance between neighbouring lesions along an organ, metres, on average: many for a patient, few for a data set.
const SPACING_M: f64 = 0.035;

/// Kinds of lesion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LesionKind {
    /// A dome that stands into the lumen.
    Polyp,
    /// A shallow crater with a fibrin base and a red rim.
    Ulcer,
    /// Fresh blood on the wall.
    Bleeding,
    /// Reddened mucosa.
    Patch,
}

/// One lesion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lesion {
    /// What it is.
    pub kind: LesionKind,
    /// Its middle in coordinates of the [`Chart`], metres.
    pub centre: Vector3<f64>,
    /// Its radius, metres.
    pub radius_m: f64,
}

impl Lesion {
    /// The class its pixels get.
    pub const fn label(&self) -> Label {
        match self.kind {
            LesionKind::Polyp => Label::Polyp,
            LesionKind::Ulcer => Label::Ulcer,
            LesionKind::Bleeding => Label::Bleeding,
            LesionKind::Patch => Label::Patch,
        }
    }

    /// How far it raises the wall of a tube into the lumen at a place, metres.
    pub(super) fn height_m(&self, chart: &Chart, along_m: f64, around_rad: f64) -> f64 {
        if (along_m - self.centre.x).abs() > 1.5 * self.radius_m {
            return 0.0;
        }
        let share = chart.distance_m(&chart.of_tube(along_m, around_rad), &self.centre) / self.radius_m;
        match self.kind {
            LesionKind::Polyp => 0.95 * self.radius_m * (1.0 - share.powi(3)).max(0.0).sqrt().min(1.0) * smooth(share),
            // A rim around a sunken floor.
            LesionKind::Ulcer => 0.0009 * ((-((share - 1.0) / 0.22).powi(2)).exp() - 1.2 * smooth(share)),
            LesionKind::Bleeding | LesionKind::Patch => 0.0,
        }
    }
}

/// From 1 at the middle smoothly to 0 at the edge.
fn smooth(share: f64) -> f64 {
    let rest = (1.0 - share).clamp(0.0, 1.0);
    let rest = (1.6 * rest).min(1.0);
    rest * rest * (3.0 - 2.0 * rest)
}

/// Kind and radius of the lesion of a number.
fn kind(i: usize, key: Key) -> (LesionKind, f64) {
    let (kind, low_m, high_m) = match i % 4 {
        0 => (LesionKind::Polyp, 0.0025, 0.0058),
        1 => (LesionKind::Patch, 0.007, 0.016),
        2 => (LesionKind::Ulcer, 0.0025, 0.005),
        _ => (LesionKind::Bleeding, 0.004, 0.009),
    };
    (kind, key.range(low_m, high_m))
}

/// Lesions all along a tube.
pub(super) fn scattered(key: Key, length_m: f64, chart: &Chart) -> Vec<Lesion> {
    let count = (length_m / SPACING_M) as usize;
    let lesion = |i: usize| {
        let mut series = key.at(i as u64).series();
        let (kind, radius_m) = kind(i, series.key());
        let along_m = length_m * (i as f64 + series.range(0.2, 0.8)) / count as f64;
        let around_rad = wrapped(series.range(0.0, TAU));
        Lesion { kind, centre: chart.of_tube(along_m, around_rad), radius_m }
    };
    (0..count).map(lesion).collect()
}

/// Lesions on the vertices of an imported wall.
pub(super) fn scattered_on(key: Key, wall: &Wall) -> Vec<Lesion> {
    const COUNT: usize = 24;
    let lesion = |i: usize| {
        let mut series = key.at(i as u64).series();
        let (kind, radius_m) = kind(i, series.key());
        let vertex = &wall.vertices[series.index(0, wall.vertices.len())];
        Lesion { kind, centre: vertex.rest, radius_m }
    };
    (0..COUNT).map(lesion).collect()
}
