//! Magnetic localisation: the capsule's magnet found from an array of Hall sensors, reading by reading.
//!
//! ```text
//! MagneticReading -> measurements -> fit from the last state -> plausible? -> Tracked
//!                                          \-> no: search a grid of starts, fit the best ones
//! ```
//! Five degrees of freedom: position and heading. A turn about the magnet's own axis changes no field, so the roll is
//! not observed: the camera is turned as little as possible from one reading to the next, and the first warning says
//! so. Poses are in the world of [`MagneticRig::world_from_array`], in metres.
//!
//! Invariants: every reading yields a [`Tracked`]; a reading that cannot be used repeats the last pose with confidence
//! 0 and says why. The filter's memory is one state, so a run of any length needs the same memory.

mod fit;
mod measurement;
mod search;

pub use fit::{FieldPrior, Fit, MagnetState, tangents};
pub use measurement::calibrate_bias;

use crate::BaselineError;
use endoscape_core::magnetic::MagneticRig;
use endoscape_core::{MagneticReading, Observation, Odometry, Pose, TrackError, Tracked};
use fit::FitConfig;
use measurement::Measurement;
use nalgebra::{Matrix3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

const NAME: &str = "magnetic";
/// Starts that are refined when there is no previous state.
const STARTS: usize = 6;
/// Standard deviation that stands for "known exactly", tesla: below any sensor's last digit.
const EXACT_TESLA: f64 = 1e-12;
/// Squared residual per degree of freedom beyond which a warm-started fit is not believed.
const IMPLAUSIBLE: f64 = 3.0;
/// Share of outliers beyond which a warm-started fit is not believed.
const MANY_OUTLIERS: f64 = 0.34;
/// Standard deviation of position at which confidence has fallen to one half, metres: the capsule's own length.
const CAPSULE_M: f64 = 0.025;

/// Settings of [`Magnetic`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MagneticConfig {
    /// Standard deviation, per component, of the uniform field that may disturb the first reading, tesla. Default
    /// 1e-6, what calibration leaves of the room's field; give 5e-5, the Earth's field, where nothing was calibrated. 0
    /// believes there is none.
    pub disturbance_tesla: f64,
    /// Random walk of that field, tesla per root second. Default 1e-7.
    pub disturbance_walk_tesla: f64,
    /// A sensor whose squared residual per component, in standard deviations, is beyond this is left out. Default 16,
    /// four standard deviations.
    pub outlier_chi_squared: f64,
}

impl Default for MagneticConfig {
    fn default() -> Self {
        Self { disturbance_tesla: 1e-6, disturbance_walk_tesla: 1e-7, outlier_chi_squared: 16.0 }
    }
}

impl MagneticConfig {
    fn check(&self) -> Result<(), BaselineError> {
        let refuse = |name, value, expected| Err(BaselineError::Config { name, value, expected });
        for (name, value) in
            [("disturbance_tesla", self.disturbance_tesla), ("disturbance_walk_tesla", self.disturbance_walk_tesla)]
        {
            if !(value.is_finite() && value >= 0.0) {
                return refuse(name, value, "a finite number of at least 0");
            }
        }
        match self.outlier_chi_squared {
            value if value.is_finite() && value >= 1.0 => Ok(()),
            value => refuse("outlier_chi_squared", value, "a finite number of at least 1"),
        }
    }
}

/// The method; see the [module](self).
#[derive(Clone, Debug)]
pub struct Magnetic {
    config: MagneticConfig,
    rig: MagneticRig,
    last: Option<Last>,
    fit: Option<Fit>,
    said_roll: bool,
}

/// What one reading leaves for the next.
#[derive(Clone, Debug)]
struct Last {
    time_s: f64,
    state: MagnetState,
    field: FieldPrior,
    world_from_camera: Pose,
}

impl Magnetic {
    /// A method for one rig.
    ///
    /// # Errors
    /// [`BaselineError::Config`] for a setting that cannot be.
    pub fn new(config: MagneticConfig, rig: MagneticRig) -> Result<Self, BaselineError> {
        config.check()?;
        Ok(Self { config, rig, last: None, fit: None, said_roll: false })
    }

    /// The fit of the last reading, in the array's frame, with its covariance; `None` if that reading gave none.
    pub const fn last_fit(&self) -> Option<&Fit> {
        self.fit.as_ref()
    }

    fn locate(&self, measured: &[Measurement], time_s: f64) -> Option<Fit> {
        let array = self.rig.array();
        let moment_a_m2 = self.rig.magnet().moment_a_m2;
        let config = FitConfig {
            moment_a_m2,
            noise_tesla: array.noise_tesla,
            outlier_chi_squared: self.config.outlier_chi_squared,
        };
        let prior = self.field_prior(time_s);
        let warm = self.last.as_ref().and_then(|last| fit::fit(measured, last.state, prior, &config));
        if let Some(warm) = warm.as_ref().filter(|warm| plausible(warm, measured.len())) {
            return Some(warm.clone());
        }
        let starts = search::starts(measured, array, &prior, moment_a_m2, STARTS);
        // In front of the array only: behind it lies the mirror image.
        let base_m = array.positions_m.iter().fold(f64::INFINITY, |low, p| low.min(p[2]));
        let in_front = |fit: &Fit| fit.state.position_m.z > base_m;
        // The best start nearly always ends at the magnet, and a plausible end is no other place by chance.
        let mut failed: Vec<Fit> = warm.into_iter().filter(in_front).collect();
        for start in starts {
            match fit::fit(measured, start, prior, &config).filter(in_front) {
                Some(found) if plausible(&found, measured.len()) => return Some(found),
                found => failed.extend(found),
            }
        }
        failed.into_iter().min_by(|a, b| {
            (a.outliers, a.chi_squared).partial_cmp(&(b.outliers, b.chi_squared)).unwrap_or(std::cmp::Ordering::Equal)
        })
    }

