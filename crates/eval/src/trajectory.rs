//! The whole judgement of a trajectory: associate, align, measure, and measure what a trivial answer would get.

use crate::EvalError;
use crate::align::{Alignment, Similarity, align, umeyama};
use crate::ape::absolute_errors;
use crate::associate::{Association, DEFAULT_TOLERANCE_S, Pairs, associate};
use crate::baselines::{self, Baselines};
use crate::drift::{self, PartScale};
use crate::inverted;
use crate::poses::{MatrixPose, Poses, path_steps_m};
use crate::rpe::{self, Delta, DeltaUnit};
use crate::segments::{LengthErrors, SegmentMean, SegmentPlan, Segments, TurnErrors, overall};
use crate::stats::{Spread, Statistics};
use serde::Serialize;

/// Below this share of answered frames a warning is given.
const INCOMPLETE: f64 = 0.99;

/// How a trajectory is judged.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// How poses are paired; nearest in time within 0.01 s by default.
    pub association: Association,
    /// What may be corrected; `sim3` by default, because one camera sees no scale.
    pub align: Alignment,
    /// Pairs of the relative error; consecutive frames by default.
    pub delta: Delta,
    /// Lengths of sub-trajectories, metres; `None` chooses them for the path.
    pub lengths_m: Option<Vec<f64>>,
    /// Frames from one sub-trajectory to the next; `None` chooses it for the path.
    pub segment_step: Option<usize>,
    /// Motion per frame of the constant baseline, from training data; `None` takes the mean of the truth itself.
    pub constant_motion: Option<MatrixPose>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            association: Association::Nearest { tolerance_s: DEFAULT_TOLERANCE_S },
            align: Alignment::Sim3,
            delta: Delta::default(),
            lengths_m: None,
            segment_step: None,
            constant_motion: None,
        }
    }
}

/// Relative errors with the choice of pairs they hold for.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RelativeErrors {
    /// Unit of `delta`.
    pub unit: DeltaUnit,
    /// Distance between the poses of a pair.
    pub delta: f64,
    /// Whether overlapping pairs count.
    pub all_pairs: bool,
    /// Number of pairs.
    pub pairs: usize,
    /// Translation, metres.
    pub translation_m: Statistics,
    /// 95 % interval of its mean.
    pub translation_m_ci95: [f64; 2],
    /// Rotation, degrees.
    pub rotation_deg: Statistics,
    /// Whole motion, as evo's full transformation.
    pub full: Statistics,
}

/// All errors of one trajectory, estimated or trivial.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrajectoryErrors {
    /// Absolute error of position after alignment, metres.
    pub ate_m: Statistics,
    /// Absolute error of rotation after alignment, degrees.
    pub rotation_deg: Statistics,
    /// Absolute error of the whole pose, as evo's full transformation.
    pub full: Statistics,
    /// Relative errors.
    pub rpe: RelativeErrors,
    /// By length of sub-trajectory.
    pub segments: Vec<LengthErrors>,
    /// Mean over all of them, weighted as KITTI does.
    pub segments_mean: Option<SegmentMean>,
    /// By accumulated rotation.
    pub turns: Vec<TurnErrors>,
    /// Distance of the end points as a percentage of the path; `None` where the truth stands still.
    pub endpoint_drift_percent: Option<f64>,
}

/// The whole answer of `eval trajectory`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrajectoryEvaluation {
    /// Poses compared.
    pub matched: usize,
    /// Poses the estimate has.
    pub estimate_frames: usize,
    /// Poses the truth has.
    pub truth_frames: usize,
    /// Share of the truth that is answered, 0 to 1.
    pub completeness: f64,
    /// Length of the true path through the compared poses, metres.
    pub path_length_m: f64,
    /// Name of the alignment.
    pub align: Alignment,
    /// Factor the estimate was multiplied by.
    pub scale: f64,
    /// The errors.
    #[serde(flatten)]
    pub errors: TrajectoryErrors,
    /// Scale along the path, of the estimate as it was written.
    pub scale_along_path: Vec<PartScale>,
    /// Standard deviation of the scale along the path over its mean, percent.
    pub scale_drift_percent: Option<f64>,
    /// The errors of trivial answers.
    pub baselines: Baselines<TrajectoryErrors>,
    /// What the reader must know, one sentence each.
    pub warnings: Vec<String>,
}

/// Judges an estimate.
///
/// # Errors
/// As [`associate`], [`align`] and [`rpe::pairs`]; [`EvalError::TooFew`] if fewer than two poses match.
pub fn evaluate(estimate: &Poses, truth: &Poses, settings: &Settings) -> Result<TrajectoryEvaluation, EvalError> {
    let pairs = associate(estimate, truth, settings.association)?;
    if pairs.len() < 2 {
        return Err(EvalError::TooFew { got: pairs.len(), needed: 2, what: "an evaluation" });
    }
    let fit = align(&pairs.estimate, &pairs.truth, settings.align)?;
    let aligned = fit.apply_all(&pairs.estimate);
    let path_length_m: f64 = path_steps_m(&pairs.truth).iter().sum();
    let ruler = Ruler {
        segments: Segments::of(&pairs.truth, &plan(settings, path_length_m)?),
        pairs: rpe::pairs(&aligned, settings.delta)?,
        delta: settings.delta,
        truth: &pairs.truth,
    };
    let scale_along_path = drift::scale_along(&pairs.estimate, &pairs.truth);
    let trivial = baselines::of(&pairs.truth, settings.constant_motion.as_ref());
    Ok(TrajectoryEvaluation {
        matched: pairs.len(),
        estimate_frames: pairs.estimate_frames,
        truth_frames: pairs.truth_frames,
        completeness: pairs.completeness,
        path_length_m,
        align: settings.align,
        scale: fit.scale,
        errors: ruler.measure(&aligned)?,
        scale_drift_percent: scale_drift_percent(&scale_along_path),
        scale_along_path,
        baselines: trivial.try_map(|poses| ruler.measure(&fitted(&poses, &pairs.truth, settings.align)))?,
        warnings: warnings(&pairs),
    })
}

