//! The `sequence` format: our own folder, as [`crate::sequence_folder`] writes it and as people edit it.

use super::{Format, Probe, common};
use crate::depth::{DepthEncoding, DepthFile};
use crate::sequence::{FrameEntry, ImageLocation};
use crate::sequence_folder::{Manifest, Row, VERSION};
use crate::{FramesError, Sequence, picture};
use endoscape_core::{Camera, TimedPose, trajectory};
use std::path::{Component, Path, PathBuf};

/// Takes folders with a `sequence.toml`.
pub fn probe(path: &Path) -> Probe {
    path.join("sequence.toml").is_file().then(|| load(path))
}

fn load(root: &Path) -> Result<Sequence, FramesError> {
    let manifest: Manifest = common::read_toml(&root.join("sequence.toml"))?;
    if manifest.version > VERSION {
        let reason = format!("is of version {}, this endoscape knows {VERSION}", manifest.version);
        return Err(FramesError::file(&root.join("sequence.toml"), reason, "use a newer endoscape"));
    }
    let mut frames = read_frames(root, &manifest)?;
    let first = frames.first().map(|frame| &frame.image);
    let Some(ImageLocation::File(first)) = first else {
        return Err(FramesError::file(&root.join("frames.csv"), "lists no frame", "write the sequence again"));
    };
    let size = picture::size(first)?;
    let camera_file = root.join("camera.toml");
    let camera: Option<Camera> = if camera_file.exists() { Some(common::read_toml(&camera_file)?) } else { None };
    if let Some(camera) = camera.filter(|camera| camera.size() != size) {
        let reason = format!("is for {} but the frames are {size}", camera.size());
        return Err(FramesError::file(&camera_file, reason, "give the camera of these frames"));
    }
    let poses_file = root.join("poses.tum");
    if poses_file.exists() {
        attach_poses(&poses_file, &mut frames)?;
    }
    Ok(Sequence {
        format: Format::Sequence,
        name: manifest.name,
        root: root.to_path_buf(),
        size,
        fps: manifest.fps,
        camera,
        video: None,
        frames,
        license: manifest.license,
        warnings: Vec::new(),
    })
}

fn read_frames(root: &Path, manifest: &Manifest) -> Result<Vec<FrameEntry>, FramesError> {
    let path = root.join("frames.csv");
    let text = common::read_text(&path)?;
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_bytes());
    let header = reader.headers().cloned().map_err(|error| FramesError::line(&path, 1, reason(&error)))?;
    let mut frames: Vec<FrameEntry> = Vec::new();
    let mut record = csv::StringRecord::new();
    loop {
        let line = reader.position().line() as usize;
        match reader.read_record(&mut record) {
            Ok(true) => {}
            Ok(false) => return Ok(frames),
            Err(error) => return Err(FramesError::line(&path, line, reason(&error))),
        }
        let line = record.position().map_or(line, |position| position.line() as usize);
        let at = |reason: String| FramesError::line(&path, line, reason);
        let row: Row = record.deserialize(Some(&header)).map_err(|error| at(reason(&error)))?;
        let frame = entry(root, manifest, &row).map_err(at)?;
        if frames.last().is_some_and(|last| frame.number <= last.number || frame.time_s <= last.time_s) {
            return Err(at(format!("frame {} at {} s is not after the one before it", row.index, row.time_s)));
        }
        frames.push(frame);
    }
}

/// The cause of a CSV error without the position, which the sentence around it gives.
fn reason(error: &csv::Error) -> String {
    match error.kind() {
        csv::ErrorKind::Deserialize { err, .. } => format!("{err} (expected index,time_s,file[,depth,mask])"),
        csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
            format!("found {len} fields where {expected_len} were expected")
        }
        _ => "is not text in columns".into(),
    }
}

fn entry(root: &Path, manifest: &Manifest, row: &Row) -> Result<FrameEntry, String> {
    if !row.time_s.is_finite() {
        return Err(format!("the time is {}", row.time_s));
    }
    let depth = match (inside(root, row.depth.as_deref())?, manifest.depth_metres_per_unit) {
        (None, _) => None,
        (Some(path), Some(metres_per_unit)) if metres_per_unit > 0.0 => {
            Some(DepthFile { path, encoding: DepthEncoding::Linear { metres_per_unit, largest: u16::MAX } })
        }
        _ => return Err("there is depth but sequence.toml has no depth_metres_per_unit above zero".into()),
    };
    let file = inside(root, Some(&row.file))?.ok_or("the frame has no file")?;
    let mask = inside(root, row.mask.as_deref())?;
    let image = ImageLocation::File(file);
    Ok(FrameEntry { number: row.index, time_s: row.time_s, image, depth, mask, world_from_camera: None })
}

/// A path that stays inside the folder and exists: a sequence folder can be moved and sent as one.
fn inside(root: &Path, name: Option<&str>) -> Result<Option<PathBuf>, String> {
    let Some(name) = name.filter(|name| !name.is_empty()) else { return Ok(None) };
    if !Path::new(name).components().all(|part| matches!(part, Component::Normal(_))) {
        return Err(format!("`{name}` does not lie inside the folder"));
    }
    let path = root.join(name);
    if path.is_file() { Ok(Some(path)) } else { Err(format!("there is no file `{name}`")) }
}

/// Gives each frame the pose of its time; the times are copies of each other, so they are equal to the last digit.
fn attach_poses(path: &Path, frames: &mut [FrameEntry]) -> Result<(), FramesError> {
    let text = common::read_text(path)?;
    let poses = trajectory::parse_tum(&text).map_err(|error| FramesError::from((path, error)))?;
    let is_record = |line: &str| !line.trim().is_empty() && !line.trim_start().starts_with('#');
    let lines = text.lines().enumerate().filter(|(_, line)| is_record(line)).map(|(index, _)| index + 1);
    for (TimedPose { time_s, world_from_camera }, line) in poses.into_iter().zip(lines) {
        let Ok(at) = frames.binary_search_by(|frame| frame.time_s.total_cmp(&time_s)) else {
            return Err(FramesError::line(path, line, format!("no frame of frames.csv is at {time_s} s")));
        };
        frames[at].world_from_camera = Some(world_from_camera);
    }
    Ok(())
}
