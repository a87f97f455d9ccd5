//! SCARED (EndoVis 2019, stereo endoscopy with structured-light truth): one keyframe folder.
//!
//! | layout | frames | found by |
//! |---|---|---|
//! | as released | `data/rgb.mp4`, left view above right | `endoscope_calibration.yaml` |
//! | split into pictures (AF-SfMLearner) | `image_02/data/NNNNNNNNNN.png`, truth numbered one less | `image_02/data` with `endoscope_calibration.yaml` |
//! | keyframe alone | `Left_Image.png` | `endoscope_calibration.yaml` |
//!
//! Poses: `data/frame_data.tar.gz` or the folder `data/frame_data`, JSON with a 4x4 `camera-pose` in millimetres that
//! maps the keyframe to the current camera. Depth: the folder `data/scene_points` where it is unpacked, and
//! `left_depth_map.tiff` for the keyframe, which is frame 0.

mod frame_data;

pub use frame_data::{parse_archive, parse_frame_data};

use super::{Probe, common, numbered};
use crate::depth::{DepthEncoding, DepthFile};
use crate::sequence::{FrameEntry, VideoFile};
use crate::{Format, FramesError, Sequence, camera_file, picture, video};
use endoscape_core::{Pose, Rect, Size};
use std::collections::BTreeMap;
use std::path::Path;

/// Frame rate assumed for pictures, whose layout does not keep that of the video.
const FPS: f64 = 25.0;
/// Largest archive of frame data read, in bytes; real ones have a few megabytes.
const LARGEST_ARCHIVE: u64 = 256 << 20;

/// Answers whether `path` holds this format, and loads it.
pub fn probe(path: &Path) -> Probe {
    path.join("endoscope_calibration.yaml").is_file().then(|| load(path))
}

/// Frames of one layout, before poses and depth.
struct Frames {
    size: Size,
    fps: Option<f64>,
    video: Option<VideoFile>,
    entries: Vec<FrameEntry>,
    /// What to subtract from a frame's number to get the number of its truth.
    truth_offset: usize,
}

fn load(path: &Path) -> Result<Sequence, FramesError> {
    let frames = frames(path)?;
    let mut warnings = doubts(path);
    let file = path.join("endoscope_calibration.yaml");
    let camera = camera_file::read_camera(&file, Some(frames.size))?;
    let camera = common::fit_camera(camera, frames.size, &mut warnings)
        .map_err(|error| FramesError::file(&file, error.to_string(), "correct it"))?;
    let mut sequence = Sequence {
        format: Format::Scared,
        name: name(path),
        root: path.to_path_buf(),
        size: frames.size,
        fps: frames.fps,
        camera: Some(camera),
        video: frames.video,
        frames: frames.entries,
        license: Some("SCARED challenge terms (non-commercial, on registration)".into()),
        warnings,
    };
    add_poses(&mut sequence, frames.truth_offset)?;
    add_depth(&mut sequence, frames.truth_offset)?;
    Ok(sequence)
}

fn frames(path: &Path) -> Result<Frames, FramesError> {
    let (video, pictures, keyframe) =
        (path.join("data/rgb.mp4"), path.join("image_02/data"), path.join("Left_Image.png"));
    if video.is_file() {
        from_video(&video)
    } else if pictures.is_dir() {
        from_pictures(&pictures)
    } else if keyframe.is_file() {
        let entries = vec![common::frame_of(&keyframe, 0, 0.0)];
        Ok(Frames { size: picture::size(&keyframe)?, fps: None, video: None, entries, truth_offset: 0 })
    } else {
        Err(FramesError::file(
            path,
            "holds a calibration but no data/rgb.mp4, image_02/data or Left_Image.png",
            "check that the data set is complete",
        ))
    }
}

/// The released video shows the left view above the right one.
fn from_video(path: &Path) -> Result<Frames, FramesError> {
    let info = video::probe(path)?;
    let stacked = info.size.height > info.size.width;
    let size = if stacked { Size::new(info.size.width, info.size.height / 2) } else { info.size };
    let crop = stacked.then_some(Rect { x: 0, y: 0, size });
    let entries = numbered::video_frames(path, &info)?;
    let video = Some(VideoFile { path: path.to_path_buf(), crop });
    Ok(Frames { size, fps: Some(info.fps), video, entries, truth_offset: 0 })
}

