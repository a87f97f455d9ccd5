//! Everything a report says, as values: which methods ran on which sequences, and how they did.
//!
//! [`judge`] turns what was read into these values; figures, tables, words and the page only show them.

use crate::ReportError;
use crate::depth_study::{self, DepthStudy};
use crate::mask_study::{self, MaskStudy};
use crate::run_folder::RunFolder;
use endoscape_eval::Alignment;
use endoscape_eval::calibration::{Calibration, calibration};
use endoscape_eval::poses::{Poses, Stamps};
use endoscape_eval::snippets::{self, SnippetEvaluation};
use endoscape_eval::trace::{Trace, trace};
use endoscape_eval::trajectory::{self, Settings, TrajectoryEvaluation};
use endoscape_frames::Sequence;
use std::collections::BTreeMap;

/// Poses of a short window, as the SfMLearner protocol has it.
const WINDOW: usize = 5;

/// Times of a frame and of its pose agree to this, seconds; both were written by the same program.
const SAME_TIME_S: f64 = 1e-6;

/// One sequence and what methods made of it.
#[derive(Clone, Debug)]
pub struct SequenceInput {
    /// Its name.
    pub name: String,
    /// Where the camera truly was, if that is known.
    pub truth: Option<Poses>,
    /// Its frames, for pictures, true depth and masks.
    pub sequence: Option<Sequence>,
    /// The methods.
    pub methods: Vec<MethodInput>,
}

/// What one method left behind.
#[derive(Clone, Debug)]
pub struct MethodInput {
    /// Its name.
    pub name: String,
    /// Its trajectory, if it has one.
    pub poses: Option<Poses>,
    /// Its folder, if it has one.
    pub run: Option<RunFolder>,
}

/// All results.
#[derive(Clone, Debug)]
pub struct Study {
    /// Headline.
    pub title: String,
    /// What was corrected before errors were taken.
    pub align: Alignment,
    /// Sequence by sequence.
    pub sequences: Vec<SequenceStudy>,
}

/// The results on one sequence.
#[derive(Clone, Debug)]
pub struct SequenceStudy {
    /// Its name.
    pub name: String,
    /// Whether the true path is known.
    pub has_truth: bool,
    /// Whether its frames come from the simulator.
    pub is_simulated: bool,
    /// Method by method, in the order given; the same order in all sequences.
    pub methods: Vec<MethodStudy>,
}

/// The results of one method on one sequence.
#[derive(Clone, Debug)]
pub struct MethodStudy {
    /// Its name.
    pub name: String,
    /// Its trajectory as it was written.
    pub poses: Option<Poses>,
    /// Its folder.
    pub run: Option<RunFolder>,
    /// Its trajectory against the truth.
    pub motion: Option<MotionStudy>,
    /// Its depth.
    pub depth: Option<DepthStudy>,
    /// Its reliability maps.
    pub masks: Option<MaskStudy>,
    /// What could not be judged and why, one sentence each.
    pub notes: Vec<String>,
}

/// A trajectory against the truth.
#[derive(Clone, Debug)]
pub struct MotionStudy {
    /// The figures.
    pub evaluation: TrajectoryEvaluation,
    /// Pose by pose.
    pub trace: Trace,
    /// Short windows; `None` where no window is whole.
    pub snippets: Option<SnippetEvaluation>,
    /// Confidence against the error of the motion that led to each frame; `None` where none was written.
    pub calibration: Option<Calibration>,
}

/// Judges all methods on all sequences.
///
/// # Errors
/// [`ReportError`] that names the method or file that cannot be compared.
pub fn judge(title: String, inputs: Vec<SequenceInput>, settings: &Settings) -> Result<Study, ReportError> {
    let sequences = inputs.into_iter().map(|input| judge_sequence(input, settings)).collect::<Result<_, _>>()?;
    Ok(Study { title, align: settings.align, sequences })
}

fn judge_sequence(input: SequenceInput, settings: &Settings) -> Result<SequenceStudy, ReportError> {
    let SequenceInput { name, truth, sequence, methods } = input;
    let judge = |method| judge_method(method, truth.as_ref(), sequence.as_ref(), settings);
    let methods = methods.into_iter().map(judge).collect::<Result<_, _>>()?;
    // What `endoscape simulate` leaves beside its frames.
    let is_simulated = sequence.is_some_and(|sequence| sequence.root.join("simulation.toml").is_file());
    Ok(SequenceStudy { name, has_truth: truth.is_some(), is_simulated, methods })
}

