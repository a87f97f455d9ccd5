//! KITTI raw: a drive `YYYY_MM_DD_drive_NNNN_sync` with `image_0N/data`, `oxts` and `velodyne_points`, and calibration
//! files one level up.
//!
//! Poses come from the inertial unit: `oxts/data/%010d.txt` in a Mercator projection, carried to the camera by
//! `calib_imu_to_velo.txt`, `calib_velo_to_cam.txt` and `calib_cam_to_cam.txt`; the world is the first posed frame of
//! the chosen camera. Whatever file is missing costs what depends on it, with a warning, and nothing else.

use super::kitti::{FPS, LICENSE, PICTURES, Projection, with_calibration};
use super::{Format, Probe, common, kitti_oxts};
use crate::depth::DepthEncoding;
use crate::{FrameEntry, FramesError, Sequence};
use endoscape_core::trajectory::{TextError, records};
use endoscape_core::{Camera, Pose, Size};
use nalgebra::Vector3;
use std::path::{Path, PathBuf};

/// Cameras, best first: left colour, right colour, left grey, right grey.
const CAMERAS: [usize; 4] = [2, 3, 0, 1];

/// Answers whether `path` holds this format, and loads it.
pub fn probe(path: &Path) -> Probe {
    if recognised(path) { Some(load(path)) } else { common::only_sequence(path, recognised, load) }
}

fn recognised(path: &Path) -> bool {
    // A common layout of SCARED borrows `image_02/data` inside its keyframe folders.
    images(path).is_some() && !common::name_of(path).starts_with("keyframe")
}

/// The best folder of frames in a drive, with the number of its camera.
fn images(path: &Path) -> Option<(PathBuf, usize)> {
    let mut folders = CAMERAS.iter().map(|camera| (path.join(format!("image_{camera:02}/data")), *camera));
    folders.find(|(folder, _)| common::holds_numbered(folder, "", PICTURES))
}

