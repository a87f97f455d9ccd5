//! Every parser of foreign text and bytes under one roof, free of I/O.
//!
//! The loaders read files and hand their content to these; the fuzz targets and the hostile-input tests call the same
//! functions directly. None of them panics, and none allocates by a number that stands in its input.

pub use crate::camera_file::parse as camera;
pub use crate::formats::colmap::{parse_cameras as colmap_cameras, parse_images as colmap_images};
pub use crate::formats::endomapper::parse_endoscope as endomapper_endoscope;
pub use crate::formats::endoslam::parse_workbook as endoslam_workbook;
pub use crate::formats::scared::{parse_archive as scared_archive, parse_frame_data as scared_frame_data};
pub use crate::formats::unity::parse_poses as unity_poses;

use crate::FramesError;
use endoscape_core::trajectory::TextError;
use std::path::Path;
use thiserror::Error;

/// What is wrong with the content of a file whose name the parser does not know.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{reason}")]
pub struct Malformed {
    /// Line counted from 1, where the fault has one.
    pub line: Option<usize>,
    /// What is wrong and what was expected.
    pub reason: String,
}

impl Malformed {
    /// A fault of the content as a whole.
    pub fn whole(reason: impl Into<String>) -> Self {
        Self { line: None, reason: reason.into() }
    }

    /// A fault in one line, counted from 1.
    pub fn line(line: usize, reason: impl Into<String>) -> Self {
        Self { line: Some(line), reason: reason.into() }
    }

    /// The same fault with the name of its file.
    pub fn at(self, path: &Path) -> FramesError {
        match self.line {
            Some(line) => FramesError::line(path, line, self.reason),
            None => FramesError::file(path, self.reason, "correct it or fetch the file again"),
        }
    }
}

impl From<TextError> for Malformed {
    fn from(error: TextError) -> Self {
        Self::line(error.line, error.reason)
    }
}

/// A finite number, or a sentence on what stands in its place.
pub(crate) fn finite(text: &str, name: &str) -> Result<f64, String> {
    let text = text.trim();
    text.parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(|| {
        let shown: String = text.chars().take(32).collect();
        format!("{name} is `{shown}` where a finite number was expected")
    })
}
