//! Supervised training of the recurrent rival: video with true poses to a network that regresses motion.
//!
//! ```text
//! Sequence -> PosedClip -> draw (symmetry, direction, gap, colour) -> Passage -> RecurrentVo -> loss -> Adam
//!            (resized, in memory)                                    (truncated back-propagation through time)
//! ```
//!
//! | module | what |
//! |---|---|
//! | [`config`] | [`SupervisedConfig`]: defaults, then file, then flags |
//! | [`clip`] | [`PosedClip`]: stretches of neighbouring frames with their poses |
//! | [`draw`] | subsequences, drawn by seed and step, as they could also have been |
//! | [`loss`] | squared translation and weighted squared rotation |
//! | [`validation`] | the network streamed over whole stretches |
//! | [`trainer`] | [`train`], [`resume`]: the recipe |
//!
//! Formulae: docs/math.md, "Recurrent odometry". Run folders are those of the joint training.

pub mod clip;
pub mod config;
pub mod draw;
pub mod loss;
pub mod trainer;
pub mod validation;

pub use clip::{PosedClip, load_posed};
pub use config::SupervisedConfig;
pub use trainer::{SupervisedJob, SupervisedSummary, config_of, is_supervised, resume, train};
