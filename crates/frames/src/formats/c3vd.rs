//! C3VD, first release: a colonoscope in a silicone colon with registered depth and poses.
//!
//! One folder per sequence holds `N_color.png` (padded with zeros or not), `NNNN_depth.tiff` and `pose.txt`. Line `k` of
//! `pose.txt`, counted from 0, belongs to frame number `k`: 16 comma-separated values, `world_from_camera` column by
//! column, in millimetres. T. Bobrow et al., "Colonoscopy 3D video dataset with paired depth from 2D-3D registration",
//! Medical Image Analysis 90 (2023).

use super::{Format, Probe, common};
use crate::depth::DepthEncoding;
use crate::{FramesError, Sequence};
use endoscape_core::camera::Omnidirectional;
use endoscape_core::trajectory::{TextError, numbers, records};
use endoscape_core::{Camera, CameraError, Pose, Size, se3};
use nalgebra::{Matrix3, Vector3};
use std::path::Path;

/// Frames per second of the recordings.
pub const FPS: f64 = 29.97;

/// Licence the data set states.
pub const LICENSE: &str = "CC BY-NC-SA 4.0";

/// The full 16-bit range stands for 100 mm; 65535 itself, like 0, is no measurement.
pub const DEPTH: DepthEncoding = DepthEncoding::Linear { metres_per_unit: 0.1 / 65535.0, largest: 65534 };

/// Size of the recordings in pixels.
pub const RECORDED: Size = Size::new(1350, 1080);

const COLOR: &[&str] = &["_color.png", "_color.jpg", "_color.jpeg"];

/// Answers whether `path` holds this format, and loads it.
pub fn probe(path: &Path) -> Probe {
    if recognised(path) { Some(load(path)) } else { common::only_sequence(path, recognised, load) }
}

fn recognised(path: &Path) -> bool {
    common::holds_numbered(path, "", COLOR)
}

fn load(path: &Path) -> Result<Sequence, FramesError> {
    let mut warnings = Vec::new();
    let mut frames = common::frames_at(&common::numbered(path, "", COLOR)?, FPS);
    let size = common::first_size(path, &frames)?;
    let camera = camera_for(size, &mut warnings).map_err(|error| common::camera_error(path, &error))?;
    let maps = common::numbered(path, "", &["_depth.tiff", "_depth.tif"])?;
    common::attach_depth(&mut frames, maps, &DEPTH, &mut warnings);
    attach_pose_file(path, &mut frames, &mut warnings)?;
    Ok(Sequence {
        format: Format::C3vd,
        name: common::name_of(path),
        root: path.to_path_buf(),
        size,
        fps: Some(FPS),
        camera: Some(camera),
        video: None,
        frames,
        license: Some(LICENSE.into()),
        warnings,
    })
}

/// Gives each frame its pose from `pose.txt` in `folder`, if that exists.
///
/// # Errors
/// [`FramesError`] with the first wrong line, or if the file ends before the last frame.
pub fn attach_pose_file(
    folder: &Path,
    frames: &mut [crate::FrameEntry],
    warnings: &mut Vec<String>,
) -> Result<(), FramesError> {
    let file = folder.join("pose.txt");
    if !file.exists() {
        warnings.push("there is no pose.txt, so the frames have no poses".into());
        return Ok(());
    }
    let poses = parse_poses(&common::read_text(&file)?).map_err(|error| (file.as_path(), error))?;
    common::attach_poses(frames, &poses, &file, warnings)
}

/// Reads `pose.txt`: per line the 16 values of a 4x4 `world_from_camera`, column by column, translation in millimetres.
///
/// # Errors
/// [`TextError`] at the first line that does not hold 16 finite numbers forming a rigid motion.
pub fn parse_poses(text: &str) -> Result<Vec<Pose>, TextError> {
    records(text)
        .map(|(line, record)| {
            let n: [f64; 16] = numbers(line, record.split(',').map(str::trim), "a 4x4 matrix column by column")?;
            if [n[3], n[7], n[11], n[15] - 1.0].iter().any(|value| value.abs() > 1e-6) {
                let reason = "the 4th, 8th, 12th and 16th values must be 0, 0, 0, 1 (a matrix column by column)".into();
                return Err(TextError { line, reason });
            }
            let rotation = Matrix3::from_column_slice(&[n[0], n[1], n[2], n[4], n[5], n[6], n[8], n[9], n[10]]);
            se3::from_matrix(&rotation, &(Vector3::new(n[12], n[13], n[14]) * 1e-3))
                .map_err(|error| TextError { line, reason: error.to_string() })
        })
        .collect()
}

/// The colonoscope as its makers calibrated it, for frames of the recorded 1350x1080 pixels.
pub fn recorded_camera() -> Result<Camera, CameraError> {
    let model = Omnidirectional {
        cx: 678.544839263292,
        cy: 542.975887548343,
        polynomial: [769.243600037458, 0.0, -8.12770624150226e-4, 6.25674244578925e-7, -1.1966218214428e-9],
        stretch: [[0.99998688, 0.00288274], [-0.00296317, 1.0]],
    };
    Camera::new(RECORDED, model.into())
}

