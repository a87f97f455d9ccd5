//! Everything that keeps a method from running, as sentences for the person who typed the path.

use endoscape_core::TrackError;
use endoscape_frames::FramesError;
use endoscape_nets::{NetsError, Network};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// What, where, why, and what to do: every variant displays as one sentence.
#[derive(Debug, Error)]
pub enum OdometryError {
    /// The input cannot be read.
    #[error(transparent)]
    Frames(#[from] FramesError),
    /// The model cannot be used.
    #[error(transparent)]
    Nets(#[from] NetsError),
    /// The method gave up.
    #[error(transparent)]
    Track(#[from] TrackError),
    /// A checkpoint that holds one network where another is needed.
    #[error("the model has no {0}; give a model that endoscape train wrote, or import the missing network into it")]
    Incomplete(Network),
    /// A setting no run can be made with.
    #[error("the setting `{setting}` is {value} but must be {range}")]
    Setting {
        /// Name of the setting.
        setting: &'static str,
        /// Its value.
        value: f64,
        /// What is possible.
        range: &'static str,
    },
    /// Not a single frame could be decoded.
    #[error("{input}: none of its frames can be decoded ({first}); give another recording")]
    NoFrame {
        /// The input.
        input: String,
        /// Why the first one could not.
        first: String,
    },
    /// The results cannot be written.
    #[error("{}: {reason}; {remedy}", path.display())]
    Output {
        /// The file or folder.
        path: PathBuf,
        /// What does not work.
        reason: String,
        /// What to do.
        remedy: &'static str,
    },
}

impl OdometryError {
    /// A result that the disk refuses.
    pub(crate) fn io(path: &Path, error: &std::io::Error) -> Self {
        use std::io::ErrorKind;
        let remedy = match error.kind() {
            ErrorKind::StorageFull => "free some space or choose another folder",
            ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => "choose a folder that you may write to",
            ErrorKind::NotFound => "check that its parent folder exists",
            _ => "check the path and the disk",
        };
        Self::output(path, format!("cannot be written ({error})"), remedy)
    }

    pub(crate) fn output(path: &Path, reason: impl Into<String>, remedy: &'static str) -> Self {
        Self::Output { path: path.to_path_buf(), reason: reason.into(), remedy }
    }
}
