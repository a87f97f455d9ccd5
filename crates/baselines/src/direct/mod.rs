//! Direct odometry: the camera's motion from the brightness of one video, without features.
//!
//! ```text
//! Frame -> Pyramid -> align to the keyframe -> believed? -> search its points' depths in the frame -> Tracked
//!                                                 |               \-> far enough? the frame becomes the keyframe
//!                                                 \-> no: the last pose without trust; after a while, a new start
//! ```
//! In the line of J. Engel, T. Schoeps, D. Cremers, "LSD-SLAM" (ECCV 2014) and J. Engel, V. Koltun, D. Cremers,
//! "Direct sparse odometry" (2018): pixels of strong gradient, an inverse-depth filter per pixel, alignment with an
//! affine change of brightness. Lengths are in an unknown unit: the first scene's middle depth is about 1. The first
//! keyframe starts from a flat scene and is worked over until depths and motions agree.
//!
//! Every camera model of core works. Invariants: every frame yields a [`Tracked`]; memory is bounded by
//! [`DirectConfig::window`] pictures.

pub mod align;
pub mod keyframe;
pub mod lens;
pub mod point;
pub mod pyramid;
pub mod search;

pub use align::{Alignment, Brightness, align};

use crate::{BaselineError, picture};
use align::Reference;
use endoscape_core::{Camera, Frame, Image, Observation, Odometry, Pose, TrackError, Tracked, se3};
use keyframe::{Keyframe, View};
use nalgebra::Vector6;
use point::InverseDepth;
use pyramid::{Lenses, Pyramid};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::sync::Arc;

const NAME: &str = "direct";
/// Standard deviation of brightness between two views of one place, grey levels: noise, compression, gloss.
const BRIGHTNESS_NOISE: f64 = 6.0;
/// Fewest points a keyframe needs.
const FEWEST_POINTS: usize = 60;
/// Points of found depth that are enough to do without the others.
const FEWEST_TRUSTED: usize = 200;
/// Share of visible points that must agree for an alignment to be believed.
const FEWEST_AGREEING: f64 = 0.5;
/// Correlation of brightness below which two pictures do not show the same.
const LEAST_CORRELATION: f64 = 0.5;
/// Frames without a believed alignment, in a row, before a new start.
const PATIENCE: usize = 5;
/// Share of points below which a frame becomes the keyframe, however small the parallax.
const KEYFRAME_VISIBLE: f64 = 0.75;
/// Share of points below which the first keyframe is left before it has been worked over with all its frames.
const START_VISIBLE: f64 = 0.6;
/// Rounds in which a new keyframe's depths and its place among the window's views follow each other.
const SETTLE_ROUNDS: usize = 3;
/// An alignment in which less than this part of the usual share agrees is tried from other guesses.
const DISAPPOINTING: f64 = 0.8;
/// Frames the first keyframe is worked over with.
const START_FRAMES: usize = 8;
/// Rounds of search and alignment over those frames.
const START_ROUNDS: usize = 2;

/// Settings of [`Direct`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DirectConfig {
    /// Pixels a keyframe is followed by. Default 2000, as in DSO.
    pub points: usize,
    /// Levels of the picture pyramid. Default 6: the coarsest of a 640-pixel row has 20 pixels.
    pub levels: usize,
    /// Parallax at which a frame becomes the keyframe, as a share of width plus height. Default 0.02, about DSO's.
    pub keyframe_parallax: f64,
    /// Earlier keyframes a new one's depths are searched in. Default 4.
    pub window: usize,
}

impl Default for DirectConfig {
    fn default() -> Self {
        Self { points: 2000, levels: 6, keyframe_parallax: 0.02, window: 4 }
    }
}

impl DirectConfig {
    fn check(&self) -> Result<(), BaselineError> {
        let refuse = |name, value, expected| Err(BaselineError::Config { name, value, expected });
        if self.points < FEWEST_POINTS {
            return refuse("points", self.points as f64, "at least 60");
        }
        if self.levels == 0 {
            return refuse("levels", 0.0, "at least 1");
        }
        if !(self.keyframe_parallax > 0.0 && self.keyframe_parallax < 1.0) {
            return refuse("keyframe_parallax", self.keyframe_parallax, "a number between 0 and 1");
        }
        Ok(())
    }
}

