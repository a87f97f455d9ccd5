//! One video at the training size, in memory.
//!
//! A training draws every frame many times, so frames are decoded and resized once and kept as bytes: four per pixel
//! (colour and mask), with a cap. The camera is scaled along, so clips of different lenses and sizes mix freely.

use crate::error::TrainError;
use endoscape_core::{Camera, DepthMap, Event, EventSink, Frame, Image, Mask, Pose, Size};
use endoscape_frames::preprocess::{field_of_view, resize, specular};
use endoscape_frames::{FramesError, Sequence};
use sha2::{Digest, Sha256};
use std::ops::Range;
use std::sync::Arc;

/// Bytes a pixel takes in memory: red, green, blue and usable.
const BYTES_PER_PIXEL: usize = 4;
/// Bytes the depth of a label takes per pixel.
const BYTES_PER_LABEL: usize = 4;
/// How far around a highlight its glow reaches, pixels at the training size.
const SPECULAR_GLOW_PX: usize = 1;
/// Depth maps kept per clip; more do not change what a validation says.
const DEPTH_MAPS: usize = 64;

/// A frame at the training size.
#[derive(Clone, Debug)]
pub struct ClipFrame {
    /// Its position in the sequence.
    pub position: usize,
    /// The picture.
    pub image: Image,
    /// Pixels worth learning from: inside the field of view, no highlight.
    pub usable: Mask,
    /// Its true pose in metres, for validation alone.
    pub world_from_camera: Option<Pose>,
    /// Its true depth at the training size, for validation alone.
    pub depth: Option<DepthMap>,
    /// What is learned about it beside what its pictures say.
    pub label: Option<Label>,
}

/// Where a run was when it saw a frame and how deep, in the run's own unit of length: nobody's truth, but found with more
/// than the networks have ([`crate::lesson`]).
#[derive(Clone, Debug)]
pub struct Label {
    /// Pose.
    pub world_from_camera: Pose,
    /// Depth at the training size.
    pub depth: DepthMap,
}

/// Frames of one video, resized, with the camera that fits them.
#[derive(Clone, Debug)]
pub struct Clip {
    /// Name of the sequence and the frames taken, as reports say it.
    pub name: String,
    /// The frames in time order; those that do not decode are left out.
    pub frames: Vec<ClipFrame>,
    /// The camera at the training size.
    pub camera: Camera,
    /// SHA-256 over the decoded pictures before resizing, so that training data can be recognised anywhere.
    pub fingerprint: String,
}

/// Which frames to load and how.
#[derive(Clone, Debug)]
pub struct ClipOptions {
    /// The training size.
    pub size: Size,
    /// Positions in the sequence; the end is cut to the sequence's.
    pub range: Range<usize>,
    /// Read true depth too.
    pub with_depth: bool,
    /// The sequence with labels in the place of its poses and depth ([`endoscape_frames::labels`]).
    pub labels: Option<Sequence>,
}

impl Clip {
    /// Memory in bytes that `frames` frames of `size` take.
    pub const fn bytes(size: Size, frames: usize) -> usize {
        frames.saturating_mul(size.area()).saturating_mul(BYTES_PER_PIXEL)
    }

    /// Decodes and resizes the frames of a sequence. A frame that does not decode is left out with a warning.
    ///
    /// # Errors
    /// [`TrainError::Data`] for a live source, a sequence without a camera, or a range without frames;
    /// [`TrainError::Frames`] for a source that cannot be opened or of which no frame decodes, and for
    /// frames of two sizes.
    pub fn load(sequence: &Sequence, options: &ClipOptions, events: &mut dyn EventSink) -> Result<Self, TrainError> {
        let range = options.range.start..options.range.end.min(sequence.frames.len());
        let name = format!("{}@{}..{}", sequence.name, range.start, range.end);
        let camera = check(sequence, &range, &name)?.scaled_to(options.size)?;
        let total = Some(range.len() as u64);
        events.event(Event::Started { stage: format!("reading {name}"), total });
        let mut source = sequence.open_frames(range.clone())?;
        let (mut frames, mut hash, mut first_error) = (Vec::with_capacity(range.len()), Sha256::new(), None);
        loop {
            match source.next_frame() {
                Ok(Some(frame)) => {
                    hash.update(frame.image.rgb());
                    frames.push(prepare(&frame, sequence, options.size)?);
                    events.event(Event::Advanced { done: frames.len() as u64 });
                }
                Ok(None) => break,
                // Two recordings in one folder: whatever was meant, training on a part of it was not.
                Err(error @ FramesError::OtherSize { .. }) => return Err(error.into()),
                Err(error) => {
                    events.event(Event::Warned(format!("{error}; training goes on without that frame")));
                    first_error.get_or_insert(error);
                }
            }
        }
        events.event(Event::Finished);
        if let (true, Some(error)) = (frames.is_empty(), first_error) {
            return Err(error.into());
        }
        restrict_to_field_of_view(&mut frames);
        let mut clip = Self { name, frames, camera, fingerprint: format!("sha256:{:x}", hash.finalize()) };
        if options.with_depth {
            clip.read_depth(sequence)?;
        }
        if let Some(labels) = &options.labels {
            clip.read_labels(labels)?;
        }
        Ok(clip)
    }

