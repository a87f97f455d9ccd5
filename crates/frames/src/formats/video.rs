//! The `video` format.

use super::Probe;
use std::path::Path;

/// Answers whether `path` holds this format, and loads it.
pub fn probe(_path: &Path) -> Probe {
    None
}

/// Whether a path is an address for `ffmpeg` rather than a file: `rtsp://...`, `/dev/video0`, ...
pub fn is_live_address(path: &Path) -> bool {
    path.to_string_lossy().contains("://") || path.starts_with("/dev/video")
}
