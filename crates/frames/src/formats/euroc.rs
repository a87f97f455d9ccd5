//! EuRoC MAV: `mav0/cam0` (pictures, `data.csv`, `sensor.yaml`) and `mav0/state_groundtruth_estimate0/data.csv`.
//!
//! The truth is the pose of the body; the camera's is that times `T_BS` of `sensor.yaml` (body from sensor). Poses are
//! interpolated to the frames' times. M. Burri et al., "The EuRoC micro aerial vehicle datasets", IJRR 35 (2016).

use super::euroc_sensor::{Sensor, parse_sensor};
use super::{Format, Probe, common};
use crate::{FrameEntry, FramesError, Sequence};
use endoscape_core::trajectory::{TextError, parse_euroc, records};
use endoscape_core::{Pose, Size};
use std::path::{Path, PathBuf};

/// Largest distance in time between two poses that are interpolated, seconds; the truth has 200 Hz.
const LONGEST_POSE_GAP_S: f64 = 0.1;

/// Answers whether `path` holds this format, and loads it.
pub fn probe(path: &Path) -> Probe {
    if recognised(path) { Some(load(path)) } else { common::only_sequence(path, recognised, load) }
}

fn recognised(path: &Path) -> bool {
    mav(path).is_some()
}

/// The folder `mav0` of a recording, which may itself be what the user names.
fn mav(path: &Path) -> Option<PathBuf> {
    let holds_camera = |mav: &PathBuf| {
        let camera = mav.join("cam0");
        camera.join("data").is_dir() && (camera.join("data.csv").is_file() || camera.join("sensor.yaml").is_file())
    };
    [path.join("mav0"), path.to_path_buf()].into_iter().find(holds_camera)
}

fn load(path: &Path) -> Result<Sequence, FramesError> {
    let mav = mav(path).ok_or_else(|| FramesError::file(path, "holds no cam0", "fetch the recording again"))?;
    let mut warnings = Vec::new();
    let camera_folder = mav.join("cam0");
    let mut frames = frames(&camera_folder)?;
    let size = common::first_size(&camera_folder, &frames)?;
    let sensor_file = camera_folder.join("sensor.yaml");
    let sensor = sensor(&sensor_file)?;
    attach_poses(&mav, sensor.as_ref(), &mut frames, &mut warnings)?;
    let camera = match &sensor {
        Some(sensor) => Some(camera(&sensor_file, sensor, size, &mut warnings)?),
        None => {
            warnings.push("there is no cam0/sensor.yaml: give the camera with --camera FILE or --hfov".into());
            None
        }
    };
    Ok(Sequence {
        format: Format::Euroc,
        name: common::name_of(path),
        root: path.to_path_buf(),
        size,
        fps: sensor.and_then(|sensor| sensor.rate_hz),
        camera,
        video: None,
        frames,
        license: None,
        warnings,
    })
}

fn frames(camera_folder: &Path) -> Result<Vec<FrameEntry>, FramesError> {
    let list = camera_folder.join("data.csv");
    let text = common::read_text(&list)?;
    let listed = parse_frames(&text).map_err(|error| (list.as_path(), error))?;
    let folder = camera_folder.join("data");
    let frame = |(number, (line, time_ns, name)): (usize, &(usize, u64, &str))| {
        let file = common::listed_file(&folder, name, &list, *line)?;
        Ok(common::frame_of(&file, number, *time_ns as f64 * 1e-9))
    };
    listed.iter().enumerate().map(frame).collect()
}

/// Reads `cam0/data.csv`: `time_ns, file` per line, in increasing time; answers (line, nanoseconds, file).
///
/// # Errors
/// [`TextError`] at the first line that is neither this nor a comment, or does not come after the one before it.
pub fn parse_frames(text: &str) -> Result<Vec<(usize, u64, &str)>, TextError> {
    let listed = records(text).map(|(line, record)| {
        let split = record.split_once(',').map(|(time, file)| (time.trim().parse(), file.trim()));
        match split {
            Some((Ok(time_ns), file)) => Ok((line, time_ns, file)),
            _ => Err(TextError { line, reason: "expected a time in whole nanoseconds, a comma and a file".into() }),
        }
    });
    let listed = listed.collect::<Result<Vec<_>, _>>()?;
    // Compared as seconds, because that is what the frames carry: times a float cannot tell apart are one time.
    common::increasing(listed.iter().map(|(line, time_ns, _): &(usize, u64, &str)| (*line, *time_ns as f64 * 1e-9)))?;
    Ok(listed)
}

fn sensor(file: &Path) -> Result<Option<Sensor>, FramesError> {
    let read = || parse_sensor(&common::read_text(file)?).map_err(|error| FramesError::from((file, error)));
    file.is_file().then(read).transpose()
}

fn camera(
    file: &Path,
    sensor: &Sensor,
    size: Size,
    warnings: &mut Vec<String>,
) -> Result<endoscape_core::Camera, FramesError> {
    let fitted = sensor.camera().and_then(|camera| common::fit_camera(camera, size, warnings));
    fitted.map_err(|error| common::camera_error(file, &error))
}

