//! Organs from a seed: a curve through the middle, a radius around it, lesions on it.
//!
//! Shapes are generic anatomy in true scale (Gray's Anatomy, 42nd ed.): colon 4 to 5 cm wide with crescent folds
//! between haustra and two flexures, stomach with longitudinal rugae, a smooth antrum and a narrow pylorus, small
//! bowel 2.5 cm wide with closely set circular folds. The world's axes are those of the patient seen from the front:
//! x to the picture's right, y towards the feet, z towards the back.

mod axis;
mod colon;
mod imported;
mod lesion;
mod small_bowel;
mod stomach;

pub use axis::Axis;
pub use lesion::{Lesion, LesionKind};

use crate::deformation::{Breathing, Deformation, Peristalsis, TIGHTEST};
use crate::mucosa::{Chart, Look};
use crate::random::Key;
use crate::surface::{Vertex, Wall};
use crate::{Effect, Effects, SimError};
use endoscape_core::Image;
use nalgebra::Vector3;
use std::f64::consts::TAU;
use std::path::Path;

/// The organs that can be grown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Organ {
    /// Large bowel from rectum to caecum.
    Colon,
    /// From fundus to pylorus.
    Stomach,
    /// A stretch of jejunum.
    SmallBowel,
}

impl Organ {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Colon, Self::Stomach, Self::SmallBowel];

    /// Its name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Colon => "colon",
            Self::Stomach => "stomach",
            Self::SmallBowel => "small-bowel",
        }
    }
}

impl std::str::FromStr for Organ {
    type Err = SimError;

    fn from_str(text: &str) -> Result<Self, SimError> {
        let unknown =
            || SimError::parameter(format!("there is no anatomy `{text}`"), "use colon, stomach or small-bowel");
        Self::ALL.into_iter().find(|organ| organ.name() == text).ok_or_else(unknown)
    }
}

/// An organ at rest with all that is needed to move and to colour it.
#[derive(Clone, Debug)]
pub struct Anatomy {
    /// The wall.
    pub wall: Wall,
    /// The middle of the lumen, with the room around it at the tightest moment.
    pub axis: Axis,
    /// How places of the wall are laid out for texture and lesions.
    pub chart: Chart,
    /// Colours and relief.
    pub look: Look,
    /// What is wrong with the patient.
    pub lesions: Vec<Lesion>,
    /// Colours of an imported mesh, in place of the mucosa's own.
    pub texture: Option<Image>,
    motions: Motions,
    key: Key,
    /// Length of the closed ends, metres.
    caps_m: [f64; 2],
}

/// What an organ's muscles do.
#[derive(Clone, Copy, Debug)]
struct Motions {
    peristalsis: Peristalsis,
    breathing: Breathing,
}

/// Shape of a tube before lesions grow on it.
struct Tube {
    axis: Axis,
    /// Radius at a place, metres, and how much of a fold it is (0 to 1).
    radius: Box<dyn Fn(f64, f64) -> (f64, f32) + Sync>,
    /// Wanted distance between rows and columns of the net, metres.
    spacing_m: f64,
    /// Usual radius, metres.
    usual_radius_m: f64,
    /// Length over which either end closes, metres.
    closing_m: [f64; 2],
}

impl Anatomy {
    /// Grows an organ.
    pub fn grow(organ: Organ, seed: u64) -> Self {
        let key = Key::new(seed).of("anatomy");
        let (tube, look, motions) = match organ {
            Organ::Colon => (colon::tube(key), Look::colon(), colon::MOTIONS),
            Organ::Stomach => (stomach::tube(key), Look::stomach(), stomach::MOTIONS),
            Organ::SmallBowel => (small_bowel::tube(key), Look::small_bowel(), small_bowel::MOTIONS),
        };
        let chart = Chart::Tube { circumference_m: TAU * tube.usual_radius_m };
        let lesions = lesion::scattered(key.of("lesions"), tube.axis.length_m(), &chart);
        let (wall, caps_m) = (tube.wall(&chart, &lesions), tube.closing_m);
        let axis = tube.axis.with_room(&tightest(&wall));
        Self { wall, axis, chart, look, lesions, texture: None, motions, key, caps_m }
    }

    /// Takes the wall of an organ from an OBJ or PLY file whose unit is `metres_per_unit`.
    ///
    /// # Errors
    /// [`SimError::Mesh`] for a file that is missing, damaged, without faces, with vertices that are no numbers, or
    /// without any place inside wide enough for a camera.
    pub fn import(path: &Path, metres_per_unit: f64, look: Organ, seed: u64) -> Result<Self, SimError> {
        let key = Key::new(seed).of("anatomy");
        let (look, motions) = match look {
            Organ::Colon => (Look::colon(), colon::MOTIONS),
            Organ::Stomach => (Look::stomach(), stomach::MOTIONS),
            Organ::SmallBowel => (Look::small_bowel(), small_bowel::MOTIONS),
        };
        let imported::Imported { wall, axis, texture } = imported::load(path, metres_per_unit)?;
        let axis = axis.with_room(&tightest(&wall));
        let chart = Chart::Space;
        let lesions = lesion::scattered_on(key.of("lesions"), &wall);
        Ok(Self { wall, axis, chart, look, lesions, texture, motions, key, caps_m: [0.0; 2] })
    }

    /// How the wall moves under the given effects.
    pub fn deformation(&self, effects: Effects) -> Deformation {
        Deformation::new(
            self.key.of("deformation"),
            self.axis.length_m(),
            effects.has(Effect::Peristalsis).then_some(self.motions.peristalsis),
            effects.has(Effect::Breathing).then_some(self.motions.breathing),
            effects.has(Effect::Contraction),
        )
    }

