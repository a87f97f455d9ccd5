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
//! in a window until path and heading show where they belong; the frames before are then told anew
//! ([`Odometry::revisions`]). Readings and frames come in any order of time and at any rates.
//! Equations: docs/math.md, "Fusion".
//!
//! Invariants: every observation yields a [`Tracked`]; poses are in the world of
//! [`MagneticRig::world_from_array`], in metres; memory is bounded by [`FusedConfig::window`] sightings.

mod config;
mod filter;
mod recorded;
mod retrace;
mod window;

pub use config::FusedConfig;
pub use recorded::Recorded;

use crate::BaselineError;
use crate::magnetic::Magnetic;
use endoscape_core::magnetic::MagneticRig;
use endoscape_core::{
    DepthMap, Frame, Image, MagneticReading, Observation, Odometry, Pose, TimedPose, TrackError, Tracked, se3,
};
use filter::{Filter, MagnetFix};
use nalgebra::{Matrix5, SMatrix, SVector, Vector3};
use retrace::{Moment, Motion, Sight};
use std::collections::VecDeque;
use std::sync::Arc;
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
/// Turn or way, in radians or vision's unit, below which vision repeats itself.
const STILL: f64 = 1e-9;

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
    /// The picture of the last frame.
    picture: Option<Arc<Image>>,
    /// The last fix since the last frame.
    latest_fix: Option<MagnetFix>,
    /// What was said at the last frames since roll and scale were found.
    trail: VecDeque<Moment>,
    /// What the last observation says of earlier frames.
    revisions: Vec<TimedPose>,
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
            picture: None,
            latest_fix: None,
            trail: VecDeque::new(),
            revisions: Vec::new(),
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
            self.take_fix(fix, reading.time_s, pose);
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
    fn take_fix(&mut self, fix: MagnetFix, time_s: f64, world_from_camera: Pose) {
        if self.filter.as_mut().is_some_and(|filter| filter.see_magnet(&fix)) {
            self.refused.magnet = 0;
            self.latest_fix = Some(fix);
            return;
        }
        self.refused.magnet += 1;
        if self.filter.is_none() || self.refused.magnet >= PATIENCE {
            let log_scale = self.filter.as_ref().map_or(0.0, |filter| filter.log_scale);
            self.filter = Some(Filter::new(time_s, world_from_camera, log_scale, &unaligned(&fix.covariance)));
            self.latest_fix = Some(fix);
            self.refused = Refused::default();
            self.trail.clear();
            self.unalign();
        }
    }

    fn track_frame(&mut self, frame: &Frame, observation: &Observation) -> Result<Tracked, TrackError> {
        let tracked = self.visual.track(observation)?;
        if let Some(filter) = &mut self.filter {
            filter.predict(frame.time_s, &self.config.walk());
        }
        let is_repeated = self.picture.replace(frame.image.clone()).is_some_and(|before| before == frame.image);
        let sure = tracked.world_from_camera.filter(|_| tracked.confidence >= self.config.visual_confidence);
        match sure {
            _ if is_repeated => self.remember(frame.time_s, Sight::Nothing),
            Some(visual_from_camera) => self.take_view(visual_from_camera, frame.time_s),
            None => self.break_off(frame.time_s),
        }
        Ok(self.tracked(frame.time_s, tracked.depth, tracked.warning))
    }

    /// Keeps what was said now, in case roll and scale are found later.
    fn remember(&mut self, time_s: f64, sight: Sight) {
        let fix = self.latest_fix.take();
        let Some(filter) = &self.filter else { return };
        if self.trail.len() == self.config.window {
            self.trail.pop_front();
        }
        self.trail.push_back(Moment { time_s, fix, sight, rotation_sigma_rad: filter.rotation_sigma_rad() });
    }

    /// Vision's track is torn: what it says next has a place, and perhaps a unit, of its own.
    fn break_off(&mut self, time_s: f64) {
        self.remember(time_s, Sight::Nothing);
        self.window.clear();
        if self.visual_from_last.take().is_some()
            && let Some(filter) = &mut self.filter
        {
            filter.doubt_scale(BREAK_LOG_SCALE);
        }
    }

    fn take_view(&mut self, visual_from_camera: Pose, time_s: f64) {
        let motion = self.visual_from_last.map(|(last, last_s)| Motion {
            before_from_now: last.inverse() * visual_from_camera,
            elapsed_s: time_s - last_s,
        });
        // Standing still says nothing about the time that passed; the next motion speaks for both.
        if motion.is_some_and(|motion| se3::log(&motion.before_from_now).amax() < STILL) {
            self.remember(time_s, Sight::Nothing);
            return;
        }
        self.visual_from_last = Some((visual_from_camera, time_s));
        self.seen.vision_s = time_s;
        self.forget_what_faded();
        if let Some(motion) = motion.filter(|_| self.is_aligned) {
            self.take_motion(&motion);
        }
        self.remember(time_s, motion.map_or(Sight::Anew, Sight::Moved));
        if !self.is_aligned {
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

    fn take_motion(&mut self, motion: &Motion) {
        let Some(filter) = &mut self.filter else { return };
        if filter.follow(&self.config.step(motion, filter.log_scale)) {
            self.refused.vision = 0;
            return;
        }
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
            self.revisions = retrace::retraced(&self.trail, filter, &self.config);
            self.trail.clear();
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
        self.revisions.clear();
        match observation {
            Observation::Frame(frame) => self.track_frame(frame, observation),
            Observation::Magnetic(reading) => self.track_reading(reading),
        }
    }

    fn revisions(&self) -> &[TimedPose] {
        &self.revisions
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