/// The method; see the [module](self).
#[derive(Clone, Debug)]
pub struct Direct {
    config: DirectConfig,
    lenses: Lenses,
    keyframe: Option<Keyframe>,
    /// Earlier keyframes' pictures, oldest first.
    window: VecDeque<View>,
    /// Frames of the first keyframe while it is worked over; empty afterwards.
    start: Vec<(View, Alignment)>,
    /// Whether the keyframe is the first one since a start.
    starting: bool,
    last: Option<View>,
    /// Motion from the frame before the last to the last.
    last_from_previous: Pose,
    lost: usize,
    /// Share of points that agreed in the last alignment.
    usual_agreeing: f64,
    /// The picture before and what was said about it.
    before: Option<(Arc<Image>, Tracked)>,
}

impl Direct {
    /// A method for the video of one camera.
    ///
    /// # Errors
    /// [`BaselineError`] for a setting that cannot be or a camera that cannot be halved.
    pub fn new(config: DirectConfig, camera: &Camera) -> Result<Self, BaselineError> {
        config.check()?;
        Ok(Self {
            config,
            lenses: Lenses::new(camera, config.levels)?,
            keyframe: None,
            window: VecDeque::new(),
            start: Vec::new(),
            starting: true,
            last: None,
            last_from_previous: Pose::identity(),
            lost: 0,
            usual_agreeing: 1.0,
            before: None,
        })
    }

    fn track_frame(&mut self, frame: &Frame) -> Tracked {
        let pyramid = Arc::new(Pyramid::new(&frame.image, frame.usable.clone(), &self.lenses));
        let Some(keyframe) = self.keyframe.take() else { return self.begin(pyramid, None) };
        match self.find(&keyframe, &pyramid).filter(believed) {
            Some(alignment) => self.accept(keyframe, pyramid, alignment),
            None => self.miss(keyframe, pyramid),
        }
    }

    /// Aligns a picture from the likeliest guess, and from the others only where that disappoints: a wrong guess can
    /// end in a place that looks nearly as good.
    fn find(&self, keyframe: &Keyframe, pyramid: &Pyramid) -> Option<Alignment> {
        let align = |guess: &Alignment| keyframe.reference.align(pyramid, &self.lenses, guess, BRIGHTNESS_NOISE);
        let guesses = self.guesses(keyframe);
        let likeliest = guesses.first().and_then(align);
        let good = |alignment: &Alignment| alignment.agreeing >= DISAPPOINTING * self.usual_agreeing;
        if likeliest.as_ref().is_some_and(good) {
            return likeliest;
        }
        let others = guesses.iter().skip(1).filter_map(align);
        likeliest.into_iter().chain(others).max_by(|a, b| a.agreeing.total_cmp(&b.agreeing))
    }

    /// Where the camera may be: on as before, at rest, half or twice as fast, or not turned.
    fn guesses(&self, keyframe: &Keyframe) -> Vec<Alignment> {
        let Some(last) = &self.last else { return Vec::new() };
        let (last_from_keyframe, brightness) = keyframe.view.to(last);
        let step = self.last_from_previous;
        let half = Pose::identity().lerp_slerp(&step, 0.5);
        let straight = Pose::from_parts(step.translation, Default::default());
        let steps = [step, Pose::identity(), half, step * step, straight];
        steps.iter().map(|step| Alignment::guess(step * last_from_keyframe, brightness)).collect()
    }

