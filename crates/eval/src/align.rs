//! Bringing an estimate into the frame, and if asked the scale, of the truth.
//!
//! S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns" (1991), equations 34
//! to 43, on the camera positions.

use crate::EvalError;
use crate::poses::MatrixPose;
use faer::Mat;
use nalgebra::{Matrix3, Rotation3, Translation3, Vector3};
use serde::{Serialize, Serializer};
use std::fmt;
use std::str::FromStr;

/// A second singular value below this share of the first is rounding: the positions lie on a line.
const RANK_TOLERANCE: f64 = 1e-12;

/// What the estimate is allowed to be corrected by before errors are taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Alignment {
    /// Nothing.
    None,
    /// Rotation and translation.
    Se3,
    /// Rotation, translation and scale.
    Sim3,
    /// Scale.
    Scale,
    /// The rigid motion that makes the first poses equal.
    First,
}

const NAMES: [(Alignment, &str); 5] = [
    (Alignment::None, "none"),
    (Alignment::Se3, "se3"),
    (Alignment::Sim3, "sim3"),
    (Alignment::Scale, "scale"),
    (Alignment::First, "first"),
];

impl Alignment {
    /// Name on the command line and in reports.
    pub fn name(self) -> &'static str {
        NAMES.iter().find(|(alignment, _)| *alignment == self).map_or("unknown", |(_, name)| name)
    }
}

impl fmt::Display for Alignment {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

impl FromStr for Alignment {
    type Err = EvalError;

    fn from_str(text: &str) -> Result<Self, EvalError> {
        NAMES.iter().find(|(_, name)| *name == text).map(|(alignment, _)| *alignment).ok_or_else(|| {
            EvalError::Setting {
                what: format!("`{text}` is no alignment"),
                remedy: "choose one of none, se3, sim3, scale, first",
            }
        })
    }
}

impl Serialize for Alignment {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

/// `truth_from_estimate`: scale, then rotate and translate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Factor on positions of the estimate.
    pub scale: f64,
    /// Rigid motion applied after it.
    pub motion: MatrixPose,
}

impl Similarity {
    /// Changes nothing.
    pub fn identity() -> Self {
        Self { scale: 1.0, motion: MatrixPose::identity() }
    }

    /// The pose in the frame of the truth; its rotation is not scaled.
    pub fn apply(&self, pose: &MatrixPose) -> MatrixPose {
        let scaled = Translation3::from(pose.translation.vector * self.scale);
        self.motion * MatrixPose::from_parts(scaled, pose.rotation)
    }

    /// All poses in the frame of the truth.
    pub fn apply_all(&self, poses: &[MatrixPose]) -> Vec<MatrixPose> {
        poses.iter().map(|pose| self.apply(pose)).collect()
    }
}

/// The best `truth_from_estimate` of the kind `alignment` allows.
///
/// # Errors
/// [`EvalError::Degenerate`] if the positions leave the rotation open (for `se3`, `sim3`) or give no scale;
/// [`EvalError::TooFew`] for no poses at all.
pub fn align(estimate: &[MatrixPose], truth: &[MatrixPose], alignment: Alignment) -> Result<Similarity, EvalError> {
    let degenerate = || EvalError::Degenerate { alignment: alignment.name() };
    match alignment {
        Alignment::None => Ok(Similarity::identity()),
        Alignment::First => match (estimate.first(), truth.first()) {
            (Some(estimate), Some(truth)) => Ok(Similarity { scale: 1.0, motion: truth * estimate.inverse() }),
            _ => Err(EvalError::TooFew { got: 0, needed: 1, what: "an alignment" }),
        },
        Alignment::Scale => {
            let fit = umeyama(estimate, truth, true);
            // Points on a line still have a scale, points in one place have none.
            let scale = if fit.rank > 0 { fit.similarity.scale } else { 0.0 };
            if scale > 0.0 { Ok(Similarity { scale, motion: MatrixPose::identity() }) } else { Err(degenerate()) }
        }
        Alignment::Se3 | Alignment::Sim3 => {
            let fit = umeyama(estimate, truth, alignment == Alignment::Sim3);
            if fit.rank >= 2 && fit.similarity.scale > 0.0 { Ok(fit.similarity) } else { Err(degenerate()) }
        }
    }
}

/// A least-squares fit and how well it is determined.
pub(crate) struct Fit {
    /// One of the best fits; the only one if `rank` is 2 or 3.
    pub similarity: Similarity,
    /// Rank of the covariance, 0 to 3.
    pub rank: usize,
}

/// Umeyama's fit of the positions of `estimate` to those of `truth`; both have the same number of poses.
pub(crate) fn umeyama(estimate: &[MatrixPose], truth: &[MatrixPose], with_scale: bool) -> Fit {
    let (mean_estimate, mean_truth) = (mean_position(estimate), mean_position(truth));
    let count = estimate.len().max(1) as f64;
    let (mut covariance, mut variance) = (Matrix3::zeros(), 0.0);
    for (x, y) in estimate.iter().zip(truth) {
        let (x, y) = (x.translation.vector - mean_estimate, y.translation.vector - mean_truth);
        covariance += y * x.transpose();
        variance += x.norm_squared();
    }
    let Some((u, d, v_t)) = singular_values(&(covariance / count)) else {
        return Fit { similarity: Similarity::identity(), rank: 0 };
    };
    // Equation 43: a reflection is no rotation.
    let sign = if u.determinant() * v_t.determinant() < 0.0 { -1.0 } else { 1.0 };
    let s = Vector3::new(1.0, 1.0, sign);
    let rotation = u * Matrix3::from_diagonal(&s) * v_t;
    // Equation 42. A single place has no scale: it stays as it is.
    let scale = if with_scale && variance > 0.0 { d.dot(&s) / (variance / count) } else { 1.0 };
    let translation = mean_truth - rotation * mean_estimate * scale;
    let motion = MatrixPose::from_parts(Translation3::from(translation), Rotation3::from_matrix_unchecked(rotation));
    let rank = d.iter().filter(|value| **value > RANK_TOLERANCE * d.max() && **value > 0.0).count();
    Fit { similarity: Similarity { scale, motion }, rank }
}

/// `(U, d, V^T)` with `d` falling.
///
/// By faer: for 3x3 nalgebra 0.35 goes through the eigenvalues of `A^T A`, which costs half the digits, and its iterative
/// form stops early on some matrices of long thin paths (it leaves `U d V^T` a relative 2.5e-4 away from `A`).
fn singular_values(matrix: &Matrix3<f64>) -> Option<(Matrix3<f64>, Vector3<f64>, Matrix3<f64>)> {
    let svd = Mat::from_fn(3, 3, |row, column| matrix[(row, column)]).svd().ok()?;
    let (u, d, v) = (svd.U(), svd.S().column_vector(), svd.V());
    Some((
        Matrix3::from_fn(|row, column| u[(row, column)]),
        Vector3::from_fn(|index, _| d[index]),
        Matrix3::from_fn(|row, column| v[(column, row)]),
    ))
}

fn mean_position(poses: &[MatrixPose]) -> Vector3<f64> {
    let sum: Vector3<f64> = poses.iter().map(|pose| pose.translation.vector).sum();
    sum / poses.len().max(1) as f64
}
