//! Depth of a run against the truth, and the maps a figure shows.

use crate::ReportError;
use crate::maps::{self, MILLIMETRES};
use crate::run_folder::RunFolder;
use endoscape_core::{DepthMap, Image};
use endoscape_eval::depth::{Crop, DepthEvaluation, Samples, Scaling, Valid, evaluate, resize_to};
use endoscape_frames::Sequence;

/// Frames a figure shows.
pub const SHOWN: usize = 3;

/// Depth of one method.
#[derive(Clone, Debug)]
pub struct DepthStudy {
    /// Errors; `None` where the truth is not known.
    pub evaluation: Option<DepthEvaluation>,
    /// A few frames, evenly spread.
    pub views: Vec<DepthView>,
}

/// One frame with its maps.
#[derive(Clone, Debug)]
pub struct DepthView {
    /// Number of the frame.
    pub number: usize,
    /// The picture, where the frames are known.
    pub image: Option<Image>,
    /// Predicted depth, of the size of the truth and scaled to it where that is known.
    pub prediction: DepthMap,
    /// True depth, metres.
    pub truth: Option<DepthMap>,
}

/// Judges the depth maps of a run; `None` if it has none.
///
/// # Errors
/// [`ReportError`] for maps that cannot be read or do not fit the truth.
pub fn judge(
    run: &RunFolder,
    sequence: Option<&Sequence>,
    notes: &mut Vec<String>,
) -> Result<Option<DepthStudy>, ReportError> {
    if run.depth.is_empty() {
        return Ok(None);
    }
    let unit = run.facts.depth_metres_per_unit.unwrap_or(MILLIMETRES);
    match sequence.filter(|sequence| sequence.has_depth()) {
        Some(sequence) => against_truth(run, sequence, unit).map(Some),
        None => {
            notes.push("no true depth is known, so depth is shown but not judged".to_owned());
            alone(run, sequence, unit).map(Some)
        }
    }
}

/// Evenly spread positions of a list, first and last left out where there are enough.
pub fn spread(count: usize) -> Vec<usize> {
    let shown = count.min(SHOWN);
    (0..shown).map(|index| (2 * index + 1) * count / (2 * shown)).collect()
}

fn against_truth(run: &RunFolder, sequence: &Sequence, unit: f64) -> Result<DepthStudy, ReportError> {
    let (min_m, max_m) = maps::usual_range_m(sequence.format);
    let valid = Valid::new(min_m, max_m, Crop::WHOLE).map_err(ReportError::evaluation(run.name()))?;
    let pairs = maps::pairs(&run.path, sequence)?;
    let both = |index: usize| -> Result<(DepthMap, DepthMap), ReportError> {
        let (map, frame) = &pairs[index];
        let missing = || ReportError::file(map, "its frame has no true depth", "evaluate frames with depth");
        let file = frame.depth.as_ref().ok_or_else(missing)?;
        Ok((maps::read_depth(map, unit)?, file.read(sequence.camera.as_ref(), sequence.size)?))
    };
    let load = |index: usize| -> Result<Samples, ReportError> {
        let (prediction, truth) = both(index)?;
        let named = ReportError::evaluation(pairs[index].0.display().to_string());
        Samples::of(&prediction, &truth, &valid).map_err(named)
    };
    let evaluation = evaluate(pairs.len(), load, Scaling::Median, &valid)?;
    let Some(evaluation) = evaluation else {
        return Err(ReportError::file(&run.path, "no pixel has both a prediction and a true depth", "check its maps"));
    };
    let mut views = Vec::new();
    for position in spread(evaluation.images.len()) {
        let (index, scale) = (evaluation.images[position].index, evaluation.images[position].scale);
        let (prediction, truth) = both(index)?;
        let prediction =
            resize_to(&prediction, truth.size()).map_err(ReportError::evaluation(run.name()))?.scaled(scale as f32);
        let number = pairs[index].1.number;
        views.push(DepthView { number, image: picture(sequence, number)?, prediction, truth: Some(truth) });
    }
    Ok(DepthStudy { evaluation: Some(evaluation), views })
}

fn alone(run: &RunFolder, sequence: Option<&Sequence>, unit: f64) -> Result<DepthStudy, ReportError> {
    let maps: Vec<_> = run.depth.iter().collect();
    let view = |position: usize| -> Result<DepthView, ReportError> {
        let (number, path) = maps[position];
        let image = sequence.map_or(Ok(None), |sequence| picture(sequence, *number))?;
        Ok(DepthView { number: *number, image, prediction: maps::read_depth(path, unit)?, truth: None })
    };
    let views = spread(maps.len()).into_iter().map(view).collect::<Result<_, _>>()?;
    Ok(DepthStudy { evaluation: None, views })
}

/// The picture of a frame by its number, where the sequence has it; live inputs keep none.
pub fn picture(sequence: &Sequence, number: usize) -> Result<Option<Image>, ReportError> {
    if sequence.is_live() {
        return Ok(None);
    }
    let position = sequence.frames.iter().position(|frame| frame.number == number);
    Ok(position.map(|position| sequence.read_image(position)).transpose()?)
}
