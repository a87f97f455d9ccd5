//! The results as one JSON object.

use crate::run_folder::{Latency, RunFolder};
use crate::study::{MethodStudy, SequenceStudy, Study};
use crate::wins::{self, Difference, Wins};
use endoscape_eval::calibration::Calibration;
use endoscape_eval::depth::DepthEvaluation;
use endoscape_eval::snippets::SnippetEvaluation;
use endoscape_eval::trajectory::TrajectoryEvaluation;
use serde::Serialize;

/// `compare.json`.
#[derive(Serialize)]
pub struct Summary<'a> {
    version: &'static str,
    align: &'static str,
    sequences: Vec<SequenceSummary<'a>>,
    wins: Option<Wins>,
}

#[derive(Serialize)]
struct SequenceSummary<'a> {
    name: &'a str,
    methods: Vec<MethodSummary<'a>>,
    differences: Vec<Difference>,
    verdict: Vec<String>,
}

#[derive(Serialize)]
struct MethodSummary<'a> {
    name: &'a str,
    trajectory: Option<&'a TrajectoryEvaluation>,
    snippets: Option<&'a SnippetEvaluation>,
    depth: Option<&'a DepthEvaluation>,
    mask_auc: Option<f64>,
    calibration: Option<&'a Calibration>,
    latency_ms: Option<Latency>,
    frames: Option<usize>,
    tracked: Option<usize>,
    notes: &'a [String],
}

impl<'a> Summary<'a> {
    /// Sums a study up.
    pub fn of(study: &'a Study) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION"),
            align: study.align.name(),
            sequences: study.sequences.iter().map(sequence).collect(),
            wins: wins::count(study),
        }
    }
}

fn sequence(sequence: &SequenceStudy) -> SequenceSummary<'_> {
    SequenceSummary {
        name: &sequence.name,
        methods: sequence.methods.iter().map(method).collect(),
        differences: wins::differences(sequence),
        verdict: crate::verdict::of(sequence),
    }
}

fn method(method: &MethodStudy) -> MethodSummary<'_> {
    let motion = method.motion.as_ref();
    let counts = method.run.as_ref().and_then(RunFolder::counts);
    MethodSummary {
        name: &method.name,
        trajectory: motion.map(|motion| &motion.evaluation),
        snippets: motion.and_then(|motion| motion.snippets.as_ref()),
        depth: method.depth.as_ref().and_then(|depth| depth.evaluation.as_ref()),
        mask_auc: method.masks.as_ref().and_then(|masks| Some(masks.roc.as_ref()?.auc)),
        calibration: motion.and_then(|motion| motion.calibration.as_ref()),
        latency_ms: method.run.as_ref().and_then(RunFolder::latency),
        frames: counts.map(|(frames, _)| frames),
        tracked: counts.map(|(_, tracked)| tracked),
        notes: &method.notes,
    }
}