fn load(path: &Path) -> Result<Sequence, FramesError> {
    let (folder, number) =
        images(path).ok_or_else(|| FramesError::file(path, "holds no frames", "fetch the drive again"))?;
    let mut warnings = Vec::new();
    let mut frames = common::frames_at(&common::numbered(&folder, "", PICTURES)?, FPS);
    let size = common::first_size(&folder, &frames)?;
    attach_times(&folder.with_file_name("timestamps.txt"), &mut frames, &mut warnings)?;
    let rig = Rig::read(path, number)?;
    let camera = camera(&rig, size, &mut warnings)?;
    attach_depth(path, &rig, &mut frames, &mut warnings)?;
    attach_poses(path, &rig, &mut frames, &mut warnings)?;
    Ok(Sequence {
        format: Format::KittiRaw,
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

/// What the three calibration files say, each as far as it is there.
struct Rig {
    /// `calib_cam_to_cam.txt`, which the camera is read from.
    camera_file: PathBuf,
    camera: Option<RectifiedCamera>,
    /// `calib_velo_to_cam.txt`: laser to the camera 0 before rectification, metres.
    first_from_velodyne: Option<Pose>,
    /// `calib_imu_to_velo.txt`: inertial unit to laser, metres.
    velodyne_from_imu: Option<Pose>,
}

struct RectifiedCamera {
    /// Size of the rectified pictures the calibration is for.
    size: Size,
    projection: Projection,
    /// Rotation that rectifies camera 0.
    rectified_from_first: Pose,
}

impl Rig {
    fn read(drive: &Path, camera: usize) -> Result<Self, FramesError> {
        let full = drive.canonicalize().unwrap_or_else(|_| drive.to_path_buf());
        let date = full.parent().unwrap_or(&full);
        let rigid = |name: &str| {
            let file = date.join(name);
            let read = || with_calibration(&file, |calibration| calibration.rigid("R", "T"));
            file.exists().then(read).transpose()
        };
        let camera_file = date.join("calib_cam_to_cam.txt");
        let read = || with_calibration(&camera_file, |calibration| RectifiedCamera::read(calibration, camera));
        let camera = camera_file.exists().then(read).transpose()?;
        let first_from_velodyne = rigid("calib_velo_to_cam.txt")?;
        Ok(Self { camera, camera_file, first_from_velodyne, velodyne_from_imu: rigid("calib_imu_to_velo.txt")? })
    }

    /// Maps laser points to the rectified camera, metres.
    fn camera_from_velodyne(&self) -> Option<Pose> {
        let camera = self.camera.as_ref()?;
        Some(camera.projection.camera_from_first * camera.rectified_from_first * self.first_from_velodyne?)
    }

    fn camera_from_imu(&self) -> Option<Pose> {
        Some(self.camera_from_velodyne()? * self.velodyne_from_imu?)
    }
}

impl RectifiedCamera {
    fn read(calibration: &super::kitti::Calibration<'_>, number: usize) -> Result<Self, TextError> {
        let [width, height] = calibration.values(&format!("S_rect_{number:02}"))?;
        let projection = calibration.projection(&format!("P_rect_{number:02}"))?;
        let rectified_from_first = calibration.rotation("R_rect_00", Vector3::zeros())?;
        // Saturates: a size that is no size ends as an empty camera, which is refused.
        Ok(Self { size: Size::new(width as usize, height as usize), projection, rectified_from_first })
    }
}

fn camera(rig: &Rig, size: Size, warnings: &mut Vec<String>) -> Result<Option<Camera>, FramesError> {
    let Some(rectified) = &rig.camera else {
        warnings.push(
            "there is no calib_cam_to_cam.txt one level up, so the camera is not known: give it with --camera FILE or \
             --hfov"
                .into(),
        );
        return Ok(None);
    };
    let calibrated = rectified.projection.camera(rectified.size);
    let fitted = calibrated.and_then(|camera| common::fit_camera(camera, size, warnings));
    fitted.map(Some).map_err(|error| common::camera_error(&rig.camera_file, &error))
}

fn attach_times(file: &Path, frames: &mut [FrameEntry], warnings: &mut Vec<String>) -> Result<(), FramesError> {
    if !file.exists() {
        warnings.push(format!("there is no timestamps.txt: frames are taken to be {FPS} per second"));
        return Ok(());
    }
    let times_s = parse_timestamps(&common::read_text(file)?).map_err(|error| (file, error))?;
    common::attach_times(frames, &times_s, file)
}

/// Reads `timestamps.txt` (`2011-09-26 13:02:25.594360375` per line) as seconds after its first line.
///
/// # Errors
/// [`TextError`] at the first line that is no date and time, or does not come after the one before it.
pub fn parse_timestamps(text: &str) -> Result<Vec<f64>, TextError> {
    let timed = records(text).map(|(line, record)| {
        let seconds = date_and_time(record);
        let reason = || format!("`{}` is no YYYY-MM-DD HH:MM:SS.S", record.chars().take(40).collect::<String>());
        seconds.map(|seconds| (line, seconds)).ok_or_else(|| TextError { line, reason: reason() })
    });
    let timed = timed.collect::<Result<Vec<_>, _>>()?;
    let first = timed.first().map_or((0, 0.0), |(_, time)| *time);
    let after_first = |(day, second_s): (i64, f64)| (day - first.0) as f64 * 86_400.0 + (second_s - first.1);
    common::increasing(timed.iter().map(|(line, time)| (*line, after_first(*time))))?;
    Ok(timed.into_iter().map(|(_, time)| after_first(time)).collect())
}

/// Day number and seconds of that day; kept apart because their sum would lose the nanoseconds.
fn date_and_time(record: &str) -> Option<(i64, f64)> {
    let (date, time) = record.split_once(' ')?;
    let whole = |text: &str, largest: i64| text.parse().ok().filter(|value| (0..=largest).contains(value));
    let mut date = date.split('-');
    let (year, month, day) = (whole(date.next()?, 9999)?, whole(date.next()?, 12)?, whole(date.next()?, 31)?);
    let mut time = time.split(':');
    let (hour, minute) = (whole(time.next()?, 23)?, whole(time.next()?, 59)?);
    let second_s: f64 = time.next()?.trim().parse().ok().filter(|second| (0.0..61.0).contains(second))?;
    let complete = date.next().is_none() && time.next().is_none() && month > 0 && day > 0;
    complete.then(|| (day_number(year, month, day), (hour * 3600 + minute * 60) as f64 + second_s))
}

/// Days since a fixed day, by counting from March so that the leap day ends the year; E. G. Richards, "Calendars", in
/// the Explanatory Supplement to the Astronomical Almanac (2013), section 15.11.
fn day_number(year: i64, month: i64, day: i64) -> i64 {
    let (years, months) = if month > 2 { (year, month - 3) } else { (year - 1, month + 9) };
    365 * years + years.div_euclid(4) - years.div_euclid(100) + years.div_euclid(400) + (153 * months + 2) / 5 + day
}

fn attach_depth(
    path: &Path,
    rig: &Rig,
    frames: &mut [FrameEntry],
    warnings: &mut Vec<String>,
) -> Result<(), FramesError> {
    let folder = path.join("velodyne_points/data");
    if !folder.is_dir() {
        return Ok(());
    }
    let Some(camera_from_velodyne) = rig.camera_from_velodyne() else {
        warnings.push(
            "the laser scans are left out: they need calib_cam_to_cam.txt and calib_velo_to_cam.txt one level up"
                .into(),
        );
        return Ok(());
    };
    let scans = common::numbered(&folder, "", &[".bin"])?;
    common::attach_depth(frames, scans, &DepthEncoding::Velodyne { camera_from_velodyne }, warnings);
    Ok(())
}

fn attach_poses(
    path: &Path,
    rig: &Rig,
    frames: &mut [FrameEntry],
    warnings: &mut Vec<String>,
) -> Result<(), FramesError> {
    let folder = path.join("oxts/data");
    if !folder.is_dir() {
        return Ok(());
    }
    let Some(camera_from_imu) = rig.camera_from_imu() else {
        warnings.push(
            "the poses are left out: they need calib_cam_to_cam.txt, calib_velo_to_cam.txt and calib_imu_to_velo.txt \
             one level up"
                .into(),
        );
        return Ok(());
    };
    let packets = common::numbered(&folder, "", &[".txt"])?;
    let poses = kitti_oxts::world_from_camera(&packets, &camera_from_imu)?;
    let mut matched = 0;
    for (number, pose) in &poses {
        if let Ok(index) = frames.binary_search_by_key(number, |frame| frame.number) {
            frames[index].world_from_camera = Some(*pose);
            matched += 1;
        }
    }
    warnings.extend(common::pairing_warning(frames.len(), poses.len(), matched));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::fixtures::{lines, loaded, picture, refusal, shared, text};
    use proptest::prelude::*;

    const CAM_TO_CAM: &str = "calib_time: 09-Jan-2012 13:57:47\nS_rect_02: 124 37\nR_rect_00: 1 0 0 0 1 0 0 0 1\n\
                              P_rect_02: 70 0 60 7 0 70 18 0 0 0 1 0\n";
    // Laser axes are x ahead, y left, z up.
    const VELO_TO_CAM: &str = "R: 0 -1 0 0 0 -1 1 0 0\nT: 0 0 -0.3\n";

    fn drive(date: &Path, frames: usize) -> PathBuf {
        let drive = date.join("2011_09_26_drive_0001_sync");
        for number in 0..frames {
            picture(&drive.join(format!("image_02/data/{number:010}.png")), Size::new(124, 37));
            // One thousandth of a degree north per frame, heading north (yaw counts from east).
            let packet = format!("{} 8.4 100 0 0 {} 0 0 0\n", 49.0 + number as f64 * 1e-3, std::f64::consts::FRAC_PI_2);
            text(&drive.join(format!("oxts/data/{number:010}.txt")), &packet);
            text(&drive.join(format!("velodyne_points/data/{number:010}.bin")), "");
        }
        drive
    }

    fn calibrate(date: &Path) {
        text(&date.join("calib_cam_to_cam.txt"), CAM_TO_CAM);
        text(&date.join("calib_velo_to_cam.txt"), VELO_TO_CAM);
        text(&date.join("calib_imu_to_velo.txt"), "R: 1 0 0 0 1 0 0 0 1\nT: -0.8 0.3 -0.8\n");
    }

    #[test]
    fn a_calibrated_drive_has_camera_laser_and_poses() {
        let date = tempfile::tempdir().unwrap();
        let drive = drive(date.path(), 3);
        calibrate(date.path());
        text(&drive.join("image_02/timestamps.txt"), &lines(3, |k| format!("2011-09-26 23:59:59.{k}00000000")));
        let sequence = loaded(probe(&drive));
        assert!(sequence.warnings.is_empty(), "{:?}", sequence.warnings);
        assert!((sequence.frames[2].time_s - 0.2).abs() < 1e-9);
        let camera_from_velodyne = match sequence.frames[0].depth.as_ref().unwrap().encoding {
            DepthEncoding::Velodyne { camera_from_velodyne } => Some(camera_from_velodyne),
            _ => None,
        };
        let ahead = camera_from_velodyne.unwrap() * nalgebra::Point3::new(10.0, 0.0, 0.0);
        assert!((ahead - nalgebra::Point3::new(0.1, 0.0, 9.7)).norm() < 1e-12);
        // The car drives along the axis of its camera, 111.2 m per thousandth of a degree.
        let moved = sequence.frames[1].world_from_camera.unwrap().translation.vector;
        assert!(moved.xy().norm() < 0.01 && (moved.z - 111.3).abs() < 0.1, "{moved}");
        assert_eq!(loaded(probe(date.path())).frames.len(), 3);
    }

    #[test]
    fn without_calibration_there_are_frames_and_advice() {
        let date = tempfile::tempdir().unwrap();
        let sequence = loaded(probe(&drive(date.path(), 2)));
        assert!(sequence.camera.is_none() && !sequence.has_poses() && !sequence.has_depth());
        assert!(sequence.warnings.iter().any(|warning| warning.contains("--camera FILE")), "{:?}", sequence.warnings);
        assert_eq!(sequence.warnings.len(), 4);
    }

    #[test]
    fn the_first_wrong_line_is_named() {
        let date = tempfile::tempdir().unwrap();
        let drive = drive(date.path(), 2);
        calibrate(date.path());
        let stamps = "image_02/timestamps.txt";
        let attempts = [
            (drive.join(stamps), "2011-09-26 13:00:00\n2011-09-26 13:00:00\n", "timestamps.txt, line 2: the time 0 s"),
            (drive.join(stamps), "2011-09-26 13:00:00\n2011-13-26 13:00:00\n", "timestamps.txt, line 2: `2011-13-26"),
            (drive.join("oxts/data/0000000001.txt"), "49 8\n", "0000000001.txt, line 1: found 2 values where 6"),
            (drive.join("oxts/data/0000000001.txt"), "90 8 0 0 0 0\n", "0000000001.txt, line 1: "),
            (
                date.path().join("calib_velo_to_cam.txt"),
                "R: 2 0 0 0 2 0 0 0 2\nT: 0 0 0",
                "cam.txt, line 1: R: the 3x3",
            ),
        ];
        for (file, wrong, sentence) in attempts {
            let right = std::fs::read_to_string(&file).ok();
            text(&file, wrong);
            let error = refusal(probe(&drive));
            assert!(error.contains(sentence), "{error}");
            match right {
                Some(right) => text(&file, &right),
                None => std::fs::remove_file(&file).unwrap(),
            }
        }
    }

    #[test]
    fn keyframes_of_another_data_set_are_not_claimed() {
        let folder = tempfile::tempdir().unwrap();
        picture(&folder.path().join("keyframe_1/image_02/data/0000000000.png"), Size::new(8, 8));
        assert!(probe(&folder.path().join("keyframe_1")).is_none() && probe(folder.path()).is_none());
    }

    #[test]
    fn days_follow_each_other() {
        assert_eq!(day_number(2012, 3, 1) - day_number(2012, 2, 28), 2);
        assert_eq!(day_number(2100, 3, 1) - day_number(2100, 2, 28), 1);
        assert_eq!(day_number(2012, 1, 1) - day_number(2011, 12, 31), 1);
        assert_eq!(day_number(1970, 1, 1) - day_number(1600, 1, 1), 135_140);
    }

    #[test]
    fn the_real_drives_load_without_calibration() {
        let Some(date) = shared("kitti-raw/2011_09_26") else { return };
        let sequence = loaded(probe(&date.join("2011_09_26_drive_0095_sync")));
        assert_eq!((sequence.frames.len(), sequence.size), (80, Size::new(1242, 375)));
        assert!(sequence.camera.is_none());
        let excerpt = loaded(probe(&date.join("lidar_excerpt")));
        assert_eq!(excerpt.frames.len(), 1);
        assert!(excerpt.warnings.iter().any(|warning| warning.contains("laser scans")));
    }

    proptest! {
        #[test]
        fn any_text_is_answered(text in "[-0-9:. \n]{0,100}") {
            let _ = (parse_timestamps(&text), common::parse_times(&text), super::super::kitti::parse_calibration(&text));
        }
    }
}