fn plan(settings: &Settings, path_length_m: f64) -> Result<SegmentPlan, EvalError> {
    let mut plan = SegmentPlan::for_path(path_length_m);
    if let Some(lengths_m) = &settings.lengths_m {
        if let Some(length) = lengths_m.iter().find(|length| !(**length > 0.0 && length.is_finite())) {
            let what = format!("{length} is no length of a sub-trajectory");
            return Err(EvalError::Setting { what, remedy: "give positive --lengths in metres" });
        }
        plan = SegmentPlan { lengths_m: lengths_m.clone(), step: 1, ..plan };
    }
    if let Some(step) = settings.segment_step {
        plan.step = step.max(1);
    }
    Ok(plan)
}

/// What all trajectories of one evaluation are measured with.
struct Ruler<'a> {
    segments: Segments,
    pairs: Vec<(usize, usize)>,
    delta: Delta,
    truth: &'a [MatrixPose],
}

impl Ruler<'_> {
    /// Errors of poses that are aligned already.
    fn measure(&self, aligned: &[MatrixPose]) -> Result<TrajectoryErrors, EvalError> {
        let absolute = absolute_errors(aligned, self.truth);
        let segments = self.segments.by_length(aligned, self.truth);
        Ok(TrajectoryErrors {
            ate_m: summed(&absolute.translation_m)?,
            rotation_deg: summed(&absolute.rotation_rad)?.scaled(1_f64.to_degrees()),
            full: summed(&absolute.full)?,
            rpe: self.relative(aligned)?,
            segments_mean: overall(&segments),
            segments,
            turns: self.segments.by_turn(aligned, self.truth),
            endpoint_drift_percent: drift::endpoint_percent(aligned, self.truth),
        })
    }

    fn relative(&self, aligned: &[MatrixPose]) -> Result<RelativeErrors, EvalError> {
        let errors = rpe::relative_errors(aligned, self.truth, &self.pairs);
        // Overlapping pairs share frames as long as they reach.
        let frames: usize = self.pairs.iter().map(|(start, end)| end - start).sum();
        let overlap = if self.delta.all_pairs { frames / self.pairs.len().max(1) } else { 1 };
        let spread = Spread::of(&errors.translation_m, overlap);
        Ok(RelativeErrors {
            unit: self.delta.unit,
            delta: self.delta.value,
            all_pairs: self.delta.all_pairs,
            pairs: self.pairs.len(),
            translation_m: summed(&errors.translation_m)?,
            translation_m_ci95: spread.map_or([0.0; 2], |spread| spread.ci95),
            rotation_deg: summed(&errors.rotation_rad)?.scaled(1_f64.to_degrees()),
            full: summed(&errors.full)?,
        })
    }
}

fn summed(errors: &[f64]) -> Result<Statistics, EvalError> {
    Statistics::of(errors).ok_or(EvalError::TooFew { got: 0, needed: 1, what: "an error" })
}

/// Trivial answers get the best fit even where it is not the only one (a straight line, a single place): their errors
/// of position are the same for each of the best fits. Without correction they start at the first true pose, which is
/// the frame they are given in.
fn fitted(trivial: &[MatrixPose], truth: &[MatrixPose], alignment: Alignment) -> Vec<MatrixPose> {
    let from_first = truth.first().copied().unwrap_or_else(MatrixPose::identity);
    let started = Similarity { scale: 1.0, motion: from_first }.apply_all(trivial);
    let fit = match alignment {
        Alignment::None | Alignment::First => Similarity::identity(),
        Alignment::Scale => {
            Similarity { scale: umeyama(&started, truth, true).similarity.scale, ..Similarity::identity() }
        }
        Alignment::Se3 | Alignment::Sim3 => umeyama(&started, truth, alignment == Alignment::Sim3).similarity,
    };
    fit.apply_all(&started)
}

fn scale_drift_percent(parts: &[PartScale]) -> Option<f64> {
    let scales: Vec<f64> = parts.iter().map(|part| part.scale).collect();
    Some(100.0 * crate::stats::std(&scales)? / crate::stats::mean(&scales)?)
}

fn warnings(pairs: &Pairs) -> Vec<String> {
    let mut warnings = Vec::new();
    if pairs.completeness < INCOMPLETE {
        let percent = 100.0 * pairs.completeness;
        warnings.push(format!("only {percent:.1} % of the true path is answered: the errors hold for that part alone"));
    }
    warnings.extend(inverted::detect(&pairs.estimate, &pairs.truth).map(|inverted| inverted.to_string()));
    warnings
}