    /// What is known of the uniform field at a time: the last estimate, let go by a random walk.
    fn field_prior(&self, time_s: f64) -> FieldPrior {
        let isotropic = |variance: f64| Matrix3::from_diagonal_element(variance.max(EXACT_TESLA.powi(2)));
        let first = isotropic(self.config.disturbance_tesla.powi(2));
        self.last.as_ref().map_or(FieldPrior { mean_tesla: Vector3::zeros(), covariance_tesla2: first }, |last| {
            let elapsed_s = (time_s - last.time_s).max(0.0);
            let walked = isotropic(self.config.disturbance_walk_tesla.powi(2) * elapsed_s);
            FieldPrior { covariance_tesla2: last.field.covariance_tesla2 + walked, ..last.field }
        })
    }

    /// The camera's pose for a magnet, turned as little as possible from the last one.
    fn world_from_camera(&self, state: &MagnetState) -> Pose {
        let world_from_array = self.rig.world_from_array();
        let before = self.last.as_ref().map_or(world_from_array.rotation, |last| last.world_from_camera.rotation);
        let heading = world_from_array.rotation * state.heading;
        let axis = before * self.rig.axis_in_camera();
        // A half turn has no smallest rotation; any axis across will do.
        let across = UnitQuaternion::from_axis_angle(
            &nalgebra::UnitVector3::new_normalize(tangents(&axis).column(0).into_owned()),
            std::f64::consts::PI,
        );
        let turn = UnitQuaternion::rotation_between(&axis, &heading).unwrap_or(across);
        let rotation = turn * before;
        let magnet_m = world_from_array * state.position_m;
        let magnet_from_camera = rotation * Vector3::from(self.rig.magnet().position_in_camera_m);
        Pose::from_parts(Translation3::from(magnet_m.coords - magnet_from_camera), rotation)
    }

    fn track_reading(&mut self, reading: &MagneticReading) -> Result<Tracked, TrackError> {
        let sensors = self.rig.array().positions_m.len();
        if reading.field_tesla.len() != sensors {
            let found = reading.field_tesla.len();
            let reason =
                format!("it has {found} sensors where the array has {sensors}; give the array of these readings");
            return Err(TrackError::Unsuitable { method: NAME, index: reading.index, reason });
        }
        let measured = measurement::measurements(reading, self.rig.array());
        let components: usize = measured.iter().map(|m| m.components.len()).sum();
        if components < 5 {
            return Ok(self.lost(format!("only {components} components of the reading are usable, 5 are needed")));
        }
        let Some(fit) = self.locate(&measured, reading.time_s) else {
            return Ok(self.lost("no place of the magnet explains the reading".into()));
        };
        let world_from_camera = self.world_from_camera(&fit.state);
        let tracked = Tracked {
            world_from_camera: Some(world_from_camera),
            confidence: confidence(&fit, sensors),
            depth: None,
            reliability: None,
            warning: self.warning(&fit),
        };
        self.last = Some(Last { time_s: reading.time_s, state: fit.state, field: fit.field, world_from_camera });
        self.fit = Some(fit);
        Ok(tracked)
    }

    /// Repeats the last pose, without trust in it.
    fn lost(&mut self, reason: String) -> Tracked {
        self.fit = None;
        let world_from_camera = self.last.as_ref().map(|last| last.world_from_camera);
        Tracked { world_from_camera, confidence: 0.0, depth: None, reliability: None, warning: Some(reason) }
    }

    fn warning(&mut self, fit: &Fit) -> Option<String> {
        let sigma_m = position_sigma_m(fit);
        if sigma_m > CAPSULE_M {
            return Some(format!(
                "the magnet is nearly out of range: its position is known to {:.0} mm",
                1e3 * sigma_m
            ));
        }
        if fit.reduced_chi_squared() > IMPLAUSIBLE {
            return Some("the readings differ from a single magnet's field by more than their noise".into());
        }
        let first = !std::mem::replace(&mut self.said_roll, true);
        first.then(|| {
            "the turn about the magnet's axis is not observed; the camera is turned as little as possible".into()
        })
    }
}

impl Odometry for Magnetic {
    fn name(&self) -> &'static str {
        NAME
    }

    fn track(&mut self, observation: &Observation) -> Result<Tracked, TrackError> {
        match observation {
            Observation::Magnetic(reading) => self.track_reading(reading),
            Observation::Frame(frame) => {
                let reason =
                    "it is a picture, but magnetic readings are needed; give a sequence with magnet.csv".into();
                Err(TrackError::Unsuitable { method: NAME, index: frame.index, reason })
            }
        }
    }
}

/// Largest standard deviation of the position over all directions, metres.
fn position_sigma_m(fit: &Fit) -> f64 {
    fit.covariance.fixed_view::<3, 3>(0, 0).symmetric_eigenvalues().max().max(0.0).sqrt()
}

/// The share of sensors that agree, less where the fit is worse than the noise or the position is vague.
fn confidence(fit: &Fit, sensors: usize) -> f64 {
    let agreeing = 1.0 - fit.outliers as f64 / sensors.max(1) as f64;
    let vague = (position_sigma_m(fit) / CAPSULE_M).powi(2);
    agreeing * fit.reduced_chi_squared().max(1.0).recip() / (1.0 + vague)
}

fn plausible(fit: &Fit, measured: usize) -> bool {
    fit.reduced_chi_squared() < IMPLAUSIBLE && (fit.outliers as f64) < MANY_OUTLIERS * measured as f64
}

#[cfg(test)]
mod tests;
