//! Fusion: the magnet gives metres and a place in the room, vision the roll and the fine motion between.
//!
//! ```text
//! MagneticReading -> Magnetic -> place and heading, 5 of 6 --\
//!                                                             Filter -> Tracked, 6 of 6, metres
//! Frame -> any visual Odometry -> motion since the last frame --/   \-- window: roll and scale found together
//! ```
//! Each side's dropout costs what only that side knows: without the array the path goes on with vision's motions at the
//! scale found so far; without vision place and heading are followed and the roll is kept. While roll or scale is
//! unknown (at the start, after a long time without vision, after a jump) vision's motions are not filtered but gathered
//! in a window until path and heading show where they belong. Readings and frames come in any order of time and at any
//! rates. Equations: docs/math.md, "Fusion".
//!
//! Invariants: every observation yields a [`Tracked`]; poses are in the world of
//! [`MagneticRig::world_from_array`], in metres; memory is bounded by [`FusedConfig::window`] sightings.

mod filter;
mod recorded;
mod window;

pub use recorded::Recorded;

use crate::magnetic::Magnetic;
use crate::{BaselineError, MagneticConfig};
use endoscape_core::magnetic::MagneticRig;
use endoscape_core::{DepthMap, Frame, MagneticReading, Observation, Odometry, Pose, TrackError, Tracked, se3};
use filter::{Filter, MagnetFix, VisualStep, Walk};
use nalgebra::{Matrix5, SMatrix, SVector, Vector3};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::time::Duration;
use window::{Drift, Mount, Sighting};

const NAME: &str = "fused";
/// Standard deviation of position at which confidence has fallen to one half, metres: the capsule's own length.
const CAPSULE_M: f64 = 0.025;
/// Fewest sightings that can say roll and scale.
const FEWEST_SIGHTINGS: usize = 8;
/// The window is fitted anew once in so many frames.
const FIT_EVERY: usize = 4;
/// Standard deviation of a roll nothing is known of, radians: that of a uniform angle, pi / sqrt(3).
const ANY_ROLL_RAD: f64 = 1.8;
/// Standard deviation of the logarithm of the scale up to which it counts as known. Less than of the roll will do: the
/// filter goes on finding it, while motions of unknown roll would mislead it.
const KNOWN_LOG_SCALE: f64 = 0.5;
/// Roll and scale count as lost at so many times the doubt at which they count as known.
const FADED: f64 = 5.0;
/// Contradictions in a row after which a side is believed and what it contradicts is given up.
const PATIENCE: usize = 5;
/// Doubt about vision's unit after a break in its track, as a standard deviation of its logarithm.
const BREAK_LOG_SCALE: f64 = 0.2;
/// Seconds a side may be silent before a warning.
const SILENT_S: f64 = 0.5;
/// Turn or way, in radians or vision's unit, below which a picture is the last one again.
const FROZEN: f64 = 1e-9;

/// Settings of [`Fused`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FusedConfig {
    /// Random walk of the position, metres per root second. Default 0.05: 9 mm from frame to frame at 30 Hz.
    pub walk_m: f64,
    /// Random walk of the orientation, radians per root second. Default 0.3: 3 degrees from frame to frame at 30 Hz.
    pub walk_rad: f64,
    /// Random walk of the logarithm of vision's scale, per root second. Default 0.1: a third in 10 s.
    pub walk_log_scale: f64,
    /// Standard deviation of the speed at which the wall moves by itself, metres per second along each axis: vision sees
    /// the way along the wall, not through the room. Default 3e-3: breath that moves an organ by 10 mm, 15 times a minute,
    /// has 5.6e-3 along the body, and simulated stomachs show 2e-3 to 6e-3 (docs/paper-experiment.md). 0 for a phantom.
    pub wall_m_per_s: f64,
    /// Standard deviation of a visual motion's translation: this share of it, beside the wall's. Default 0.2.
    pub visual_share: f64,
    /// ... and this at least, metres. Default 2e-4, the error per frame of ORB-SLAM2 and DSO on C3VD.
    pub visual_floor_m: f64,
    /// Standard deviation of a visual motion's rotation: this share of it. Default 0.1: a wall moves more than it turns.
    pub visual_turn_share: f64,
    /// ... and this at least, radians. Default 5e-3, as above.
    pub visual_floor_rad: f64,
    /// Visual motions below this confidence are not used. Default 0.1.
    pub visual_confidence: f64,
    /// Sightings roll and scale are found from, at most. Default 120, 4 s at 30 Hz.
    pub window: usize,
    /// The roll counts as known up to this standard deviation, radians. Default 0.1.
    pub known: f64,
    /// Settings of the magnetic side.
    pub magnetic: MagneticConfig,
}

