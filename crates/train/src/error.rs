//! Everything that can go wrong between a path and a trained model, as sentences for the person who started it.

use endoscape_core::CameraError;
use endoscape_frames::FramesError;
use endoscape_nets::NetsError;
use endoscape_synthesis::SynthesisError;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// What, where, why, and what to do: every variant displays as one sentence.
#[derive(Debug, Error)]
pub enum TrainError {
    /// A sequence cannot be read.
    #[error(transparent)]
    Frames(#[from] FramesError),
    /// A network or checkpoint cannot be used.
    #[error(transparent)]
    Nets(#[from] NetsError),
    /// Cameras or the objective cannot be used.
    #[error(transparent)]
    Synthesis(#[from] SynthesisError),
    /// A camera that cannot be read out at the training size.
    #[error("the camera does not fit the training size: {0}")]
    Camera(#[from] CameraError),
    /// A setting outside its range.
    #[error("the setting `{setting}` {reason}")]
    Config {
        /// Its dotted name, as in `config.toml`.
        setting: String,
        /// What is wrong with it and what is possible.
        reason: String,
    },
    /// A sequence nothing can be learned from.
    #[error("{name}: {reason}; {remedy}")]
    Data {
        /// Name of the sequence.
        name: String,
        /// What is wrong.
        reason: String,
        /// What to do.
        remedy: String,
    },
    /// A file or folder of the run that cannot be used.
    #[error("{}: {reason}; {remedy}", path.display())]
    Run {
        /// The file or folder.
        path: PathBuf,
        /// What is wrong.
        reason: String,
        /// What to do.
        remedy: &'static str,
    },
    /// The loss is no number any more.
    #[error(
        "the loss became {loss} before step {step}, so training stopped; the checkpoint of step {kept} is unharmed: \
         start a new run from it with --init and a lower learning_rate or a smaller gradient_norm"
    )]
    Diverged {
        /// The step at which it was noticed.
        step: u64,
        /// Step of the last checkpoint.
        kept: u64,
        /// What the loss is.
        loss: f32,
    },
    /// A thread that makes batches died.
    #[error("a thread that prepares training data stopped unexpectedly; run the command again with --resume")]
    Loader,
}

impl TrainError {
    pub(crate) fn config(setting: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Config { setting: setting.into(), reason: reason.into() }
    }

    pub(crate) fn data(name: &str, reason: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Data { name: name.to_owned(), reason: reason.into(), remedy: remedy.into() }
    }

    pub(crate) fn run(path: &Path, reason: impl Into<String>, remedy: &'static str) -> Self {
        Self::Run { path: path.to_path_buf(), reason: reason.into(), remedy }
    }

    /// An operating-system error with the remedy its kind suggests.
    pub(crate) fn io(path: &Path, action: &'static str, error: &std::io::Error) -> Self {
        use std::io::ErrorKind;
        let remedy = match error.kind() {
            ErrorKind::StorageFull => "free some space or choose another folder",
            ErrorKind::PermissionDenied => "check the permissions",
            _ => "check the path and the disk",
        };
        Self::run(path, format!("cannot {action}: {error}"), remedy)
    }
}
