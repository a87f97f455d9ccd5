//! What a run has found out about a sequence, read back from its folder: labels that nobody had to draw.
//!
//! `endoscape run` writes a pose and a depth map for every frame, all in one unit of length. Laid over the sequence it
//! ran over they take the place of the truth, so that whoever reads sequences can read labels.

use crate::depth::{DepthEncoding, DepthFile};
use crate::formats::common;
use crate::{FramesError, Sequence};
use endoscape_core::{Pose, Size, TimedPose, trajectory};
use serde::Deserialize;
use std::collections::HashMap;
use std::path::Path;

/// The part of `run.json` that says what its maps are.
#[derive(Deserialize)]
struct Facts {
    depth: Option<Maps>,
}

#[derive(Deserialize)]
struct Maps {
    /// Length of a step of 16-bit maps; `None` for maps of another form.
    unit_per_step: Option<f64>,
    size: Option<Size>,
}

/// A line of `frames.csv`.
#[derive(Deserialize)]
struct Row {
    index: usize,
    tracked: bool,
}

/// The sequence with poses and depth as the run in `folder` has them, in the run's unit of length: those of its own are
/// gone, and so are the poses of frames that the run lost. [`Sequence::size`] is that of the run's maps.
///
/// # Errors
/// [`FramesError`]: a folder that no run over this sequence has written, or one without 16-bit depth maps.
pub fn of_run(sequence: &Sequence, folder: &Path) -> Result<Sequence, FramesError> {
    let Maps { unit_per_step, size } = maps(folder)?;
    let (Some(metres_per_unit), Some(size)) = (unit_per_step, size) else {
        let reason = "holds no 16-bit depth maps to learn from";
        return Err(FramesError::file(folder, reason, "run again with --depth png"));
    };
    let poses = poses(folder)?;
    let encoding = DepthEncoding::Linear { metres_per_unit, largest: u16::MAX - 1 };
    let mut labelled = Sequence { size, camera: None, ..sequence.clone() };
    for frame in &mut labelled.frames {
        let path = folder.join("depth").join(format!("{:06}.png", frame.number));
        frame.world_from_camera = poses.get(&frame.number).copied();
        frame.depth = path.is_file().then(|| DepthFile { path, encoding: encoding.clone() });
    }
    if !labelled.has_poses() || !labelled.has_depth() {
        let reason = format!("says nothing about the frames of {}", sequence.root.display());
        return Err(FramesError::file(folder, reason, "give the folder of a run over the same input"));
    }
    Ok(labelled)
}

fn maps(folder: &Path) -> Result<Maps, FramesError> {
    let path = folder.join("run.json");
    let facts: Facts = serde_json::from_str(&common::read_text(&path)?).map_err(|error| {
        let reason = format!("is not what a run writes ({error})");
        FramesError::file(&path, reason, "give the result folder of endoscape run")
    })?;
    Ok(facts.depth.unwrap_or(Maps { unit_per_step: None, size: None }))
}

/// Poses of the frames that were tracked, by number.
fn poses(folder: &Path) -> Result<HashMap<usize, Pose>, FramesError> {
    let (frames, path) = (folder.join("frames.csv"), folder.join("trajectory.tum"));
    let text = common::read_text(&frames)?;
    let rows: Result<Vec<Row>, _> = csv::Reader::from_reader(text.as_bytes()).deserialize().collect();
    let remedy = "run again";
    let rows = rows.map_err(|error| FramesError::file(&frames, format!("cannot be read ({error})"), remedy))?;
    let poses =
        trajectory::parse_tum(&common::read_text(&path)?).map_err(|error| FramesError::from((&*path, error)))?;
    if rows.len() != poses.len() {
        let reason = format!("has {} poses but frames.csv {} frames", poses.len(), rows.len());
        return Err(FramesError::file(&path, reason, remedy));
    }
    let tracked = rows.into_iter().zip(poses).filter(|(row, _)| row.tracked);
    Ok(tracked.map(|(row, TimedPose { world_from_camera, .. })| (row.index, world_from_camera)).collect())
}

#[cfg(test)]
mod tests;
