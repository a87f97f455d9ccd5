//! TUM RGB-D: `rgb.txt`, `depth.txt` and `groundtruth.txt` over folders of pictures named by their times.
//!
//! Depth is paired with the frame nearest in time, within 20 ms as the benchmark's own tools do; poses are
//! interpolated to the frames' times. J. Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS
//! 2012.

use super::{Format, Probe, common};
use crate::depth::{DepthEncoding, DepthFile};
use crate::{FrameEntry, FramesError, Sequence};
use endoscape_core::camera::{Intrinsics, RadialTangential};
use endoscape_core::trajectory::{TextError, parse_tum, records};
use endoscape_core::{Camera, CameraError, Size};
use std::path::Path;

const FPS: f64 = 30.0;

/// Largest distance in time between a frame and its depth, seconds.
const LONGEST_DEPTH_GAP_S: f64 = 0.02;

/// Largest distance in time between two poses that are interpolated, seconds; the tracker ran at 100 Hz.
const LONGEST_POSE_GAP_S: f64 = 0.1;

/// 5000 units to the metre; 0 is no measurement.
const DEPTH: DepthEncoding = DepthEncoding::Linear { metres_per_unit: 1.0 / 5000.0, largest: u16::MAX };

/// Size of the recordings in pixels.
const RECORDED: Size = Size::new(640, 480);

/// Answers whether `path` holds this format, and loads it.
pub fn probe(path: &Path) -> Probe {
    if recognised(path) { Some(load(path)) } else { common::only_sequence(path, recognised, load) }
}

fn recognised(path: &Path) -> bool {
    let others = ["depth.txt", "groundtruth.txt", "rgb"];
    path.join("rgb.txt").is_file() && others.iter().any(|name| path.join(name).exists())
}

fn load(path: &Path) -> Result<Sequence, FramesError> {
    let mut warnings = Vec::new();
    let list = path.join("rgb.txt");
    let text = common::read_text(&list)?;
    let listed = parse_list(&text).map_err(|error| (list.as_path(), error))?;
    let frame = |(number, entry): (usize, &Listed<'_>)| {
        let file = common::listed_file(path, entry.file, &list, entry.line)?;
        Ok(common::frame_of(&file, number, entry.time_s))
    };
    let mut frames = listed.iter().enumerate().map(frame).collect::<Result<Vec<_>, FramesError>>()?;
    let size = common::first_size(path, &frames)?;
    attach_depth(path, &mut frames, &mut warnings)?;
    attach_poses(path, &mut frames, &mut warnings)?;
    Ok(Sequence {
        format: Format::Tum,
        name: common::name_of(path),
        root: path.to_path_buf(),
        size,
        fps: Some(FPS),
        camera: camera(path, &text, size, &mut warnings)?,
        video: None,
        frames,
        license: Some("CC BY 4.0".into()),
        warnings,
    })
}

/// One line of `rgb.txt` or `depth.txt`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Listed<'a> {
    /// Line counted from 1.
    pub line: usize,
    /// Seconds on the recording's clock.
    pub time_s: f64,
    /// Path relative to the sequence's folder.
    pub file: &'a str,
}

/// Reads `rgb.txt` or `depth.txt`: `time file` per line, in increasing time.
///
/// # Errors
/// [`TextError`] at the first line that is neither this nor a comment, or does not come after the one before it.
pub fn parse_list(text: &str) -> Result<Vec<Listed<'_>>, TextError> {
    let listed = records(text).map(|(line, record)| {
        let split = record.split_once(char::is_whitespace).map(|(time, file)| (time.parse(), file.trim()));
        match split {
            Some((Ok(time_s), file)) if f64::is_finite(time_s) => Ok(Listed { line, time_s, file }),
            _ => Err(TextError { line, reason: "expected a time in seconds and the name of a picture".into() }),
        }
    });
    let listed = listed.collect::<Result<Vec<_>, _>>()?;
    common::increasing(listed.iter().map(|entry| (entry.line, entry.time_s)))?;
    Ok(listed)
}

