//! What a path holds, and which convention its numbers follow.
//!
//! Every frame is decoded once, so a damaged file is found here and not in the middle of a training. Where poses and
//! depth exist, the depth of one frame is carried into another under the loader's convention and under the usual wrong
//! ones; where there are poses but no depth, points followed from picture to picture take its place.

mod consistency;
mod convention;
mod epipolar;
mod preview;
mod verdict;

pub use consistency::{Residual, View, residual};
pub use convention::{Convention, NO_MOTION, conventions};
pub use epipolar::MotionScore;
pub use preview::{Panel, contact_sheet};
pub use verdict::{ConventionScore, DepthConsistency};

use self::epipolar::MotionCheck;
use crate::preprocess::field_of_view::{self, FieldOfView};
use crate::{FramesError, Sequence};
use endoscape_core::{Camera, Event, EventSink, Image, Mask};
use serde::Serialize;

/// Frames read of a live input.
const LIVE_FRAMES: usize = 60;

/// Frames looked at for the field of view and shown in the preview.
const LOOKED_AT: usize = 8;

/// Everything found out about a sequence. Serialises to the JSON object of `endoscape inspect --json`.
#[derive(Clone, Debug, Serialize)]
pub struct Inspection {
    /// Name of the format.
    pub format: &'static str,
    /// Short name of the sequence.
    pub name: String,
    /// Frames that decode.
    pub frames: usize,
    /// Frames per second, where known.
    pub fps: Option<f64>,
    /// Width of the frames in pixels.
    pub width: usize,
    /// Height of the frames in pixels.
    pub height: usize,
    /// The camera, where known.
    pub camera: Option<Camera>,
    /// Horizontal field of view in degrees, where the camera is known.
    pub horizontal_fov_deg: Option<f64>,
    /// Whether any frame has a pose.
    pub has_poses: bool,
    /// Whether any frame has depth.
    pub has_depth: bool,
    /// Whether any frame has a mask.
    pub has_masks: bool,
    /// Length of the camera's path in metres, where poses exist.
    pub path_length_m: Option<f64>,
    /// Share of the picture inside the field of view; 1 where the picture is full.
    pub field_of_view_share: f64,
    /// Agreement of the first pair of depth maps, where poses and depth exist.
    pub depth_consistency: Option<DepthConsistency>,
    /// Every convention tried, the loader's first.
    pub conventions: Vec<ConventionScore>,
    /// Without depth: the share of followed points each convention explains, the loader's first.
    pub motion_check: Vec<MotionScore>,
    /// What the user should know, one sentence each.
    pub warnings: Vec<String>,
    /// Licence, as far as the data set states one.
    pub license: Option<String>,
    /// Frames for a preview, with their depth.
    #[serde(skip)]
    pub panels: Vec<Panel>,
    /// The field of view found, `None` where the picture is full.
    #[serde(skip)]
    pub field_of_view: Option<FieldOfView>,
}

/// Decodes every frame, measures the path and proves the convention.
///
/// # Errors
/// The first [`FramesError`] met in any frame or depth map.
pub fn inspect(sequence: &Sequence, sink: &mut dyn EventSink) -> Result<Inspection, FramesError> {
    let decoded = decode_all(sequence, sink)?;
    let field_of_view = field_of_view::find(&decoded.kept.iter().map(|(_, image)| image.clone()).collect::<Vec<_>>());
    let verdict = verdict::check(sequence)?;
    let motion = if verdict.scores.is_empty() { epipolar::check(sequence)? } else { MotionCheck::default() };
    let mut warnings = sequence.warnings.clone();
    warnings.extend(decoded.warnings);
    warnings.extend(what_cannot_be_proven(sequence, !(verdict.scores.is_empty() && motion.scores.is_empty())));
    warnings.extend(verdict.warnings.into_iter().chain(motion.warnings));
    let path_length_m = if sequence.has_poses() { Some(sequence.trajectory()?.path_length_m()) } else { None };
    let fov_rad = sequence.camera.and_then(|camera| camera.horizontal_field_of_view_rad());
    Ok(Inspection {
        format: sequence.format.name(),
        name: sequence.name.clone(),
        frames: decoded.count,
        fps: sequence.fps,
        width: sequence.size.width,
        height: sequence.size.height,
        camera: sequence.camera,
        horizontal_fov_deg: fov_rad.map(f64::to_degrees),
        has_poses: sequence.has_poses(),
        has_depth: sequence.has_depth(),
        has_masks: sequence.has_masks(),
        path_length_m,
        field_of_view_share: field_of_view.as_ref().map_or(1.0, |found| share(&found.mask)),
        depth_consistency: verdict.consistency,
        conventions: verdict.scores,
        motion_check: motion.scores,
        warnings,
        license: sequence.license.clone(),
        panels: panels(sequence, decoded.kept)?,
        field_of_view,
    })
}

