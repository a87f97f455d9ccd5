//! The price of calling pixels unreliable.

use crate::flex;
use burn::tensor::Tensor;

/// Keeps the logarithm finite where a mask has died; its gradient ends there too.
pub(crate) const SMALLEST_RELIABILITY: f64 = 1e-7;

/// Mean cross-entropy of reliabilities against "all reliable", `mean(-ln E)`: without it, a mask of zeros would explain
/// everything away.
///
/// # Shapes
/// - `reliability`: `[batch, sources, height, width]`, in (0, 1)
pub fn reliability_cross_entropy(reliability: Tensor<4>) -> Tensor<1> {
    flex::cross_entropy(&reliability, SMALLEST_RELIABILITY).unwrap_or_else(|| cross_entropy_reference(reliability))
}

/// [`reliability_cross_entropy`] in plain tensor operations.
pub(crate) fn cross_entropy_reference(reliability: Tensor<4>) -> Tensor<1> {
    -reliability.clamp_min(SMALLEST_RELIABILITY).log().mean()
}
