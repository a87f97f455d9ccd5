//! The magnet in the capsule and the Hall sensors below the table.
//!
//! The capsule carries a ring magnet behind its lens, along its axis; a planar array lies under the patient, who lies
//! on the back. Field and files are [`endoscape_core::magnetic`]'s. Real sensors have noise, an offset and steps
//! ([`Effect::Hall`]), and the coils that steer the capsule leave a field behind ([`Effect::Actuation`]).

use crate::random::{Key, Wander};
use crate::{Effect, Effects, SimError};
use endoscape_core::magnetic::{HallArray, Magnet, MagneticRig};
use endoscape_core::{MagneticReading, Pose};
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use std::f64::consts::PI;

/// Remanence of sintered NdFeB of grade N42, tesla.
const REMANENCE_TESLA: f64 = 1.3;
/// Magnetic constant, T m / A.
const MU_0: f64 = 4e-7 * PI;
/// Outer and inner diameter and length of the ring, metres; it fits into a capsule of 11 mm.
const RING_M: [f64; 3] = [0.009, 0.005, 0.006];
/// The ring's centre behind the centre of projection, metres.
const BEHIND_LENS_M: f64 = 0.009;
/// Distance from the middle of the organ down to the array, metres: half a trunk and the table.
const TABLE_M: f64 = 0.16;
/// Noise of one component of a triaxial Hall sensor, its step, and the spread of its offset with the room's field, T.
const NOISE_TESLA: f64 = 5e-7;
const STEP_TESLA: f64 = 1.61e-7;
const OFFSET_TESLA: f64 = 4e-5;
/// What the coils leave behind after compensation, T and T/m.
const RESIDUAL_TESLA: f64 = 1.5e-6;
const RESIDUAL_TESLA_PER_M: f64 = 8e-6;

/// Number and distance of the sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hall {
    /// Sensors in the patient's left-right direction.
    pub columns: usize,
    /// Sensors along the patient.
    pub rows: usize,
    /// Distance between neighbours, metres.
    pub pitch_m: f64,
}

impl Default for Hall {
    fn default() -> Self {
        Self { columns: 8, rows: 8, pitch_m: 0.035 }
    }
}

/// Reads the array at any moment.
#[derive(Clone, Debug)]
pub struct Magnetometer {
    rig: MagneticRig,
    effects: Effects,
    key: Key,
    /// Course of the coils' residual: a uniform field and its gradient along three axes.
    residual: [Wander; 6],
}

impl Magnetometer {
    /// Lays the array under the patient.
    ///
    /// # Errors
    /// [`SimError::Parameter`] for an array without sensors or with too few to tell a magnet's place.
    pub fn new(hall: Hall, effects: Effects, seed: u64) -> Result<Self, SimError> {
        let key = Key::new(seed).of("magnet");
        let refuse = |what: String| SimError::parameter(what, "choose an array such as 8x8 with a pitch of 0.035 m");
        if hall.columns * hall.rows > 10_000 || !(0.001..=1.0).contains(&hall.pitch_m) {
            let Hall { columns, rows, pitch_m } = hall;
            return Err(refuse(format!("no array has {columns}x{rows} sensors {pitch_m} m apart")));
        }
        // Without noise the file still needs a number above zero: rounding.
        let noise_tesla = if effects.has(Effect::Hall) { NOISE_TESLA } else { 1e-15 };
        let mut array = HallArray::grid(hall.columns, hall.rows, hall.pitch_m, &HallArray::TRIAXIAL, noise_tesla);
        if effects.has(Effect::Hall) {
            let offset = |sensor: usize| {
                [0, 1, 2].map(|axis| OFFSET_TESLA * key.of("offset").at(sensor as u64).at(axis).range(-1.0, 1.0))
            };
            array.bias_tesla = (0..array.positions_m.len()).map(offset).collect();
        }
        let [outer, inner, length] = RING_M;
        let volume = 0.25 * PI * (outer * outer - inner * inner) * length;
        let magnet = Magnet {
            moment_a_m2: REMANENCE_TESLA * volume / MU_0,
            position_in_camera_m: [0.0, 0.0, -BEHIND_LENS_M],
            axis_in_camera: [0.0, 0.0, 1.0],
        };
        // Below is along the world's z; the array looks up.
        let upward = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
        let world_from_array = Pose::from_parts(Translation3::new(0.0, 0.0, TABLE_M), upward);
        let rig = MagneticRig::new(magnet, array, world_from_array).map_err(|error| refuse(error.to_string()))?;
        let residual = std::array::from_fn(|i| Wander::new(key.of("coils").at(i as u64), 3.0));
        Ok(Self { rig, effects, key, residual })
    }

