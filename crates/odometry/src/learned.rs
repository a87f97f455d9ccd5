//! [`LearnedOdometry`]: the networks as an [`Odometry`], [`LearnedDepth`]: the depth network as a [`DepthEstimator`].
//!
//! A frame's way through [`LearnedOdometry::track`]: resized as in training; looked at for flaws; its depth predicted;
//! its motion against the anchor measured in a window ([`crate::history`]), corrected ([`crate::align`]) and sharpened
//! ([`crate::refine`]); its depth
//! corrected by what the motion has measured ([`crate::correct`]); compared with the anchor for the unit of length ([`crate::scale`]) and for trust ([`crate::confidence`]); chained. Invariants:
//! the state has a bounded size, every frame gets a finite pose, and the same frames give the same poses.

use crate::OdometryError;
use crate::align::Aligner;
use crate::chain::{self, Motion};
use crate::confidence::likeness;
use crate::config::OdometryConfig;
use crate::correct::Corrector;
use crate::health::{Flaw, flaw_of};
use crate::history::{Distance, History, Keyframe, Spacing, View, Window};
use crate::networks::{DepthModel, DepthNetwork, MotionModel, MotionNetwork, Motions};
use crate::refine::{Contrast, Refiner};
use crate::reproject::{LATTICE, Moved, Reprojector, bilinear, stretched};
use crate::scale::{Scale, ratio};
use burn::tensor::Device;
use endoscape_core::{
    Camera, DepthEstimator, DepthMap, Frame, Grid, Image, Mask, Observation, Odometry, Pose, Size, TrackError, Tracked,
};
use endoscape_frames::parallax::Thumbnail;
use endoscape_frames::preprocess::resize;
use endoscape_nets::Checkpoint;
use endoscape_synthesis::{CameraBatch, SynthesisError};
use std::sync::Arc;
use std::time::{Duration, Instant};

const NAME: &str = "learned";

/// Brightness of pixels that carry texture: above the black border of endoscopes, below highlights.
const TEXTURED: std::ops::RangeInclusive<f32> = 12.0..=250.0;

/// Pictures whose aspect ratios differ by less have one shape: what rounding to whole pixels makes of small ones.
const SAME_SHAPE: f64 = 0.01;

/// What a frame of low confidence is told with.
const DOUBTFUL: &str = "the picture hardly fits the motion that was found, so the pose is doubtful";

/// A picture that has moved by less than this share of the trained displacement has not moved as far as anybody can
/// tell: half a pixel of the thumbnail for the usual 0.02.
const STILL: f64 = 0.25;

/// Depth of single frames.
pub struct LearnedDepth {
    network: Box<dyn DepthModel>,
    size: Size,
}

impl LearnedDepth {
    /// Takes the depth network of a checkpoint on `device`; pictures are brought to `size` for it.
    ///
    /// # Errors
    /// [`OdometryError::Incomplete`] without a depth network.
    pub fn new(checkpoint: &Checkpoint, size: Size, device: &Device) -> Result<Self, OdometryError> {
        Ok(Self { network: Box::new(DepthNetwork::new(checkpoint.disp.clone(), device)?), size })
    }

    /// Depth of a picture in the networks' unit, at about their size but of the picture's shape.
    ///
    /// # Errors
    /// [`OdometryError::Frames`] for a picture without pixels.
    pub fn depth(&self, image: &Image) -> Result<DepthMap, OdometryError> {
        let depth = self.network.depth(&resize::image(image, self.size)?);
        Ok(DepthMap::new(stretched(depth.grid(), map_size(image.size(), self.size))))
    }
}

/// Size of maps of pictures of `frame`: that of the networks, or as wide as theirs where they squeeze the picture.
///
/// A map of another shape than the picture would be of no use to a program that knows the picture alone.
fn map_size(frame: Size, networks: Size) -> Size {
    let height = (networks.width * frame.height) as f64 / frame.width.max(1) as f64;
    let squeezed = (height / networks.height as f64 - 1.0).abs() > SAME_SHAPE;
    if squeezed { Size::new(networks.width, (height.round() as usize).max(1)) } else { networks }
}

impl DepthEstimator for LearnedDepth {
    fn estimate_depth(&mut self, frame: &Frame) -> Result<DepthMap, TrackError> {
        let unsuitable = |reason| TrackError::Unsuitable { method: NAME, index: frame.index, reason };
        let depth = self.depth(&frame.image).map_err(|error| unsuitable(error.to_string()))?;
        Ok(DepthMap::new(stretched(depth.grid(), frame.image.size())))
    }
}

