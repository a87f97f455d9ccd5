//! Video files and live inputs through an `ffmpeg` process.
//!
//! Decoding stays with `ffmpeg`: it knows every container an endoscopy tower writes, and a crash of a decoder on a
//! damaged file is a crash of another process. Pixels come through its standard output as raw RGB; the time of each
//! frame comes through the log line its `showinfo` filter prints just before, so variable frame rates keep their true
//! times.
//!
//! | module | what |
//! |---|---|
//! | `index` | times of all frames of a file, from its packets |
//! | `decoder` | the process: one picture with its time after the other |
//! | `reader` | [`VideoReader`]: a part of a file, every frame accounted for |
//! | `live` | [`LiveReader`]: network streams and devices; never falls behind |

mod decoder;
mod index;
mod live;
mod reader;

pub use index::{VideoIndex, VideoInfo};
pub use live::LiveReader;
pub use reader::VideoReader;

use crate::FramesError;
use std::ffi::OsString;
use std::path::Path;
use std::process::{Command, Stdio};

/// Where the two programs are; by default on PATH.
#[derive(Clone, Debug)]
pub struct Programs {
    /// The decoder.
    pub ffmpeg: OsString,
    /// Its companion that describes files.
    pub ffprobe: OsString,
}

impl Default for Programs {
    fn default() -> Self {
        Self { ffmpeg: "ffmpeg".into(), ffprobe: "ffprobe".into() }
    }
}

/// Describes the first video stream of a file or live address without decoding it.
///
/// # Errors
/// [`FramesError::Program`] without ffmpeg, [`FramesError::File`] for what is no video or damaged.
pub fn probe(path: &Path) -> Result<VideoInfo, FramesError> {
    Programs::default().probe(path)
}

/// Finds the time of every frame of a file; see [`VideoIndex`].
///
/// # Errors
/// As [`probe`], and [`FramesError::File`] for a file that ends before its own header says.
pub fn index(path: &Path) -> Result<VideoIndex, FramesError> {
    Programs::default().index(path)
}

/// Whether a path is an address for `ffmpeg` rather than a file: `rtsp://...`, `/dev/video0`, ...
pub fn is_live_address(path: &Path) -> bool {
    path.to_string_lossy().contains("://") || path.starts_with("/dev") && path.to_string_lossy().contains("/video")
}

/// Arguments that name an input; `file:` keeps names with colons or leading dashes from being taken for addresses.
fn input_arguments(path: &Path) -> Vec<OsString> {
    let mut arguments: Vec<OsString> = Vec::new();
    let text = path.to_string_lossy();
    if path.starts_with("/dev") && is_live_address(path) {
        arguments.extend(["-f", "v4l2"].map(OsString::from));
    } else if text.starts_with("rtsp") {
        // Lost UDP packets show as torn pictures.
        arguments.extend(["-rtsp_transport", "tcp"].map(OsString::from));
    }
    let mut name = OsString::from(if is_live_address(path) { "" } else { "file:" });
    name.push(path);
    arguments.extend(["-i".into(), name]);
    arguments
}

/// A command that neither reads our input nor inherits our output.
fn command(program: &OsString) -> Command {
    let mut command = Command::new(program);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// Why a program did not start.
fn not_started(path: &Path, program: &'static str, error: &std::io::Error) -> FramesError {
    if error.kind() == std::io::ErrorKind::NotFound {
        let action = format!("read the video {}", path.display());
        return FramesError::Program { action, program, package: "ffmpeg" };
    }
    FramesError::file(path, format!("`{program}` does not start ({error})"), "check the installation of ffmpeg")
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
