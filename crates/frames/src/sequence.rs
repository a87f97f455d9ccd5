//! What every loader ends in.

use crate::depth::DepthFile;
use crate::{Format, FramesError};
use endoscape_core::{Camera, Pose, Rect, Size, TimedPose, Trajectory};
use std::path::PathBuf;

/// Frames in time order with all that is known about them. Pixels stay on disk until a frame is asked for.
#[derive(Clone, Debug)]
pub struct Sequence {
    /// Which loader made it.
    pub format: Format,
    /// Short name, usually that of the folder.
    pub name: String,
    /// The path the user gave.
    pub root: PathBuf,
    /// Size of every frame in pixels.
    pub size: Size,
    /// Frames per second, where it is known or stated.
    pub fps: Option<f64>,
    /// The camera, of [`Sequence::size`]; `None` where no calibration is known.
    pub camera: Option<Camera>,
    /// The video that holds the pixels, for frames located in a video.
    pub video: Option<VideoFile>,
    /// The frames in time order.
    pub frames: Vec<FrameEntry>,
    /// Licence of the data as far as the data set states one.
    pub license: Option<String>,
    /// What the user should know, one sentence each: scaled intrinsics, unmatched poses, doubtful units.
    pub warnings: Vec<String>,
}

/// One frame before decoding.
#[derive(Clone, Debug)]
pub struct FrameEntry {
    /// Number of the frame in its data set (from its file name, or counted), unique and increasing.
    pub number: usize,
    /// Seconds since the data set's own zero.
    pub time_s: f64,
    /// Where its pixels are.
    pub image: ImageLocation,
    /// Where its depth is, if it has any.
    pub depth: Option<DepthFile>,
    /// Where the mask of its usable pixels is (white is usable), if it has one.
    pub mask: Option<PathBuf>,
    /// Its pose in metres, if it has one.
    pub world_from_camera: Option<Pose>,
}

/// Where the pixels of a frame are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ImageLocation {
    /// A picture of its own.
    File(PathBuf),
    /// The frame of this position, counted from 0, in [`Sequence::video`].
    Video(usize),
}

/// A video and the part of its picture that is the camera's.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VideoFile {
    /// The file or live address.
    pub path: PathBuf,
    /// The block of each picture to use; all of it if `None`.
    pub crop: Option<Rect>,
}

impl Sequence {
    /// The frames that have a pose, as a trajectory.
    ///
    /// # Errors
    /// [`FramesError::File`] if their times do not increase.
    pub fn trajectory(&self) -> Result<Trajectory, FramesError> {
        let timed = |frame: &FrameEntry| {
            frame.world_from_camera.map(|world_from_camera| TimedPose { time_s: frame.time_s, world_from_camera })
        };
        Trajectory::new(self.frames.iter().filter_map(timed).collect())
            .map_err(|error| FramesError::file(&self.root, error.to_string(), "correct the times of its frames"))
    }

    /// Whether any frame has a pose.
    pub fn has_poses(&self) -> bool {
        self.frames.iter().any(|frame| frame.world_from_camera.is_some())
    }

    /// Whether any frame has depth.
    pub fn has_depth(&self) -> bool {
        self.frames.iter().any(|frame| frame.depth.is_some())
    }

    /// Whether any frame has a mask of its own.
    pub fn has_masks(&self) -> bool {
        self.frames.iter().any(|frame| frame.mask.is_some())
    }
}