/// Poses and depth of the frames of one stream, in time order.
pub struct LearnedOdometry {
    depth: LearnedDepth,
    motion: Box<dyn MotionModel>,
    aligner: Option<Aligner>,
    config: OdometryConfig,
    lens: Option<Lens>,
    history: Option<History>,
    path: Motion,
    /// Frames seen, usable or not.
    position: usize,
    /// Agreement of the forward and backward estimate of the anchor's pose.
    agreement: f64,
    corrector: Corrector,
    /// Brightness of the frame before, and what was said about it, for pictures that repeat.
    before: Option<(Grid<f32>, Tracked)>,
    clock: StageClock,
}

/// The camera at the networks' size.
#[derive(Debug)]
struct Lens {
    /// As the frames have it.
    camera: Arc<Camera>,
    /// For comparing.
    lattice: Reprojector,
    /// For maps.
    dense: Reprojector,
    /// For the alignment network, if there is one.
    aligned: Option<CameraBatch>,
    /// For sharpening motions, where that is wanted.
    refiner: Option<Refiner>,
}

/// The frame under work.
struct Present {
    position: usize,
    image: Arc<Image>,
    contrast: Option<Arc<Contrast>>,
    luma: Arc<Grid<f32>>,
    thumbnail: Thumbnail,
    depth: Arc<Grid<f32>>,
}

/// A frame to be aligned with an anchor.
#[derive(Clone, Copy)]
struct Picture<'a> {
    image: &'a Image,
    contrast: Option<&'a Contrast>,
}

impl<'a> Picture<'a> {
    fn of(present: &'a Present) -> Self {
        Self { image: &present.image, contrast: present.contrast.as_deref() }
    }
}

/// What comparing the frame with its anchor says.
struct Comparison {
    scale: Scale,
    likeness: f64,
    reliability: Option<Grid<f32>>,
}

impl LearnedOdometry {
    /// Takes the networks of a checkpoint on `device`.
    ///
    /// # Errors
    /// [`OdometryError`] for an impossible configuration or a missing network.
    pub fn new(checkpoint: Checkpoint, config: OdometryConfig, device: &Device) -> Result<Self, OdometryError> {
        let depth = DepthNetwork::new(checkpoint.disp, device)?;
        let motion = MotionNetwork::new(checkpoint.pose, device)?;
        let aligner = checkpoint.align.map(|net| Aligner::new(net, device.clone()));
        Ok(Self { aligner, ..Self::from_models(Box::new(depth), Box::new(motion), config)? })
    }

    /// Takes any two models.
    ///
    /// # Errors
    /// [`OdometryError::Setting`] for an impossible configuration.
    pub fn from_models(
        depth: Box<dyn DepthModel>,
        motion: Box<dyn MotionModel>,
        config: OdometryConfig,
    ) -> Result<Self, OdometryError> {
        config.validate()?;
        Ok(Self {
            depth: LearnedDepth { network: depth, size: config.size },
            motion,
            aligner: None,
            config,
            lens: None,
            history: None,
            path: Motion::default(),
            position: 0,
            agreement: 1.0,
            corrector: Corrector::default(),
            before: None,
            clock: StageClock::default(),
        })
    }

    fn frame(&mut self, frame: &Frame) -> Result<Tracked, OdometryError> {
        let image = Arc::new(resize::image(&frame.image, self.config.size)?);
        self.see_through(frame.camera.as_ref())?;
        let luma = image.luma();
        let flaw = flaw_of(&luma, self.before.as_ref().map(|(luma, _)| luma));
        self.clock.lap("preprocess");
        let mut tracked = match flaw {
            Some(flaw) => self.without_sight(flaw),
            None => {
                let contrast = self.refiner().map(|refiner| refiner.contrast(&frame.image)).transpose()?;
                self.with_sight(image, contrast.map(Arc::new), luma.clone())
            }
        };
        let size = map_size(frame.image.size(), self.config.size);
        tracked.depth = tracked.depth.map(|depth| DepthMap::new(stretched(depth.grid(), size)));
        tracked.reliability = tracked.reliability.map(|reliability| stretched(&reliability, size));
        self.position += 1;
        self.before = Some((luma, tracked.clone()));
        Ok(tracked)
    }

