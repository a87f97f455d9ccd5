//! Frames with true poses at the training size, in memory.
//!
//! Motion is learned between neighbours, so a frame that does not decode or has no pose ends a stretch. The camera is
//! not needed: the network sees pictures alone.

use crate::clip::Source;
use crate::error::TrainError;
use endoscape_core::{Event, EventSink, Image, Pose, Size};
use endoscape_frames::preprocess::resize;
use endoscape_frames::{FramesError, Sequence};
use endoscape_nets::DataSource;
use sha2::{Digest, Sha256};

/// Bytes a pixel takes in memory.
const BYTES_PER_PIXEL: usize = 3;

/// A frame at the training size.
#[derive(Clone, Debug)]
pub struct PosedFrame {
    /// The picture.
    pub image: Image,
    /// Its true pose, metres.
    pub world_from_camera: Pose,
}

/// What a sequence gives for supervised training.
#[derive(Clone, Debug)]
pub struct PosedClip {
    /// Name of the sequence and the frames taken, as reports say it.
    pub name: String,
    /// Runs of at least two neighbouring frames, in time order.
    pub stretches: Vec<Vec<PosedFrame>>,
    /// SHA-256 over the decoded pictures before resizing.
    pub fingerprint: String,
}

impl PosedClip {
    /// Name and fingerprint, for manifests.
    pub fn source(&self) -> DataSource {
        DataSource { name: self.name.clone(), fingerprint: self.fingerprint.clone() }
    }

    /// Decodes and resizes the frames of a source. A frame that does not decode is left out with a warning.
    ///
    /// # Errors
    /// [`TrainError::Data`] for a live source, an empty range or a sequence without two neighbouring frames of known
    /// pose; [`TrainError::Frames`] for a source that cannot be opened or has frames of two sizes.
    pub fn load(source: &Source, size: Size, events: &mut dyn EventSink) -> Result<Self, TrainError> {
        let sequence = &source.sequence;
        let range = source.range.start..source.range.end.min(sequence.frames.len());
        let name = format!("{}@{}..{}", sequence.name, range.start, range.end);
        check(source, &name)?;
        events.event(Event::Started { stage: format!("reading {name}"), total: Some(range.len() as u64) });
        let (mut reader, mut hash, mut done) = (sequence.open_frames(range)?, Sha256::new(), 0);
        let mut stretches = Stretches::default();
        loop {
            match reader.next_frame() {
                Ok(Some(frame)) => {
                    hash.update(frame.image.rgb());
                    let pose = pose_of(sequence, frame.index);
                    if let Some(world_from_camera) = pose {
                        let image = resize::image(&frame.image, size)?;
                        stretches.add(frame.index, PosedFrame { image, world_from_camera });
                    }
                    done += 1;
                    events.event(Event::Advanced { done });
                }
                Ok(None) => break,
                Err(error @ FramesError::OtherSize { .. }) => return Err(error.into()),
                Err(error) => {
                    events.event(Event::Warned(format!("{error}; training goes on without that frame")));
                }
            }
        }
        events.event(Event::Finished);
        let stretches = stretches.finish();
        if stretches.is_empty() {
            return Err(no_truth(&name, "no two neighbouring frames of it decode and have true poses"));
        }
        Ok(Self { name, stretches, fingerprint: format!("sha256:{:x}", hash.finalize()) })
    }
}

fn pose_of(sequence: &Sequence, position: usize) -> Option<Pose> {
    sequence.frames.get(position).and_then(|entry| entry.world_from_camera)
}

/// Frames gathered into runs of neighbours.
#[derive(Default)]
struct Stretches {
    all: Vec<Vec<PosedFrame>>,
    /// Position that continues the latest run.
    next: Option<usize>,
}

impl Stretches {
    fn add(&mut self, position: usize, frame: PosedFrame) {
        match self.all.last_mut().filter(|_| self.next == Some(position)) {
            Some(stretch) => stretch.push(frame),
            None => self.all.push(vec![frame]),
        }
        self.next = Some(position + 1);
    }

    fn finish(mut self) -> Vec<Vec<PosedFrame>> {
        self.all.retain(|stretch| stretch.len() > 1);
        self.all
    }
}

