//! Any sequence to a clean sequence folder: rectified, resized and thinned, with intrinsics, masks, poses and depth
//! carried along together.

use crate::preprocess::field_of_view::{self, FieldOfView};
use crate::preprocess::rectify::{Rectifier, pinhole_for};
use crate::preprocess::resize;
use crate::sequence_folder::{Header, Writer, WrittenFrame};
use crate::{FramesError, Sequence};
use endoscape_core::{Camera, DepthMap, Event, EventSink, Frame, Image, Mask, Size};
use std::ops::Range;
use std::path::Path;

/// Frames looked at to find the field of view.
const LOOKED_AT: usize = 8;

/// What to do on the way. The default copies everything as it is.
#[derive(Clone, Debug)]
pub struct ConvertOptions {
    /// Remap to a pinhole camera along the same axis.
    pub rectify: bool,
    /// Horizontal field of view of that pinhole, radians; the widest wholly seen one if `None`.
    pub horizontal_fov_rad: Option<f64>,
    /// Size of the written frames; that of the sequence if `None`.
    pub size: Option<Size>,
    /// Positions to take, counted from 0, the end excluded; all if `None`.
    pub range: Option<Range<usize>>,
    /// Take every n-th of them; 1 takes all.
    pub every: usize,
}

impl Default for ConvertOptions {
    fn default() -> Self {
        Self { rectify: false, horizontal_fov_rad: None, size: None, range: None, every: 1 }
    }
}

/// What was written.
#[derive(Clone, Debug, PartialEq)]
pub struct Converted {
    /// Frames written.
    pub frames: usize,
    /// The camera of the written frames.
    pub camera: Option<Camera>,
    /// Size of the written frames.
    pub size: Size,
}

/// Writes a sequence to a new folder; nothing is left there if anything fails.
///
/// # Errors
/// [`FramesError`] for a request that cannot be met (rectifying without a camera, an empty range), a frame that does
/// not decode, or a folder that cannot be written.
pub fn convert(
    sequence: &Sequence,
    out: &Path,
    options: &ConvertOptions,
    sink: &mut dyn EventSink,
) -> Result<Converted, FramesError> {
    let range = positions(sequence, options)?;
    let path = Transform::new(sequence, options)?;
    let field_of_view = find_field_of_view(sequence, &range)?;
    let mut writer = Writer::create(out, header(sequence, &path, options))?;
    sink.event(Event::Started { stage: "converting".into(), total: Some(range.len().div_ceil(options.every) as u64) });
    let mut source = sequence.open_frames(range.clone())?;
    let mut frames = 0;
    while let Some(frame) = source.next_frame()? {
        if frame.index >= range.end {
            break;
        }
        if frame.index < range.start || (frame.index - range.start) % options.every != 0 {
            continue;
        }
        write_one(sequence, &frame, &path, field_of_view.as_ref(), &mut writer)?;
        frames += 1;
        sink.event(Event::Advanced { done: frames as u64 });
    }
    writer.finish()?;
    sink.event(Event::Finished);
    Ok(Converted { frames, camera: path.camera, size: path.size })
}

fn positions(sequence: &Sequence, options: &ConvertOptions) -> Result<Range<usize>, FramesError> {
    if options.every == 0 {
        return Err(request("every 0th frame is no frame at all", "give --every 1 or more"));
    }
    if sequence.is_live() {
        let bounded = options.range.clone().filter(|range| range.start < range.end);
        return bounded
            .ok_or_else(|| request("a live input has no last frame", "say how many to take, such as --range 0..300"));
    }
    let total = sequence.frames.len();
    let range = options.range.clone().unwrap_or(0..total);
    if range.start >= range.end || range.end > total {
        let what = format!("frames {}..{} do not exist in {total} frames", range.start, range.end);
        return Err(request(&what, "give a range A..B with A below B and B at most the number of frames"));
    }
    Ok(range)
}

fn request(what: &str, remedy: &str) -> FramesError {
    FramesError::Request { what: what.into(), remedy: remedy.into() }
}

/// The geometry from stored to written pixels.
struct Transform {
    camera: Option<Camera>,
    size: Size,
    rectifier: Option<Rectifier>,
}