    fn read_labels(&mut self, labels: &Sequence) -> Result<(), TrainError> {
        for frame in &mut self.frames {
            let pose = labels.frames.get(frame.position).and_then(|entry| entry.world_from_camera);
            let Some(world_from_camera) = pose else { continue };
            let depth = labels.read_depth(frame.position)?.map(|depth| resize::depth(&depth, frame.image.size()));
            frame.label = depth.map(|depth| Label { world_from_camera, depth });
        }
        Ok(())
    }

    fn read_depth(&mut self, sequence: &Sequence) -> Result<(), TrainError> {
        let known = |frame: &&mut ClipFrame| sequence.frames[frame.position].depth.is_some();
        let count = self.frames.iter_mut().filter(known).count();
        for frame in self.frames.iter_mut().filter(known).step_by(count.div_ceil(DEPTH_MAPS).max(1)) {
            let size = frame.image.size();
            frame.depth = sequence.read_depth(frame.position)?.map(|depth| resize::depth(&depth, size));
        }
        Ok(())
    }
}

/// The camera, if the sequence can be trained on at all.
fn check<'a>(sequence: &'a Sequence, range: &Range<usize>, name: &str) -> Result<&'a Camera, TrainError> {
    if sequence.is_live() {
        return Err(TrainError::data(name, "a live source has no frames to go back to", "record it to a file first"));
    }
    if range.is_empty() {
        let reason = format!("the sequence has {} frames, so the range is empty", sequence.frames.len());
        return Err(TrainError::data(name, reason, "choose a range inside the sequence"));
    }
    sequence.camera.as_ref().ok_or_else(|| {
        let remedy = "give a calibration with --camera FILE or state the field of view with --hfov DEGREES";
        TrainError::data(name, "its camera is not known, but depth and motion depend on it", remedy)
    })
}

fn prepare(frame: &Frame, sequence: &Sequence, size: Size) -> Result<ClipFrame, TrainError> {
    let image = resize::image(&frame.image, size)?;
    let config = specular::SpecularConfig { dilation_px: SPECULAR_GLOW_PX, ..specular::SpecularConfig::default() };
    let mut usable = specular::mask(&image, &config);
    if let Some(own) = &frame.usable {
        intersect(&mut usable, &resize::mask(own, size));
    }
    let world_from_camera = sequence.frames.get(frame.index).and_then(|entry| entry.world_from_camera);
    Ok(ClipFrame { position: frame.index, image, usable, world_from_camera, depth: None, label: None })
}

/// Takes the black border around the field of view out of every mask.
fn restrict_to_field_of_view(frames: &mut [ClipFrame]) {
    let looked_at = frames.iter().step_by(frames.len().div_ceil(64).max(1));
    let images: Vec<Image> = looked_at.map(|frame| frame.image.clone()).collect();
    if let Some(field) = field_of_view::find(&images) {
        frames.iter_mut().for_each(|frame| intersect(&mut frame.usable, &field.mask));
    }
}

/// A sequence and the frames of it to use.
#[derive(Clone, Debug)]
pub struct Source {
    /// The sequence.
    pub sequence: Sequence,
    /// Positions of the frames; the end may lie beyond the sequence's.
    pub range: Range<usize>,
    /// What is to be learned beside the pictures; see [`ClipOptions::labels`].
    pub labels: Option<Sequence>,
}

impl Source {
    /// Memory in bytes that its frames take at a size.
    fn bytes(&self, size: Size) -> usize {
        let frames = self.range.end.min(self.sequence.frames.len()).saturating_sub(self.range.start);
        let labels = if self.labels.is_some() { frames.saturating_mul(size.area() * BYTES_PER_LABEL) } else { 0 };
        Clip::bytes(size, frames).saturating_add(labels)
    }
}

/// Loads all sources at one size.
///
/// # Errors
/// [`TrainError::Data`] before anything is decoded if the frames need more than `memory_mib`, else as [`Clip::load`].
pub fn load_clips(
    sources: &[Source],
    size: Size,
    with_depth: bool,
    memory_mib: usize,
    events: &mut dyn EventSink,
) -> Result<Vec<Arc<Clip>>, TrainError> {
    let needed_mib = sources.iter().map(|source| source.bytes(size)).fold(0, usize::saturating_add) >> 20;
    if needed_mib > memory_mib {
        let reason = format!("frames of {size} take {needed_mib} MiB, above the cap of {memory_mib} MiB");
        let remedy = "use fewer frames or a smaller size, or raise memory_mib in the configuration";
        return Err(TrainError::data("data", reason, remedy));
    }
    let load = |source: &Source| {
        let options = ClipOptions { size, range: source.range.clone(), with_depth, labels: source.labels.clone() };
        Clip::load(&source.sequence, &options, events).map(Arc::new)
    };
    sources.iter().map(load).collect()
}

fn intersect(mask: &mut Mask, other: &Mask) {
    for (usable, other) in mask.values_mut().iter_mut().zip(other.values()) {
        *usable &= other;
    }
}