/// Pictures numbered from 1 by ffmpeg, while the truth is numbered from 0.
fn from_pictures(folder: &Path) -> Result<Frames, FramesError> {
    let pictures = numbered::list(folder, "", &["png", "jpg"])?;
    let first = pictures.values().next().ok_or_else(|| numbered::none_found(folder, "0000000001.png"))?;
    let size = picture::size(first)?;
    let entries = pictures.iter().map(|(number, file)| common::frame_of(file, *number, *number as f64 / FPS)).collect();
    Ok(Frames { size, fps: Some(FPS), video: None, entries, truth_offset: 1 })
}

fn add_poses(sequence: &mut Sequence, truth_offset: usize) -> Result<(), FramesError> {
    let archive = sequence.root.join("data/frame_data.tar.gz");
    let folder = sequence.root.join("data/frame_data");
    let poses = if folder.is_dir() {
        read_folder(&folder)?
    } else if archive.is_file() {
        parse_archive(&common::read_bytes(&archive, LARGEST_ARCHIVE)?).map_err(|error| error.at(&archive))?
    } else {
        sequence.warnings.push("no data/frame_data: the frames have no poses".into());
        return Ok(());
    };
    for frame in &mut sequence.frames {
        frame.world_from_camera = truth(frame.number, truth_offset).and_then(|number| poses.get(&number)).copied();
    }
    let matched = sequence.frames.iter().filter(|frame| frame.world_from_camera.is_some()).count();
    sequence.warnings.extend(common::pairing_warning(sequence.frames.len(), poses.len(), matched));
    Ok(())
}

fn read_folder(folder: &Path) -> Result<BTreeMap<usize, Pose>, FramesError> {
    let files = numbered::list(folder, "frame_data", &["json"])?;
    let pose = |(number, file): (&usize, &std::path::PathBuf)| {
        let bytes = common::read_bytes(file, frame_data::LARGEST_JSON)?;
        Ok((*number, parse_frame_data(&bytes).map_err(|error| error.at(file))?))
    };
    files.iter().map(pose).collect()
}

fn add_depth(sequence: &mut Sequence, truth_offset: usize) -> Result<(), FramesError> {
    let folder = sequence.root.join("data/scene_points");
    // Both kinds of file hold the left view in their first rows.
    let encoding = DepthEncoding::PointsTiff { first_row: 0, rows: sequence.size.height };
    let mut maps =
        if folder.is_dir() { numbered::list(&folder, "scene_points", &["tiff", "tif"])? } else { BTreeMap::new() };
    let keyframe = sequence.root.join("left_depth_map.tiff");
    if keyframe.is_file() {
        maps.entry(0).or_insert(keyframe);
    }
    if !folder.is_dir() && sequence.root.join("data/scene_points.tar.gz").is_file() {
        sequence.warnings.push("data/scene_points.tar.gz is not unpacked: only the keyframe has depth".into());
    }
    for frame in &mut sequence.frames {
        let map = truth(frame.number, truth_offset).and_then(|number| maps.remove(&number));
        frame.depth = map.map(|path| DepthFile { path, encoding: encoding.clone() });
    }
    Ok(())
}

fn truth(number: usize, offset: usize) -> Option<usize> {
    number.checked_sub(offset)
}

/// What is known to be wrong with some of the data sets, whose number stands in a folder above.
fn doubts(path: &Path) -> Vec<String> {
    let full = path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
    let number = full.components().find_map(|part| {
        let part = part.as_os_str().to_string_lossy().to_lowercase();
        part.strip_prefix("dataset").and_then(|rest| rest.trim_start_matches('_').parse::<u32>().ok())
    });
    match number {
        Some(number @ (4 | 5)) => vec![format!("the calibration of SCARED dataset {number} is known to be unreliable")],
        _ => Vec::new(),
    }
}

/// `dataset_1/keyframe_2` says more than `keyframe_2`.
fn name(path: &Path) -> String {
    let full = path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
    full.parent().map_or_else(
        || common::name_of(path),
        |parent| format!("{}/{}", common::name_of(parent), common::name_of(path)),
    )
}
