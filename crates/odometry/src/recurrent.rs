//! [`RecurrentOdometry`]: the recurrent network as an [`Odometry`], frame by frame with its memory carried along.
//!
//! Every usable frame is paired with the usable one before it; the network's motion, in metres, moves the pose on. A
//! black, over-exposed, featureless or frozen frame is never shown to the network, so that its memory stays that of what
//! was seen; the frame after it is paired with the last one seen, as far apart as training has known pairs to be, and
//! after a longer gap a new pair begins with an empty memory. Invariants: bounded memory, a finite pose for every frame.

use crate::OdometryError;
use crate::chain::{self, Motion};
use crate::config::OdometryConfig;
use crate::health::{Flaw, flaw_of};
use crate::learned::StageClock;
use burn::tensor::{Device, Tensor, TensorData};
use endoscape_core::{Frame, Grid, Image, Observation, Odometry, Pose, Rotation, Size, TrackError, Tracked};
use endoscape_frames::preprocess::resize;
use endoscape_nets::{Memory, RecurrentCheckpoint, RecurrentVo, network_values};
use std::time::Duration;

const NAME: &str = "recurrent";
/// Frames from one frame of a pair to the next at most, as in training by default.
const LONGEST_GAP: usize = 2;
/// Steps of the training's mean length, and radians, up to which the motion of a pair is like those of the training.
const USUAL_STEPS: f64 = 10.0;
const USUAL_TURN_RAD: f64 = 1.0;

/// Poses of the frames of one stream, in time order, in metres.
pub struct RecurrentOdometry {
    net: RecurrentVo,
    unit_m: f64,
    size: Size,
    device: Device,
    memory: Option<Memory>,
    /// The latest usable frame.
    last: Option<Seen>,
    /// Brightness of the frame before, usable or not, for pictures that repeat.
    before: Option<Grid<f32>>,
    path: Motion,
    clock: StageClock,
}

/// A frame that the network can be shown.
struct Seen {
    index: usize,
    /// `[3, height, width]`.
    values: Vec<f32>,
    world_from_camera: Pose,
}

impl RecurrentOdometry {
    /// Takes the network of a checkpoint that lives on `device`; `size` overrides the size of its pictures.
    ///
    /// # Errors
    /// [`OdometryError::Setting`] for a size the network cannot see.
    pub fn new(checkpoint: RecurrentCheckpoint, size: Option<Size>, device: &Device) -> Result<Self, OdometryError> {
        let config = OdometryConfig::for_model(checkpoint.manifest.input.as_ref(), size);
        config.validate()?;
        Ok(Self {
            net: checkpoint.net,
            unit_m: checkpoint.config.unit_m,
            size: config.size,
            device: device.clone(),
            memory: None,
            last: None,
            before: None,
            path: Motion::default(),
            clock: StageClock::default(),
        })
    }

    /// Size at which the network sees the pictures.
    pub const fn size(&self) -> Size {
        self.size
    }

    /// Length of the network's unit of translation, metres.
    pub const fn unit_m(&self) -> f64 {
        self.unit_m
    }

    fn frame(&mut self, frame: &Frame) -> Result<Tracked, OdometryError> {
        let image = resize::image(&frame.image, self.size)?;
        let luma = image.luma();
        let flaw = flaw_of(&luma, self.before.as_ref());
        self.before = Some(luma);
        self.clock.lap("preprocess");
        let tracked = match flaw {
            Some(Flaw::Frozen) => guess(self.path.pose(), Flaw::Frozen.to_string()),
            Some(flaw) => guess(self.path.coast(), flaw.to_string()),
            None => self.with_sight(frame.index, &image),
        };
        self.clock.lap("motion");
        Ok(tracked)
    }

    fn with_sight(&mut self, index: usize, image: &Image) -> Tracked {
        let values = network_values(image);
        let Some(last) = self.last.take() else {
            return self.begin(index, values, None);
        };
        let gap = index.saturating_sub(last.index).max(1);
        if gap > LONGEST_GAP {
            let unseen = gap - 1;
            self.memory = None;
            return self.begin(index, values, Some(format!("after {unseen} frames unseen the pose is a prediction")));
        }
        let (motion, memory) = self.motion(&last.values, &values);
        if !chain::is_finite(&motion) {
            self.last = Some(last);
            return guess(self.path.coast(), "the network gave no finite motion, so the pose is a prediction".into());
        }
        let world_from_camera = chain::renormalised(last.world_from_camera * motion);
        self.path.arrive(world_from_camera);
        self.memory = Some(memory);
        self.last = Some(Seen { index, values, world_from_camera });
        let confidence = self.plausibility(&motion) / gap as f64;
        tracked(world_from_camera, confidence, None)
    }

    /// A frame that nothing is known to have come before has the latest known pose; usually it makes the world.
    fn begin(&mut self, index: usize, values: Vec<f32>, warning: Option<String>) -> Tracked {
        let world_from_camera = self.path.pose();
        self.last = Some(Seen { index, values, world_from_camera });
        let confidence = if warning.is_none() { 1.0 } else { 0.0 };
        tracked(world_from_camera, confidence, warning)
    }

    /// `previous_from_current` of two pictures, metres, and what to remember if it is believed.
    fn motion(&self, previous: &[f32], current: &[f32]) -> (Pose, Memory) {
        let Size { width, height } = self.size;
        let pair = TensorData::new([previous, current].concat(), [1, 1, 6, height, width]);
        let (motion, memory) = self.net.forward(Tensor::from_data(pair, &self.device), self.memory.clone());
        let numbers: Vec<f64> = motion.into_data().iter::<f32>().map(f64::from).collect();
        let number = |index: usize| numbers.get(index).copied().unwrap_or(f64::NAN);
        let motion = Rotation::AxisAngle.pose(std::array::from_fn(number));
        (chain::scaled(&motion, self.unit_m), memory)
    }

    /// 1 for a motion like those of the training, falling with its excess beyond them. The network itself gives no
    /// measure of trust.
    fn plausibility(&self, motion: &Pose) -> f64 {
        let steps = motion.translation.vector.norm() / (USUAL_STEPS * self.unit_m);
        let turn = motion.rotation.angle() / USUAL_TURN_RAD;
        1.0 / steps.max(turn).max(1.0)
    }
}

const fn tracked(world_from_camera: Pose, confidence: f64, warning: Option<String>) -> Tracked {
    Tracked { world_from_camera: Some(world_from_camera), confidence, depth: None, reliability: None, warning }
}

fn guess(world_from_camera: Pose, reason: String) -> Tracked {
    tracked(world_from_camera, 0.0, Some(reason))
}

impl Odometry for RecurrentOdometry {
    fn name(&self) -> &'static str {
        NAME
    }

    fn track(&mut self, observation: &Observation) -> Result<Tracked, TrackError> {
        self.clock.restart();
        let unsuitable = |index, reason| TrackError::Unsuitable { method: NAME, index, reason };
        match observation {
            Observation::Frame(frame) => self.frame(frame).map_err(|error| unsuitable(frame.index, error.to_string())),
            Observation::Magnetic(reading) => {
                Err(unsuitable(reading.index, "it is no picture; give a video".to_owned()))
            }
        }
    }

    fn stage_times(&self) -> &[(&'static str, Duration)] {
        self.clock.laps()
    }
}
