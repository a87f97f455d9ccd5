//! KITTI odometry: `sequences/NN/{image_2, image_0}/%06d.png`, `calib.txt`, `times.txt` and `poses/NN.txt`.
//!
//! The colour camera (`image_2`) is taken where it is there, else the grey one. Published poses are those of camera 0
//! in its own first frame; they are moved to the chosen camera by its baseline, the world staying the first frame of
//! camera 0. Sequences may be cut short: frame number `k` has line `k` of each file, counted from 0.

use super::kitti::{FPS, LICENSE, PICTURES, Projection, with_calibration};
use super::{Format, Probe, common};
use crate::{FrameEntry, FramesError, Sequence};
use endoscape_core::trajectory::parse_kitti;
use endoscape_core::{Camera, Size};
use std::path::{Path, PathBuf};

/// Folders with frames and the number of their camera, best first.
const CAMERAS: &[(&str, usize)] = &[("image_2", 2), ("image_0", 0), ("image_3", 3), ("image_1", 1)];

/// Answers whether `path` holds this format, and loads it.
pub fn probe(path: &Path) -> Probe {
    if recognised(path) {
        return Some(load(path));
    }
    let root = if common::name_of(path) == "sequences" { path.to_path_buf() } else { path.join("sequences") };
    common::only_sequence(&root, recognised, load)
}

fn recognised(path: &Path) -> bool {
    images(path).is_some()
}

/// The best folder of frames in a sequence, with the number of its camera.
fn images(path: &Path) -> Option<(PathBuf, usize)> {
    let mut folders = CAMERAS.iter().map(|(name, camera)| (path.join(name), *camera));
    folders.find(|(folder, _)| common::holds_numbered(folder, "", PICTURES))
}

fn load(path: &Path) -> Result<Sequence, FramesError> {
    let (folder, number) =
        images(path).ok_or_else(|| FramesError::file(path, "holds no frames", "fetch the sequence again"))?;
    let mut warnings = Vec::new();
    let mut frames = common::frames_at(&common::numbered(&folder, "", PICTURES)?, FPS);
    let size = common::first_size(&folder, &frames)?;
    attach_times(path, &mut frames, &mut warnings)?;
    let projection = projection(path, number, &mut warnings)?;
    attach_poses(path, projection.as_ref(), &mut frames, &mut warnings)?;
    let camera = projection.map(|projection| camera(path, &projection, size, &mut warnings)).transpose()?;
    Ok(Sequence {
        format: Format::KittiOdometry,
        name: common::name_of(path),
        root: path.to_path_buf(),
        size,
        fps: Some(FPS),
        camera,
        video: None,
        frames,
        license: Some(LICENSE.into()),
        warnings,
    })
}

fn attach_times(path: &Path, frames: &mut [FrameEntry], warnings: &mut Vec<String>) -> Result<(), FramesError> {
    let file = path.join("times.txt");
    if !file.exists() {
        warnings.push(format!("there is no times.txt: frames are taken to be {FPS} per second"));
        return Ok(());
    }
    let times_s = common::parse_times(&common::read_text(&file)?).map_err(|error| (file.as_path(), error))?;
    common::attach_times(frames, &times_s, &file)
}

/// What `calib.txt` says about camera `number`.
fn projection(path: &Path, number: usize, warnings: &mut Vec<String>) -> Result<Option<Projection>, FramesError> {
    let file = path.join("calib.txt");
    if !file.exists() {
        warnings.push("there is no calib.txt: give the camera with --camera FILE or --hfov".into());
        return Ok(None);
    }
    with_calibration(&file, |calibration| calibration.projection(&format!("P{number}"))).map(Some)
}

fn camera(path: &Path, projection: &Projection, size: Size, warnings: &mut Vec<String>) -> Result<Camera, FramesError> {
    warnings.extend(common::centre_warning(&projection.intrinsics, size));
    projection.camera(size).map_err(|error| common::camera_error(&path.join("calib.txt"), &error))
}

/// Gives the frames their poses from `poses/NN.txt` beside `sequences`, moved from camera 0 to the chosen one.
fn attach_poses(
    path: &Path,
    projection: Option<&Projection>,
    frames: &mut [FrameEntry],
    warnings: &mut Vec<String>,
) -> Result<(), FramesError> {
    let file = pose_file(path);
    if !file.exists() {
        warnings.push(format!("there is no {}, so the frames have no poses", file.display()));
        return Ok(());
    }
    let mut poses = parse_kitti(&common::read_text(&file)?).map_err(|error| (file.as_path(), error))?;
    if let Some(projection) = projection {
        let first_from_camera = projection.camera_from_first.inverse();
        poses.iter_mut().for_each(|pose| *pose *= first_from_camera);
    }
    common::attach_poses(frames, &poses, &file, warnings)
}

