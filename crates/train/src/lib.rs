//! Training: unlabelled video to networks that see depth and motion.
//!
//! ```text
//! Sequence -> Clip -> SnippetDataset -> augment -> SnippetBatch -> DepthMotionModel -> objective -> Adam
//!            (resized, in memory)       \______ loader threads ______/                 \-> Validator -> best, latest
//! ```
//!
//! | module | what |
//! |---|---|
//! | [`config`] | [`TrainConfig`]: preset, then file, then flags |
//! | [`clip`] | [`Clip`]: one video at the training size |
//! | [`gap`] | how far apart the frames of a snippet are |
//! | [`dataset`] | [`SnippetDataset`]: all snippets, drawn by seed and step |
//! | [`augment`](mod@augment) | the same snippet as it could also have been |
//! | [`alignment`] | what the alignment network learns from labels |
//! | [`lesson`] | what labels from a run teach beside the pictures |
//! | [`batch`], [`loader`] | snippets to tensors, made ahead by threads |
//! | [`model`], [`optimizer`], [`schedule`] | both networks, Adam, the learning rate |
//! | [`trainer`] | [`train`], [`resume`]: the recipe |
//! | [`validation`] | photometric, depth and trajectory figures |
//! | [`collapse`] | notices trainings that learn nothing |
//! | [`state`], [`run_folder`], [`transfer`] | what is on disk: going on, looking back, starting from |
//! | [`adapt`](mod@adapt) | going on learning from new videos, never to a worse model |
//! | [`supervised`] | the recurrent rival, trained with true poses |
//! | `tensorboard` | curves as TensorBoard reads them |
//!
//! Images and formulae follow `endoscape-nets` and `endoscape-synthesis`; libraries never print, they tell
//! [`Event`](endoscape_core::Event)s.

pub mod adapt;
pub mod alignment;
pub mod augment;
pub mod batch;
pub mod clip;
pub mod collapse;
pub mod config;
pub mod dataset;
mod error;
pub mod gap;
pub mod lesson;
pub mod loader;
pub mod model;
pub mod optimizer;
pub mod run_folder;
pub mod schedule;
pub mod state;
pub mod supervised;
mod tensorboard;
#[cfg(test)]
mod testing;
pub mod trainer;
pub mod transfer;
pub mod validation;

pub use adapt::{AdaptJob, Adapted, GivenModel, NewVideo, adapt};
pub use clip::{Clip, Source, load_clips};
pub use config::{Preset, TrainConfig};
pub use dataset::SnippetDataset;
pub use error::TrainError;
pub use run_folder::{RunFolder, model_folder};
pub use trainer::{Summary, TrainJob, resume, train};
