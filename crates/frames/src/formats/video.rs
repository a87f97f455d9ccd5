//! The `video` format: a video file, told by its content, or a live address.

use super::{Format, Probe, common};
use crate::sequence::{FrameEntry, ImageLocation, VideoFile};
use crate::video::{self, VideoIndex};
use crate::{FramesError, Sequence, picture};
use std::path::Path;

pub use crate::video::is_live_address;

/// Endings that say a file is meant to be a video, also when it is too damaged to tell.
const EXTENSIONS: &[&str] =
    &["mp4", "m4v", "mov", "avi", "mkv", "webm", "mpg", "mpeg", "ts", "mts", "wmv", "flv", "ogv"];

/// Takes files with a video stream and live addresses.
pub fn probe(path: &Path) -> Probe {
    if is_live_address(path) {
        return Some(open_live(path));
    }
    if !path.is_file() || picture::is_picture(path) {
        return None;
    }
    let meant = common::extension(&path.to_string_lossy()).is_some_and(|end| EXTENSIONS.contains(&end.as_str()));
    match video::probe(path) {
        Ok(info) if info.is_moving() => Some(video::index(path).map(|index| sequence(path, &index))),
        // Without ffmpeg nothing can be told about any file; only a name that says video makes that worth saying.
        Err(error) if meant => Some(Err(error)),
        _ => None,
    }
}

fn sequence(path: &Path, index: &VideoIndex) -> Sequence {
    let frame = |(position, time_s)| FrameEntry {
        number: position,
        time_s,
        image: ImageLocation::Video(position),
        depth: None,
        mask: None,
        world_from_camera: None,
    };
    let frames = index.times_s().enumerate().map(frame).collect();
    Sequence { frames, ..empty(path, index.info.size, index.info.fps) }
}

fn open_live(address: &Path) -> Result<Sequence, FramesError> {
    let info = video::probe(address)?;
    let warning = "a live source has no end: its frames are not listed".to_owned();
    Ok(Sequence { warnings: vec![warning], ..empty(address, info.size, info.fps) })
}

fn empty(path: &Path, size: endoscape_core::Size, fps: Option<f64>) -> Sequence {
    Sequence {
        format: Format::Video,
        name: common::name_of(path),
        root: path.to_path_buf(),
        size,
        fps,
        camera: None,
        video: Some(VideoFile { path: path.to_path_buf(), crop: None }),
        frames: Vec::new(),
        license: None,
        warnings: Vec::new(),
    }
}