impl Transform {
    fn new(sequence: &Sequence, options: &ConvertOptions) -> Result<Self, FramesError> {
        let size = options.size.unwrap_or(sequence.size);
        if options.rectify {
            let Some(from) = &sequence.camera else {
                let what = format!("{} cannot be rectified without a calibration", sequence.root.display());
                return Err(request(&what, "give one with --camera FILE"));
            };
            let to = pinhole_for(from, size, options.horizontal_fov_rad)?;
            return Ok(Self { camera: Some(to), size, rectifier: Some(Rectifier::new(from, &to)) });
        }
        let scaled = sequence.camera.map(|camera| camera.scaled_to(size)).transpose();
        let camera = scaled.map_err(|error| request(&error.to_string(), "give another --size"))?;
        Ok(Self { camera, size, rectifier: None })
    }

    fn image(&self, image: &Image) -> Result<Image, FramesError> {
        match &self.rectifier {
            Some(rectifier) => Ok(rectifier.image(image)?),
            None => Ok(resize::image(image, self.size)?),
        }
    }

    fn depth(&self, depth: &DepthMap) -> Result<DepthMap, FramesError> {
        match &self.rectifier {
            Some(rectifier) => Ok(rectifier.depth(depth)?),
            None => Ok(resize::depth(depth, self.size)),
        }
    }

    /// Usable pixels after the transform; `None` when all are.
    fn mask(&self, usable: Option<&Mask>) -> Result<Option<Mask>, FramesError> {
        let mask = match (&self.rectifier, usable) {
            (Some(rectifier), Some(usable)) => rectifier.mask(usable)?,
            (Some(rectifier), None) => rectifier.valid().clone(),
            (None, Some(usable)) => resize::mask(usable, self.size),
            (None, None) => return Ok(None),
        };
        Ok(mask.values().contains(&false).then_some(mask))
    }
}

fn find_field_of_view(sequence: &Sequence, range: &Range<usize>) -> Result<Option<FieldOfView>, FramesError> {
    let spread =
        (0..LOOKED_AT.min(range.len())).map(|part| range.start + part * range.len() / LOOKED_AT.min(range.len()));
    let images = sequence.read_images(&spread.collect::<Vec<_>>())?;
    Ok(field_of_view::find(&images))
}

fn header(sequence: &Sequence, path: &Transform, options: &ConvertOptions) -> Header {
    let mut steps = Vec::new();
    if options.rectify {
        steps.push("rectified".to_string());
    }
    if path.size != sequence.size {
        steps.push(format!("resized from {} to {}", sequence.size, path.size));
    }
    if options.every > 1 {
        steps.push(format!("every {}th frame", options.every));
    }
    let steps = if steps.is_empty() { "copied".into() } else { steps.join(", ") };
    Header {
        name: sequence.name.clone(),
        fps: sequence.fps.map(|fps| fps / options.every as f64),
        camera: path.camera,
        license: sequence.license.clone(),
        provenance: Some(format!("{} of format {}, {steps}", sequence.name, sequence.format)),
        depth_metres_per_unit: None,
    }
}

fn write_one(
    sequence: &Sequence,
    frame: &Frame,
    path: &Transform,
    field_of_view: Option<&FieldOfView>,
    writer: &mut Writer,
) -> Result<(), FramesError> {
    // Frames of a live input have no entry and bring nothing but their picture and time.
    let entry = sequence.frames.get(frame.index);
    let usable = both(frame.usable.as_deref(), field_of_view.map(|found| &found.mask));
    let (image, mask) = (path.image(&frame.image)?, path.mask(usable.as_ref())?);
    let depth = if entry.is_some() { sequence.read_depth(frame.index)? } else { None };
    let depth = depth.map(|depth| path.depth(&depth)).transpose()?;
    writer.write_frame(&WrittenFrame {
        number: entry.map_or(frame.index, |entry| entry.number),
        time_s: entry.map_or(frame.time_s, |entry| entry.time_s),
        image: &image,
        depth: depth.as_ref(),
        mask: mask.as_ref(),
        world_from_camera: entry.and_then(|entry| entry.world_from_camera),
    })
}

/// Pixels usable by both masks; a mask that is not there allows everything.
fn both(a: Option<&Mask>, b: Option<&Mask>) -> Option<Mask> {
    match (a, b) {
        (Some(a), Some(b)) if a.size() == b.size() => {
            let mut mask = a.clone();
            mask.values_mut().iter_mut().zip(b.values()).for_each(|(a, b)| *a = *a && *b);
            Some(mask)
        }
        (a, b) => a.or(b).cloned(),
    }
}
