//! The two sockets every method plugs into.

use crate::{DepthMap, Frame, Grid, Observation, Pose, TimedPose};
use std::time::Duration;
use thiserror::Error;

/// Where the camera is after one more observation.
#[derive(Clone, Debug)]
pub struct Tracked {
    /// Pose in the frame of the first observation, in the method's own length unit; a method with a reference outside
    /// the capsule gives it in that reference's world, in metres. `None` when the method has lost track or has not
    /// started yet. A frame is reported either way: nothing is dropped in silence.
    pub world_from_camera: Option<Pose>,
    /// Trust in this pose, from 0 (a guess) to 1.
    pub confidence: f64,
    /// Depth of this frame in the same length unit, where the method makes one.
    pub depth: Option<DepthMap>,
    /// Trust per pixel, 0 to 1, where the method makes one.
    pub reliability: Option<Grid<f32>>,
    /// What the user should know about this observation, one sentence.
    pub warning: Option<String>,
}

/// Why a method cannot go on. A bad frame is no reason: it yields a [`Tracked`] of low confidence.
#[derive(Debug, Error)]
pub enum TrackError {
    /// The observation is of a kind or size the method was not made for.
    #[error("{method} cannot use observation {index}: {reason}")]
    Unsuitable {
        /// Name of the method.
        method: &'static str,
        /// Position of the observation.
        index: usize,
        /// What does not fit, and what would.
        reason: String,
    },
    /// The method itself failed.
    #[error("{method} failed at observation {index}: {reason}")]
    Failed {
        /// Name of the method.
        method: &'static str,
        /// Position of the observation.
        index: usize,
        /// What happened.
        reason: String,
    },
}

/// A method that turns observations in time order into camera poses.
pub trait Odometry {
    /// Name as written in results.
    fn name(&self) -> &'static str;

    /// Takes the next observation in time order and says where the camera is.
    ///
    /// # Errors
    /// [`TrackError`] when the method cannot continue at all.
    fn track(&mut self, observation: &Observation) -> Result<Tracked, TrackError>;

    /// What the last [`Odometry::track`] says of earlier observations, by their times: poses that replace those told
    /// before. Empty where the method never looks back.
    fn revisions(&self) -> &[TimedPose] {
        &[]
    }

    /// How long each stage of the last [`Odometry::track`] took, in order; empty where the method does not measure.
    fn stage_times(&self) -> &[(&'static str, Duration)] {
        &[]
    }
}

/// A method that sees depth in a single frame.
pub trait DepthEstimator {
    /// Depth of one frame, of the frame's size, in the method's own length unit.
    ///
    /// # Errors
    /// [`TrackError`] when the frame cannot be used.
    fn estimate_depth(&mut self, frame: &Frame) -> Result<DepthMap, TrackError>;
}
