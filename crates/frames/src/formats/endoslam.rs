//! EndoSLAM's real recordings (Mendeley cd2rtzm23r, `Cameras/<camera>/<organ>/Tumor{free,ous}Trajectory_i`).
//!
//! `Frames/frame_NNNNNN.jpg` and one workbook `Poses/*.xlsx` whose columns `ImageFrame`, `trans_x..z` (metres) and
//! `quot_x..w` are found by name. The rows are joined to the frames by number; they seldom pair one to one.

mod workbook;

pub use workbook::{PoseRow, parse_workbook};

use super::{Probe, common};
use crate::{Format, FramesError, Sequence};
use endoscape_core::camera::{Intrinsics, RadialTangential};
use endoscape_core::{Camera, Size};
use std::collections::BTreeMap;
use std::path::Path;

/// Largest workbook read, in bytes; real ones have less than a megabyte.
const LARGEST_WORKBOOK: u64 = 64 << 20;

/// What the data set's paper states about a camera (K. B. Ozyoruk et al., Medical Image Analysis 2021).
struct Device {
    name: &'static str,
    fps: f64,
    /// The calibration with the size its pictures have, for the cameras whose numbers are public.
    lens: Option<(Size, RadialTangential)>,
}

const fn lens(fx: f64, fy: f64, cx: f64, cy: f64, skew: f64, k: [f64; 2]) -> RadialTangential {
    let intrinsics = Intrinsics { fx, fy, cx, cy, skew };
    RadialTangential { intrinsics, k1: k[0], k2: k[1], p1: 0.0, p2: 0.0, k3: 0.0, k4: 0.0, k5: 0.0, k6: 0.0 }
}

/// The HighCam is described as 1280x720, but its files are 640x480 and the calibration is for those.
const DEVICES: [Device; 4] = [
    Device {
        name: "HighCam",
        fps: 20.0,
        lens: Some((Size::new(640, 480), lens(957.411, 959.386, 282.192, 170.731, 5.6242, [0.2533, -0.2085]))),
    },
    Device { name: "LowCam", fps: 20.0, lens: None },
    Device { name: "PillCam", fps: 4.0, lens: None },
    Device {
        name: "MiroCam",
        fps: 3.0,
        lens: Some((Size::new(320, 320), lens(156.0418, 155.7529, 178.5604, 181.8043, 0.0, [-0.2486, 0.0614]))),
    },
];

/// Answers whether `path` holds this format, and loads it.
pub fn probe(path: &Path) -> Probe {
    if !path.join("Frames").is_dir() {
        return None;
    }
    let workbooks = common::list(&path.join("Poses"), |name| name.to_lowercase().ends_with(".xlsx")).ok()?;
    match workbooks.as_slice() {
        [] => None,
        [workbook] => Some(load(path, workbook)),
        [_, second, ..] => {
            Some(Err(FramesError::file(second, "is a second workbook beside another", "move one of the two away")))
        }
    }
}

fn load(path: &Path, workbook: &Path) -> Result<Sequence, FramesError> {
    let folder = path.join("Frames");
    let mut warnings = Vec::new();
    let device = device(path);
    let fps = frame_rate(device, &mut warnings);
    let frames = common::frames_at(&common::numbered(&folder, "frame_", &[".jpg", ".jpeg", ".png"])?, fps);
    let size = common::first_size(&folder, &frames)?;
    let camera = camera(path, device, size, &mut warnings)?;
    let rows = parse_workbook(&common::read_bytes(workbook, LARGEST_WORKBOOK)?).map_err(|error| error.at(workbook))?;
    let mut sequence = Sequence {
        format: Format::Endoslam,
        name: common::name_of(path),
        root: path.to_path_buf(),
        size,
        fps: Some(fps),
        camera,
        video: None,
        frames,
        license: None,
        warnings,
    };
    join(&mut sequence, &rows);
    Ok(sequence)
}

/// Gives every frame the first pose whose `ImageFrame` is its number.
fn join(sequence: &mut Sequence, rows: &[PoseRow]) {
    let mut poses = BTreeMap::new();
    for row in rows {
        poses.entry(row.frame).or_insert(row.world_from_camera);
    }
    for frame in &mut sequence.frames {
        frame.world_from_camera = poses.get(&frame.number).copied();
    }
    let matched = sequence.frames.iter().filter(|frame| frame.world_from_camera.is_some()).count();
    if poses.len() < rows.len() {
        let repeated = rows.len() - poses.len();
        sequence.warnings.push(format!("{repeated} rows repeat the ImageFrame of an earlier row and were dropped"));
    }
    sequence.warnings.extend(common::pairing_warning(sequence.frames.len(), poses.len(), matched));
}

/// The device named by a folder above the sequence.
fn device(path: &Path) -> Option<&'static Device> {
    let full = path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
    let named = |device: &&Device| full.components().any(|part| part.as_os_str().eq_ignore_ascii_case(device.name));
    DEVICES.iter().find(named)
}

