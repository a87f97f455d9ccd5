//! The price of calling pixels unreliable.

use burn::tensor::Tensor;

/// Keeps the logarithm finite where a mask has died; its gradient ends there too.
const SMALLEST_RELIABILITY: f64 = 1e-7;

/// Mean cross-entropy of reliabilities against "all reliable", `mean(-ln E)`: without it, a mask of zeros would explain
/// everything away.
///
/// # Shapes
/// - `reliability`: `[batch, sources, height, width]`, in (0, 1)
pub fn reliability_cross_entropy(reliability: Tensor<4>) -> Tensor<1> {
    -reliability.clamp_min(SMALLEST_RELIABILITY).log().mean()
}