    /// Prepares for a camera, unless it is the one of the frame before.
    fn see_through(&mut self, camera: Option<&Arc<Camera>>) -> Result<(), OdometryError> {
        let known = self.lens.as_ref().map(|lens| &lens.camera);
        if known == camera {
            return Ok(());
        }
        let lens = |camera: &Arc<Camera>| {
            let reprojector = |count| Reprojector::new(camera, self.config.size, count);
            let refiner = self.config.refine.then(|| Refiner::new(camera)).transpose()?;
            let aligned = self.aligner.as_ref().map(|aligner| aligner.camera(camera, self.config.size)).transpose()?;
            Ok(Lens {
                camera: camera.clone(),
                lattice: reprojector(LATTICE)?,
                dense: reprojector(usize::MAX)?,
                aligned,
                refiner,
            })
        };
        let impossible = |error: SynthesisError| TrackError::Unsuitable {
            method: NAME,
            index: self.position,
            reason: error.to_string(),
        };
        self.lens = camera.map(lens).transpose().map_err(impossible)?;
        Ok(())
    }

    fn refiner(&self) -> Option<&Refiner> {
        self.lens.as_ref()?.refiner.as_ref()
    }

    /// A repeated picture repeats the answer, any other flawed one leaves only a guess.
    fn without_sight(&mut self, flaw: Flaw) -> Tracked {
        let repeated = self.before.as_ref().filter(|_| flaw == Flaw::Frozen).map(|(_, tracked)| tracked.clone());
        let (depth, reliability) = repeated.map_or((None, None), |tracked| (tracked.depth, tracked.reliability));
        let pose = if flaw == Flaw::Frozen { self.path.pose() } else { self.path.coast() };
        Tracked { world_from_camera: Some(pose), confidence: 0.0, depth, reliability, warning: Some(flaw.to_string()) }
    }

    fn with_sight(&mut self, image: Arc<Image>, contrast: Option<Arc<Contrast>>, luma: Grid<f32>) -> Tracked {
        let thumbnail = Thumbnail::new(&image, &Mask::filled(image.size(), true));
        let depth = self.depth.network.depth(&image);
        self.clock.lap("depth");
        let depth = Arc::new(depth.into_grid());
        let present = Present { position: self.position, image, contrast, luma: Arc::new(luma), thumbnail, depth };
        match self.history.take() {
            None => self.begin(&present),
            Some(history) => self.follow(history, &present),
        }
    }

    /// The first usable frame has the latest known pose; usually it is the first of all and makes the world.
    fn begin(&mut self, present: &Present) -> Tracked {
        let view = present.view(self.path.pose());
        let keyframe = self.keyframe(present, view, present.depth.clone(), Scale::default());
        let OdometryConfig { fixed_gap, least_displacement, .. } = self.config;
        let side = self.motion.side();
        self.history = Some(History::new(keyframe, Spacing { side, fixed_gap, least_displacement }));
        // Nothing but the frame itself is there to fill a window with; only the reliability of its pixels is used.
        let motions = self.motion.motions(&present.image, &vec![present.image.as_ref(); 2 * side]);
        self.clock.lap("motion");
        Tracked {
            world_from_camera: Some(self.path.pose()),
            confidence: 1.0,
            depth: Some(DepthMap::new(present.depth.as_ref().clone())),
            reliability: motions.reliability,
            warning: None,
        }
    }

    fn follow(&mut self, mut history: History, present: &Present) -> Tracked {
        let distance = history.distance(&present.thumbnail, present.position);
        if distance == Distance::Far {
            history.advance();
        }
        let window = history.window(present.position, &present.image, distance == Distance::Far);
        let sources: Vec<&Image> = window.sources.iter().map(Arc::as_ref).collect();
        let motions = self.motion.motions(&window.target, &sources);
        self.clock.lap("motion");
        if !motions.source_from_target.iter().all(chain::is_finite) {
            self.history = Some(history);
            return self.without_answer();
        }
        self.look_back(&mut history, &window, &motions);
        let guess = self.frame_from_anchor(&history, distance, &motions);
        let expected = self.path.expected();
        let frame_from_anchor = self.measured_motion(history.anchor_mut(), Picture::of(present), [guess, expected]);
        self.clock.lap("refine");
        let tracked = self.place(&mut history, present, distance, (frame_from_anchor, motions.reliability.as_ref()));
        self.clock.lap("scale");
        self.history = Some(history);
        tracked
    }

    /// The networks gave numbers that are none.
    fn without_answer(&mut self) -> Tracked {
        Tracked {
            world_from_camera: Some(self.path.coast()),
            confidence: 0.0,
            depth: None,
            reliability: None,
            warning: Some("the motion network gave no finite motion, so the pose is a prediction".into()),
        }
    }