impl Default for FusedConfig {
    fn default() -> Self {
        Self {
            walk_m: 0.05,
            walk_rad: 0.3,
            walk_log_scale: 0.1,
            wall_m_per_s: 0.003,
            visual_share: 0.2,
            visual_turn_share: 0.1,
            visual_floor_m: 2e-4,
            visual_floor_rad: 5e-3,
            visual_confidence: 0.1,
            window: 120,
            known: 0.1,
            magnetic: MagneticConfig::default(),
        }
    }
}

impl FusedConfig {
    fn check(&self) -> Result<(), BaselineError> {
        let positive = [
            ("walk_m", self.walk_m),
            ("walk_rad", self.walk_rad),
            ("walk_log_scale", self.walk_log_scale),
            ("visual_share", self.visual_share),
            ("visual_turn_share", self.visual_turn_share),
            ("visual_floor_m", self.visual_floor_m),
            ("visual_floor_rad", self.visual_floor_rad),
            ("known", self.known),
        ];
        let bad = positive.into_iter().find(|(_, value)| !(value.is_finite() && *value > 0.0));
        if let Some((name, value)) = bad {
            return Err(BaselineError::Config { name, value, expected: "a finite number above 0" });
        }
        if !(self.wall_m_per_s.is_finite() && self.wall_m_per_s >= 0.0) {
            let (name, value) = ("wall_m_per_s", self.wall_m_per_s);
            return Err(BaselineError::Config { name, value, expected: "a finite number of at least 0" });
        }
        if self.window < FEWEST_SIGHTINGS {
            return Err(BaselineError::Config { name: "window", value: self.window as f64, expected: "at least 8" });
        }
        Ok(())
    }

    const fn walk(&self) -> Walk {
        Walk { translation_m: self.walk_m, rotation_rad: self.walk_rad, log_scale: self.walk_log_scale }
    }
}

/// The method; see the [module](self).
pub struct Fused {
    config: FusedConfig,
    rig: MagneticRig,
    magnetic: Magnetic,
    visual: Box<dyn Odometry>,
    filter: Option<Filter>,
    /// Whether roll and scale are known, so that visual motions are filtered.
    is_aligned: bool,
    window: VecDeque<Sighting>,
    /// Frames since the window was last fitted.
    unfitted: usize,
    /// The camera in vision's world at the last frame vision is sure of, and that frame's time in seconds.
    visual_from_last: Option<(Pose, f64)>,
    refused: Refused,
    seen: Seen,
}

/// Contradictions in a row, of each side.
#[derive(Clone, Copy, Debug, Default)]
struct Refused {
    magnet: usize,
    vision: usize,
}

/// When each side last said something, seconds.
#[derive(Clone, Copy, Debug)]
struct Seen {
    magnet_s: f64,
    vision_s: f64,
}

impl Fused {
    /// Fuses a visual method with the readings of a rig.
    ///
    /// # Errors
    /// [`BaselineError::Config`] for a setting that cannot be.
    pub fn new(config: FusedConfig, visual: Box<dyn Odometry>, rig: MagneticRig) -> Result<Self, BaselineError> {
        config.check()?;
        Ok(Self {
            magnetic: Magnetic::new(config.magnetic, rig.clone())?,
            config,
            rig,
            visual,
            filter: None,
            is_aligned: false,
            window: VecDeque::new(),
            unfitted: 0,
            visual_from_last: None,
            refused: Refused::default(),
            seen: Seen { magnet_s: f64::NEG_INFINITY, vision_s: f64::NEG_INFINITY },
        })
    }

    /// Metres per unit of vision, once known.
    pub fn scale(&self) -> Option<f64> {
        self.filter.as_ref().filter(|_| self.is_aligned).map(|filter| filter.log_scale.exp())
    }

    /// Covariance of the last pose's error, a twist in the camera's frame (m, rad); `None` before the first reading.
    pub fn pose_covariance(&self) -> Option<nalgebra::Matrix6<f64>> {
        self.filter.as_ref().map(Filter::pose_covariance)
    }

    fn mount(&self) -> Mount {
        let in_camera_m = Vector3::from(self.rig.magnet().position_in_camera_m);
        Mount { in_camera_m, axis: self.rig.axis_in_camera() }
    }

