//! Trajectory and depth metrics. Pure functions: no files, no plots, no printing.
//!
//! ```text
//! bytes -> read::poses -> Poses -> associate -> Pairs -> align -> ape, rpe, segments, drift -> trajectory::evaluate
//!                                         \-> snippets::evaluate          baselines beside each
//! DepthMap -> depth::Samples -> DepthErrors        masks -> roc        confidences -> calibration
//! ```
//!
//! | module | what |
//! |---|---|
//! | [`read`] | trajectories from the contents of files |
//! | [`poses`] | poses as the numbers that were written |
//! | [`mod@associate`] | which poses belong together; completeness |
//! | [`mod@align`] | Umeyama's alignment in its variants |
//! | [`ape`], [`rpe`], [`segments`], [`drift`] | the errors |
//! | [`snippets`] | errors of short windows, in both definitions |
//! | [`baselines`] | what looking at nothing would get |
//! | [`inverted`] | estimates written the wrong way round |
//! | [`mod@trace`] | errors pose by pose, for figures |
//! | [`paired`] | whether one method is better than another, or only luckier |
//! | [`bootstrap`], [`stats`] | intervals and summaries |
//! | [`trajectory`] | the recipe |
//! | [`depth`] | errors of depth maps |
//! | [`mod@roc`], [`mod@calibration`] | quality of masks and of confidences |
//!
//! Units are metres, seconds and radians; names of fields say where reports use degrees or percent.

pub mod align;
pub mod ape;
pub mod associate;
pub mod baselines;
pub mod bootstrap;
pub mod calibration;
pub mod depth;
pub mod drift;
pub mod error;
pub mod inverted;
pub mod paired;
pub mod poses;
pub mod read;
pub mod roc;
pub mod rpe;
pub mod segments;
pub mod snippets;
pub mod stats;
pub mod trace;
pub mod trajectory;

pub use align::Alignment;
pub use associate::Association;
pub use error::EvalError;
pub use poses::{Duplicates, MatrixPose, Poses, Stamps};
pub use read::TrajectoryFormat;