    /// Combines the forward estimate that placed a new anchor with the backward one of its first window.
    fn look_back(&mut self, history: &mut History, window: &Window, motions: &Motions) {
        let Some((previous, previous_from_anchor)) = window.previous.as_ref().zip(motions.source_from_target.first())
        else {
            return;
        };
        let (anchor, world_from_previous) = (history.anchor_mut(), previous.world_from_camera);
        let forward = world_from_previous.inverse() * anchor.view.world_from_camera;
        let guesses = [*previous_from_anchor, world_from_previous];
        let picture = Picture { image: &previous.image, contrast: previous.contrast.as_deref() };
        let backward = self.measured_motion(anchor, picture, guesses);
        let backward = chain::scaled(&backward, anchor.scale.factor());
        self.agreement = chain::agreement(&forward, &backward);
        anchor.view.world_from_camera = chain::renormalised(world_from_previous * chain::midway(&forward, &backward));
    }

    /// The motion from the anchor, in the unit of the anchor's depth.
    fn frame_from_anchor(&self, history: &History, distance: Distance, motions: &Motions) -> Pose {
        let still = STILL * self.config.least_displacement;
        match distance {
            // Training has shown the network no still pictures, so that it would see a motion in them.
            Distance::Near(Some(moved)) if history.is_beginning() && moved < still => Pose::identity(),
            _ => motions.source_from_target.last().copied().unwrap_or_else(Pose::identity),
        }
    }

    /// The motion from the anchor, in the unit of its depth, as the pictures have it; `guess`, the network's, where they
    /// do not say. `expected` is the pose the camera has if it goes on as before.
    fn measured_motion(&self, anchor: &mut Keyframe, picture: Picture<'_>, [guess, expected]: [Pose; 2]) -> Pose {
        let expected_from_anchor = expected.inverse() * anchor.view.world_from_camera;
        let expected = chain::scaled(&expected_from_anchor, 1.0 / anchor.scale.factor());
        let aligner = self.aligner.as_ref().zip(anchor.alignment.as_ref());
        // Not the expected motion: what is left of its errors would grow from frame to frame.
        let guesses = [guess, Pose::identity()];
        let aligned = aligner.and_then(|(aligner, target)| aligner.aligned(target, picture.image, &guesses));
        let guess = aligned.unwrap_or(guess);
        let compared = anchor.reference.as_mut().zip(picture.contrast);
        let Some(((reference, current), refiner)) = compared.zip(self.refiner()) else { return guess };
        refiner.refined(reference, current, &[guess, expected]).unwrap_or(guess)
    }

    /// Chains the motion and remembers the frame.
    fn place(
        &mut self,
        history: &mut History,
        present: &Present,
        distance: Distance,
        (frame_from_anchor, mask): (Pose, Option<&Grid<f32>>),
    ) -> Tracked {
        let anchor = history.anchor();
        let Comparison { scale, likeness, reliability } = self.compare(anchor, present, &frame_from_anchor, mask);
        let anchor_from_frame = chain::scaled(&frame_from_anchor, anchor.scale.factor()).inverse();
        let world_from_camera = chain::renormalised(anchor.view.world_from_camera * anchor_from_frame);
        self.path.arrive(world_from_camera);
        let measured = self.measured(anchor, present, &frame_from_anchor, scale);
        let depth = measured.map_or_else(|| present.depth.clone(), Arc::new);
        let view = present.view(world_from_camera);
        let keyframe = (distance == Distance::Far).then(|| self.keyframe(present, view.clone(), depth.clone(), scale));
        history.remember(view, keyframe);
        let confidence = likeness * self.agreement;
        Tracked {
            world_from_camera: Some(world_from_camera),
            confidence,
            depth: Some(DepthMap::new(depth.map(|depth| depth * scale.factor() as f32))),
            reliability,
            warning: (confidence < self.config.lost_below).then(|| DOUBTFUL.to_owned()),
        }
    }

    /// A keyframe of a frame with `depth` in its own unit.
    fn keyframe(&self, present: &Present, view: View, depth: Arc<Grid<f32>>, scale: Scale) -> Keyframe {
        let sharp = self.refiner().zip(present.contrast.as_deref());
        let reference = sharp.map(|(refiner, contrast)| refiner.reference(contrast, &depth));
        let camera = self.lens.as_ref().and_then(|lens| lens.aligned.as_ref());
        let aligner = self.aligner.as_ref().zip(camera);
        let alignment = aligner.map(|(aligner, camera)| aligner.target(&present.image, &depth, camera));
        let mut keyframe = Keyframe::new(view, present.luma.clone(), present.thumbnail.clone(), depth, scale);
        (keyframe.reference, keyframe.alignment) = (reference, alignment);
        keyframe
    }