fn camera(
    path: &Path,
    device: Option<&Device>,
    frames: Size,
    warnings: &mut Vec<String>,
) -> Result<Option<Camera>, FramesError> {
    let Some((size, lens)) = device.and_then(|device| device.lens) else {
        warnings.push("no calibration of this camera is known: give one with --camera".into());
        return Ok(None);
    };
    Camera::new(size, lens.into())
        .and_then(|camera| common::fit_camera(camera, frames, warnings))
        .map(Some)
        .map_err(|error| common::camera_error(path, &error))
}

fn frame_rate(device: Option<&Device>, warnings: &mut Vec<String>) -> f64 {
    match device {
        Some(device) => {
            if device.name == "PillCam" {
                warnings.push("the PillCam changes its frame rate between 4 and 35 per second: 4 was assumed".into());
            }
            device.fps
        }
        None => {
            warnings.push(
                "no folder above names the camera (HighCam, LowCam, PillCam, MiroCam): 20 frames per second assumed"
                    .into(),
            );
            20.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::fixtures::{loaded, picture, refusal};
    use rust_xlsxwriter::Workbook;

    const COLUMNS: [&str; 10] =
        ["", "ImageFrame", "Pose_Index", "trans_x", "trans_y", "trans_z", "quot_x", "quot_y", "quot_z", "quot_w"];

    /// A workbook with these frames at x = 1, 2, ... metres.
    fn workbook(frames: &[u32]) -> Workbook {
        let mut workbook = Workbook::new();
        let sheet = workbook.add_worksheet();
        for (column, name) in COLUMNS.iter().enumerate() {
            sheet.write(0, column as u16, *name).unwrap();
        }
        for (row, frame) in (1..).zip(frames) {
            let numbers = [f64::from(row) - 1.0, f64::from(*frame), 5.0, f64::from(row), 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
            for (column, number) in numbers.into_iter().enumerate() {
                sheet.write(row, column as u16, number).unwrap();
            }
        }
        workbook
    }

    fn fixture(workbook: &mut Workbook) -> (tempfile::TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("HighCam/Colon-IV/TumorfreeTrajectory_1");
        for number in 0..3 {
            picture(&path.join(format!("Frames/frame_{number:06}.jpg")), Size::new(64, 48));
        }
        std::fs::create_dir_all(path.join("Poses")).unwrap();
        workbook.save(path.join("Poses/low_high_pose.xlsx")).unwrap();
        (folder, path)
    }

    #[test]
    fn rows_are_joined_by_frame_number() {
        let (_folder, path) = fixture(&mut workbook(&[0, 2, 2, 7]));
        let sequence = loaded(probe(&path));
        let x = |index: usize| sequence.frames[index].world_from_camera.map(|pose| pose.translation.x);
        assert_eq!((x(0), x(1), x(2)), (Some(1.0), None, Some(2.0)));
        assert_eq!((sequence.fps, sequence.frames[2].time_s), (Some(20.0), 0.1));
        let endoscape_core::CameraModel::RadialTangential(lens) = *sequence.camera.unwrap().model() else { panic!() };
        assert!((lens.intrinsics.skew - 0.56242).abs() < 1e-9 && lens.k1 == 0.2533);
        let told = ["2 of 3 frames have a pose; 1 of 3 poses", "1 rows repeat", "the intrinsics were scaled"];
        assert!(told.iter().all(|told| sequence.warnings.iter().any(|w| w.contains(told))), "{:?}", sequence.warnings);
    }

    #[test]
    fn faults_name_the_row() {
        let mut book = workbook(&[0, 1]);
        book.worksheet_from_index(0).unwrap().write(2, 4, "n/a").unwrap();
        let sentence = refusal(probe(&fixture(&mut book).1));
        assert!(sentence.contains("low_high_pose.xlsx, line 3: trans_y is `n/a`"), "{sentence}");
        let mut book = workbook(&[0]);
        book.worksheet_from_index(0).unwrap().write(0, 9, "w").unwrap();
        let sentence = refusal(probe(&fixture(&mut book).1));
        assert!(sentence.contains("line 1: has no column quot_w"), "{sentence}");
    }

    #[test]
    fn an_unreadable_workbook_is_a_sentence() {
        let (_folder, path) = fixture(&mut workbook(&[0]));
        std::fs::write(path.join("Poses/low_high_pose.xlsx"), b"PK\x03\x04 not really").unwrap();
        let sentence = refusal(probe(&path));
        assert!(sentence.contains("low_high_pose.xlsx: is no readable XLSX workbook"), "{sentence}");
    }

    #[test]
    fn a_far_cell_costs_nothing() {
        let mut book = workbook(&[0]);
        book.worksheet_from_index(0).unwrap().write(1_048_575, 16_383, 1).unwrap();
        let bytes = book.save_to_buffer().unwrap();
        assert_eq!(parse_workbook(&bytes).unwrap().len(), 1);
    }
}