fn judge_method(
    method: MethodInput,
    truth: Option<&Poses>,
    sequence: Option<&Sequence>,
    settings: &Settings,
) -> Result<MethodStudy, ReportError> {
    let MethodInput { name, poses, run } = method;
    let mut notes = Vec::new();
    let motion = match (&poses, truth) {
        (Some(poses), Some(truth)) => Some(judge_motion(&name, poses, truth, run.as_ref(), settings, &mut notes)?),
        _ => None,
    };
    let (mut depth, mut masks) = (None, None);
    if let Some(run) = &run {
        notes.extend(lost(run));
        depth = depth_study::judge(run, sequence, &mut notes)?;
        masks = mask_study::judge(run, sequence, &mut notes)?;
    }
    Ok(MethodStudy { name, poses, run, motion, depth, masks, notes })
}

/// Frames without track; a method may have written a pose for them all the same.
fn lost(run: &RunFolder) -> Option<String> {
    let (frames, tracked) = run.counts().filter(|(frames, tracked)| tracked < frames)?;
    Some(format!("track was lost in {} of {frames} frames", frames - tracked))
}

fn judge_motion(
    name: &str,
    poses: &Poses,
    truth: &Poses,
    run: Option<&RunFolder>,
    settings: &Settings,
    notes: &mut Vec<String>,
) -> Result<MotionStudy, ReportError> {
    let evaluation = trajectory::evaluate(poses, truth, settings).map_err(ReportError::evaluation(name))?;
    let trace = trace(poses, truth, settings.association, settings.align).map_err(ReportError::evaluation(name))?;
    notes.extend(evaluation.warnings.iter().cloned());
    let constant = settings.constant_motion.as_ref();
    let snippets = snippets::evaluate(poses, truth, settings.association, WINDOW, constant).ok();
    let calibration = run.and_then(|run| calibrate(run, &trace));
    Ok(MotionStudy { evaluation, trace, snippets, calibration })
}

/// Confidences beside the errors of the motions that led to their frames; `None` for too few of them.
fn calibrate(run: &RunFolder, trace: &Trace) -> Option<Calibration> {
    let key = |time_s: f64| (time_s / SAME_TIME_S).round() as i64;
    let confident = run.frames.iter().filter_map(|frame| Some((key(frame.time_s), frame.confidence?)));
    let by_time: BTreeMap<i64, f64> = confident.collect();
    let steps = trace.stamps[1..].iter().zip(&trace.steps.translation_m);
    let known = steps.filter_map(|(stamp, error)| Some((*by_time.get(&key(*stamp))?, *error)));
    let (confidences, errors): (Vec<f64>, Vec<f64>) = known.unzip();
    trace.in_seconds.then(|| calibration(&confidences, &errors).ok())?
}

impl Study {
    /// Whether more than one method is shown, so that they can be compared.
    pub fn compares(&self) -> bool {
        self.sequences.iter().any(|sequence| sequence.methods.len() > 1)
    }
}

impl MethodStudy {
    /// Positions to draw, metres, interrupted by points that are not finite where frames are missing: aligned where the
    /// truth is known, else as written.
    pub fn path(&self) -> Vec<[f64; 3]> {
        let position = |pose: &endoscape_eval::MatrixPose| -> [f64; 3] { pose.translation.vector.into() };
        match (&self.motion, &self.poses) {
            (Some(motion), _) => {
                let mut path = Vec::with_capacity(motion.trace.aligned.len());
                for (pose, gap) in motion.trace.aligned.iter().zip(&motion.trace.after_gap) {
                    if *gap {
                        path.push([f64::NAN; 3]);
                    }
                    path.push(position(pose));
                }
                path
            }
            (None, Some(poses)) => poses.world_from_camera().iter().map(position).collect(),
            (None, None) => Vec::new(),
        }
    }
}

/// Stamps of poses for an axis: seconds, numbers of frames, or positions.
pub fn stamps(poses: &Poses) -> Vec<f64> {
    match poses.stamps() {
        Stamps::Seconds(times_s) => times_s.clone(),
        Stamps::Frames(frames) => frames.iter().map(|frame| *frame as f64).collect(),
        Stamps::Order => (0..poses.len()).map(|index| index as f64).collect(),
    }
}
