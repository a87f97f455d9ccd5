//! The learned networks at work: a pose and a depth map for every frame of a stream, in bounded memory.
//!
//! ```text
//! FrameSource -> pipeline::run -> LearnedOdometry::track -> Tracked -> RunWriter
//!                                   | health     can anything be seen in this frame?
//!                                   | networks   depth of the frame, motions of a window
//!                                   | history    which frames make the window
//!                                   | align      the motion once more, by a network that sees what is wrong with it
//!                                   | refine     the motion to a fraction of a pixel
//!                                   | correct    depth as the motion has measured it
//!                                   | scale      one unit of length over the sequence
//!                                   | chain      motions to poses
//!                                   | confidence how far to trust the pose
//! ```
//!
//! | module | what |
//! |---|---|
//! | [`learned`] | [`LearnedOdometry`], [`LearnedDepth`]: the two traits of `core` on a checkpoint |
//! | [`recurrent`] | [`RecurrentOdometry`]: the recurrent rival, in metres |
//! | [`config`] | [`OdometryConfig`]: every limit with its origin |
//! | [`networks`] | the networks behind plain pictures and poses |
//! | [`history`] | keyframes, recent frames, and the window a motion is measured in |
//! | [`align`] | the motion corrected by the alignment network |
//! | [`refine`] | the motion sharpened by aligning brightness |
//! | [`correct`] | depth maps corrected by points whose depth the motion has measured |
//! | [`chain`] | means, predictions and scaled motions on SE(3) |
//! | [`reproject`] | where the pixels of one frame lie in another |
//! | [`scale`], [`confidence`] | what comparing two frames says about unit and trust |
//! | [`health`] | black, over-exposed, featureless and frozen frames |
//! | [`pipeline`] | any [`Odometry`](endoscape_core::Odometry) over any stream, no frame lost |
//! | [`latency`] | percentiles in constant memory |
//! | [`run_folder`] | [`RunWriter`]: the results on disk, whole or not at all |
//!
//! Poses are `world_from_camera`, the world being the first frame. Lengths are in the unit the training gave the
//! networks, which a single camera cannot tie to metres. Formulae: docs/math.md, "From motions to a trajectory".

pub mod align;
pub mod chain;
pub mod confidence;
pub mod config;
pub mod correct;
mod error;
pub mod health;
pub mod history;
pub mod latency;
pub mod learned;
pub mod networks;
pub mod pipeline;
pub mod recurrent;
pub mod refine;
pub mod reproject;
pub mod run_folder;
pub mod scale;

pub use config::OdometryConfig;
pub use error::OdometryError;
pub use latency::{LatencyAccount, Percentiles};
pub use learned::{LearnedDepth, LearnedOdometry};
pub use pipeline::{Account, Step, StepSink};
pub use recurrent::RecurrentOdometry;
pub use run_folder::{DepthFormat, RunWriter};
