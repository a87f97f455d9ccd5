//! What the loaders share: listing, reading with a limit, pairing, fitting a camera to its frames.

use super::Probe;
use crate::depth::{DepthEncoding, DepthFile};
use crate::sequence::{FrameEntry, ImageLocation};
use crate::{FramesError, natural, picture};
use endoscape_core::camera::Intrinsics;
use endoscape_core::trajectory::{TextError, TimedPose, numbers, records};
use endoscape_core::{Camera, CameraError, Pose, Size, Trajectory, TrajectoryError};
use serde::de::DeserializeOwned;
use std::io::Read as _;
use std::path::{Path, PathBuf};

/// Largest text file a loader reads, in bytes: ten hours of poses at 60 Hz stay far below it.
const LARGEST_TEXT: u64 = 1 << 30;

/// Files directly in `folder` that `keep` accepts by name, in natural order.
pub fn list(folder: &Path, keep: impl Fn(&str) -> bool) -> Result<Vec<PathBuf>, FramesError> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|error| FramesError::io(folder, "list", error))? {
        let entry = entry.map_err(|error| FramesError::io(folder, "list", error))?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if keep(&name) {
            names.push(name);
        }
    }
    names.sort_by(|a, b| natural::cmp(a, b));
    Ok(names.into_iter().map(|name| folder.join(name)).filter(|path| path.is_file()).collect())
}

/// Whether a file name ends like a picture's.
pub fn is_picture(name: &str) -> bool {
    extension(name).is_some_and(|extension| picture::EXTENSIONS.contains(&extension.as_str()))
}

/// Ending of a file name in lower case, without its dot.
pub fn extension(name: &str) -> Option<String> {
    Path::new(name).extension().map(|extension| extension.to_string_lossy().to_lowercase())
}

/// Reads a TOML file whole; a fault in it is told with its line.
pub fn read_toml<T: DeserializeOwned>(path: &Path) -> Result<T, FramesError> {
    let text = read_text(path)?;
    toml::from_str(&text).map_err(|error| {
        let before = error.span().and_then(|span| text.get(..span.start)).unwrap_or_default();
        FramesError::line(path, 1 + before.matches('\n').count(), error.message().replace('\n', ", "))
    })
}

/// Reads a whole text file, refusing one that is absurdly large or not text.
pub fn read_text(path: &Path) -> Result<String, FramesError> {
    let bytes = read_bytes(path, LARGEST_TEXT)?;
    String::from_utf8(bytes).map_err(|_| FramesError::file(path, "is not text", "fetch the file again"))
}

/// Reads a whole file of at most `limit` bytes.
pub fn read_bytes(path: &Path, limit: u64) -> Result<Vec<u8>, FramesError> {
    let file = std::fs::File::open(path).map_err(|error| FramesError::io(path, "read", error))?;
    let mut bytes = Vec::new();
    file.take(limit + 1).read_to_end(&mut bytes).map_err(|error| FramesError::io(path, "read", error))?;
    if bytes.len() as u64 > limit {
        let reason = format!("is larger than {} MiB, which no such file is", limit >> 20);
        return Err(FramesError::file(path, reason, "check that it is the right file"));
    }
    Ok(bytes)
}

/// The name a path ends in, for messages and sequence names.
pub fn name_of(path: &Path) -> String {
    let full = path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
    full.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned())
}

/// A frame that is a picture of its own and nothing else yet.
pub fn frame_of(path: &Path, number: usize, time_s: f64) -> FrameEntry {
    let image = ImageLocation::File(path.to_path_buf());
    FrameEntry { number, time_s, image, depth: None, mask: None, world_from_camera: None }
}

/// The camera read out at the size the frames have; a warning says so when that is not the calibration's size.
pub fn fit_camera(camera: Camera, frames: Size, warnings: &mut Vec<String>) -> Result<Camera, CameraError> {
    if camera.size() == frames {
        return Ok(camera);
    }
    warnings.push(format!(
        "the frames are {frames} but the calibration is for {}: the intrinsics were scaled to the frames",
        camera.size()
    ));
    camera.scaled_to(frames)
}

/// A sentence on poses and frames that do not pair one to one; `None` when they do.
pub fn pairing_warning(frames: usize, poses: usize, matched: usize) -> Option<String> {
    (frames != matched || poses != matched).then(|| {
        format!(
            "{matched} of {frames} frames have a pose; {} of {poses} poses belong to no frame",
            poses.saturating_sub(matched)
        )
    })
}

