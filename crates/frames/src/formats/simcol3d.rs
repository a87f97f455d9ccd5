//! SimCol3D: rendered colonoscopies, `FrameBuffer_NNNN.png` and `Depth_NNNN.png` in one folder per path.
//!
//! Beside the folder `Frames_X` stand `SavedPosition_X.txt` (centimetres) and `SavedRotationQuaternion_X.txt`
//! (x y z w), line `k` for frame `k`, and the `cam.txt` all paths share. The renderer's axes are left-handed (y up);
//! `world_from_camera` follows by mirroring y on both sides. A. Rau et al., arXiv 2307.11261 (2023).
//!
//! The published `cam.txt` reads `227.60416 0 227.60416 0 237.5 237.5 0 0 1`: taken literally, a square render with
//! unequal focal lengths and a centre off the middle, most likely `fy` and `cx` in each other's place. The default is
//! the corrected reading, with a warning; [`literal_camera`] is the other one.

use super::{Format, Probe, common};
use crate::depth::DepthEncoding;
use crate::{FrameEntry, FramesError, Sequence};
use endoscape_core::camera::{Intrinsics, Pinhole};
use endoscape_core::trajectory::{TextError, numbers, records};
use endoscape_core::{Camera, CameraError, Pose, Size, se3};
use std::path::{Path, PathBuf};

/// No frame rate is stated; frames are put in time at the rate of ordinary video.
const ASSUMED_FPS: f64 = 30.0;

/// Size of the renders in pixels.
const RENDERED: Size = Size::new(475, 475);

/// The focal length and the centre of the renders, in pixels.
const FOCAL: f64 = 227.60416;
const CENTRE: f64 = 237.5;

/// 256 x (0 ..= 255) stands for 0 to 20 cm; 0 is no measurement.
const DEPTH: DepthEncoding = DepthEncoding::Linear { metres_per_unit: 0.20 / (256.0 * 255.0), largest: u16::MAX };

const FRAME: &str = "FrameBuffer_";

/// Answers whether `path` holds this format, and loads it.
pub fn probe(path: &Path) -> Probe {
    if recognised(path) { Some(load(path)) } else { common::only_sequence(path, recognised, load) }
}

fn recognised(path: &Path) -> bool {
    common::holds_numbered(path, FRAME, &[".png"])
}

fn load(path: &Path) -> Result<Sequence, FramesError> {
    let mut warnings = vec![format!("no frame rate is stated: frames are put in time at {ASSUMED_FPS} per second")];
    let mut frames = common::frames_at(&common::numbered(path, FRAME, &[".png"])?, ASSUMED_FPS);
    let size = common::first_size(path, &frames)?;
    let maps = common::numbered(path, "Depth_", &[".png"])?;
    common::attach_depth(&mut frames, maps, &DEPTH, &mut warnings);
    attach_poses(path, &mut frames, &mut warnings)?;
    Ok(Sequence {
        format: Format::Simcol3d,
        name: common::name_of(path),
        root: path.to_path_buf(),
        size,
        fps: None,
        camera: Some(camera(path, size, &mut warnings)?),
        video: None,
        frames,
        license: Some("CC BY-NC-SA 4.0".into()),
        warnings,
    })
}

/// The renderer's camera with equal focal lengths and its centre in the middle, for frames of `size`.
///
/// # Errors
/// [`CameraError::Empty`] for a size without pixels.
pub fn fixed_camera(size: Size) -> Result<Camera, CameraError> {
    camera_of(Intrinsics { fx: FOCAL, fy: FOCAL, cx: CENTRE, cy: CENTRE, skew: 0.0 }, size)
}

/// The camera as the published `cam.txt` literally reads, for frames of `size`.
///
/// # Errors
/// [`CameraError::Empty`] for a size without pixels.
pub fn literal_camera(size: Size) -> Result<Camera, CameraError> {
    camera_of(Intrinsics { fx: FOCAL, fy: CENTRE, cx: FOCAL, cy: CENTRE, skew: 0.0 }, size)
}

fn camera_of(intrinsics: Intrinsics, size: Size) -> Result<Camera, CameraError> {
    Camera::new(RENDERED, Pinhole { intrinsics }.into())?.scaled_to(size)
}

/// The camera of `cam.txt`, corrected where that holds the published slip, or the known one where there is none.
fn camera(path: &Path, size: Size, warnings: &mut Vec<String>) -> Result<Camera, FramesError> {
    let (_, parent) = beside(path);
    let file = parent.join("cam.txt");
    let camera = if file.is_file() {
        let stated = parse_camera(&common::read_text(&file)?).map_err(|error| (file.as_path(), error))?;
        if swapped(&stated) {
            warnings.push(
                "cam.txt holds fy and cx in each other's place: read as fx = fy = 227.604, cx = cy = 237.5; choose \
                 --simcol-k literal to take it as it stands"
                    .into(),
            );
            fixed_camera(size)
        } else {
            camera_of(stated, size)
        }
    } else {
        warnings.push("there is no cam.txt: the known camera of the renders is used".into());
        fixed_camera(size)
    };
    if size != RENDERED {
        warnings.push(format!("the frames are {size} but the renders were {RENDERED}: the intrinsics were scaled"));
    }
    camera.map_err(|error| common::camera_error(&file, &error))
}

