//! How different two pictures look, per pixel, and how such differences become one number.
//!
//! Pictures are RGB in [-1, 1], as the networks see them. Maps of errors and weights are `[batch, 1, height, width]`;
//! weights are 0 or 1 and carry no gradient.

use crate::flex;
use crate::warp::indicator;
use burn::tensor::Tensor;
use serde::{Deserialize, Serialize};

/// How much better warping must be to count, in units of the photometric error; Godard et al., ICCV 2019, break ties by
/// noise of this size.
const AUTO_MASK_MARGIN: f64 = 1e-5;

/// What the sum of weighted errors is divided by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Average {
    /// The number of pixels that count, so that losing pixels is no way to a lower loss.
    #[default]
    ValidPixels,
    /// The number of all pixels (SfMLearner's PyTorch port).
    AllPixels,
}

/// Mean over the channels of `|a - b|`.
///
/// # Shapes
/// - `a`, `b`: `[batch, channels, height, width]`
/// - returns: `[batch, 1, height, width]`
pub fn absolute_difference(a: Tensor<4>, b: Tensor<4>) -> Tensor<4> {
    (a - b).abs().mean_dim(1)
}

/// `(1 - SSIM) / 2` over 3 x 3 windows with reflected borders, averaged over the channels: 0 for equal pictures.
///
/// Wang et al., "Image quality assessment", TIP 2004, with the window of Godard et al., CVPR 2017. The pictures are
/// brought to [0, 1] first: the luminance term compares means and needs them positive.
///
/// # Shapes
/// - `a`, `b`: `[batch, channels, height, width]`, in [-1, 1]
/// - returns: `[batch, 1, height, width]`
pub fn structural_distance(a: Tensor<4>, b: Tensor<4>) -> Tensor<4> {
    // (0.01 L)^2 and (0.03 L)^2 with L = 1, the range of values; Wang et al., Eq. 7 and 9.
    const C1: f64 = 0.01 * 0.01;
    const C2: f64 = 0.03 * 0.03;
    let (a, b) = (reflected((a + 1.0) * 0.5), reflected((b + 1.0) * 0.5));
    let (mean_a, mean_b) = (window_mean(a.clone()), window_mean(b.clone()));
    let mean_ab = mean_a.clone() * mean_b.clone();
    let mean_squares = mean_a.square() + mean_b.square();
    let covariance = window_mean(a.clone() * b.clone()) - mean_ab.clone();
    let variances = window_mean(a.square() + b.square()) - mean_squares.clone();
    let above = (mean_ab * 2.0 + C1) * (covariance * 2.0 + C2);
    let below = (mean_squares + C1) * (variances + C2);
    ((-(above / below) + 1.0) * 0.5).mean_dim(1)
}

/// `w (1 - SSIM) / 2 + (1 - w) |a - b|` per pixel; Godard et al., CVPR 2017, who use `w` = 0.85.
///
/// # Shapes
/// - `a`, `b`: `[batch, channels, height, width]`, in [-1, 1]
/// - returns: `[batch, 1, height, width]`
pub fn photometric_error(a: Tensor<4>, b: Tensor<4>, ssim_weight: f64) -> Tensor<4> {
    flex::photometric_error(&a, &b, ssim_weight).unwrap_or_else(|| photometric_error_reference(a, b, ssim_weight))
}

/// [`photometric_error`] in plain tensor operations.
pub(crate) fn photometric_error_reference(a: Tensor<4>, b: Tensor<4>, ssim_weight: f64) -> Tensor<4> {
    if ssim_weight == 0.0 {
        return absolute_difference(a, b);
    }
    let structure = structural_distance(a.clone(), b.clone());
    structure * ssim_weight + absolute_difference(a, b) * (1.0 - ssim_weight)
}

/// 1 where the warped source matches the target better than the source as it stands, else 0.
///
/// Godard et al., ICCV 2019, Eq. 5: pixels that do not move with the camera (frozen frames, an overlay, the vignette)
/// teach infinite depth and are dropped. A margin of the size of the published tie-breaking noise drops ties, and keeps
/// the objective a function of its inputs alone.
///
/// # Shapes
/// - `warped_error`, `unwarped_error`, returns: `[batch, 1, height, width]`
pub fn auto_mask(warped_error: Tensor<4>, unwarped_error: Tensor<4>) -> Tensor<4> {
    let gain = unwarped_error.detach() - warped_error.detach();
    indicator(gain.clone().greater_scalar(AUTO_MASK_MARGIN), &gain)
}

/// Per pixel, the smallest error of any source in which the pixel counts, and whether it counts in any.
///
/// Godard et al., ICCV 2019, Eq. 4: a point hidden in one source is usually seen in another.
///
/// # Shapes
/// - `errors`, `valid`: one `[batch, 1, height, width]` per source
pub fn minimum_over_sources(errors: Vec<Tensor<4>>, valid: Vec<Tensor<4>>) -> (Tensor<4>, Tensor<4>) {
    // Any error a pixel can have is far below; where nothing counts the value is multiplied by 0 later.
    const ABOVE_ALL: f64 = 1e4;
    let counts = Tensor::cat(valid, 1);
    let errors = Tensor::cat(errors, 1).mask_fill(counts.clone().lower_scalar(0.5), ABOVE_ALL);
    (errors.min_dim(1), counts.max_dim(1))
}

/// Mean of `values` over the pixels that count; 0 where none does.
///
/// # Shapes
/// - `values`, `weights`: `[batch, 1, height, width]`
pub fn average(values: Tensor<4>, weights: Tensor<4>, by: Average) -> Tensor<1> {
    flex::average(&values, &weights, by).unwrap_or_else(|| average_reference(values, weights, by))
}

/// [`average`] in plain tensor operations.
pub(crate) fn average_reference(values: Tensor<4>, weights: Tensor<4>, by: Average) -> Tensor<1> {
    // Not a product alone: 0 * NaN would spread from a pixel that does not count.
    let weighted = values.mask_fill(weights.clone().equal_scalar(0.0), 0.0) * weights.clone();
    match by {
        Average::ValidPixels => weighted.sum() / weights.sum().clamp_min(1.0),
        Average::AllPixels => weighted.mean(),
    }
}

/// One pixel of mirror image around the picture, or of its own border where it is a single pixel wide.
fn reflected(picture: Tensor<4>) -> Tensor<4> {
    let along = |picture: Tensor<4>, axis: usize| {
        let length = picture.dims()[axis];
        let pixel = |index: usize| picture.clone().narrow(axis, index.min(length - 1), 1);
        Tensor::cat(vec![pixel(1), picture.clone(), pixel(length.saturating_sub(2))], axis)
    };
    along(along(picture, 3), 2)
}

/// Mean over 3 x 3 windows; the picture shrinks by one pixel on every side.
///
/// Sums of shifted pictures, one axis after the other: on the CPU a hundred times faster than pooling.
fn window_mean(picture: Tensor<4>) -> Tensor<4> {
    let along = |picture: Tensor<4>, axis: usize| {
        let length = picture.dims()[axis] - 2;
        let shifted = |by: usize| picture.clone().narrow(axis, by, length);
        shifted(0) + shifted(1) + shifted(2)
    };
    along(along(picture, 3), 2) / 9.0
}