    /// Makes a frame the first keyframe, of a flat scene of the given inverse depth.
    fn begin(&mut self, pyramid: Arc<Pyramid>, inverse_depth: Option<f64>) -> Tracked {
        let (world_from_camera, brightness) = self
            .last
            .as_ref()
            .map_or((Pose::identity(), Brightness::default()), |l| (l.world_from_camera, l.brightness));
        let view = View { pyramid, world_from_camera, brightness };
        let keyframe = Keyframe::flat(view.clone(), &self.lenses, self.config.points, inverse_depth.unwrap_or(1.0));
        if keyframe.reference.points.len() < FEWEST_POINTS {
            return held(self.last.as_ref(), "the picture has too little structure to start from");
        }
        let fresh = self.last.is_none();
        (self.starting, self.lost, self.last_from_previous) = (true, 0, Pose::identity());
        self.window.clear();
        self.start.clear();
        self.keyframe = Some(keyframe);
        self.last = Some(view);
        let warning = (!fresh).then(|| "a new start after the way was lost: scale and place are guessed".into());
        let confidence = if fresh { 1.0 } else { 0.0 };
        Tracked { world_from_camera: Some(world_from_camera), confidence, depth: None, reliability: None, warning }
    }

    /// Takes an alignment that is believed: depths learn from the frame, and it may become the keyframe.
    fn accept(&mut self, mut keyframe: Keyframe, pyramid: Arc<Pyramid>, alignment: Alignment) -> Tracked {
        let mut view = if self.starting {
            self.work_over(&mut keyframe, pyramid, alignment)
        } else {
            let view = keyframe.view.aligned(&alignment, pyramid);
            keyframe.observe(&view, &self.lenses, BRIGHTNESS_NOISE);
            keyframe.trust_found(FEWEST_TRUSTED);
            view
        };
        let (motion, _) = keyframe.view.to(&view);
        let size = self.lenses.level(0).camera().size();
        let depth = keyframe.depth_seen_from(&motion, &self.lenses, size);
        let far = keyframe.parallax(&motion, &self.lenses)
            > self.config.keyframe_parallax * (size.width + size.height) as f64;
        let ready = !self.starting || self.start.len() >= START_FRAMES || alignment.visible < START_VISIBLE;
        if ready && (far || alignment.visible < KEYFRAME_VISIBLE) {
            (keyframe, view) = self.next_keyframe(keyframe, view);
        }
        if let Some(last) = &self.last {
            self.last_from_previous = view.world_from_camera.inverse() * last.world_from_camera;
        }
        let world_from_camera = Some(view.world_from_camera);
        (self.lost, self.usual_agreeing) = (0, alignment.agreeing);
        (self.keyframe, self.last) = (Some(keyframe), Some(view));
        let confidence = alignment.agreeing * alignment.visible;
        Tracked { world_from_camera, confidence, depth: Some(depth), reliability: None, warning: None }
    }

    /// While the first keyframe is young: all its frames again and again, depths and motions in turn.
    fn work_over(&mut self, keyframe: &mut Keyframe, pyramid: Arc<Pyramid>, alignment: Alignment) -> View {
        let newest = keyframe.view.aligned(&alignment, pyramid);
        self.start.push((newest.clone(), alignment));
        if self.start.len() > START_FRAMES {
            self.start.remove(0);
        }
        for _ in 0..START_ROUNDS {
            forget_depths(&mut keyframe.reference);
            for (view, _) in &self.start {
                keyframe.observe(view, &self.lenses, BRIGHTNESS_NOISE);
            }
            for (view, alignment) in &mut self.start {
                let again = keyframe.reference.align(&view.pyramid, &self.lenses, alignment, BRIGHTNESS_NOISE);
                let Some(again) = again.filter(believed) else { continue };
                *alignment = again;
                *view = keyframe.view.aligned(&again, Arc::clone(&view.pyramid));
            }
        }
        self.start.last().map_or(newest, |(view, _)| view.clone())
    }

