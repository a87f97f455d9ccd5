//! Monocular ORB SLAM: the camera's motion from corners that are found again, by the crate kornia-slam.
//!
//! ```text
//! Frame -> View (small, pinhole, equalised; ORB features) -> Map (kornia-slam) -> Tracked
//!                                                              |  lost
//!                                                              v
//!                              Memory of its landmarks -> recognised? -> Tracked, and the next map is tied to it
//! ```
//! In the line of R. Mur-Artal, J. Montiel, J. Tardos, "ORB-SLAM" (2015): two views begin a map, projected landmarks give
//! each frame's pose, keyframes add landmarks, and a local bundle adjustment refines them. kornia-slam 0.1 has all this;
//! what it leaves out, relocalisation, is `memory` (docs/decisions/007).
//!
//! Lengths are in an unknown unit: the middle depth of the first map is 1. Poses are those of the moment; what a later
//! adjustment would change in them is not taken back. Invariants: every frame yields a [`Tracked`]; the memory holds a
//! bounded number of landmarks, the map under way grows by its keyframes.

mod map;
mod memory;
mod view;

use crate::{BaselineError, picture};
use endoscape_core::{Camera, Frame, Observation, Odometry, Pose, TrackError, Tracked};
use kornia_image::Image as Pixels;
use map::{Found, Map};
use memory::Memory;
use serde::{Deserialize, Serialize};
use std::time::{Duration, Instant};
use view::{Eye, View};

const NAME: &str = "orb";
/// Seconds without track after which an established map is given up (kornia-slam's own policy without inertial sensor).
const PATIENCE_S: f64 = 0.5;
/// Confidence of a pose found among remembered landmarks alone.
const RECOGNISED: f64 = 0.5;

/// Settings of [`Orb`]: [`OrbConfig::endoscopic`], the default, or [`OrbConfig::ordinary`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OrbConfig {
    /// Width pictures are reduced to, pixels; narrower ones stay as they are.
    pub width: usize,
    /// Features looked for in a picture.
    pub features: usize,
    /// Difference of grey levels that makes a corner (E. Rosten and T. Drummond's FAST, 2006).
    pub fast_threshold: f64,
    /// The same where a part of the picture has no such corner.
    pub fast_floor: f64,
    /// Clip limit of the equalisation of contrast; 0 leaves pictures as they are.
    pub clip_limit: f64,
    /// Median angle between the rays of the pair of pictures that begins a map, degrees, at least. A small one begins
    /// earlier; at 1 a sideways motion past a nearly flat scene is still mistaken for a turn.
    pub parallax_deg: f64,
    /// Fewest and most frames between keyframes.
    pub keyframe_frames: (usize, usize),
    /// Share of the last keyframe's landmarks below which a frame becomes the next one.
    pub keyframe_share: f64,
}

impl OrbConfig {
    /// For pictures from inside the body: few, weak corners. 320 pixels across, equalised, 2000 features, FAST 6 and 2:
    /// the one setting at which ORB-SLAM2 tracks C3VD.
    pub const fn endoscopic() -> Self {
        Self {
            width: 320,
            features: 2000,
            fast_threshold: 6.0,
            fast_floor: 2.0,
            clip_limit: 3.0,
            parallax_deg: 2.0,
            keyframe_frames: (3, 8),
            keyframe_share: 0.6,
        }
    }

    /// For streets and rooms: ORB-SLAM2's settings for KITTI. Keyframes may follow each other closely, because what is
    /// seen changes within a few frames.
    pub const fn ordinary() -> Self {
        Self {
            width: 1280,
            fast_threshold: 20.0,
            fast_floor: 7.0,
            clip_limit: 0.0,
            parallax_deg: 1.0,
            keyframe_frames: (2, 8),
            keyframe_share: 0.9,
            ..Self::endoscopic()
        }
    }

    fn check(&self) -> Result<(), BaselineError> {
        let refuse = |name, value, expected| Err(BaselineError::Config { name, value, expected });
        if self.features < 200 {
            return refuse("features", self.features as f64, "at least 200: a map begins with 100 matches");
        }
        for (name, value) in [("fast_threshold", self.fast_threshold), ("fast_floor", self.fast_floor)] {
            if !(1.0..=255.0).contains(&value) {
                return refuse(name, value, "a number from 1 to 255");
            }
        }
        if !(0.0..=1000.0).contains(&self.clip_limit) {
            return refuse("clip_limit", self.clip_limit, "a number from 0 to 1000");
        }
        if !(0.1..=30.0).contains(&self.parallax_deg) {
            return refuse("parallax_deg", self.parallax_deg, "a number from 0.1 to 30");
        }
        if !(0.0..=1.0).contains(&self.keyframe_share) {
            return refuse("keyframe_share", self.keyframe_share, "a number from 0 to 1");
        }
        match self.keyframe_frames {
            (least, most) if least >= 1 && least <= most => Ok(()),
            (least, _) => refuse("keyframe_frames", least as f64, "two rising numbers of at least 1"),
        }
    }
}