/// `poses/NN.txt` of `sequences/NN`.
fn pose_file(path: &Path) -> PathBuf {
    let full = path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
    let root = full.parent().and_then(Path::parent).unwrap_or(&full);
    root.join("poses").join(format!("{}.txt", common::name_of(path)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::fixtures::{lines, loaded, picture, refusal, shared, text};

    const CALIB: &str = "P0: 70 0 60 0 0 70 18 0 0 0 1 0\nP2: 70 0 60 -35 0 70 18 0 0 0 1 0\nTr: 1 0\n";

    fn data_set(root: &Path, name: &str, image: &str, frames: usize) -> PathBuf {
        let sequence = root.join("sequences").join(name);
        for number in 0..frames {
            picture(&sequence.join(image).join(format!("{number:06}.png")), Size::new(124, 37));
        }
        text(&sequence.join("calib.txt"), CALIB);
        text(&sequence.join("times.txt"), &lines(frames, |k| format!("{}", k as f64 * 0.11)));
        // The car drives ahead while it turns by a quarter at the last frame.
        let pose = |k: usize| {
            if k + 1 < frames { format!("1 0 0 0 0 1 0 0 0 0 1 {k}") } else { format!("0 0 1 0 0 1 0 0 -1 0 0 {k}") }
        };
        text(&root.join(format!("poses/{name}.txt")), &lines(frames, pose));
        sequence
    }

    #[test]
    fn the_root_and_the_sequence_are_the_same_data() {
        let root = tempfile::tempdir().unwrap();
        let folder = data_set(root.path(), "07", "image_0", 4);
        for path in [root.path(), &root.path().join("sequences"), &folder] {
            let sequence = loaded(probe(path));
            assert_eq!((sequence.name.as_str(), sequence.frames.len()), ("07", 4));
            assert!((sequence.frames[3].time_s - 0.33).abs() < 1e-12);
            assert!((sequence.trajectory().unwrap().path_length_m() - 3.0).abs() < 1e-12);
            assert!(sequence.warnings.is_empty(), "{:?}", sequence.warnings);
        }
        data_set(root.path(), "08", "image_0", 1);
        assert!(refusal(probe(root.path())).contains("holds 2 sequences (07, 08)"));
    }

    #[test]
    fn poses_are_those_of_the_chosen_camera() {
        let root = tempfile::tempdir().unwrap();
        let folder = data_set(root.path(), "07", "image_0", 3);
        data_set(root.path(), "07", "image_2", 3);
        let sequence = loaded(probe(&folder));
        // P2 places camera 2 half a metre to the right of camera 0 (P = K [I | -0.5 x]); after the turn, right is -z.
        let position = |index: usize| sequence.frames[index].world_from_camera.unwrap().translation.vector;
        assert!((position(1) - nalgebra::Vector3::new(0.5, 0.0, 1.0)).norm() < 1e-12);
        assert!((position(2) - nalgebra::Vector3::new(0.0, 0.0, 1.5)).norm() < 1e-12);
    }

    #[test]
    fn the_first_error_is_named() {
        let root = tempfile::tempdir().unwrap();
        let folder = data_set(root.path(), "07", "image_0", 3);
        let attempts = [
            ("sequences/07/times.txt", "0\n0.1\n0.1\n", "times.txt, line 3: the time 0.1 s does not come after 0.1 s"),
            ("sequences/07/times.txt", "0\n", "times.txt: has 1 times but the frames go up to number 2"),
            ("sequences/07/calib.txt", "P0: 70 0 60\n", "calib.txt, line 1: found 3 values where 12"),
            ("sequences/07/calib.txt", "P1: 70 0 60\n", "calib.txt, line 1: the file ends without an entry P0"),
            ("sequences/07/calib.txt", "P0: 0 0 60 0 0 70 18 0 0 0 1 0", "calib.txt, line 1: P0: its focal lengths"),
            ("poses/07.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 2 3\n", "07.txt, line 2: found 3 values where 12"),
            ("poses/07.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", "07.txt: has 1 poses but"),
        ];
        for (file, wrong, sentence) in attempts {
            let right = std::fs::read_to_string(root.path().join(file)).unwrap();
            text(&root.path().join(file), wrong);
            let error = refusal(probe(&folder));
            assert!(error.contains(sentence), "{error}");
            text(&root.path().join(file), &right);
        }
        assert!(probe(&root.path().join("poses")).is_none());
    }

    #[test]
    fn missing_files_are_warnings() {
        let root = tempfile::tempdir().unwrap();
        picture(&root.path().join("image_2/000000.png"), Size::new(124, 37));
        let sequence = loaded(probe(root.path()));
        assert!(sequence.camera.is_none() && !sequence.has_poses());
        assert_eq!(sequence.warnings.len(), 3);
    }

    #[test]
    fn the_real_excerpt_has_its_known_length() {
        let Some(root) = shared("kitti-odometry") else { return };
        for path in [root.clone(), root.join("sequences/00")] {
            let sequence = loaded(probe(&path));
            assert_eq!((sequence.frames.len(), sequence.name.as_str()), (300, "00"));
            let length_m = sequence.trajectory().unwrap().path_length_m();
            assert!((length_m - 216.0).abs() < 0.5, "{length_m}");
            assert!(sequence.camera.is_some() && sequence.warnings.is_empty(), "{:?}", sequence.warnings);
        }
    }
}