    /// Makes a view the keyframe and settles its place; the one before it joins the window. A view with too few points
    /// leaves everything as it is.
    fn next_keyframe(&mut self, previous: Keyframe, view: View) -> (Keyframe, View) {
        let mut next = Keyframe::after(&previous, view.clone(), &self.lenses, self.config.points, BRIGHTNESS_NOISE);
        if next.reference.points.len() < FEWEST_POINTS {
            return (previous, view);
        }
        self.window.push_back(previous.view);
        // The frames the start was worked over with; the last of them is the keyframe itself.
        let worked_over = self.start.len().saturating_sub(1);
        self.window.extend(self.start.drain(..).take(worked_over).map(|(view, _)| view));
        while self.window.len() > self.config.window {
            self.window.pop_front();
        }
        for _ in 1..SETTLE_ROUNDS {
            next.view.world_from_camera = self.settled_pose(&self.observed(next.clone()));
        }
        self.starting = false;
        let next = self.observed(next);
        let view = next.view.clone();
        (next, view)
    }

    /// A new keyframe with its depths searched in the window's views.
    fn observed(&self, mut keyframe: Keyframe) -> Keyframe {
        for earlier in self.window.iter().rev() {
            keyframe.observe(earlier, &self.lenses, BRIGHTNESS_NOISE);
        }
        keyframe.trust_found(FEWEST_TRUSTED);
        keyframe
    }

    /// The place of a keyframe on which the views of the window agree: the mean of where each of them, aligned to the
    /// keyframe's points, puts it.
    fn settled_pose(&self, keyframe: &Keyframe) -> Pose {
        let here = keyframe.view.world_from_camera;
        let place = |view: &View| {
            let (motion, brightness) = keyframe.view.to(view);
            let guess = Alignment::guess(motion, brightness);
            let aligned =
                keyframe.reference.align(&view.pyramid, &self.lenses, &guess, BRIGHTNESS_NOISE).filter(believed)?;
            Some(se3::log(&(here.inverse() * view.world_from_camera * aligned.current_from_reference)))
        };
        let places: Vec<Vector6<f64>> = self.window.iter().filter_map(place).collect();
        // The keyframe's own place, from the tracking that led here, has its vote.
        let mean = places.iter().sum::<Vector6<f64>>() / (places.len() + 1) as f64;
        here * se3::exp(&mean)
    }

    /// A frame that could not be aligned.
    fn miss(&mut self, keyframe: Keyframe, pyramid: Arc<Pyramid>) -> Tracked {
        self.lost += 1;
        let inverse_depth = keyframe.middle_inverse_depth();
        self.keyframe = Some(keyframe);
        if self.lost >= PATIENCE {
            return self.begin(pyramid, Some(inverse_depth));
        }
        held(self.last.as_ref(), "the picture does not agree with the ones before it")
    }
}

impl Odometry for Direct {
    fn name(&self) -> &'static str {
        NAME
    }

    fn track(&mut self, observation: &Observation) -> Result<Tracked, TrackError> {
        let size = self.lenses.level(0).camera().size();
        let frame = picture::of(observation, NAME, size)?;
        // Seen again, a picture would be taken for new evidence of depths it has already given.
        if let Some((_, tracked)) = self.before.as_ref().filter(|(image, _)| *image == frame.image) {
            return Ok(tracked.clone());
        }
        let tracked = self.track_frame(frame);
        self.before = Some((frame.image.clone(), tracked.clone()));
        Ok(tracked)
    }
}

fn believed(alignment: &Alignment) -> bool {
    alignment.agreeing >= FEWEST_AGREEING && alignment.correlation >= LEAST_CORRELATION
}

/// The last pose, without trust in it.
fn held(last: Option<&View>, reason: &str) -> Tracked {
    let world_from_camera = last.map(|last| last.world_from_camera);
    Tracked { world_from_camera, confidence: 0.0, depth: None, reliability: None, warning: Some(reason.into()) }
}

/// Depths stay where they are but lose their certainty, so that a new round may move them.
fn forget_depths(reference: &mut Reference) {
    for point in &mut reference.points {
        let InverseDepth { mean, .. } = point.inverse_depth;
        let variance = (keyframe::UNKNOWN_SHARE * mean).powi(2);
        point.inverse_depth.variance = variance;
        (point.found, point.missed) = (0, 0);
    }
}

#[cfg(test)]
mod tests;