    /// Length of the closed end nearer to a place along the organ, metres.
    pub(crate) fn cap_m(&self, along_m: f64) -> f64 {
        self.caps_m[usize::from(along_m > 0.5 * self.axis.length_m())]
    }

    /// Distance from which the wall is usually seen, metres: a little more than the room at the wider places.
    pub fn usual_distance_m(&self) -> f64 {
        let length_m = self.axis.length_m();
        let mut rooms: Vec<f64> = (0..100).map(|i| self.axis.room_m(length_m * f64::from(i) / 99.0)).collect();
        rooms.sort_by(f64::total_cmp);
        3.0 * rooms[66].max(0.002)
    }

    /// Length of the diagonal of the box around the wall, metres: no depth exceeds it.
    pub fn extent_m(&self) -> f64 {
        let corners = self
            .wall
            .vertices
            .iter()
            .fold((Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY)), |(low, high), vertex| {
                (low.inf(&vertex.rest), high.sup(&vertex.rest))
            });
        (corners.1 - corners.0).norm()
    }
}

impl Tube {
    /// The wall as a net around the axis, lesions raised or sunk.
    fn wall(&self, chart: &Chart, lesions: &[Lesion]) -> Wall {
        let length_m = self.axis.length_m();
        let rows = (length_m / self.spacing_m).ceil() as usize + 1;
        let columns = ((TAU * self.usual_radius_m / self.spacing_m).ceil() as usize).max(16);
        Wall::net(rows, columns, true, |row, column| {
            let along_m = length_m * row as f64 / (rows - 1) as f64;
            let around_rad = TAU * column as f64 / columns as f64;
            let (radius_m, fold) = (self.radius)(along_m, around_rad);
            let raised_m: f64 = lesions.iter().map(|lesion| lesion.height_m(chart, along_m, around_rad)).sum();
            let radius_m = (radius_m - raised_m) * self.closing(along_m, length_m);
            let outward = self.axis.frame(along_m) * Vector3::new(around_rad.cos(), around_rad.sin(), 0.0);
            let rest = self.axis.point(along_m) + outward * radius_m;
            Vertex { rest, inward: outward * -radius_m, along_m, around_rad, fold }
        })
    }

    /// Factor of the radius that rounds both ends off like hemispheres.
    fn closing(&self, along_m: f64, length_m: f64) -> f64 {
        let round = |from_end_m: f64, closing_m: f64| {
            let rest = 1.0 - (from_end_m / closing_m).min(1.0);
            (1.0 - rest * rest).max(0.0).sqrt()
        };
        round(along_m, self.closing_m[0]) * round(length_m - along_m, self.closing_m[1])
    }
}

/// Every vertex as far inside as deformation can bring it.
fn tightest(wall: &Wall) -> Vec<Vector3<f64>> {
    wall.vertices.iter().map(|vertex| vertex.rest + vertex.inward * TIGHTEST).collect()
}

/// A smooth curve through values at increasing places, constant beyond them.
fn curve(places: &[(f64, f64)], at: f64) -> f64 {
    let next = places.partition_point(|(place, _)| *place < at);
    match (next.checked_sub(1).and_then(|i| places.get(i)), places.get(next)) {
        (Some((x0, y0)), Some((x1, y1))) => {
            let t = (at - x0) / (x1 - x0);
            y0 + (y1 - y0) * t * t * (3.0 - 2.0 * t)
        }
        (Some((_, y)), None) | (None, Some((_, y))) => *y,
        (None, None) => 0.0,
    }
}

/// Angle brought to -pi to pi.
fn wrapped(angle_rad: f64) -> f64 {
    (angle_rad + 0.5 * TAU).rem_euclid(TAU) - 0.5 * TAU
}

/// A crescent: a ridge across the tube that covers a part of the way around it.
#[derive(Clone, Copy, Debug)]
struct Crescent {
    along_m: f64,
    around_rad: f64,
    /// Half the angle it covers; pi and more is a full ring.
    reach_rad: f64,
    /// Half-width of its crest, metres.
    width_m: f64,
    /// Height as a share of the radius.
    depth: f64,
    /// Lean along the tube per radian around it, metres.
    lean_m: f64,
}

impl Crescent {
    /// Height at a place, as a share of the radius.
    fn height(&self, along_m: f64, around_rad: f64) -> f64 {
        let around = wrapped(around_rad - self.around_rad);
        let from_crest = (along_m - self.along_m - self.lean_m * around.sin()) / self.width_m;
        if from_crest.abs() > 6.0 || around.abs() > self.reach_rad {
            return 0.0;
        }
        let share =
            if self.reach_rad >= 3.2 { 1.0 } else { (0.5 * std::f64::consts::PI * around / self.reach_rad).cos() };
        // A thin crest on a broad foot.
        let profile = 0.72 * (-from_crest * from_crest).exp() + 0.28 * (-(from_crest / 2.6).powi(2)).exp();
        self.depth * share.sqrt() * share.sqrt().min(1.0) * profile
    }
}

/// Height of the crescents around a place; `crescents` are sorted along the tube.
fn crests(crescents: &[Crescent], along_m: f64, around_rad: f64) -> f64 {
    const REACH_M: f64 = 0.03;
    let first = crescents.partition_point(|crescent| crescent.along_m < along_m - REACH_M);
    let near = crescents[first..].iter().take_while(|crescent| crescent.along_m < along_m + REACH_M);
    let sum: f64 = near.map(|crescent| crescent.height(along_m, around_rad)).sum();
    // However many meet, the lumen stays open.
    0.55 * (sum / 0.55).tanh()
}

#[cfg(test)]
mod tests;
