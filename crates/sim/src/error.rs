//! What can go wrong between parameters and a finished sequence, as sentences for the person who typed them.

use endoscape_core::CameraError;
use endoscape_frames::FramesError;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// What, where, why, and what to do, in one sentence.
#[derive(Debug, Error)]
pub enum SimError {
    /// A parameter that no patient has.
    #[error("{what}; {remedy}")]
    Parameter {
        /// What was asked for and why it cannot be.
        what: String,
        /// What to do.
        remedy: String,
    },
    /// A mesh that cannot be the wall of an organ.
    #[error("{}: {reason}; {remedy}", path.display())]
    Mesh {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
        /// What to do.
        remedy: &'static str,
    },
    /// The camera would touch or cross the wall.
    #[error(
        "frame {frame}: the camera would be {clearance_mm:.2} mm from the wall, less than the {least_mm:.2} mm its window needs; choose another seed or path, or a wider organ"
    )]
    Wall {
        /// Number of the frame.
        frame: usize,
        /// Distance from the camera to the wall in millimetres, 0 beyond it.
        clearance_mm: f64,
        /// Distance the camera's own body needs, millimetres.
        least_mm: f64,
    },
    /// The camera model refused its numbers.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The sequence folder could not be written, or an input not be read.
    #[error(transparent)]
    Frames(#[from] FramesError),
}

impl SimError {
    /// A parameter that cannot be.
    pub(crate) fn parameter(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Parameter { what: what.into(), remedy: remedy.into() }
    }

    /// A mesh that cannot be used.
    pub(crate) fn mesh(path: &Path, reason: impl Into<String>, remedy: &'static str) -> Self {
        Self::Mesh { path: path.to_path_buf(), reason: reason.into(), remedy }
    }
}