/// Whether the sequence can be learned from at all, before anything is decoded.
fn check(source: &Source, name: &str) -> Result<(), TrainError> {
    let sequence = &source.sequence;
    if sequence.is_live() {
        return Err(TrainError::data(name, "a live source has no true poses", "give a recorded sequence"));
    }
    let frames = sequence.frames.get(source.range.start..source.range.end.min(sequence.frames.len()));
    let Some(frames) = frames.filter(|frames| !frames.is_empty()) else {
        let reason = format!("the sequence has {} frames, so the range is empty", sequence.frames.len());
        return Err(TrainError::data(name, reason, "choose a range inside the sequence"));
    };
    if frames.iter().all(|frame| frame.world_from_camera.is_none()) {
        return Err(no_truth(name, "it has no true poses, which supervised training learns from"));
    }
    Ok(())
}

fn no_truth(name: &str, reason: &str) -> TrainError {
    TrainError::data(name, reason, "give a sequence with poses, or train without --supervised")
}

/// Loads all sources at one size.
///
/// # Errors
/// [`TrainError::Data`] before anything is decoded if the frames need more than `memory_mib`, else as
/// [`PosedClip::load`].
pub fn load_posed(
    sources: &[Source],
    size: Size,
    memory_mib: usize,
    events: &mut dyn EventSink,
) -> Result<Vec<PosedClip>, TrainError> {
    let frames =
        |source: &Source| source.range.end.min(source.sequence.frames.len()).saturating_sub(source.range.start);
    let total: usize = sources.iter().map(frames).sum();
    let needed_mib = total.saturating_mul(size.area()).saturating_mul(BYTES_PER_PIXEL) >> 20;
    if needed_mib > memory_mib {
        let reason = format!("{total} frames of {size} take {needed_mib} MiB, above the cap of {memory_mib} MiB");
        let remedy = "use fewer frames or a smaller size, or raise memory_mib in the configuration";
        return Err(TrainError::data("data", reason, remedy));
    }
    sources.iter().map(|source| PosedClip::load(source, size, events)).collect()
}

/// Mean length of a step from frame to frame, metres: the unit of the network's translation.
///
/// # Errors
/// [`TrainError::Data`] if the camera never moves, or has no finite place.
pub fn mean_step_m(clips: &[PosedClip]) -> Result<f64, TrainError> {
    let stretches = clips.iter().flat_map(|clip| &clip.stretches);
    let steps: Vec<f64> =
        stretches.flat_map(|stretch| stretch.windows(2).map(|pair| step_m(&pair[0], &pair[1]))).collect();
    let mean = steps.iter().sum::<f64>() / steps.len().max(1) as f64;
    if mean > 0.0 && mean.is_finite() {
        return Ok(mean);
    }
    let reason = "the camera never moves in it, so there is no motion to learn";
    Err(TrainError::data("training data", reason, "give sequences of a moving camera"))
}

fn step_m(a: &PosedFrame, b: &PosedFrame) -> f64 {
    (b.world_from_camera.translation.vector - a.world_from_camera.translation.vector).norm()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(x: f64) -> PosedFrame {
        let image = Image::from_fn(Size::new(4, 4), |_, _| [9; 3]);
        PosedFrame { image, world_from_camera: Pose::translation(x, 0.0, 0.0) }
    }

    #[test]
    fn a_missing_frame_ends_a_stretch() {
        let mut stretches = Stretches::default();
        for position in [0, 1, 2, 4, 6, 7] {
            stretches.add(position, frame(position as f64));
        }
        let lengths: Vec<usize> = stretches.finish().iter().map(Vec::len).collect();
        assert_eq!(lengths, [3, 2]);
    }

    #[test]
    fn the_unit_is_the_mean_step_and_rest_has_none() {
        let clip = |places: &[f64]| PosedClip {
            name: "test".into(),
            stretches: vec![places.iter().map(|x| frame(*x)).collect()],
            fingerprint: String::new(),
        };
        assert_eq!(mean_step_m(&[clip(&[0.0, 1.0, 4.0]), clip(&[5.0, 3.0])]).unwrap(), 2.0);
        assert!(mean_step_m(&[clip(&[1.0, 1.0])]).unwrap_err().to_string().contains("never moves"));
        assert!(mean_step_m(&[clip(&[1.0, f64::NAN])]).is_err());
    }
}
