//! The frames of a recording that a data set keeps as one video.

use crate::sequence::{FrameEntry, ImageLocation};
use crate::video::VideoIndex;

/// One entry per frame of a video, numbered from 0, at the times of the container.
pub fn frames_of(index: &VideoIndex) -> Vec<FrameEntry> {
    let entry = |(number, time_s): (usize, f64)| FrameEntry {
        number,
        time_s,
        image: ImageLocation::Video(number),
        depth: None,
        mask: None,
        world_from_camera: None,
    };
    index.times_s().enumerate().map(entry).collect()
}

#[cfg(test)]
pub mod tests {
    use std::path::Path;
    use std::process::{Command, Stdio};

    /// Makes a video of a test picture with ffmpeg; without ffmpeg the test that asks is skipped.
    pub fn make_video(path: &Path, size: &str, frames: usize) -> bool {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        let source = format!("testsrc=size={size}:rate=25");
        let made = Command::new("ffmpeg")
            .args(["-loglevel", "error", "-f", "lavfi", "-i", &source, "-frames:v", &frames.to_string()])
            .arg(path)
            .stdin(Stdio::null())
            .status()
            .is_ok_and(|status| status.success());
        if !made {
            eprintln!("skipped: no ffmpeg to make {}", path.display());
        }
        made
    }
}
