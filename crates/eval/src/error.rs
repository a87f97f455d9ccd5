//! Everything that can keep numbers from being compared, as sentences for the person who gave them.

use thiserror::Error;

/// What, where, why, and what to do. Paths are unknown here; who read the file puts its path in front.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum EvalError {
    /// A line of a text that cannot be right.
    #[error("line {line}: {reason}; correct that line or write the file again")]
    Line {
        /// Line counted from 1.
        line: usize,
        /// What is wrong there and what was expected.
        reason: String,
    },
    /// A file as a whole that is no trajectory.
    #[error("is no trajectory: {reason}; give a tum, kitti, euroc, csv, npy or npz file")]
    NoTrajectory {
        /// What was found instead.
        reason: String,
    },
    /// Nothing in it.
    #[error("holds no pose; check that the method wrote its result")]
    Empty,
    /// NaN, infinity, or numbers whose squares are.
    #[error("pose {index} holds a number that is not finite or too large to be squared; take such poses out")]
    NotFinite {
        /// Position of the pose, from 0.
        index: usize,
    },
    /// Stamps that run backwards.
    #[error("the stamps are not sorted: pose {index} at {stamp} comes after {previous}; sort the poses by time")]
    Unsorted {
        /// Position of the later pose, from 0.
        index: usize,
        /// Its stamp.
        stamp: f64,
        /// The stamp before it.
        previous: f64,
    },
    /// Two poses at one time.
    #[error(
        "pose {index} has the same stamp {stamp} as the one before it; remove one of them or pass --keep-duplicates"
    )]
    Duplicate {
        /// Position of the later pose, from 0.
        index: usize,
        /// The stamp both have.
        stamp: f64,
    },
    /// As many stamps as poses are needed.
    #[error("{stamps} stamps for {poses} poses; give one stamp per pose")]
    Unpaired {
        /// Number of stamps.
        stamps: usize,
        /// Number of poses.
        poses: usize,
    },
    /// Nothing matches in time.
    #[error(
        "no pose of the estimate ({estimate}) lies within {tolerance_s} s of one of the truth ({truth}); check the clocks or raise --tolerance"
    )]
    NoOverlap {
        /// Time range of the estimate.
        estimate: String,
        /// Time range of the truth.
        truth: String,
        /// Largest difference in time allowed, in seconds.
        tolerance_s: f64,
    },
    /// Poses without times cannot be told apart when their numbers differ.
    #[error(
        "the estimate has {estimate} poses and the truth {truth}, and at least one of them has no times to pair them by; give both with times or pass --by-index"
    )]
    Counts {
        /// Poses of the estimate.
        estimate: usize,
        /// Poses of the truth.
        truth: usize,
    },
    /// More poses are needed.
    #[error("only {got} poses of estimate and truth match and {what} needs {needed}; give a longer trajectory")]
    TooFew {
        /// Matched poses.
        got: usize,
        /// How many are needed.
        needed: usize,
        /// For what.
        what: &'static str,
    },
    /// Positions on one line or in one point leave the rotation open.
    #[error(
        "the positions lie on one line or in one point, so no {alignment} alignment is determined; use --align first or --align none"
    )]
    Degenerate {
        /// Name of the alignment.
        alignment: &'static str,
    },
    /// No sub-trajectory of the length asked for.
    #[error("no pair of poses is {delta} {unit} apart; choose a smaller --rpe-delta")]
    NoPairs {
        /// The distance asked for.
        delta: f64,
        /// Its unit.
        unit: &'static str,
    },
    /// A setting that has no meaning.
    #[error("{what}; {remedy}")]
    Setting {
        /// What is wrong.
        what: String,
        /// What to do.
        remedy: &'static str,
    },
    /// Depth maps that cannot cover the same view.
    #[error(
        "the predicted map is {prediction} but the truth is {truth}, a different shape; predict for the whole picture at its aspect ratio"
    )]
    Shape {
        /// Size of the prediction.
        prediction: endoscape_core::Size,
        /// Size of the truth.
        truth: endoscape_core::Size,
    },
}

impl From<endoscape_core::trajectory::TextError> for EvalError {
    fn from(error: endoscape_core::trajectory::TextError) -> Self {
        Self::Line { line: error.line, reason: error.reason }
    }
}