impl Default for OrbConfig {
    fn default() -> Self {
        Self::endoscopic()
    }
}

/// The method; see the [module](self).
pub struct Orb {
    config: OrbConfig,
    size: endoscape_core::Size,
    eye: Eye,
    map: Map,
    /// Whether the map lies in the world of the maps before it, or is the first.
    is_tied: bool,
    memory: Memory,
    previous: Option<Pixels<u8, 1>>,
    last: Option<Pose>,
    stages: [(&'static str, Duration); 2],
}

impl Orb {
    /// A method for the video of one camera.
    ///
    /// # Errors
    /// [`BaselineError`] for a setting that cannot be or a camera no pinhole stands for.
    pub fn new(config: OrbConfig, camera: &Camera) -> Result<Self, BaselineError> {
        config.check()?;
        let eye = Eye::new(&config, camera)?;
        let map = Map::new(&config, eye.pinhole());
        let stages = [("features", Duration::ZERO), ("track", Duration::ZERO)];
        let (size, memory) = (camera.size(), Memory::default());
        Ok(Self { config, size, eye, map, is_tied: true, memory, previous: None, last: None, stages })
    }

    fn track_frame(&mut self, frame: &Frame) -> Result<Tracked, TrackError> {
        let begun = Instant::now();
        let fail = |reason| TrackError::Failed { method: NAME, index: frame.index, reason };
        let view = self.eye.see(frame).map_err(fail)?;
        let seen = Instant::now();
        let (size, at) = (self.eye.size(), (frame.index, frame.time_s));
        let tracked = match self.map.track(&view, size, self.previous.as_ref(), at) {
            Some(found) => self.found(&found, &view, frame.index),
            None => self.missed(&view, frame.time_s),
        };
        self.previous = Some(view.pixels);
        self.stages = [("features", seen - begun), ("track", seen.elapsed())];
        Ok(tracked)
    }

    /// A frame with a place in the map.
    fn found(&mut self, found: &Found, view: &View, index: usize) -> Tracked {
        let mut warning = None;
        let mut pose = found.world_from_camera;
        if found.is_first && !self.memory.is_empty() {
            self.is_tied = false;
            let last = self.last.unwrap_or_else(Pose::identity);
            self.map.place(&pose, &last, self.map.scale);
            pose = last;
            warning = Some("a new start after the way was lost: scale and place are guessed".to_owned());
        }
        if !self.is_tied && found.is_keyframe {
            let known = self.memory.recognise(view, self.eye.pinhole());
            if let Some(known) = known.filter(|known| self.map.tie(index, &pose, known)) {
                (self.is_tied, pose) = (true, known.world_from_camera);
                warning = Some("the place was recognised: the new map is tied to the one before".to_owned());
            }
        }
        self.last = Some(pose);
        let confidence = if found.is_first && !self.is_tied { 0.0 } else { found.confidence };
        Tracked { world_from_camera: Some(pose), confidence, depth: None, reliability: None, warning }
    }

    /// A frame without a place in the map: perhaps it shows landmarks of old.
    fn missed(&mut self, view: &View, time_s: f64) -> Tracked {
        if self.map.is_given_up(time_s) {
            let scale = self.map.scale;
            self.memory.add(self.map.landmarks().into_iter());
            self.map = Map::new(&self.config, self.eye.pinhole());
            self.map.scale = scale;
        }
        let known = self.memory.recognise(view, self.eye.pinhole());
        let (confidence, warning) = match (&known, self.last) {
            (Some(_), _) => (RECOGNISED, "the way was lost; this place was recognised"),
            (None, Some(_)) => (0.0, "the way is lost: too few known corners are seen"),
            (None, None) => (0.0, "no map yet: two pictures with parallax and enough corners are needed"),
        };
        self.last = known.map(|known| known.world_from_camera).or(self.last);
        let warning = Some(warning.to_owned());
        Tracked { world_from_camera: self.last, confidence, depth: None, reliability: None, warning }
    }
}

impl Odometry for Orb {
    fn name(&self) -> &'static str {
        NAME
    }

    fn track(&mut self, observation: &Observation) -> Result<Tracked, TrackError> {
        self.track_frame(picture::of(observation, NAME, self.size)?)
    }

    fn stage_times(&self) -> &[(&'static str, Duration)] {
        &self.stages
    }
}

#[cfg(test)]
mod tests;
