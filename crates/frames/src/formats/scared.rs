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

use super::{Probe, common, video_frames};
use crate::depth::{DepthEncoding, DepthFile};
use crate::sequence::{FrameEntry, VideoFile};
use crate::{Format, FramesError, Sequence, camera_file, picture, video};
use endoscape_core::{Pose, Rect, Size};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

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
    let camera = camera_file::read_fitted(&file, frames.size, &mut warnings)?;
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
    let index = video::index(path)?;
    let (whole, fps) = (index.info.size, index.info.fps);
    let stacked = whole.height > whole.width;
    let size = if stacked { Size::new(whole.width, whole.height / 2) } else { whole };
    let crop = stacked.then_some(Rect { x: 0, y: 0, size });
    let video = Some(VideoFile { path: path.to_path_buf(), crop });
    Ok(Frames { size, fps, video, entries: video_frames::frames_of(&index), truth_offset: 0 })
}

/// Pictures numbered from 1 by ffmpeg, while the truth is numbered from 0.
fn from_pictures(folder: &Path) -> Result<Frames, FramesError> {
    let entries = common::frames_at(&common::numbered(folder, "", &[".png", ".jpg"])?, FPS);
    let size = common::first_size(folder, &entries)?;
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
    let files = common::numbered(folder, "frame_data", &[".json"])?;
    let pose = |(number, file): (usize, PathBuf)| {
        let bytes = common::read_bytes(&file, frame_data::LARGEST_JSON)?;
        Ok((number, parse_frame_data(&bytes).map_err(|error| error.at(&file))?))
    };
    files.into_iter().map(pose).collect()
}

fn add_depth(sequence: &mut Sequence, truth_offset: usize) -> Result<(), FramesError> {
    let folder = sequence.root.join("data/scene_points");
    // Both kinds of file hold the left view in their first rows.
    let encoding = DepthEncoding::PointsTiff { first_row: 0, rows: sequence.size.height };
    let maps =
        if folder.is_dir() { common::numbered(&folder, "scene_points", &[".tiff", ".tif"])? } else { Vec::new() };
    let mut maps: BTreeMap<usize, PathBuf> = maps.into_iter().collect();
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::fixtures::{loaded, picture, refusal, text};

    const CALIBRATION: &str = "%YAML:1.0\n---\nM1: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 10., 0., 3.5, 0., 10., 2.5, 0., 0., 1. ]\n\
        D1: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ 0.01, 0., 0., 0., 0. ]\n";

    /// The keyframe seen from a camera `x` millimetres to its right.
    fn frame_data(x: f64) -> String {
        format!("{{\"camera-pose\": [[1, 0, 0, {}], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], \"timestamp\": 0}}", -x)
    }

    fn archive(frames: usize) -> Vec<u8> {
        let mut builder = tar::Builder::new(flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast()));
        for number in 0..frames {
            let json = frame_data(number as f64);
            let mut header = tar::Header::new_gnu();
            header.set_size(json.len() as u64);
            header.set_mode(0o644);
            builder.append_data(&mut header, format!("./frame_data{number:06}.json"), json.as_bytes()).unwrap();
        }
        builder.into_inner().unwrap().finish().unwrap()
    }

    fn fixture() -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("dataset_4/keyframe_1");
        text(&path.join("endoscope_calibration.yaml"), CALIBRATION);
        text(&path.join("left_depth_map.tiff"), "");
        (folder, path)
    }

    #[test]
    fn poses_are_inverted_and_in_metres() {
        let pose = parse_frame_data(frame_data(3.0).as_bytes()).unwrap();
        assert_eq!(pose.translation.x, 3e-3);
        let poses = parse_archive(&archive(3)).unwrap();
        assert_eq!((poses.len(), poses[&2].translation.x), (3, 2e-3));
    }

    #[test]
    fn split_pictures_are_numbered_one_ahead_of_their_truth() {
        let (_folder, path) = fixture();
        for number in 1..=3 {
            picture(&path.join(format!("image_02/data/{number:010}.png")), Size::new(8, 6));
        }
        std::fs::create_dir_all(path.join("data")).unwrap();
        std::fs::write(path.join("data/frame_data.tar.gz"), archive(3)).unwrap();
        text(&path.join("data/scene_points/scene_points000001.tiff"), "");
        let sequence = loaded(probe(&path));
        assert_eq!(sequence.name, "dataset_4/keyframe_1");
        assert_eq!(sequence.frames[2].world_from_camera.unwrap().translation.x, 2e-3);
        let depth = |index: usize| sequence.frames[index].depth.as_ref().map(|depth| common::name_of(&depth.path));
        assert_eq!(depth(0).as_deref(), Some("left_depth_map.tiff"));
        assert_eq!(depth(1).as_deref(), Some("scene_points000001.tiff"));
        assert_eq!(
            sequence.frames[0].depth.as_ref().unwrap().encoding,
            DepthEncoding::PointsTiff { first_row: 0, rows: 6 }
        );
        assert_eq!(sequence.warnings, ["the calibration of SCARED dataset 4 is known to be unreliable"]);
    }

    #[test]
    fn unpacked_frame_data_is_read_and_blamed_by_name() {
        let (_folder, path) = fixture();
        picture(&path.join("Left_Image.png"), Size::new(8, 6));
        text(&path.join("data/frame_data/frame_data000000.json"), &frame_data(0.0));
        assert!(loaded(probe(&path)).frames[0].world_from_camera.is_some());
        text(&path.join("data/frame_data/frame_data000000.json"), "{\n\"camera-pose\": [[1, 2]]}");
        let sentence = refusal(probe(&path));
        assert!(sentence.contains("frame_data000000.json, line 2: holds no 4x4 camera-pose"), "{sentence}");
    }

    #[test]
    fn archives_that_are_none_and_that_never_end_are_refused() {
        assert!(parse_archive(b"not gzip").unwrap_err().reason.contains("no readable .tar.gz"));
        let whole = archive(3);
        assert!(parse_archive(&whole[..whole.len() / 2]).is_err());
        let (_folder, path) = fixture();
        assert!(refusal(probe(&path)).contains("holds a calibration but no data/rgb.mp4"));
    }

    #[test]
    fn the_left_view_is_the_upper_half_of_the_video() {
        let (_folder, path) = fixture();
        if !video_frames::tests::make_video(&path.join("data/rgb.mp4"), "64x96", 4) {
            return;
        }
        std::fs::write(path.join("data/frame_data.tar.gz"), archive(3)).unwrap();
        let sequence = loaded(probe(&path));
        let crop = sequence.video.as_ref().unwrap().crop.unwrap();
        assert_eq!((crop.x, crop.y, crop.size, sequence.size), (0, 0, Size::new(64, 48), Size::new(64, 48)));
        assert_eq!((sequence.frames.len(), sequence.fps), (4, Some(25.0)));
        assert_eq!(sequence.frames[2].world_from_camera.unwrap().translation.x, 2e-3);
        assert!(sequence.warnings.iter().any(|warning| warning.starts_with("3 of 4 frames have a pose")));
    }
}