fn attach_depth(path: &Path, frames: &mut [FrameEntry], warnings: &mut Vec<String>) -> Result<(), FramesError> {
    let list = path.join("depth.txt");
    if !list.exists() {
        return Ok(());
    }
    let text = common::read_text(&list)?;
    let listed = parse_list(&text).map_err(|error| (list.as_path(), error))?;
    let total = frames.len();
    let mut matched = 0;
    for frame in frames {
        if let Some(entry) = nearest(&listed, frame.time_s) {
            let file = common::listed_file(path, entry.file, &list, entry.line)?;
            frame.depth = Some(DepthFile { path: file, encoding: DEPTH });
            matched += 1;
        }
    }
    if matched < total {
        warnings.push(format!("{matched} of {total} frames have depth within {LONGEST_DEPTH_GAP_S} s"));
    }
    Ok(())
}

/// The entry nearest to `time_s`, if it is near enough.
fn nearest<'a>(listed: &[Listed<'a>], time_s: f64) -> Option<Listed<'a>> {
    let after = listed.partition_point(|entry| entry.time_s < time_s);
    let around = &listed[after.saturating_sub(1)..listed.len().min(after + 1)];
    let gap_s = |entry: &Listed<'_>| (entry.time_s - time_s).abs();
    let best = around.iter().min_by(|a, b| gap_s(a).total_cmp(&gap_s(b)))?;
    (gap_s(best) <= LONGEST_DEPTH_GAP_S).then_some(*best)
}

fn attach_poses(path: &Path, frames: &mut [FrameEntry], warnings: &mut Vec<String>) -> Result<(), FramesError> {
    let file = path.join("groundtruth.txt");
    if !file.exists() {
        warnings.push("there is no groundtruth.txt, so the frames have no poses".into());
        return Ok(());
    }
    let text = common::read_text(&file)?;
    let trajectory = parse_tum(&text)
        .and_then(|poses| common::trajectory_of(&text, poses))
        .map_err(|error| (file.as_path(), error))?;
    common::interpolate_poses(frames, &trajectory, LONGEST_POSE_GAP_S, warnings);
    Ok(())
}

/// The calibration of the Kinect the sequence's name or the comments of `rgb.txt` name.
fn camera(path: &Path, list: &str, size: Size, warnings: &mut Vec<String>) -> Result<Option<Camera>, FramesError> {
    let comments = list.lines().filter(|line| line.starts_with('#')).take(10);
    let name = common::name_of(path);
    let Some(camera) = std::iter::once(name.as_str()).chain(comments).find_map(sensor) else {
        warnings
            .push("neither the folder nor rgb.txt names freiburg1, 2 or 3: give the camera with --camera FILE".into());
        return Ok(None);
    };
    let fitted = camera.and_then(|camera| common::fit_camera(camera, size, warnings));
    fitted.map(Some).map_err(|error| common::camera_error(path, &error))
}