    fn track_reading(&mut self, reading: &MagneticReading) -> Result<Tracked, TrackError> {
        let tracked = self.magnetic.track(&Observation::Magnetic(reading.clone()))?;
        if let Some(filter) = &mut self.filter {
            filter.predict(reading.time_s, &self.config.walk());
        }
        if let (Some(fix), Some(pose)) = (self.fix(), tracked.world_from_camera) {
            self.seen.magnet_s = reading.time_s;
            self.take_fix(&fix, reading.time_s, pose);
        }
        Ok(self.tracked(reading.time_s, None, tracked.warning))
    }

    /// The last reading's fit in the world; `None` if it gave none.
    fn fix(&self) -> Option<MagnetFix> {
        let (fit, mount) = (self.magnetic.last_fit()?, self.mount());
        let fix = MagnetFix {
            in_camera_m: mount.in_camera_m,
            axis_in_camera: mount.axis,
            in_world_m: fit.state.position_m.coords,
            across: fit.state.tangents(),
            // A reading that fits badly is worth as much less.
            covariance: fit.covariance * fit.reduced_chi_squared().max(1.0),
        };
        Some(fix.in_world(self.rig.world_from_array()))
    }

    /// Updates the filter, or starts it where there is none or the fixes contradict it for long.
    fn take_fix(&mut self, fix: &MagnetFix, time_s: f64, world_from_camera: Pose) {
        if self.filter.as_mut().is_some_and(|filter| filter.see_magnet(fix)) {
            self.refused.magnet = 0;
            return;
        }
        self.refused.magnet += 1;
        if self.filter.is_none() || self.refused.magnet >= PATIENCE {
            let log_scale = self.filter.as_ref().map_or(0.0, |filter| filter.log_scale);
            self.filter = Some(Filter::new(time_s, world_from_camera, log_scale, &unaligned(&fix.covariance)));
            self.refused = Refused::default();
            self.unalign();
        }
    }

    fn track_frame(&mut self, frame: &Frame, observation: &Observation) -> Result<Tracked, TrackError> {
        let tracked = self.visual.track(observation)?;
        if let Some(filter) = &mut self.filter {
            filter.predict(frame.time_s, &self.config.walk());
        }
        let sure = tracked.world_from_camera.filter(|_| tracked.confidence >= self.config.visual_confidence);
        match sure {
            Some(visual_from_camera) => self.take_view(visual_from_camera, frame.time_s),
            None => self.break_off(),
        }
        Ok(self.tracked(frame.time_s, tracked.depth, tracked.warning))
    }

    /// Vision's track is torn: what it says next has a place, and perhaps a unit, of its own.
    fn break_off(&mut self) {
        self.window.clear();
        if self.visual_from_last.take().is_some()
            && let Some(filter) = &mut self.filter
        {
            filter.doubt_scale(BREAK_LOG_SCALE);
        }
    }

    fn take_view(&mut self, visual_from_camera: Pose, time_s: f64) {
        let motion = self.visual_from_last.map(|(last, _)| last.inverse() * visual_from_camera);
        // A picture shown again says nothing about the time that passed; the next one speaks for both.
        if motion.is_some_and(|motion| se3::log(&motion).amax() < FROZEN) {
            return;
        }
        let last = self.visual_from_last.replace((visual_from_camera, time_s));
        let elapsed_s = last.map_or(0.0, |(_, last_s)| time_s - last_s);
        self.seen.vision_s = time_s;
        self.forget_what_faded();
        if self.is_aligned {
            if let Some(motion) = motion {
                self.take_motion(&motion, elapsed_s);
            }
        } else {
            self.gather(visual_from_camera);
        }
        if let Some(filter) = &mut self.filter {
            filter.clone_pose();
        }
    }

    /// Roll and scale that time has made uncertain are found anew.
    fn forget_what_faded(&mut self) {
        let (roll, scale) = (FADED * self.config.known, FADED * KNOWN_LOG_SCALE);
        let faded = |filter: &Filter| filter.rotation_sigma_rad() > roll || filter.scale_sigma() > scale;
        if self.is_aligned && self.filter.as_ref().is_some_and(faded) {
            self.unalign();
        }
    }

    fn unalign(&mut self) {
        (self.is_aligned, self.unfitted) = (false, 0);
        self.window.clear();
    }

    fn take_motion(&mut self, motion: &Pose, elapsed_s: f64) {
        let Some(filter) = &mut self.filter else { return };
        let way_m = motion.translation.vector.norm() * filter.log_scale.exp();
        let turn_rad = motion.rotation.angle();
        let by_wall_m = self.config.wall_m_per_s * elapsed_s;
        let step = VisualStep {
            motion: *motion,
            translation_sigma_m: self.config.visual_floor_m.hypot(self.config.visual_share * way_m).hypot(by_wall_m),
            rotation_sigma_rad: self.config.visual_floor_rad.hypot(self.config.visual_turn_share * turn_rad),
        };
        if filter.see_motion(&step) {
            self.refused.vision = 0;
            return;
        }
        // A wall that moves deceives vision about the way, hardly about the turn.
        filter.see_turn(&step);
        self.refused.vision += 1;
        if self.refused.vision >= PATIENCE {
            self.refused.vision = 0;
            self.unalign();
        }
    }