    /// Magnet and array.
    pub const fn rig(&self) -> &MagneticRig {
        &self.rig
    }

    /// One reading of all sensors.
    pub fn read(&self, index: usize, time_s: f64, world_from_camera: &Pose) -> MagneticReading {
        let shown = |(sensor, field): (usize, Vector3<f64>)| Some(self.shown(index, time_s, sensor, field));
        let field_tesla = self.rig.field_tesla(world_from_camera).into_iter().enumerate().map(shown).collect();
        MagneticReading { index, time_s, field_tesla }
    }

    /// What a sensor shows of a field.
    fn shown(&self, index: usize, time_s: f64, sensor: usize, field: Vector3<f64>) -> Vector3<f64> {
        let mut shown = field;
        if self.effects.has(Effect::Actuation) {
            let place = Vector3::from(self.rig.array().positions_m[sensor]);
            let [x, y, z, a, b, c] = std::array::from_fn(|i| self.residual[i].at(time_s));
            shown += Vector3::new(x, y, z) * RESIDUAL_TESLA;
            shown += Vector3::new(a * place.x, b * place.y, c * place.x) * RESIDUAL_TESLA_PER_M;
        }
        if self.effects.has(Effect::Hall) {
            shown += Vector3::from(self.rig.array().bias_tesla[sensor]);
            let key = self.key.of("noise").at(index as u64).at(sensor as u64);
            shown += Vector3::from_fn(|axis, _| NOISE_TESLA * key.at(axis as u64).normal());
            shown = shown.map(|component| (component / STEP_TESLA).round() * STEP_TESLA);
        }
        shown
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose() -> Pose {
        Pose::from_parts(Translation3::new(0.03, -0.02, 0.01), UnitQuaternion::from_euler_angles(0.4, -0.7, 1.1))
    }

    #[test]
    fn without_effects_readings_are_the_dipoles_field() {
        let meter = Magnetometer::new(Hall::default(), Effects::none(), 3).unwrap();
        let reading = meter.read(4, 0.4, &pose());
        // The formula once more, in the world: B = mu_0 / (4 pi r^3) (3 (m e) e - m).
        let moment = pose().rotation * Vector3::z() * meter.rig().magnet().moment_a_m2;
        let centre = pose() * nalgebra::Point3::new(0.0, 0.0, -BEHIND_LENS_M);
        for (at, shown) in meter.rig().array().positions_m.iter().zip(&reading.field_tesla) {
            let way = meter.rig().world_from_array() * nalgebra::Point3::from(*at) - centre;
            let (r, e) = (way.norm(), way.normalize());
            let field = (e * (3.0 * moment.dot(&e)) - moment) * (1e-7 / r.powi(3));
            let in_array = meter.rig().world_from_array().rotation.inverse() * field;
            assert!((in_array - shown.unwrap()).norm() < 1e-14 * (1.0 + field.norm() * 1e3));
        }
    }

    #[test]
    fn imperfections_have_their_size() {
        let effects = Effects::none().with(Effect::Hall);
        let (clean, real) = (
            Magnetometer::new(Hall::default(), Effects::none(), 3).unwrap(),
            Magnetometer::new(Hall::default(), effects, 3).unwrap(),
        );
        let (mut sum, mut count) = (0.0, 0.0);
        for index in 0..50 {
            let (a, b) = (clean.read(index, 0.0, &pose()), real.read(index, 0.0, &pose()));
            for ((a, b), bias) in a.field_tesla.iter().zip(&b.field_tesla).zip(&real.rig().array().bias_tesla) {
                sum += (b.unwrap() - a.unwrap() - Vector3::from(*bias)).norm_squared();
                count += 3.0;
            }
        }
        let expected = NOISE_TESLA.hypot(STEP_TESLA / 12.0_f64.sqrt());
        assert!(((sum / count).sqrt() / expected - 1.0).abs() < 0.03);
        let pushed = Magnetometer::new(Hall::default(), Effects::none().with(Effect::Actuation), 3).unwrap();
        let (a, b) = (clean.read(0, 1.0, &pose()), pushed.read(0, 1.0, &pose()));
        let error = (a.field_tesla[9].unwrap() - b.field_tesla[9].unwrap()).norm();
        assert!(error > 1e-8 && error < 6e-6, "{error}");
    }

    #[test]
    fn arrays_that_tell_nothing_are_refused() {
        for hall in [Hall { columns: 0, ..Hall::default() }, Hall { pitch_m: -1.0, ..Hall::default() }] {
            assert!(Magnetometer::new(hall, Effects::none(), 0).is_err());
        }
    }
}
