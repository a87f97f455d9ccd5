//! Which method is better, and whether that could be luck.
//!
//! Across sequences: the signed-rank test on the absolute errors in percent of the path. Within one sequence poses hang
//! together, so no test of single poses holds; the difference of two methods gets a block bootstrap interval instead.

use crate::study::{MotionStudy, SequenceStudy, Study};
use endoscape_eval::bootstrap::mean_interval;
use endoscape_eval::paired::{SignedRank, signed_rank};
use endoscape_eval::stats::mean;
use serde::Serialize;
use std::collections::BTreeMap;

/// Blocks a sequence is cut into for the interval of a difference.
const BLOCKS: usize = 20;

/// Who won where.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Wins {
    /// Sequences on which each method has the lowest absolute error, in the order of methods.
    pub wins: Vec<usize>,
    /// Mean over sequences of the absolute error in percent of the path.
    pub mean_percent: Vec<Option<f64>>,
    /// Position of the method with most wins; of equals the one with the lower mean.
    pub best: Option<usize>,
    /// The best against each other method across sequences; `None` where they share none or do not differ.
    pub tests: Vec<Option<SignedRank>>,
}

/// One method against the best one on the same poses of one sequence.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Position of the best method.
    pub best: usize,
    /// Position of the other.
    pub other: usize,
    /// Poses both have.
    pub poses: usize,
    /// Mean of its error of position minus that of the best, metres.
    pub mean_m: f64,
    /// 95 % interval of that mean.
    pub ci95_m: [f64; 2],
}

impl Difference {
    /// Whether the interval leaves no doubt about the sign.
    pub fn is_decided(&self) -> bool {
        self.ci95_m[0] > 0.0 || self.ci95_m[1] < 0.0
    }
}

/// Absolute error (root mean square) in percent of the path.
pub fn percent_of_path(motion: &MotionStudy) -> Option<f64> {
    let percent = 100.0 * motion.evaluation.errors.ate_m.rmse / motion.evaluation.path_length_m;
    percent.is_finite().then_some(percent)
}

/// Counts wins over all sequences; `None` for fewer than two methods.
pub fn count(study: &Study) -> Option<Wins> {
    let methods = study.sequences.iter().map(|sequence| sequence.methods.len()).max().filter(|count| *count > 1)?;
    let errors: Vec<Vec<Option<f64>>> = study.sequences.iter().map(percents).collect();
    let mut wins = vec![0; methods];
    for row in &errors {
        if let Some(winner) = lowest(row) {
            wins[winner] += 1;
        }
    }
    let column = |method: usize| -> Vec<f64> { errors.iter().filter_map(|row| *row.get(method)?).collect() };
    let mean_percent: Vec<Option<f64>> = (0..methods).map(|method| mean(&column(method))).collect();
    let rank = |method: &usize| (std::cmp::Reverse(wins[*method]), ordered(mean_percent[*method]));
    let best = (0..methods).filter(|method| mean_percent[*method].is_some()).min_by_key(rank);
    let against = |best: usize, other: usize| {
        let both = errors.iter().filter_map(|row| Some(row.get(other).copied()?? - row.get(best).copied()??));
        signed_rank(&both.collect::<Vec<f64>>())
    };
    let tests = (0..methods).map(|other| best.filter(|best| *best != other).and_then(|best| against(best, other)));
    Some(Wins { tests: tests.collect(), best, mean_percent, wins })
}

fn percents(sequence: &SequenceStudy) -> Vec<Option<f64>> {
    sequence.methods.iter().map(|method| method.motion.as_ref().and_then(percent_of_path)).collect()
}

fn lowest(errors: &[Option<f64>]) -> Option<usize> {
    (0..errors.len()).filter(|index| errors[*index].is_some()).min_by_key(|index| ordered(errors[*index]))
}

/// Sorts as the numbers do; errors are never negative, so their bits are in order. What is missing comes last.
fn ordered(error: Option<f64>) -> u64 {
    error.map_or(u64::MAX, f64::to_bits)
}

/// The best method of a sequence against each other one.
pub fn differences(sequence: &SequenceStudy) -> Vec<Difference> {
    let Some(best) = lowest(&percents(sequence)) else { return Vec::new() };
    let motion = |index: usize| sequence.methods[index].motion.as_ref();
    let others = (0..sequence.methods.len()).filter(|other| *other != best);
    others.filter_map(|other| difference((best, motion(best)?), (other, motion(other)?))).collect()
}

fn difference(best: (usize, &MotionStudy), other: (usize, &MotionStudy)) -> Option<Difference> {
    let errors = |motion: &MotionStudy| -> BTreeMap<usize, f64> {
        motion.trace.truth_index.iter().copied().zip(motion.trace.absolute.translation_m.iter().copied()).collect()
    };
    let (ours, theirs) = (errors(best.1), errors(other.1));
    let differences: Vec<f64> = ours.iter().filter_map(|(pose, error)| Some(theirs.get(pose)? - error)).collect();
    let ci95_m = mean_interval(&differences, differences.len().div_ceil(BLOCKS))?;
    Some(Difference { best: best.0, other: other.0, poses: differences.len(), mean_m: mean(&differences)?, ci95_m })
}