/// What reading a sequence to its end brought.
struct Decoded {
    count: usize,
    /// A few pictures with their positions.
    kept: Vec<(usize, Image)>,
    warnings: Vec<String>,
}

/// Reads the sequence to its end; keeps a few pictures spread along it, with their positions.
fn decode_all(sequence: &Sequence, sink: &mut dyn EventSink) -> Result<Decoded, FramesError> {
    // A live input has no end: a few seconds of it tell enough.
    let total = if sequence.is_live() { LIVE_FRAMES } else { sequence.frames.len() };
    sink.event(Event::Started { stage: "reading frames".into(), total: Some(total as u64) });
    let wanted: Vec<usize> = (0..LOOKED_AT).map(|part| part * total.saturating_sub(1) / (LOOKED_AT - 1)).collect();
    let mut kept = Vec::new();
    let mut count = 0;
    let mut source = sequence.open_frames(0..sequence.frames.len())?;
    while let Some(frame) = source.next_frame()? {
        if wanted.contains(&frame.index) {
            kept.push((frame.index, (*frame.image).clone()));
        }
        count += 1;
        sink.event(Event::Advanced { done: count as u64 });
        if sequence.is_live() && count == LIVE_FRAMES {
            break;
        }
    }
    sink.event(Event::Finished);
    Ok(Decoded { count, kept, warnings: source.warnings() })
}

/// Frames to show: those spread along the sequence, or those with depth where only few have any.
fn panels(sequence: &Sequence, spread: Vec<(usize, Image)>) -> Result<Vec<Panel>, FramesError> {
    let with_depth: Vec<usize> = (0..sequence.frames.len()).filter(|at| sequence.frames[*at].depth.is_some()).collect();
    let shown = spread.iter().filter(|(position, _)| with_depth.contains(position)).count();
    let images = if shown < with_depth.len().min(LOOKED_AT) {
        let step = with_depth.len().div_ceil(LOOKED_AT);
        let positions = with_depth.into_iter().step_by(step);
        positions.map(|position| Ok((position, sequence.read_image(position)?))).collect::<Result<_, FramesError>>()?
    } else {
        spread
    };
    let panel = |(position, image)| Ok(Panel { image, depth: sequence.read_depth(position)? });
    images.into_iter().map(panel).collect()
}

/// Share of usable pixels.
fn share(mask: &Mask) -> f64 {
    mask.values().iter().filter(|usable| **usable).count() as f64 / mask.values().len().max(1) as f64
}

fn what_cannot_be_proven(sequence: &Sequence, proven: bool) -> Option<String> {
    let missing = match (sequence.has_poses(), sequence.has_depth(), sequence.camera.is_some()) {
        _ if proven => return None,
        (false, _, true) => return None,
        (_, _, false) => "no calibration is known, so nothing can be projected; give one with --camera FILE or --hfov DEGREES",
        (true, false, true) => "the convention of the poses cannot be proven: there is no depth, and too few points could be followed from picture to picture",
        (true, true, true) => "the convention of the poses cannot be proven: no two frames with depth and pose overlap",
    };
    Some(missing.into())
}
