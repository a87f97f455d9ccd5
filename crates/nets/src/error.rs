//! Everything that can go wrong with configurations and weight files, as sentences for the person who typed the path.

use std::path::{Path, PathBuf};
use thiserror::Error;

/// What, where, why, and what to do: every variant displays as one sentence.
#[derive(Debug, Error)]
pub enum NetsError {
    /// Nothing is there.
    #[error("{}: no such {what}; check the path", path.display())]
    Missing {
        /// The path looked at.
        path: PathBuf,
        /// What was expected there: `checkpoint folder`, `weight file`.
        what: &'static str,
    },
    /// The operating system refused.
    #[error("{}: cannot {action}: {source}; {remedy}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was tried: `read`, `write`.
        action: &'static str,
        /// What the operating system said.
        source: std::io::Error,
        /// What to do.
        remedy: &'static str,
    },
    /// A file that is truncated, damaged or of another kind.
    #[error("{}: {reason}; copy or download the file again", path.display())]
    Corrupt {
        /// The file.
        path: PathBuf,
        /// What does not hold.
        reason: String,
    },
    /// Readable weights that belong to another network.
    #[error("{}: {reason}; {remedy}", path.display())]
    Mismatch {
        /// The file or folder.
        path: PathBuf,
        /// Which tensor or setting disagrees.
        reason: String,
        /// What to do.
        remedy: &'static str,
    },
    /// A checkpoint from the future.
    #[error("{}: written as checkpoint format {found}, but this program reads up to {supported}; update endoscape", path.display())]
    Newer {
        /// The manifest.
        path: PathBuf,
        /// Its format version.
        found: u32,
        /// The newest version this program knows.
        supported: u32,
    },
    /// A setting no network can be built from.
    #[error("the network setting `{setting}` {reason}")]
    Config {
        /// The setting's dotted name, as in `config.toml`.
        setting: String,
        /// What is wrong with its value and which values are possible.
        reason: String,
    },
}

impl NetsError {
    /// An operating-system error with the remedy its kind suggests.
    pub(crate) fn io(path: &Path, action: &'static str, source: std::io::Error) -> Self {
        use std::io::ErrorKind;
        let path = path.to_path_buf();
        let remedy = match source.kind() {
            ErrorKind::NotFound if action == "read" => return Self::Missing { path, what: "file" },
            ErrorKind::NotFound => "check that its parent folder exists",
            ErrorKind::PermissionDenied => "check the permissions",
            ErrorKind::StorageFull => "free some space or choose another place",
            ErrorKind::NotADirectory => "a folder was expected there",
            ErrorKind::IsADirectory => "a file was expected there",
            _ => "check the path and the disk",
        };
        Self::Io { path, action, source, remedy }
    }

    pub(crate) fn corrupt(path: &Path, reason: impl Into<String>) -> Self {
        Self::Corrupt { path: path.to_path_buf(), reason: reason.into() }
    }

    pub(crate) fn mismatch(path: &Path, reason: impl Into<String>, remedy: &'static str) -> Self {
        Self::Mismatch { path: path.to_path_buf(), reason: reason.into(), remedy }
    }

    pub(crate) fn config(setting: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Config { setting: setting.into(), reason: reason.into() }
    }
}
