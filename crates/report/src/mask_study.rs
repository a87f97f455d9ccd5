//! Reliability maps of a run: how well they tell usable pixels from unusable ones.

use crate::ReportError;
use crate::depth_study::{picture, spread};
use crate::maps;
use crate::run_folder::RunFolder;
use endoscape_core::{Grid, Image, Mask};
use endoscape_eval::roc::{Roc, roc};
use endoscape_frames::Sequence;

/// Most pixels the curve is drawn from; more change no visible digit.
const MOST_PIXELS: usize = 2_000_000;

/// Reliability of one method.
#[derive(Clone, Debug)]
pub struct MaskStudy {
    /// How well reliability finds the usable pixels of the true masks; `None` where there are none.
    pub roc: Option<Roc>,
    /// A few frames, evenly spread.
    pub views: Vec<MaskView>,
}

/// One frame with its maps.
#[derive(Clone, Debug)]
pub struct MaskView {
    /// Number of the frame.
    pub number: usize,
    /// The picture, where the frames are known.
    pub image: Option<Image>,
    /// Trust per pixel, 0 to 1.
    pub reliability: Grid<f32>,
    /// True mask of usable pixels.
    pub truth: Option<Mask>,
}

/// Judges the reliability maps of a run; `None` if it has none.
///
/// # Errors
/// [`ReportError`] for maps that cannot be read.
pub fn judge(
    run: &RunFolder,
    sequence: Option<&Sequence>,
    notes: &mut Vec<String>,
) -> Result<Option<MaskStudy>, ReportError> {
    if run.reliability.is_empty() {
        return Ok(None);
    }
    let roc = match sequence.filter(|sequence| sequence.has_masks()) {
        Some(sequence) => curve(run, sequence, notes)?,
        None => {
            notes.push("no true masks are known, so reliability is shown but not judged".to_owned());
            None
        }
    };
    let maps: Vec<_> = run.reliability.iter().collect();
    let mut views = Vec::new();
    for position in spread(maps.len()) {
        let (number, path) = maps[position];
        let image = sequence.map_or(Ok(None), |sequence| picture(sequence, *number))?;
        let truth = sequence.map_or(Ok(None), |sequence| true_mask(sequence, *number))?;
        views.push(MaskView { number: *number, image, reliability: maps::read_reliability(path)?, truth });
    }
    Ok(Some(MaskStudy { roc, views }))
}

fn true_mask(sequence: &Sequence, number: usize) -> Result<Option<Mask>, ReportError> {
    let position = sequence.frames.iter().position(|frame| frame.number == number);
    position.map_or(Ok(None), |position| Ok(sequence.read_mask(position)?))
}

/// Pixels of all frames that have both maps, thinned evenly.
fn curve(run: &RunFolder, sequence: &Sequence, notes: &mut Vec<String>) -> Result<Option<Roc>, ReportError> {
    let frames = run.reliability.len().max(1);
    let stride = (frames * sequence.size.area()).div_ceil(MOST_PIXELS).max(1);
    let (mut scores, mut usable) = (Vec::new(), Vec::new());
    for (number, path) in &run.reliability {
        let Some(mask) = true_mask(sequence, *number)? else { continue };
        let reliability = maps::read_reliability(path)?;
        let (from, to) = (reliability.size(), mask.size());
        for pixel in (0..to.area()).step_by(stride) {
            let (x, y) = (pixel % to.width, pixel / to.width);
            // Nearest pixel: masks have no values in between.
            if let Some(score) = reliability.get(x * from.width / to.width, y * from.height / to.height) {
                scores.push(f64::from(*score));
                usable.push(mask.values()[pixel]);
            }
        }
    }
    match roc(&scores, &usable) {
        Ok(roc) => Ok(Some(roc)),
        Err(error) => {
            notes.push(format!("reliability is not judged: {error}"));
            Ok(None)
        }
    }
}