    /// The frame's depth in its own unit, `scale`, as pictures have measured it at the anchor's points.
    fn measured(
        &mut self,
        anchor: &Keyframe,
        present: &Present,
        frame_from_anchor: &Pose,
        scale: Scale,
    ) -> Option<Grid<f32>> {
        let (reference, refiner) = anchor.reference.as_ref().zip(self.refiner())?;
        let unit = scale.factor() / anchor.scale.factor();
        let predicted = present.depth.map(|depth| depth * unit as f32);
        let sightings = refiner.sightings(reference, frame_from_anchor, &predicted);
        self.corrector.corrected(&present.depth, &sightings)
    }

    /// Compares the frame with its anchor. Without a camera nothing can be compared, and reliability stays where the
    /// anchor sees it.
    fn compare(
        &self,
        anchor: &Keyframe,
        present: &Present,
        frame_from_anchor: &Pose,
        mask: Option<&Grid<f32>>,
    ) -> Comparison {
        let memory = self.config.scale_memory;
        let Some(lens) = &self.lens else {
            return Comparison { scale: anchor.scale.next(None, memory), likeness: 1.0, reliability: mask.cloned() };
        };
        let moved = lens.lattice.reproject(&anchor.depth, frame_from_anchor);
        let textured = |pixel: usize| anchor.luma.values().get(pixel).is_some_and(|luma| TEXTURED.contains(luma));
        let least = mask.map_or(0.0, mean);
        let reliable = |pixel: usize| mask.is_none_or(|mask| mask.values().get(pixel).is_some_and(|m| *m >= least));
        let compared = lens.lattice.pixels().filter(|pixel| textured(*pixel)).count();
        let ratio = ratio(&moved, &present.depth, |pixel| textured(pixel) && reliable(pixel), compared);
        Comparison {
            scale: anchor.scale.next(ratio, memory),
            likeness: likeness(&moved, &anchor.luma, &present.luma, textured, compared),
            reliability: mask.map(|mask| carried_over(mask, lens, &present.depth, frame_from_anchor, ratio)),
        }
    }
}

/// The anchor's reliability as the frame sees it: each pixel of the frame takes the value of the place it shows; 0 where
/// the anchor does not show it.
fn carried_over(
    mask: &Grid<f32>,
    lens: &Lens,
    depth: &Grid<f32>,
    frame_from_anchor: &Pose,
    ratio: Option<f64>,
) -> Grid<f32> {
    let ratio = ratio.unwrap_or(1.0);
    // In the unit of the frame's depth, which is `ratio` times larger than the anchor's.
    let anchor_from_frame = chain::scaled(&frame_from_anchor.inverse(), 1.0 / ratio);
    let mut reliability = Grid::filled(depth.size(), 0.0);
    for Moved { from, to, .. } in lens.dense.reproject(depth, &anchor_from_frame) {
        reliability.values_mut()[from] = bilinear(mask, &to).unwrap_or(0.0) as f32;
    }
    reliability
}

fn mean(grid: &Grid<f32>) -> f32 {
    grid.values().iter().sum::<f32>() / grid.size().area().max(1) as f32
}

impl Present {
    fn view(&self, world_from_camera: Pose) -> View {
        View { position: self.position, image: self.image.clone(), contrast: self.contrast.clone(), world_from_camera }
    }
}

impl Odometry for LearnedOdometry {
    fn name(&self) -> &'static str {
        NAME
    }

    fn track(&mut self, observation: &Observation) -> Result<Tracked, TrackError> {
        self.clock.restart();
        let index = self.position;
        let unsuitable = |reason: String| TrackError::Unsuitable { method: NAME, index, reason };
        let Observation::Frame(frame) = observation else {
            return Err(unsuitable("it is no picture; give a video".into()));
        };
        self.frame(frame).map_err(|error| match error {
            OdometryError::Track(error) => error,
            other => unsuitable(other.to_string()),
        })
    }

    fn stage_times(&self) -> &[(&'static str, Duration)] {
        self.clock.laps()
    }
}

/// Time of each stage of one frame.
#[derive(Debug, Default)]
pub(crate) struct StageClock {
    laps: Vec<(&'static str, Duration)>,
    last: Option<Instant>,
}

impl StageClock {
    /// Begins a frame.
    pub(crate) fn restart(&mut self) {
        self.laps.clear();
        self.last = Some(Instant::now());
    }

    /// Ends the stage `name`.
    pub(crate) fn lap(&mut self, name: &'static str) {
        let now = Instant::now();
        self.laps.push((name, self.last.map_or(Duration::ZERO, |last| now - last)));
        self.last = Some(now);
    }

    /// The stages of the frame so far, in order.
    pub(crate) fn laps(&self) -> &[(&'static str, Duration)] {
        &self.laps
    }
}