/// Frame number in a name made of `prefix`, digits and one of `endings`; `None` for any other name.
pub fn number_between(name: &str, prefix: &str, endings: &[&str]) -> Option<usize> {
    let rest = name.strip_prefix(prefix)?;
    let digits = endings.iter().find_map(|ending| rest.strip_suffix(ending))?;
    digits.bytes().all(|byte| byte.is_ascii_digit()).then(|| digits.parse().ok())?
}

/// Files directly in `folder` whose names [`number_between`] knows, by increasing number.
///
/// # Errors
/// [`FramesError`] if the folder cannot be listed or two files have one number.
pub fn numbered(folder: &Path, prefix: &str, endings: &[&str]) -> Result<Vec<(usize, PathBuf)>, FramesError> {
    let number = |name: &str| number_between(name, prefix, endings);
    let paths = list(folder, |name| number(name).is_some())?;
    let mut files: Vec<(usize, PathBuf)> =
        paths.into_iter().filter_map(|path| Some((number(&path.file_name()?.to_string_lossy())?, path))).collect();
    files.sort_by_key(|(number, _)| *number);
    match files.windows(2).find(|pair| pair[0].0 == pair[1].0) {
        Some(pair) => {
            let reason = format!("has the number {} twice, the other time in {}", pair[1].0, name_of(&pair[0].1));
            Err(FramesError::file(&pair[1].1, reason, "move one of the two away"))
        }
        None => Ok(files),
    }
}

/// Whether `folder` directly holds a file whose name [`number_between`] knows.
pub fn holds_numbered(folder: &Path, prefix: &str, endings: &[&str]) -> bool {
    let known = |name: &str| number_between(name, prefix, endings).is_some();
    std::fs::read_dir(folder).is_ok_and(|mut entries| {
        entries.any(|entry| entry.is_ok_and(|entry| known(&entry.file_name().to_string_lossy())))
    })
}

/// Opens the only sequence of a data set among the folders directly in `parent`.
///
/// `None` if there is none, or if pictures lie beside them, which then are what the user means; an error that lists
/// them if there are several.
pub fn only_sequence(
    parent: &Path,
    recognised: fn(&Path) -> bool,
    load: fn(&Path) -> Result<crate::Sequence, FramesError>,
) -> Probe {
    let entries = || Some(std::fs::read_dir(parent).ok()?.filter_map(|entry| Some(entry.ok()?.path())));
    if entries()?.any(|path| is_picture(&path.to_string_lossy())) {
        return None;
    }
    let mut found: Vec<PathBuf> = entries()?.filter(|path| path.is_dir() && recognised(path)).collect();
    found.sort_by(|a, b| natural::cmp(&a.to_string_lossy(), &b.to_string_lossy()));
    match found.as_slice() {
        [] => None,
        [only] => Some(load(only)),
        several => {
            let mut names = several.iter().take(12).map(|path| name_of(path)).collect::<Vec<_>>().join(", ");
            if several.len() > 12 {
                names.push_str(", ...");
            }
            let reason = format!("holds {} sequences ({names})", several.len());
            Some(Err(FramesError::file(parent, reason, "name one of them")))
        }
    }
}

/// Frames from numbered pictures, at `number / fps` seconds.
pub fn frames_at(pictures: &[(usize, PathBuf)], fps: f64) -> Vec<FrameEntry> {
    pictures.iter().map(|(number, path)| frame_of(path, *number, *number as f64 / fps)).collect()
}

/// Size of the first frame's picture.
///
/// # Errors
/// [`FramesError::File`] on `folder` if there is no frame, or as [`picture::size`].
pub fn first_size(folder: &Path, frames: &[FrameEntry]) -> Result<Size, FramesError> {
    match frames.first().map(|frame| &frame.image) {
        Some(ImageLocation::File(path)) => picture::size(path),
        _ => Err(FramesError::file(folder, "holds no frame", "fetch the data again")),
    }
}

/// Gives each frame the pose of its number, which is the place of the pose in `file` counted from 0.
///
/// # Errors
/// [`FramesError::File`] if the file ends before the last frame.
pub fn attach_poses(
    frames: &mut [FrameEntry],
    poses: &[Pose],
    file: &Path,
    warnings: &mut Vec<String>,
) -> Result<(), FramesError> {
    check_covered(frames, poses.len(), "poses", file)?;
    for frame in frames.iter_mut() {
        frame.world_from_camera = poses.get(frame.number).copied();
    }
    warnings.extend(pairing_warning(frames.len(), poses.len(), frames.len()));
    Ok(())
}

/// Gives each frame the time of its number, which is the place of the time in `file` counted from 0.
///
/// # Errors
/// [`FramesError::File`] if the file ends before the last frame.
pub fn attach_times(frames: &mut [FrameEntry], times_s: &[f64], file: &Path) -> Result<(), FramesError> {
    check_covered(frames, times_s.len(), "times", file)?;
    for frame in frames.iter_mut() {
        frame.time_s = times_s[frame.number];
    }
    Ok(())
}

