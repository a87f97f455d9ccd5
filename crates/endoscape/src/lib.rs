#![doc = include_str!("../README.md")]
//!
//! # Rooms
//!
//! | module | what |
//! |---|---|
//! | [`core`] | nouns and the two traits every method plugs into |
//! | [`frames`] | where frames come from |
//! | [`nets`] | the networks and their checkpoints |
//! | [`odometry`] | learned methods at work |
//! | [`baselines`] | direct and magnetic odometry, their fusion, ORB SLAM |
//! | [`train`], [`synthesis`] | learning from unlabelled video, and what it minimises |
//! | [`eval`], [`report`] | errors with their baselines, and pages of them |
//! | [`sim`] | patients from a seed, with exact truth |

pub use endoscape_baselines as baselines;
pub use endoscape_core as core;
pub use endoscape_eval as eval;
pub use endoscape_frames as frames;
pub use endoscape_nets as nets;
pub use endoscape_odometry as odometry;
pub use endoscape_report as report;
pub use endoscape_sim as sim;
pub use endoscape_synthesis as synthesis;
pub use endoscape_train as train;

/// What most programs need.
pub mod prelude {
    pub use burn::tensor::Device;
    pub use endoscape_core::{
        Camera, DepthEstimator, DepthMap, Frame, Image, Observation, Odometry, Pose, Size, TimedPose, Tracked,
        Trajectory,
    };
    pub use endoscape_eval::Poses;
    pub use endoscape_eval::trajectory::{Settings, evaluate};
    pub use endoscape_frames::{FrameSource, Sequence, formats, picture};
    pub use endoscape_nets::Checkpoint;
    pub use endoscape_odometry::{LearnedDepth, LearnedOdometry, OdometryConfig};
}