/// Colour camera of the sensor a text names: fx, fy, cx, cy and k1, k2, p1, p2, k3 as the benchmark's web page
/// "Intrinsic Camera Calibration of the Kinect" gives them; the pictures of freiburg3 are already undistorted.
fn sensor(text: &str) -> Option<Result<Camera, CameraError>> {
    let ([fx, fy, cx, cy], distortion): ([f64; 4], [f64; 5]) = match text.split_once("freiburg")?.1.chars().next()? {
        '1' => ([517.306408, 516.469215, 318.643040, 255.313989], [0.262383, -0.953104, -0.005358, 0.002628, 1.163314]),
        '2' => {
            ([520.908620, 521.007327, 325.141442, 249.701764], [0.231222, -0.784899, -0.003257, -0.000105, 0.917205])
        }
        '3' => ([535.4, 539.2, 320.1, 247.6], [0.0; 5]),
        _ => return None,
    };
    let intrinsics = Intrinsics { fx, fy, cx, cy, skew: 0.0 };
    Some(Camera::new(RECORDED, RadialTangential::from_opencv(intrinsics, &distortion).into()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::fixtures::{lines, loaded, picture, refusal, shared, text};
    use proptest::prelude::*;

    fn sequence(folder: &Path) {
        let time = |k: usize| 100.0 + k as f64 / 30.0;
        for k in 0..4 {
            picture(&folder.join(format!("rgb/{k}.png")), Size::new(64, 48));
            picture(&folder.join(format!("depth/{k}.png")), Size::new(64, 48));
        }
        let head = "# color images\n# file: 'rgbd_dataset_freiburg2_made.bag'\n";
        text(&folder.join("rgb.txt"), &(head.to_owned() + &lines(4, |k| format!("{:.6} rgb/{k}.png", time(k)))));
        text(&folder.join("depth.txt"), &lines(4, |k| format!("{:.6} depth/{k}.png", time(k) + 0.012)));
        // Half a metre per second along x, and nothing known after 100.08 s.
        let pose = |k: usize| format!("{} {} 0 0 0 0 0 1", 99.98 + 0.02 * k as f64, 0.01 * k as f64);
        text(&folder.join("groundtruth.txt"), &lines(6, pose));
    }

    #[test]
    fn depth_and_poses_meet_frames_by_time() {
        let folder = tempfile::tempdir().unwrap();
        sequence(folder.path());
        let sequence = loaded(probe(folder.path()));
        let depth = |k: usize| sequence.frames[k].depth.as_ref().unwrap().path.clone();
        assert!((0..4).all(|k| depth(k) == folder.path().join(format!("depth/{k}.png"))));
        let x = |k: usize| sequence.frames[k].world_from_camera.map(|pose| pose.translation.x);
        assert!((x(1).unwrap() - 0.5 * (0.02 + 1.0 / 30.0)).abs() < 1e-6);
        assert_eq!(x(3), None);
        assert!(sequence.warnings.iter().any(|warning| warning.contains("3 of 4 frames have a pose")));
        let model = match sequence.camera.unwrap().model() {
            endoscape_core::CameraModel::RadialTangential(model) => Some(*model),
            _ => None,
        };
        let model = model.unwrap();
        assert!(model.k1 == 0.231222 && (model.intrinsics.fx - 52.090862).abs() < 1e-9);
    }

    #[test]
    fn the_first_wrong_line_is_named() {
        let folder = tempfile::tempdir().unwrap();
        sequence(folder.path());
        let attempts = [
            ("rgb.txt", "# a\n1 rgb/0.png\n1 rgb/1.png\n", "rgb.txt, line 3: the time 1 s does not come after 1 s"),
            ("rgb.txt", "1 rgb/0.png\n2 rgb/9.png\n", "rgb.txt, line 2: names rgb/9.png, which does not exist"),
            ("rgb.txt", "1 ../0.png\n", "rgb.txt, line 1: `../0.png` leads outside"),
            ("rgb.txt", "nan rgb/0.png\n", "rgb.txt, line 1: expected a time"),
            ("rgb.txt", "# nothing\n", "holds no frame"),
            ("depth.txt", "1\n", "depth.txt, line 1: expected a time"),
            ("groundtruth.txt", "1 0 0 0 0 0 0 1\n\n1 0 0 0 0 0 0 1\n", "groundtruth.txt, line 3: "),
            ("groundtruth.txt", "1 0 0 0 0 0 0\n", "groundtruth.txt, line 1: found 7 values"),
        ];
        for (file, wrong, sentence) in attempts {
            let right = std::fs::read_to_string(folder.path().join(file)).unwrap();
            text(&folder.path().join(file), wrong);
            let error = refusal(probe(folder.path()));
            assert!(error.contains(sentence), "{error}");
            text(&folder.path().join(file), &right);
        }
    }

    #[test]
    fn the_real_excerpt_loads() {
        let Some(folder) = shared("tum/freiburg1_rpy") else { return };
        let sequence = loaded(probe(&folder));
        assert_eq!((sequence.frames.len(), sequence.size), (24, RECORDED));
        assert!(sequence.frames.iter().all(|frame| frame.world_from_camera.is_some() && frame.depth.is_some()));
        assert!(sequence.camera.is_some() && sequence.warnings.is_empty(), "{:?}", sequence.warnings);
    }

    proptest! {
        #[test]
        fn any_text_is_answered(text in "[-0-9eE.a/# \n]{0,100}") {
            if let Ok(listed) = parse_list(&text) {
                let _ = nearest(&listed, 1.0);
            }
        }
    }
}