/// Refuses a file of `count` records that ends before the last frame; frames stand in order of their numbers.
fn check_covered(frames: &[FrameEntry], count: usize, what: &str, file: &Path) -> Result<(), FramesError> {
    match frames.last().map(|frame| frame.number).filter(|last| *last >= count) {
        Some(last) => {
            let reason = format!("has {count} {what} but the frames go up to number {last} (counted from 0)");
            Err(FramesError::file(file, reason, "fetch it again, or keep only the frames it covers"))
        }
        None => Ok(()),
    }
}

/// Gives each frame the depth map of its number; maps of no frame are reported.
pub fn attach_depth(
    frames: &mut [FrameEntry],
    maps: Vec<(usize, PathBuf)>,
    encoding: &DepthEncoding,
    warnings: &mut Vec<String>,
) {
    let total = maps.len();
    let mut matched = 0;
    for (number, path) in maps {
        if let Ok(index) = frames.binary_search_by_key(&number, |frame| frame.number) {
            frames[index].depth = Some(DepthFile { path, encoding: encoding.clone() });
            matched += 1;
        }
    }
    if matched < total {
        warnings.push(format!("{} of {total} depth maps belong to no frame", total - matched));
    }
}

/// Times that strictly increase, one per line.
///
/// # Errors
/// [`TextError`] at the first line that is no finite number or does not come after the one before it.
pub fn parse_times(text: &str) -> Result<Vec<f64>, TextError> {
    let timed = records(text).map(|(line, record)| {
        numbers(line, record.split_whitespace(), "a time in seconds").map(|[time_s]: [f64; 1]| (line, time_s))
    });
    let timed = timed.collect::<Result<Vec<_>, _>>()?;
    increasing(timed.iter().copied())?;
    Ok(timed.into_iter().map(|(_, time_s)| time_s).collect())
}

/// Refuses the first of several (line, time in seconds) that does not come after the one before it.
///
/// # Errors
/// [`TextError`] with that line.
pub fn increasing(times: impl Iterator<Item = (usize, f64)>) -> Result<(), TextError> {
    let mut previous_s = f64::NEG_INFINITY;
    for (line, time_s) in times {
        if time_s <= previous_s {
            let reason = format!("the time {time_s} s does not come after {previous_s} s on the line before");
            return Err(TextError { line, reason });
        }
        previous_s = time_s;
    }
    Ok(())
}

/// A trajectory from the records of `text`, one pose per record, so that an error can name its line.
///
/// # Errors
/// [`TextError`] at the first record whose time does not come after the one before it.
pub fn trajectory_of(text: &str, poses: Vec<TimedPose>) -> Result<Trajectory, TextError> {
    Trajectory::new(poses).map_err(|error| {
        let index = match error {
            TrajectoryError::NotFinite { index } | TrajectoryError::NotIncreasing { index, .. } => index,
            TrajectoryError::Unpaired { .. } => 0,
        };
        TextError { line: records(text).nth(index).map_or(1, |(line, _)| line), reason: error.to_string() }
    })
}

/// Pose at `time_s` between two poses that are at most `longest_gap_s` apart; `None` in gaps and outside.
pub fn pose_at(trajectory: &Trajectory, time_s: f64, longest_gap_s: f64) -> Option<Pose> {
    let poses = trajectory.poses();
    let after = poses.partition_point(|pose| pose.time_s < time_s);
    let right = poses.get(after)?.time_s;
    let gap_s = if right == time_s { 0.0 } else { right - poses.get(after.checked_sub(1)?)?.time_s };
    (gap_s <= longest_gap_s).then(|| trajectory.interpolate(time_s))?
}

/// Gives each frame the pose at its time, interpolated between poses at most `longest_gap_s` apart; frames without are
/// reported.
pub fn interpolate_poses(
    frames: &mut [FrameEntry],
    trajectory: &Trajectory,
    longest_gap_s: f64,
    warnings: &mut Vec<String>,
) {
    for frame in frames.iter_mut() {
        frame.world_from_camera = pose_at(trajectory, frame.time_s, longest_gap_s);
    }
    let matched = frames.iter().filter(|frame| frame.world_from_camera.is_some()).count();
    if matched < frames.len() {
        warnings.push(format!(
            "{matched} of {} frames have a pose: the truth does not cover the others, or has gaps above {longest_gap_s} s",
            frames.len()
        ));
    }
}

