//! A light that moves with the camera changes the brightness of everything it approaches.

use burn::tensor::Tensor;

/// Variance below which a picture counts as flat and its contrast is left alone; pictures lie in [-1, 1].
const FLAT: f64 = 1e-6;

/// Gives a synthesised view the mean and standard deviation of the target, both over the pixels that count.
///
/// One gain and one offset per picture absorb what distance and exposure do to brightness while leaving colours and
/// texture for the photometric loss. The gradient runs through the statistics.
///
/// # Shapes
/// - `view`, `target`: `[batch, channels, height, width]`
/// - `valid`: `[batch, 1, height, width]`, 0 or 1; a picture in which nothing counts is returned unchanged in contrast
pub fn align_brightness(view: Tensor<4>, target: Tensor<4>, valid: Tensor<4>) -> Tensor<4> {
    let (view_mean, view_deviation) = moments(view.clone(), valid.clone());
    let (target_mean, target_deviation) = moments(target, valid);
    (view - view_mean) * (target_deviation / view_deviation) + target_mean
}

/// Mean and standard deviation over all channels of the pixels that count, each `[batch, 1, 1, 1]`.
fn moments(picture: Tensor<4>, valid: Tensor<4>) -> (Tensor<4>, Tensor<4>) {
    let channels = picture.dims()[1] as f64;
    let count = (valid.clone().sum_dims(&[1, 2, 3]) * channels).clamp_min(1.0);
    let mean = (picture.clone() * valid.clone()).sum_dims(&[1, 2, 3]) / count.clone();
    let deviations = (picture - mean.clone()) * valid;
    let variance = deviations.square().sum_dims(&[1, 2, 3]) / count;
    (mean, (variance + FLAT).sqrt())
}
