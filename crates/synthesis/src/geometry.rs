//! Two views of one scene should agree on its depth.

use burn::tensor::Tensor;

/// Keeps the quotient finite where both depths vanish.
const SMALLEST_SUM: f64 = 1e-6;

/// `|D_computed - D_sampled| / (D_computed + D_sampled)` per pixel, between 0 and 1 and free of scale.
///
/// Bian et al., "Unsupervised scale-consistent depth and ego-motion", NeurIPS 2019, Eq. 3. One minus it says how far a
/// pixel can be trusted: moving, hidden and mismatched points disagree.
///
/// # Shapes
/// - `computed`: `[batch, 1, height, width]`, the target's depth seen from the source
///   ([`Correspondence::depth`](crate::warp::Correspondence))
/// - `sampled`: the source's own depth at the same place
pub fn depth_disagreement(computed: Tensor<4>, sampled: Tensor<4>) -> Tensor<4> {
    let sum = (computed.clone().abs() + sampled.clone().abs()).clamp_min(SMALLEST_SUM);
    (computed - sampled).abs() / sum
}
