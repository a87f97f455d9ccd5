//! Frames by number: pictures that carry it in their names, and the frames of a video.

use super::common;
use crate::sequence::{FrameEntry, ImageLocation};
use crate::video::VideoInfo;
use crate::{FramesError, natural};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Most frames a video may claim: four days at 30 per second.
const MOST_FRAMES: usize = 10_000_000;

/// Files of `folder` named `prefix<number>.<one of extensions>`, by number.
///
/// # Errors
/// [`FramesError`] if the folder cannot be listed or two files carry the same number.
pub fn list(folder: &Path, prefix: &str, extensions: &[&str]) -> Result<BTreeMap<usize, PathBuf>, FramesError> {
    let wanted = |name: &str| {
        let extension = common::extension(name);
        name.starts_with(prefix) && extension.is_some_and(|extension| extensions.contains(&extension.as_str()))
    };
    let mut files = BTreeMap::new();
    for path in common::list(folder, wanted)? {
        let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        let rest = &stem[prefix.len()..];
        let Some(number) = natural::number(rest).filter(|_| rest.bytes().all(|byte| byte.is_ascii_digit())) else {
            continue;
        };
        if let Some(other) = files.insert(number, path.clone()) {
            let reason = format!("has the same frame number as {}", common::name_of(&other));
            return Err(FramesError::file(&path, reason, "remove one of the two"));
        }
    }
    Ok(files)
}

/// The refusal of a folder that should hold such files and holds none.
pub fn none_found(folder: &Path, example: &str) -> FramesError {
    FramesError::file(folder, format!("holds no pictures named like {example}"), "check that the data set is complete")
}

/// One entry per frame of a video, numbered from 0.
///
/// # Errors
/// [`FramesError`] if the number of frames is not known or the frame rate is none.
pub fn video_frames(path: &Path, info: &VideoInfo) -> Result<Vec<FrameEntry>, FramesError> {
    let count = info.frames.filter(|count| (1..=MOST_FRAMES).contains(count));
    let count = count.filter(|_| info.fps.is_finite() && info.fps > 0.0).ok_or_else(|| {
        FramesError::file(path, "does not tell how many frames it has at which rate", "repack it with ffmpeg -c copy")
    })?;
    let entry = |number: usize| FrameEntry {
        number,
        time_s: number as f64 / info.fps,
        image: ImageLocation::Video(number),
        depth: None,
        mask: None,
        world_from_camera: None,
    };
    Ok((0..count).map(entry).collect())
}
