//! How the wall moves: peristalsis, contractions of a place, breathing.
//!
//! Everything is a closed function of a vertex and the time, so any moment can be had without the moments before it.
//! Numbers of the gut: stomach 3 waves per minute at 2 to 3 mm/s, small bowel 8 to 12 per minute at about 10 mm/s,
//! colon slow and weak most of the time (J. Hall, Guyton and Hall Textbook of Medical Physiology, chapter 64).

use crate::random::{Key, Wander};
use crate::surface::Vertex;
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// The lumen never closes by more than this share: the capsule inside keeps its place.
pub const TIGHTEST: f64 = 0.45;

/// A train of travelling rings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peristalsis {
    /// Share by which the lumen narrows at the crest.
    pub depth: f64,
    /// Distance from crest to crest, metres.
    pub wavelength_m: f64,
    /// Half-width of a crest, metres.
    pub width_m: f64,
    /// Speed along the organ, metres per second.
    pub speed_m_s: f64,
}

/// Slow swing of the whole organ with the diaphragm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Breathing {
    /// Half the way, metres.
    pub amplitude_m: f64,
    /// Seconds per breath.
    pub period_s: f64,
}

/// A patch of wall that tightens and relaxes.
#[derive(Clone, Debug)]
struct Contraction {
    along_m: f64,
    around_rad: f64,
    width_m: f64,
    depth: f64,
    course: Wander,
}

/// Which motions there are, and how strong.
#[derive(Clone, Debug, Default)]
pub struct Deformation {
    peristalsis: Option<Peristalsis>,
    breathing: Option<Breathing>,
    contractions: Vec<Contraction>,
}

impl Deformation {
    /// A wall that stands still.
    pub fn none() -> Self {
        Self::default()
    }

    /// The given motions along an organ of `length_m`; `contractions` places that tighten.
    pub fn new(
        key: Key,
        length_m: f64,
        peristalsis: Option<Peristalsis>,
        breathing: Option<Breathing>,
        contractions: bool,
    ) -> Self {
        // One place every 6 cm, each with a course of its own.
        let count = if contractions { (length_m / 0.06).ceil() as u64 } else { 0 };
        let place = |i: u64| {
            let mut series = key.at(i).series();
            Contraction {
                along_m: length_m * series.range(0.0, 1.0),
                around_rad: series.range(0.0, TAU),
                width_m: series.range(0.012, 0.025),
                depth: series.range(0.12, 0.3),
                course: Wander::new(series.key(), 14.0),
            }
        };
        Self { peristalsis, breathing, contractions: (0..count).map(place).collect() }
    }

    /// Whether nothing moves.
    pub fn is_still(&self) -> bool {
        self.peristalsis.is_none() && self.breathing.is_none() && self.contractions.is_empty()
    }

    /// The deformation at a time, with everything worked out that all vertices share.
    pub fn at(&self, time_s: f64) -> Deformed<'_> {
        // Inspiration is quicker than expiration.
        let breath_m = self.breathing.map_or(0.0, |Breathing { amplitude_m, period_s }| {
            let phase = TAU * time_s / period_s;
            amplitude_m * (phase + 0.35 * phase.sin()).sin()
        });
        let tensions = self.contractions.iter().map(|place| place.depth * (0.5 + 0.5 * place.course.at(time_s)));
        Deformed { deformation: self, time_s, breath_m, tensions: tensions.collect() }
    }
}

/// A deformation at one moment.
#[derive(Clone, Debug)]
pub struct Deformed<'a> {
    deformation: &'a Deformation,
    time_s: f64,
    /// How far the breath has come, metres.
    breath_m: f64,
    /// Present depth of every contraction.
    tensions: Vec<f64>,
}

impl Deformed<'_> {
    /// Position of a vertex.
    pub fn position(&self, vertex: &Vertex) -> Vector3<f64> {
        let tightened = vertex.rest + vertex.inward * self.squeeze(vertex.along_m, vertex.around_rad);
        tightened + self.swing(&vertex.rest)
    }

    /// How much everything at a place is carried along by breathing, metres.
    ///
    /// Downwards (world y) and a little forwards, more on one side than the other, as the diaphragm pushes.
    pub fn swing(&self, place: &Vector3<f64>) -> Vector3<f64> {
        let nearness = 1.0 / (1.0 + ((place.y + 0.1) / 0.25).powi(2));
        Vector3::new(0.15, 1.0, 0.3) * (self.breath_m * nearness)
    }

    /// Share by which the wall has moved towards the middle, 0 to [`TIGHTEST`].
    fn squeeze(&self, along_m: f64, around_rad: f64) -> f64 {
        let Deformation { peristalsis, contractions, .. } = self.deformation;
        let wave = peristalsis.map_or(0.0, |train| train.squeeze(along_m, around_rad, self.time_s));
        let open = contractions
            .iter()
            .zip(&self.tensions)
            .fold(1.0 - wave, |open, (place, tension)| open * (1.0 - tension * place.share(along_m, around_rad)));
        // A smooth limit: nearly the sum while small, never beyond the tightest.
        TIGHTEST * ((1.0 - open) / TIGHTEST).tanh()
    }
}

impl Peristalsis {
    fn squeeze(&self, along_m: f64, around_rad: f64, time_s: f64) -> f64 {
        // Crests are not exactly square to the organ.
        let place = along_m + 0.1 * self.width_m * (around_rad + 1.0).sin() - self.speed_m_s * time_s;
        let from_crest = (place / self.wavelength_m).rem_euclid(1.0) - 0.5;
        self.depth * (-(from_crest * self.wavelength_m / self.width_m).powi(2)).exp()
    }
}

impl Contraction {
    /// How much of the contraction reaches a place, 0 to 1.
    fn share(&self, along_m: f64, around_rad: f64) -> f64 {
        let along = (along_m - self.along_m) / self.width_m;
        if along.abs() > 4.0 {
            return 0.0;
        }
        let side = 0.5 + 0.5 * (around_rad - self.around_rad).cos();
        side * (-along * along).exp()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn lively() -> Deformation {
        let train = Peristalsis { depth: 0.35, wavelength_m: 0.06, width_m: 0.012, speed_m_s: 0.003 };
        let breathing = Breathing { amplitude_m: 0.004, period_s: 4.0 };
        Deformation::new(Key::new(2), 0.5, Some(train), Some(breathing), true)
    }

    proptest! {
        #[test]
        fn the_lumen_never_closes(along_m in 0.0..0.5_f64, around_rad in 0.0..TAU, time_s in 0.0..500.0_f64) {
            let squeeze = lively().at(time_s).squeeze(along_m, around_rad);
            prop_assert!((0.0..TIGHTEST).contains(&squeeze));
        }
    }

    #[test]
    fn a_still_wall_stands_still_and_waves_travel() {
        let vertex = Vertex {
            rest: Vector3::new(0.0, 0.02, 0.1),
            inward: Vector3::new(0.0, -0.02, 0.0),
            along_m: 0.1,
            around_rad: 0.3,
            fold: 0.0,
        };
        assert_eq!(Deformation::none().at(7.0).position(&vertex), vertex.rest);
        let train = Peristalsis { depth: 0.3, wavelength_m: 0.06, width_m: 0.01, speed_m_s: 0.004 };
        let waves = Deformation::new(Key::new(1), 0.5, Some(train), None, false);
        let later = Vertex { along_m: vertex.along_m + 0.004 * 2.5, ..vertex };
        assert!((waves.at(1.0).position(&vertex) - waves.at(3.5).position(&later)).norm() < 1e-12);
    }
}
