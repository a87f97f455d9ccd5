//! EndoSLAM's real recordings (Mendeley cd2rtzm23r, `Cameras/<camera>/<organ>/Tumor{free,ous}Trajectory_i`).
//!
//! `Frames/frame_NNNNNN.jpg` and one workbook `Poses/*.xlsx` whose columns `ImageFrame`, `trans_x..z` (metres) and
//! `quot_x..w` are found by name. The rows are joined to the frames by number; they seldom pair one to one.

mod workbook;

pub use workbook::{PoseRow, parse_workbook};

use super::{Probe, common, numbered};
use crate::{Format, FramesError, Sequence, picture};
use endoscape_core::camera::{Intrinsics, RadialTangential};
use endoscape_core::{Camera, Size};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

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
    let pictures = numbered::list(&folder, "frame_", &["jpg", "jpeg", "png"])?;
    let first = pictures.values().next().ok_or_else(|| numbered::none_found(&folder, "frame_000000.jpg"))?;
    let size = picture::size(first)?;
    let mut warnings = Vec::new();
    let device = device(path);
    let camera = camera(path, device, size, &mut warnings)?;
    let fps = frame_rate(device, &mut warnings);
    let rows = parse_workbook(&common::read_bytes(workbook, LARGEST_WORKBOOK)?).map_err(|error| error.at(workbook))?;
    let frame = |(number, picture): (&usize, &PathBuf)| common::frame_of(picture, *number, *number as f64 / fps);
    let mut sequence = Sequence {
        format: Format::Endoslam,
        name: common::name_of(path),
        root: path.to_path_buf(),
        size,
        fps: Some(fps),
        camera,
        video: None,
        frames: pictures.iter().map(frame).collect(),
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
    let invalid = |error: endoscape_core::CameraError| FramesError::file(path, error.to_string(), "check the frames");
    let camera = Camera::new(size, lens.into()).map_err(invalid)?;
    common::fit_camera(camera, frames, warnings).map(Some).map_err(invalid)
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