/// A picture or map named inside a data set's list, or an error with its line if the name leads outside the data set
/// or to nothing.
///
/// # Errors
/// [`FramesError::Line`].
pub fn listed_file(folder: &Path, name: &str, list: &Path, line: usize) -> Result<PathBuf, FramesError> {
    use std::path::Component::{CurDir, Normal};
    if !Path::new(name).components().all(|part| matches!(part, Normal(_) | CurDir)) {
        return Err(FramesError::line(list, line, format!("`{name}` leads outside the data set")));
    }
    let path = folder.join(name);
    if !path.is_file() {
        return Err(FramesError::line(list, line, format!("names {name}, which does not exist")));
    }
    Ok(path)
}

/// A calibration that is no camera, blamed on its file.
pub fn camera_error(file: &Path, error: &CameraError) -> FramesError {
    FramesError::file(file, format!("holds no usable calibration: {error}"), "correct it or give --camera FILE")
}

/// A sentence on a principal point far from the middle of the frames, as after a resize or a crop the calibration
/// does not know of.
pub fn centre_warning(intrinsics: &Intrinsics, frames: Size) -> Option<String> {
    let share = |centre: f64, extent: usize| centre / extent as f64;
    let (x, y) = (share(intrinsics.cx, frames.width), share(intrinsics.cy, frames.height));
    let usual = 0.25..=0.75;
    (!usual.contains(&x) || !usual.contains(&y)).then(|| {
        format!(
            "the principal point ({:.1}, {:.1}) is far from the middle of the {frames} frames: they may have been \
             resized or cropped since the calibration; give --camera FILE if so",
            intrinsics.cx, intrinsics.cy
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_give_numbers() {
        let endings = ["_color.png", "_color.jpg"];
        assert_eq!(number_between("0012_color.jpg", "", &endings), Some(12));
        assert_eq!(number_between("FrameBuffer_0003.png", "FrameBuffer_", &[".png"]), Some(3));
        for name in ["_color.png", "x1_color.png", "-1_color.png", "1_colour.png", "99999999999999999999999_color.png"]
        {
            assert_eq!(number_between(name, "", &endings), None, "{name}");
        }
    }

    #[test]
    fn one_number_twice_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["0.png", "1.png", "01.png"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let error = numbered(folder.path(), "", &[".png"]).unwrap_err().to_string();
        assert!(error.contains("number 1 twice"), "{error}");
    }

    #[test]
    fn a_folder_stands_for_its_only_sequence_unless_pictures_lie_there() {
        let load = |path: &Path| Err(FramesError::file(path, "was loaded", "stop"));
        let recognised = |path: &Path| path.join("own").is_file();
        let parent = tempfile::tempdir().unwrap();
        let answer = || only_sequence(parent.path(), recognised, load).map(|answer| answer.unwrap_err().to_string());
        assert_eq!(answer(), None);
        for (name, sentence) in [("b", "b: was loaded"), ("a", "holds 2 sequences (a, b); name one of them")] {
            std::fs::create_dir(parent.path().join(name)).unwrap();
            std::fs::write(parent.path().join(name).join("own"), "").unwrap();
            assert!(answer().unwrap().contains(sentence), "{:?}", answer());
        }
        std::fs::write(parent.path().join("1.png"), "").unwrap();
        assert_eq!(answer(), None);
    }

    #[test]
    fn times_must_increase() {
        assert_eq!(parse_times("0\n0.5\n\n1e0\n").unwrap(), [0.0, 0.5, 1.0]);
        assert_eq!(parse_times("0\n\n0\n").unwrap_err().line, 3);
        assert_eq!(parse_times("0\ninf\n").unwrap_err().line, 2);
    }

    #[test]
    fn gaps_have_no_pose() {
        let pose = |time_s| TimedPose { time_s, world_from_camera: Pose::identity() };
        let trajectory = Trajectory::new(vec![pose(0.0), pose(0.05), pose(1.0)]).unwrap();
        assert!(pose_at(&trajectory, 0.02, 0.1).is_some());
        assert!(pose_at(&trajectory, 0.5, 0.1).is_none());
        assert!(pose_at(&trajectory, 1.0, 0.1).is_some());
        assert!(pose_at(&trajectory, 1.1, 0.1).is_none());
        assert!(pose_at(&trajectory, -0.1, 0.1).is_none());
    }

    #[test]
    fn lists_name_nothing_outside() {
        let folder = tempfile::tempdir().unwrap();
        let list = Path::new("rgb.txt");
        for name in ["/etc/passwd", "../a.png", "missing.png"] {
            let error = listed_file(folder.path(), name, list, 7).unwrap_err().to_string();
            assert!(error.starts_with("rgb.txt, line 7"), "{error}");
        }
    }
}
