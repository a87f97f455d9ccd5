//! Where the camera goes: smooth flights through the lumen that keep clear of the wall and within physical bounds.
//!
//! A [`Flight`] is a closed function of time. It follows the axis of the organ, strays from it by less than the free
//! room, and turns its view away from the way ahead. Each kind has its own course, speeds and unrest; if a kind's
//! wish exceeds its limits of speed or acceleration, the whole flight is slowed down until it does not.

mod kind;

pub use kind::PathKind;

use crate::anatomy::{Anatomy, Axis};
use crate::deformation::Deformation;
use crate::random::{Key, Wander};
use crate::{Effect, Effects, SimError};
use endoscape_core::Pose;
use kind::{Course, Habits};
use nalgebra::{UnitQuaternion, Vector3};

/// Least distance from the centre of projection to the wall, metres: the window of a capsule in front of its lens.
pub const WINDOW_M: f64 = 0.0016;
/// Share of the free room a flight may use, and one that leans against the wall.
const USED_ROOM: f64 = 0.62;
const LEANING: f64 = 0.98;
/// The camera keeps to where the ball around the axis has this radius, metres.
const LEAST_ROOM_M: f64 = 0.0026;

/// A camera's way through an organ.
#[derive(Clone, Debug)]
pub struct Flight<'a> {
    axis: &'a Axis,
    deformation: &'a Deformation,
    habits: Habits,
    /// Share of the free room used.
    used_room: f64,
    /// Part of the axis flown along, metres.
    from_m: f64,
    to_m: f64,
    /// How much slower than wished, 1 if not.
    pace: f64,
    along: Wander,
    stray: [Wander; 2],
    turn: [Wander; 3],
    start: f64,
}

impl<'a> Flight<'a> {
    /// Plans a flight of `duration_s` from a seed; of the effects, contact lets it lean against the wall.
    ///
    /// # Errors
    /// [`SimError::Parameter`] if the organ is nowhere wide enough for the camera.
    pub fn plan(
        kind: PathKind,
        anatomy: &'a Anatomy,
        deformation: &'a Deformation,
        effects: Effects,
        (duration_s, seed): (f64, u64),
    ) -> Result<Self, SimError> {
        let key = Key::new(seed).of("path");
        let habits = kind.habits();
        let narrow = || {
            SimError::parameter(
                format!("the organ is nowhere {:.1} mm wide, so no camera fits into it", 2e3 * LEAST_ROOM_M),
                "choose a wider organ or correct --mesh-unit",
            )
        };
        let (from_m, to_m) = anatomy.axis.passable(LEAST_ROOM_M).ok_or_else(narrow)?;
        let (from_m, to_m) = habits.stretch(from_m, to_m, &anatomy.axis, key);
        let wander = |name: &str, period_s: f64| Wander::new(key.of(name), period_s);
        let mut flight = Self {
            axis: &anatomy.axis,
            deformation,
            used_room: if effects.has(Effect::Contact) { LEANING } else { USED_ROOM },
            from_m,
            to_m,
            pace: 1.0,
            along: wander("along", habits.surge_period_s),
            stray: [wander("stray x", habits.stray_period_s), wander("stray y", 1.17 * habits.stray_period_s)],
            turn: [
                wander("pitch", habits.turn_period_s),
                wander("yaw", 0.9 * habits.turn_period_s),
                wander("roll", 1.6 * habits.turn_period_s),
            ],
            start: key.of("start").uniform(),
            habits,
        };
        flight.pace = flight.slowed(duration_s);
        Ok(flight)
    }

    /// Pose of the camera at a time: `world_from_camera`, metres.
    pub fn pose(&self, time_s: f64) -> Pose {
        let (place, view) = self.still(self.pace * time_s);
        // The camera lies in the organ and swings with it.
        Pose::from_parts((place + self.deformation.at(time_s).swing(&place)).into(), view)
    }

    /// How much slower than wished the flight is to stay within its limits; 1 if not slowed.
    pub const fn pace(&self) -> f64 {
        self.pace
    }