/// The same camera for frames of `size`, with warnings where they were resized or may have been cropped.
pub fn camera_for(size: Size, warnings: &mut Vec<String>) -> Result<Camera, CameraError> {
    let camera = common::fit_camera(recorded_camera()?, size, warnings)?;
    if size.area() > 0 && !same_shape(size, RECORDED) {
        warnings.push(format!(
            "the frames are {size}, another shape than the recorded {RECORDED}: if they were cropped rather than \
             squeezed, give their camera with --camera FILE"
        ));
    }
    Ok(camera)
}

/// Whether two sizes have one aspect ratio up to rounding to whole pixels.
fn same_shape(a: Size, b: Size) -> bool {
    let (across, down) = (a.width as f64 / b.width as f64, a.height as f64 / b.height as f64);
    (across / down - 1.0).abs() < 0.01
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::fixtures::{lines, loaded, picture, refusal, shared, text};
    use proptest::prelude::*;

    fn pose_line(x_mm: usize) -> String {
        format!("1,0,0,0,0,1,0,0,0,0,1,0,{x_mm},0,0,1")
    }

    fn sequence(folder: &Path, frames: usize, poses: usize) {
        for number in 0..frames {
            picture(&folder.join(format!("{number}_color.png")), Size::new(135, 108));
        }
        text(&folder.join("0002_depth.tiff"), "");
        text(&folder.join("pose.txt"), &lines(poses, pose_line));
    }

    #[test]
    fn frames_poses_and_depth_meet_by_number() {
        let folder = tempfile::tempdir().unwrap();
        sequence(folder.path(), 12, 12);
        let sequence = loaded(probe(folder.path()));
        assert_eq!(sequence.frames.iter().map(|frame| frame.number).collect::<Vec<_>>(), (0..12).collect::<Vec<_>>());
        assert!((sequence.trajectory().unwrap().path_length_m() - 0.011).abs() < 1e-12);
        assert!(sequence.frames[2].depth.is_some() && sequence.frames[1].depth.is_none());
        assert_eq!(sequence.camera.unwrap().size(), Size::new(135, 108));
        assert_eq!(sequence.warnings.len(), 1, "{:?}", sequence.warnings);
        assert!(sequence.warnings[0].contains("scaled"));
    }

    #[test]
    fn too_few_poses_are_an_error_and_too_many_a_warning() {
        let folder = tempfile::tempdir().unwrap();
        sequence(folder.path(), 5, 3);
        let error = refusal(probe(folder.path()));
        assert!(error.contains("pose.txt: has 3 poses but the frames go up to number 4"), "{error}");
        sequence(folder.path(), 5, 9);
        let warnings = loaded(probe(folder.path())).warnings;
        assert!(warnings.iter().any(|warning| warning.contains("4 of 9 poses belong to no frame")), "{warnings:?}");
    }

    #[test]
    fn the_first_wrong_line_is_named() {
        let folder = tempfile::tempdir().unwrap();
        sequence(folder.path(), 3, 3);
        let wrong = [
            ("1,0,0,0,0,1,0,0,0,0,1,0,5,0,0", "found 15 values where 16"),
            ("1,0,0,0,0,1,0,0,0,0,1,0,nan,0,0,1", "`nan` is not a finite number"),
            ("2,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1", "not a rotation"),
            ("1,0,0,5,0,1,0,0,0,0,1,0,0,0,0,1", "column by column"),
        ];
        for (line, reason) in wrong {
            text(&folder.path().join("pose.txt"), &format!("{}\n{line}\n{}\n", pose_line(0), pose_line(2)));
            let error = refusal(probe(folder.path()));
            assert!(error.contains("pose.txt, line 2: ") && error.contains(reason), "{error}");
        }
    }

    #[test]
    fn frames_alone_are_enough_and_other_pictures_are_not_claimed() {
        let folder = tempfile::tempdir().unwrap();
        picture(&folder.path().join("color_1.png"), Size::new(8, 8));
        picture(&folder.path().join("1.png"), Size::new(8, 8));
        assert!(probe(folder.path()).is_none());
        picture(&folder.path().join("0001_color.png"), Size::new(64, 64));
        let sequence = loaded(probe(folder.path()));
        assert!(!sequence.has_poses());
        assert!(sequence.warnings.iter().any(|warning| warning.contains("another shape")));
    }

    #[test]
    fn the_real_sequence_has_its_known_length() {
        let Some(folder) = shared("c3vd/cecum_t1_a") else { return };
        let sequence = loaded(probe(&folder));
        assert_eq!((sequence.frames.len(), sequence.size), (150, RECORDED));
        assert_eq!(sequence.frames.iter().filter(|frame| frame.depth.is_some()).count(), 5);
        let length_m = sequence.trajectory().unwrap().path_length_m();
        assert!((length_m - 0.0363).abs() < 0.00005, "{length_m}");
        assert!(sequence.warnings.is_empty(), "{:?}", sequence.warnings);
        let original = loaded(probe(&shared("c3vd/cecum_t1_a_original_files").unwrap()));
        assert_eq!(original.frames.len(), 1);
        assert_eq!(original.warnings, ["1 of 1 frames have a pose; 149 of 150 poses belong to no frame"]);
    }

    proptest! {
        #[test]
        fn any_text_is_answered(text in "([-0-9.e,]{0,4}|1,0,0,0,0,1,0,0,0,0,1,0,|\n){0,20}") {
            let _ = parse_poses(&text);
        }
    }
}