fn attach_poses(
    mav: &Path,
    sensor: Option<&Sensor>,
    frames: &mut [FrameEntry],
    warnings: &mut Vec<String>,
) -> Result<(), FramesError> {
    let file = mav.join("state_groundtruth_estimate0/data.csv");
    let body_from_camera: Option<Pose> = sensor.map(|sensor| sensor.body_from_camera);
    let (true, Some(body_from_camera)) = (file.is_file(), body_from_camera) else {
        warnings.push(
            "the frames have no poses: they need state_groundtruth_estimate0/data.csv and cam0/sensor.yaml".into(),
        );
        return Ok(());
    };
    let text = common::read_text(&file)?;
    let mut poses = parse_euroc(&text).map_err(|error| (file.as_path(), error))?;
    // What the file gives is the body; on the camera's side of it stands T_BS.
    poses.iter_mut().for_each(|pose| pose.world_from_camera *= body_from_camera);
    let trajectory = common::trajectory_of(&text, poses).map_err(|error| (file.as_path(), error))?;
    common::interpolate_poses(frames, &trajectory, LONGEST_POSE_GAP_S, warnings);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::euroc_sensor::tests::SENSOR;
    use super::*;
    use crate::formats::fixtures::{lines, loaded, picture, refusal, text};
    use proptest::prelude::*;

    const START_NS: u64 = 1_403_636_579_763_555_584;

    fn sequence(root: &Path) -> PathBuf {
        let mav = root.join("mav0");
        let time_ns = |k: usize| START_NS + 50_000_000 * k as u64;
        for k in 0..3 {
            picture(&mav.join(format!("cam0/data/{}.png", time_ns(k))), Size::new(752, 480));
        }
        let frames = lines(3, |k| format!("{0},{0}.png\r", time_ns(k)));
        text(&mav.join("cam0/data.csv"), &format!("#timestamp [ns],filename\r\n{frames}"));
        text(&mav.join("cam0/sensor.yaml"), SENSOR);
        // The body moves along x at one metre per second without turning.
        let truth = |k: usize| format!("{},{},0,0,1,0,0,0,1,0,0", time_ns(k) - 25_000_000, 0.05 * k as f64);
        text(&mav.join("state_groundtruth_estimate0/data.csv"), &format!("#timestamp, p\n{}", lines(4, truth)));
        mav
    }

    #[test]
    fn poses_are_those_of_the_camera() {
        let root = tempfile::tempdir().unwrap();
        let mav = sequence(root.path());
        for path in [root.path(), &mav] {
            let sequence = loaded(probe(path));
            assert_eq!((sequence.frames.len(), sequence.fps), (3, Some(20.0)));
            let pose = sequence.frames[1].world_from_camera.unwrap();
            // Halfway between two truths, seen from a camera that sits at (0.1, 0.2, 0.3) and is turned about z.
            assert!((pose.translation.vector - nalgebra::Vector3::new(0.175, 0.2, 0.3)).norm() < 1e-5, "{pose}");
            assert!((pose.rotation * nalgebra::Vector3::x() - nalgebra::Vector3::y()).norm() < 1e-12);
            assert!(sequence.warnings.is_empty(), "{:?}", sequence.warnings);
        }
    }

    #[test]
    fn the_first_wrong_line_is_named() {
        let root = tempfile::tempdir().unwrap();
        let mav = sequence(root.path());
        let attempts = [
            ("cam0/data.csv", "#\n1,a.png\n".to_owned(), "data.csv, line 2: names a.png, which does not exist"),
            ("cam0/data.csv", format!("{START_NS},{START_NS}.png\n1,{START_NS}.png"), "data.csv, line 2: the time"),
            ("cam0/data.csv", "0.5,a.png\n".to_owned(), "data.csv, line 1: expected a time in whole nanoseconds"),
            ("cam0/sensor.yaml", "resolution: [752]\n".to_owned(), "sensor.yaml, line 1: "),
            ("state_groundtruth_estimate0/data.csv", "1,2,3\n".to_owned(), "data.csv, line 1: found 3 values where 8"),
            ("state_groundtruth_estimate0/data.csv", "#\n2,0,0,0,1,0,0,0\n1,0,0,0,1,0,0,0\n".to_owned(), "line 3: "),
        ];
        for (file, wrong, sentence) in attempts {
            let right = std::fs::read_to_string(mav.join(file)).unwrap();
            text(&mav.join(file), &wrong);
            let error = refusal(probe(&mav));
            assert!(error.contains(sentence), "{error}");
            text(&mav.join(file), &right);
        }
    }

    #[test]
    fn without_calibration_there_are_only_frames_and_a_file_is_not_claimed() {
        let root = tempfile::tempdir().unwrap();
        let mav = sequence(root.path());
        assert!(probe(&mav.join("state_groundtruth_estimate0/data.csv")).is_none());
        std::fs::remove_file(mav.join("cam0/sensor.yaml")).unwrap();
        let sequence = loaded(probe(&mav));
        assert!(sequence.camera.is_none() && !sequence.has_poses());
        assert_eq!(sequence.warnings.len(), 2);
    }

    proptest! {
        #[test]
        fn any_text_is_answered(text in "[0-9,.a# \r\n]{0,100}") {
            let _ = parse_frames(&text);
        }
    }
}