    /// Place and view in the organ at rest, at a time of the undelayed flight.
    fn still(&self, time_s: f64) -> (Vector3<f64>, UnitQuaternion<f64>) {
        let along_m = self.along_m(time_s);
        let frame = self.axis.frame(along_m);
        let free_m = self.used_room * (self.axis.room_m(along_m) - WINDOW_M).max(0.0);
        let [x, y] = self.stray(time_s);
        let place = self.axis.point(along_m) + frame * Vector3::new(free_m * x, free_m * y, 0.0);
        (place, frame * self.view(time_s, along_m))
    }

    /// Place along the axis.
    fn along_m(&self, time_s: f64) -> f64 {
        let length_m = self.to_m - self.from_m;
        let surge_m = self.habits.surge_m * self.along.at(time_s);
        let travelled_m = self.habits.speed_m_s * time_s + surge_m;
        let share = match self.habits.course {
            // There and back without end, with soft turns.
            Course::Roam => 0.5 - 0.5 * (std::f64::consts::PI * (travelled_m / length_m + self.start)).cos(),
            Course::Forward => settle(travelled_m / length_m),
            Course::Backward => 1.0 - settle(travelled_m / length_m),
        };
        self.from_m + length_m * share.clamp(0.0, 1.0)
    }

    /// Place across the lumen within the unit disc.
    fn stray(&self, time_s: f64) -> [f64; 2] {
        let loops = self.habits.loops;
        let angle = std::f64::consts::TAU * time_s / self.habits.loop_period_s.max(1e-9);
        let part = |wander: &Wander, circle: f64| {
            self.habits.stray * ((1.0 - loops) * wander.at(time_s) + loops * circle) / std::f64::consts::SQRT_2
        };
        [part(&self.stray[0], angle.cos()), part(&self.stray[1], (self.habits.lissajous * angle).sin())]
    }

    /// Direction of view relative to the way ahead.
    fn view(&self, time_s: f64, along_m: f64) -> UnitQuaternion<f64> {
        let [pitch, yaw, roll] = [0, 1, 2].map(|i| self.turn[i].at(time_s));
        let habits = &self.habits;
        let angle = std::f64::consts::TAU * time_s / habits.loop_period_s.max(1e-9);
        let circling = habits.circling_rad;
        let tilt = Vector3::new(
            habits.tilt_rad * pitch + circling * angle.sin(),
            habits.tilt_rad * yaw + circling * angle.cos(),
            0.0,
        );
        let back = habits.retroflexion_rad * retroflexed(self.share(along_m));
        let spin =
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), habits.roll_rad * roll + habits.spin_rad_s * time_s);
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), back) * UnitQuaternion::from_scaled_axis(tilt) * spin
    }

    fn share(&self, along_m: f64) -> f64 {
        (along_m - self.from_m) / (self.to_m - self.from_m)
    }

    /// The pace at which speed and acceleration stay within the limits for the whole flight.
    fn slowed(&self, duration_s: f64) -> f64 {
        // Unrest repeats within minutes; a long flight shows all of it in its first ten.
        let (watched_s, step_s) = (duration_s.clamp(1.0, 600.0), 0.05);
        let at = |i: i64| self.still(i as f64 * step_s).0;
        let (mut speed, mut acceleration) = (0.0_f64, 0.0_f64);
        let mut last = [at(-1), at(0)];
        for i in 1..=(watched_s / step_s) as i64 {
            let next = at(i);
            speed = speed.max((next - last[1]).norm() / step_s);
            acceleration = acceleration.max((next - last[1] * 2.0 + last[0]).norm() / (step_s * step_s));
            last = [last[1], next];
        }
        let by_speed = self.habits.fastest_m_s / speed.max(1e-12);
        let by_acceleration = (self.habits.hardest_m_s2 / acceleration.max(1e-12)).sqrt();
        // Sampling misses the very peak by a little.
        (0.97 * by_speed.min(by_acceleration)).min(1.0)
    }
}

/// Advances steadily, then comes softly to rest at 1.
fn settle(share: f64) -> f64 {
    const STEADY: f64 = 0.9;
    let rest = 1.0 - STEADY;
    if share <= STEADY { share.max(0.0) } else { STEADY + rest * ((share - STEADY) / rest).tanh() }
}

/// How far the tip is bent back: 0 at the start, 1 from half the way on.
fn retroflexed(share: f64) -> f64 {
    let t = (2.0 * share).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests;
