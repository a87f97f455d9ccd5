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
