//! Everything that can keep a report from being written, as sentences for the person who asked for it.

use endoscape_eval::EvalError;
use endoscape_frames::FramesError;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// What, where, why, and what to do.
#[derive(Debug, Error)]
pub enum ReportError {
    /// A file that cannot be used or written.
    #[error("{}: {what}; {remedy}", path.display())]
    File {
        /// The file or folder.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
        /// What to do.
        remedy: &'static str,
    },
    /// Numbers that cannot be compared.
    #[error("{name}: {source}")]
    Evaluation {
        /// The method or file.
        name: String,
        /// Why.
        source: EvalError,
    },
    /// A figure that could not be drawn.
    #[error("the figure `{figure}` cannot be drawn: {reason}; report this with the input")]
    Drawing {
        /// Its title.
        figure: String,
        /// Why.
        reason: String,
    },
    /// Frames, depth or masks that cannot be read.
    #[error(transparent)]
    Frames(#[from] FramesError),
}

impl ReportError {
    /// A file with what is wrong and what to do.
    pub fn file(path: &Path, what: impl Into<String>, remedy: &'static str) -> Self {
        Self::File { path: path.to_owned(), what: what.into(), remedy }
    }

    /// Something that could not be compared, under the name the reader knows.
    pub fn evaluation(name: impl Into<String>) -> impl FnOnce(EvalError) -> Self {
        let name = name.into();
        move |source| Self::Evaluation { name, source }
    }
}