/// Whether intrinsics show the published slip: `cx` repeats `fx` and `fy` repeats `cy`.
fn swapped(intrinsics: &Intrinsics) -> bool {
    let Intrinsics { fx, fy, cx, cy, .. } = *intrinsics;
    fx != fy && fx == cx && fy == cy
}

/// Reads `cam.txt`: the nine numbers of a camera matrix row by row, on one line or several.
///
/// # Errors
/// [`TextError`] on line 1 unless there are nine finite numbers.
pub fn parse_camera(text: &str) -> Result<Intrinsics, TextError> {
    let fields = text.split(|c: char| c.is_whitespace() || c == ',').filter(|field| !field.is_empty());
    let n: [f64; 9] = numbers(1, fields.take(10), "a 3x3 camera matrix row by row")?;
    Ok(Intrinsics { fx: n[0], fy: n[4], cx: n[2], cy: n[5], skew: n[1] })
}

/// Name of the path without `Frames_`, and the folder that holds what belongs to it.
fn beside(path: &Path) -> (String, PathBuf) {
    let full = path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
    let name = common::name_of(path);
    let suffix = name.strip_prefix("Frames_").unwrap_or(&name).to_owned();
    (suffix, full.parent().map_or_else(|| full.clone(), Path::to_path_buf))
}

fn attach_poses(path: &Path, frames: &mut [FrameEntry], warnings: &mut Vec<String>) -> Result<(), FramesError> {
    let (suffix, parent) = beside(path);
    let positions = parent.join(format!("SavedPosition_{suffix}.txt"));
    let rotations = parent.join(format!("SavedRotationQuaternion_{suffix}.txt"));
    if !positions.exists() && !rotations.exists() {
        warnings.push(format!("there is no SavedPosition_{suffix}.txt beside the folder, so the frames have no poses"));
        return Ok(());
    }
    let position_text = common::read_text(&positions)?;
    let rotation_text = common::read_text(&rotations)?;
    let positions_cm = parse_positions(&position_text).map_err(|error| (positions.as_path(), error))?;
    let turns = parse_rotations(&rotation_text).map_err(|error| (rotations.as_path(), error))?;
    if positions_cm.len() != turns.len() {
        let reason = format!("has {} rotations for {} positions", turns.len(), positions_cm.len());
        return Err(FramesError::file(&rotations, reason, "fetch both files again"));
    }
    let poses = positions_cm.iter().zip(&turns).map(|(position, turn)| mirrored(*position, turn)).collect::<Vec<_>>();
    common::attach_poses(frames, &poses, &positions, warnings)
}

/// `diag(1, -1, 1, 1) P diag(1, -1, 1, 1)`: mirroring y negates the y of the position and, in the quaternion, the
/// turns about x and z.
fn mirrored(position_cm: [f64; 3], turn: &Pose) -> Pose {
    let [x, y, z] = position_cm.map(|value| 0.01 * value);
    let q = turn.rotation.quaternion();
    let mirrored = nalgebra::Quaternion::new(q.w, -q.i, q.j, -q.k);
    Pose::from_parts(nalgebra::Translation3::new(x, -y, z), nalgebra::Unit::new_unchecked(mirrored))
}

/// Reads `SavedPosition_X.txt`: `x y z` in centimetres per line.
///
/// # Errors
/// [`TextError`] at the first line that does not hold three finite numbers.
pub fn parse_positions(text: &str) -> Result<Vec<[f64; 3]>, TextError> {
    records(text).map(|(line, record)| numbers(line, record.split_whitespace(), "x y z")).collect()
}