    /// Adds what both sides say now to the window, and fits it from time to time.
    fn gather(&mut self, visual_from_camera: Pose) {
        let mount = self.mount();
        let Some(filter) = &self.filter else { return };
        let (place, turn) = filter.magnet_variances(&mount.in_camera_m, &mount.axis);
        let world_from_camera = filter.world_from_camera;
        let magnet_m = world_from_camera * nalgebra::Point3::from(mount.in_camera_m);
        let heading = world_from_camera * mount.axis.into_inner();
        let magnet_m = (magnet_m.coords, place);
        self.window.push_back(Sighting { visual_from_camera, magnet_m, heading: (heading, turn) });
        if self.window.len() > self.config.window {
            self.window.pop_front();
        }
        self.unfitted += 1;
        if self.unfitted >= FIT_EVERY && self.window.len() >= FEWEST_SIGHTINGS {
            self.unfitted = 0;
            self.align(&mount, world_from_camera);
        }
    }

    /// Takes over roll and scale where the window settles them.
    fn align(&mut self, mount: &Mount, start: Pose) {
        let (Some(filter), known) = (&mut self.filter, self.config.known) else { return };
        let window = self.window.make_contiguous();
        let drift = Drift { way: self.config.visual_share, turn: self.config.visual_turn_share };
        let Some(found) = window::agree(window, mount, &start, drift) else { return };
        let rotation = found.covariance.fixed_view::<3, 3>(3, 3).symmetric_eigenvalues().max();
        if rotation < known * known && found.covariance[(6, 6)] < KNOWN_LOG_SCALE * KNOWN_LOG_SCALE {
            *filter = Filter::new(filter.time_s, found.world_from_camera, found.log_scale, &found.covariance);
            self.is_aligned = true;
            self.refused = Refused::default();
            self.window.clear();
        }
    }

    fn tracked(&self, time_s: f64, depth: Option<DepthMap>, warning: Option<String>) -> Tracked {
        let blind = time_s - self.seen.vision_s > SILENT_S;
        let afar = time_s - self.seen.magnet_s > SILENT_S;
        let known = if self.is_aligned { 1.0 } else { 0.5 };
        let vague = |filter: &Filter| 1.0 / (1.0 + (filter.position_sigma_m() / CAPSULE_M).powi(2));
        let confidence = if blind && afar { 0.0 } else { self.filter.as_ref().map_or(0.0, vague) * known };
        let own = match (blind, afar, self.is_aligned) {
            (true, true, _) => Some("neither the array nor the camera sees the capsule's motion"),
            (true, false, _) => Some("the camera sees no motion; the turn about the magnet's axis is kept"),
            (false, true, _) => Some("the array does not see the magnet; the way goes on by the camera alone"),
            (false, false, false) => Some("the turn about the magnet's axis is not known yet"),
            (false, false, true) => None,
        };
        Tracked {
            world_from_camera: self.filter.as_ref().map(|filter| filter.world_from_camera),
            confidence,
            depth: self.scale().and_then(|scale| depth.map(|depth| depth.scaled(scale as f32))),
            reliability: None,
            warning: own.map(str::to_owned).or(warning),
        }
    }
}

impl Odometry for Fused {
    fn name(&self) -> &'static str {
        NAME
    }

    fn track(&mut self, observation: &Observation) -> Result<Tracked, TrackError> {
        match observation {
            Observation::Frame(frame) => self.track_frame(frame, observation),
            Observation::Magnetic(reading) => self.track_reading(reading),
        }
    }

    fn stage_times(&self) -> &[(&'static str, Duration)] {
        self.visual.stage_times()
    }
}

/// What one fix says of a pose and of the scale: place and heading, any roll, any scale.
///
/// The heading's directions do not matter at this doubt, so its larger variance stands for both.
fn unaligned(fix: &Matrix5<f64>) -> SMatrix<f64, 7, 7> {
    let place = fix.fixed_view::<3, 3>(0, 0).symmetric_eigenvalues().max();
    let roll = ANY_ROLL_RAD * ANY_ROLL_RAD;
    SMatrix::from_diagonal(&SVector::from([place, place, place, roll, roll, roll, 1.0]))
}

#[cfg(test)]
mod tests;
