//! Whether a method knows when it is wrong.
//!
//! Two views of a confidence beside the errors it came with: the reliability curve (the mean error of each bin of
//! confidence) and sparsification (E. Ilg et al., "Uncertainty estimates and multi-hypotheses networks for optical
//! flow", 2018): the mean error left after the least confident share is taken away, against the best order possible.

use crate::EvalError;
use crate::stats::mean;
use serde::Serialize;

/// Bins of the reliability curve and steps of the sparsification curve.
const BINS: usize = 20;

/// One bin of the reliability curve, equally many values in each.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ReliabilityBin {
    /// Mean confidence in the bin.
    pub confidence: f64,
    /// Mean error in the bin.
    pub error: f64,
    /// Values in the bin.
    pub count: usize,
}

/// How well confidence orders errors.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Calibration {
    /// From the least to the most confident.
    pub reliability: Vec<ReliabilityBin>,
    /// Mean error left, relative to that of all values, after taking away 0, 5, ... 95 % by confidence.
    pub sparsification: Vec<f64>,
    /// The same by the errors themselves, which no order beats.
    pub oracle: Vec<f64>,
    /// Mean difference of the two curves: 0 is perfect.
    pub ause: f64,
    /// The same of a confidence that says nothing, which leaves the mean error as it is.
    pub ause_chance: f64,
}

/// Compares confidences (any scale, higher is surer) with the errors that came with them.
///
/// # Errors
/// [`EvalError::Setting`] if the lengths differ, fewer than 20 values are given, one is not finite, or all errors are 0.
pub fn calibration(confidences: &[f64], errors: &[f64]) -> Result<Calibration, EvalError> {
    let refused = |what: &str| EvalError::Setting { what: what.into(), remedy: "give a confidence for every error" };
    let all = || confidences.iter().chain(errors);
    if confidences.len() != errors.len() || errors.len() < BINS || all().any(|value| !value.is_finite()) {
        return Err(refused("the confidences do not fit the errors"));
    }
    let mut by_confidence: Vec<(f64, f64)> = confidences.iter().copied().zip(errors.iter().copied()).collect();
    by_confidence.sort_by(|a, b| a.0.total_cmp(&b.0));
    let in_order = shared_among_ties(&by_confidence);
    let mut best = errors.to_vec();
    best.sort_by(|a, b| b.total_cmp(a));
    let whole = mean(errors).filter(|mean| *mean > 0.0).ok_or_else(|| refused("all errors are zero"))?;
    let (sparsification, oracle) = (sparsified(&in_order, whole), sparsified(&best, whole));
    let area = |left: &dyn Fn(usize) -> f64| {
        let differences: Vec<f64> = oracle.iter().enumerate().map(|(step, best)| left(step) - best).collect();
        mean(&differences).unwrap_or_default()
    };
    Ok(Calibration {
        reliability: reliability(&by_confidence),
        ause: area(&|step| sparsification[step]),
        ause_chance: area(&|_| 1.0),
        sparsification,
        oracle,
    })
}

/// Errors in the order of confidence; equal confidences say nothing about the order of their errors, so each of these
/// counts as their mean.
fn shared_among_ties(by_confidence: &[(f64, f64)]) -> Vec<f64> {
    let shared = |ties: &[(f64, f64)]| {
        let mean = ties.iter().map(|(_, error)| error).sum::<f64>() / ties.len() as f64;
        std::iter::repeat_n(mean, ties.len())
    };
    by_confidence.chunk_by(|a, b| a.0 == b.0).flat_map(shared).collect()
}

/// Mean of what is left after each twentieth is taken from the front, relative to the mean of all.
fn sparsified(errors: &[f64], whole: f64) -> Vec<f64> {
    let left = |step: usize| mean(&errors[step * errors.len() / BINS..]).unwrap_or_default() / whole;
    (0..BINS).map(left).collect()
}

fn reliability(by_confidence: &[(f64, f64)]) -> Vec<ReliabilityBin> {
    let edge = |bin: usize| bin * by_confidence.len() / BINS;
    let summed = |values: &[(f64, f64)]| {
        let count = values.len();
        let (confidence, error) = values.iter().fold((0.0, 0.0), |sum, value| (sum.0 + value.0, sum.1 + value.1));
        ReliabilityBin { confidence: confidence / count as f64, error: error / count as f64, count }
    };
    (0..BINS).map(|bin| summed(&by_confidence[edge(bin)..edge(bin + 1)])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_perfect_order_has_no_area_and_a_reversed_one_has_much() {
        let errors: Vec<f64> = (1..=100).map(f64::from).collect();
        let sure: Vec<f64> = errors.iter().map(|error| -error).collect();
        let perfect = calibration(&sure, &errors).unwrap();
        assert_eq!(perfect.ause, 0.0);
        assert!(perfect.reliability.windows(2).all(|bins| bins[0].error > bins[1].error));
        assert!(calibration(&errors, &errors).unwrap().ause > 0.9);
    }

    #[test]
    fn a_constant_confidence_is_chance_whatever_the_order() {
        for errors in [(1..=100).map(f64::from).collect::<Vec<_>>(), (1..=100).rev().map(f64::from).collect()] {
            let constant = calibration(&[0.5; 100], &errors).unwrap();
            assert!(constant.sparsification.iter().all(|left| (left - 1.0).abs() < 1e-12));
            assert!((constant.ause - constant.ause_chance).abs() < 1e-12 && constant.ause_chance > 0.4);
        }
    }

    #[test]
    fn poison_is_refused() {
        assert!(calibration(&[0.0; 30], &[0.0; 30]).is_err());
        assert!(calibration(&[f64::NAN; 30], &[1.0; 30]).is_err());
        assert!(calibration(&[1.0; 3], &[1.0; 3]).is_err());
    }
}