/// Reads `SavedRotationQuaternion_X.txt`: `x y z w` per line, as motions without translation.
///
/// # Errors
/// [`TextError`] at the first line that does not hold four finite numbers of norm near 1.
pub fn parse_rotations(text: &str) -> Result<Vec<Pose>, TextError> {
    records(text)
        .map(|(line, record)| {
            let xyzw = numbers(line, record.split_whitespace(), "x y z w")?;
            se3::from_quaternion([0.0; 3], xyzw).map_err(|error| TextError { line, reason: error.to_string() })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::fixtures::{lines, loaded, picture, refusal, shared, text};
    use proptest::prelude::*;

    const LITERAL: &str = "227.60416 0 227.60416 0 237.5 237.5 0 0 1";

    fn data_set(root: &Path, frames: usize) -> PathBuf {
        let folder = root.join("Frames_S1");
        for number in 0..frames {
            picture(&folder.join(format!("FrameBuffer_{number:04}.png")), Size::new(95, 95));
            picture(&folder.join(format!("Depth_{number:04}.png")), Size::new(95, 95));
        }
        text(&root.join("SavedPosition_S1.txt"), &lines(frames, |k| format!("0 {k} 0")));
        text(&root.join("SavedRotationQuaternion_S1.txt"), &lines(frames, |_| "0 0 0.6 0.8".into()));
        text(&root.join("cam.txt"), LITERAL);
        folder
    }

    #[test]
    fn up_becomes_minus_y_and_centimetres_metres() {
        let root = tempfile::tempdir().unwrap();
        let folder = data_set(root.path(), 3);
        for path in [root.path(), &folder] {
            let sequence = loaded(probe(path));
            let pose = sequence.frames[2].world_from_camera.unwrap();
            assert!((pose.translation.vector - nalgebra::Vector3::new(0.0, -0.02, 0.0)).norm() < 1e-15);
            assert!(sequence.frames.iter().all(|frame| frame.depth.is_some()));
            assert!(sequence.warnings.iter().any(|warning| warning.contains("--simcol-k literal")));
        }
    }

    #[test]
    fn only_the_published_slip_is_corrected() {
        let root = tempfile::tempdir().unwrap();
        let folder = data_set(root.path(), 1);
        let size = Size::new(95, 95);
        assert_eq!(loaded(probe(&folder)).camera.unwrap(), fixed_camera(size).unwrap());
        text(&root.path().join("cam.txt"), "200 0 230\n0 210 240\n0 0 1\n");
        let camera = loaded(probe(&folder)).camera.unwrap();
        let expected = Intrinsics { fx: 200.0, fy: 210.0, cx: 230.0, cy: 240.0, skew: 0.0 };
        assert_eq!(camera, camera_of(expected, size).unwrap());
        let literal = literal_camera(RENDERED).unwrap();
        let corner = literal.project(&nalgebra::Point3::new(1.0, 1.0, 1.0)).unwrap();
        assert!((corner.x - 2.0 * FOCAL).abs() < 1e-9 && (corner.y - 2.0 * CENTRE).abs() < 1e-9);
        assert!(swapped(&parse_camera(LITERAL).unwrap()));
    }

    #[test]
    fn the_first_wrong_line_is_named() {
        let root = tempfile::tempdir().unwrap();
        let folder = data_set(root.path(), 3);
        let attempts = [
            ("SavedPosition_S1.txt", "0 0 0\n0 0\n", "SavedPosition_S1.txt, line 2: found 2 values where 3"),
            ("SavedPosition_S1.txt", "0 0 0\n", "has 3 rotations for 1 positions"),
            ("SavedRotationQuaternion_S1.txt", "0 0 0 1\n0 0 0 0\n", "Quaternion_S1.txt, line 2: the quaternion"),
            ("cam.txt", "1 2 3", "cam.txt, line 1: found 3 values where 9"),
        ];
        for (file, wrong, sentence) in attempts {
            let right = std::fs::read_to_string(root.path().join(file)).unwrap();
            text(&root.path().join(file), wrong);
            let error = refusal(probe(&folder));
            assert!(error.contains(sentence), "{error}");
            text(&root.path().join(file), &right);
        }
        std::fs::remove_file(root.path().join("SavedRotationQuaternion_S1.txt")).unwrap();
        assert!(refusal(probe(&folder)).contains("no such file"));
    }

    #[test]
    fn two_data_sets_in_one_folder_are_not_guessed_at() {
        let root = tempfile::tempdir().unwrap();
        let folder = data_set(root.path(), 1);
        picture(&folder.join("0_color.png"), Size::new(135, 108));
        let error = crate::formats::open(&folder, None).unwrap_err().to_string();
        assert!(error.contains("two data sets at once (c3vd, simcol3d)"), "{error}");
    }

    #[test]
    fn the_real_frames_load() {
        let Some(folder) = shared("simcol3d/Frames") else { return };
        let sequence = loaded(probe(&folder));
        assert_eq!((sequence.frames.len(), sequence.size), (10, RENDERED));
        assert!(sequence.frames.iter().all(|frame| frame.depth.is_some()) && !sequence.has_poses());
        let degrees = sequence.camera.unwrap().horizontal_field_of_view_rad().unwrap().to_degrees();
        assert!((degrees - 92.4).abs() < 0.1, "{degrees}");
    }

    proptest! {
        #[test]
        fn mirroring_is_conjugation(axis in prop::array::uniform3(-1.0..1.0_f64), position in prop::array::uniform3(-9.0..9.0)) {
            let turn = Pose::new(nalgebra::Vector3::zeros(), axis.into());
            let flip = nalgebra::Matrix4::from_diagonal(&nalgebra::Vector4::new(1.0, -1.0, 1.0, 1.0));
            let mut stored = turn.to_homogeneous();
            stored.fixed_view_mut::<3, 1>(0, 3).copy_from(&(nalgebra::Vector3::from(position) * 0.01));
            let expected = flip * stored * flip;
            prop_assert!((mirrored(position, &turn).to_homogeneous() - expected).amax() < 1e-12);
        }

        #[test]
        fn any_text_is_answered(text in "[-0-9eE. \n]{0,100}") {
            let _ = (parse_camera(&text), parse_positions(&text), parse_rotations(&text));
        }
    }
}
