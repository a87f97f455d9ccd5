//! Errors of short windows, the protocol of T. Zhou et al., "Unsupervised learning of depth and ego-motion from video"
//! (2017), in both definitions that are in use.
//!
//! In each window positions are taken relative to the first pose, the estimate is scaled by `sum(g.p) / sum(p.p)`, and
//! nothing is rotated. What is published under this name is `sqrt(sum |g - s p|^2) / N`, which is the root mean square
//! error divided by `sqrt(N)`; both are given. The scale may come out negative, so these numbers cannot see an inverted
//! pose chain: they never stand alone.

use crate::EvalError;
use crate::ape::angle_rad;
use crate::associate::{Association, Pairs, associate};
use crate::baselines::{self, Baselines};
use crate::poses::{MatrixPose, Poses};
use crate::stats::Spread;
use rayon::prelude::*;
use serde::Serialize;

/// Errors of one window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WindowErrors {
    /// `sqrt(sum of squares) / N`, metres.
    pub published_m: f64,
    /// `sqrt(sum of squares / N)`, metres.
    pub rmse_m: f64,
    /// Mean angle between true and estimated rotation relative to the first pose, over all N poses, radians.
    pub rotation_rad: f64,
}

/// Errors over all windows.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SnippetErrors {
    /// `sqrt(sum of squares) / N`, metres: the figure papers print.
    pub ate_published: Spread,
    /// `sqrt(sum of squares / N)`, metres.
    pub ate_rmse: Spread,
    /// Mean rotation error of a window, radians.
    pub rotation_rad: Spread,
}

/// The whole answer of `eval snippets`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SnippetEvaluation {
    /// Poses per window.
    pub length: usize,
    /// Windows judged.
    pub windows: usize,
    /// Windows a complete estimate would have had.
    pub windows_possible: usize,
    /// Share of the truth that is answered, 0 to 1.
    pub completeness: f64,
    /// The errors.
    #[serde(flatten)]
    pub errors: SnippetErrors,
    /// The same windows answered without looking at any picture.
    pub baselines: Baselines<SnippetErrors>,
}

/// Judges all windows of `length` matched poses without a gap.
///
/// `constant_motion` is the motion per frame of the constant baseline; `None` takes the mean of the truth itself.
///
/// # Errors
/// As [`associate`]; [`EvalError::TooFew`] if no window is complete; [`EvalError::Setting`] for a length below 2.
pub fn evaluate(
    estimate: &Poses,
    truth: &Poses,
    association: Association,
    length: usize,
    constant_motion: Option<&MatrixPose>,
) -> Result<SnippetEvaluation, EvalError> {
    if length < 2 {
        let what = format!("a window of {length} poses has no motion");
        return Err(EvalError::Setting { what, remedy: "give a --length of 2 or more" });
    }
    let pairs = associate(estimate, truth, association)?;
    let starts = starts(&pairs, length);
    let too_few = EvalError::TooFew { got: pairs.len(), needed: length, what: "a window without lost frames" };
    let judge = |estimate: &[MatrixPose]| judge(estimate, &pairs.truth, &starts, length);
    let errors = judge(&pairs.estimate).ok_or_else(|| too_few.clone())?;
    let baselines =
        baselines::of(&pairs.truth, constant_motion).try_map(|poses| judge(&poses).ok_or_else(|| too_few.clone()))?;
    let expected = (pairs.len() as f64 / pairs.completeness).round() as usize;
    Ok(SnippetEvaluation {
        length,
        windows: starts.len(),
        windows_possible: (expected + 1).saturating_sub(length).max(starts.len()),
        completeness: pairs.completeness,
        errors,
        baselines,
    })
}

/// First poses of the windows that contain no gap.
fn starts(pairs: &Pairs, length: usize) -> Vec<usize> {
    let whole = |(start, window): (usize, &[bool])| (!window[1..].iter().any(|gap| *gap)).then_some(start);
    pairs.after_gap.windows(length).enumerate().filter_map(whole).collect()
}

fn judge(estimate: &[MatrixPose], truth: &[MatrixPose], starts: &[usize], length: usize) -> Option<SnippetErrors> {
    let window = |start: &usize| window_errors(&estimate[*start..start + length], &truth[*start..start + length]);
    let windows: Vec<WindowErrors> = starts.par_iter().map(window).collect();
    let spread = |figure: fn(&WindowErrors) -> f64| Spread::of(&windows.iter().map(figure).collect::<Vec<_>>(), length);
    Some(SnippetErrors {
        ate_published: spread(|window| window.published_m)?,
        ate_rmse: spread(|window| window.rmse_m)?,
        rotation_rad: spread(|window| window.rotation_rad)?,
    })
}

/// Errors of one window of as many estimated as true poses, at least one.
pub fn window_errors(estimate: &[MatrixPose], truth: &[MatrixPose]) -> WindowErrors {
    let relative = |poses: &[MatrixPose]| -> Vec<MatrixPose> {
        poses.first().map(|first| poses.iter().map(|pose| first.inv_mul(pose)).collect()).unwrap_or_default()
    };
    let (p, g) = (relative(estimate), relative(truth));
    let both = || p.iter().zip(&g).map(|(p, g)| (p.translation.vector, g.translation.vector));
    let squares: f64 = both().map(|(p, _)| p.norm_squared()).sum();
    // An estimate that does not move has no scale to be corrected by.
    let scale = if squares > 0.0 { both().map(|(p, g)| g.dot(&p)).sum::<f64>() / squares } else { 1.0 };
    let sum: f64 = both().map(|(p, g)| (g - p * scale).norm_squared()).sum();
    let angles: f64 = p.iter().zip(&g).map(|(p, g)| angle_rad(&p.inv_mul(g))).sum();
    let count = p.len().max(1) as f64;
    WindowErrors { published_m: sum.sqrt() / count, rmse_m: (sum / count).sqrt(), rotation_rad: angles / count }
}
