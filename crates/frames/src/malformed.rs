//! What a parser says about content whose file it does not know.
//!
//! Parsers of foreign text and bytes are pure functions, so that they can be fuzzed: a loader reads the file, hands
//! its content over, and puts the file's name to the fault with [`Malformed::at`].

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
