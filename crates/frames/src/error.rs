//! Everything that can go wrong between a path and a frame, as sentences for the person who typed the path.

use endoscape_core::Size;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// What, where, why, and what to do.
///
/// Every variant displays as one sentence. Paths stand first, remedies last.
#[derive(Debug, Error)]
pub enum FramesError {
    /// Nothing is there.
    #[error("{}: no such file or folder; check the path", path.display())]
    Missing {
        /// The path as given.
        path: PathBuf,
    },
    /// The operating system refused.
    #[error("{}: cannot {action}: {source}; {remedy}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was tried: `read`, `write`, `list`.
        action: &'static str,
        /// What the operating system said.
        source: std::io::Error,
        /// What to do.
        remedy: &'static str,
    },
    /// A text file has a line that cannot be right.
    #[error("{}, line {line}: {reason}; correct that line or fetch the file again", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Line counted from 1.
        line: usize,
        /// What is wrong and what was expected.
        reason: String,
    },
    /// A file as a whole cannot be used.
    #[error("{}: {reason}; {remedy}", path.display())]
    File {
        /// The file or folder.
        path: PathBuf,
        /// What is wrong.
        reason: String,
        /// What to do.
        remedy: String,
    },
    /// A picture of another size than its sequence.
    #[error(
        "{}: the picture is {found} but the sequence is {expected}; leave it out or convert it to the size of the others",
        path.display()
    )]
    OtherSize {
        /// The picture or video.
        path: PathBuf,
        /// Its size.
        found: Size,
        /// The size of the sequence.
        expected: Size,
    },
    /// No loader knows the folder or file.
    #[error("{}: {reason}; give a video, a folder of pictures, a data-set sequence or a sequence folder", path.display())]
    Unrecognised {
        /// The path.
        path: PathBuf,
        /// What was found instead.
        reason: String,
    },
    /// Several loaders claim one folder.
    #[error("{}: holds two data sets at once ({formats}); move one away or name one with --format", path.display())]
    Ambiguous {
        /// The path.
        path: PathBuf,
        /// The names of the formats.
        formats: String,
    },
    /// An external program is not installed.
    #[error(
        "cannot {action}: the program `{program}` is not installed; install the package `{package}` and make sure it is on PATH"
    )]
    Program {
        /// What needed it.
        action: String,
        /// The program looked for.
        program: &'static str,
        /// The package that brings it.
        package: &'static str,
    },
    /// The call asks for something that cannot be.
    #[error("{what}; {remedy}")]
    Request {
        /// What cannot be, and why.
        what: String,
        /// What to do.
        remedy: String,
    },
}

impl FramesError {
    /// An operating-system error with the remedy its kind suggests.
    pub fn io(path: &Path, action: &'static str, source: std::io::Error) -> Self {
        use std::io::ErrorKind;
        let path = path.to_path_buf();
        let remedy = match source.kind() {
            ErrorKind::NotFound if action == "read" => return Self::Missing { path },
            ErrorKind::NotFound => "check that its parent folder exists",
            ErrorKind::PermissionDenied => "check the permissions",
            ErrorKind::StorageFull => "free some space or choose another place",
            ErrorKind::NotADirectory => "a folder was expected there",
            ErrorKind::IsADirectory => "a file was expected there",
            _ => "check the path and the disk",
        };
        Self::Io { path, action, source, remedy }
    }

    /// A file as a whole that cannot be used.
    pub fn file(path: &Path, reason: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::File { path: path.to_path_buf(), reason: reason.into(), remedy: remedy.into() }
    }

    /// A line that cannot be right.
    pub fn line(path: &Path, line: usize, reason: impl Into<String>) -> Self {
        Self::Line { path: path.to_path_buf(), line, reason: reason.into() }
    }
}

impl From<(&Path, endoscape_core::trajectory::TextError)> for FramesError {
    fn from((path, error): (&Path, endoscape_core::trajectory::TextError)) -> Self {
        Self::line(path, error.line, error.reason)
    }
}
