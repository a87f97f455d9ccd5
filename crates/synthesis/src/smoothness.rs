//! Neighbouring pixels should have similar depth, unless the picture says otherwise.

use crate::flex;
use crate::pyramid::shrink;
use burn::tensor::Tensor;
use serde::{Deserialize, Serialize};

/// Keeps the division finite for a map of zeros.
const SMALLEST_MEAN: f64 = 1e-7;

/// Which map is asked to be smooth, and how.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Smoothness {
    /// Small second differences of disparity (SfMLearner in TensorFlow).
    SecondOrderDisparity,
    /// Small second differences of depth (SfMLearner's PyTorch port).
    SecondOrderDepth,
    /// Small first differences of mean-normalised disparity, except across image edges (Godard et al., ICCV 2019).
    #[default]
    EdgeAware,
}

/// `mean |d_xx| + mean |d_xy| + mean |d_yx| + mean |d_yy|` of a map; zero for planes.
///
/// # Shapes
/// - `map`: `[batch, channels, height, width]`
pub fn second_order(map: Tensor<4>) -> Tensor<1> {
    flex::second_order(&map).unwrap_or_else(|| second_order_reference(map))
}

/// [`second_order`] in plain tensor operations.
pub(crate) fn second_order_reference(map: Tensor<4>) -> Tensor<1> {
    let (dx, dy) = (difference(map.clone(), 3), difference(map, 2));
    let mixed = mean_abs(difference(dx.clone(), 2));
    // d_xy and d_yx are the same numbers.
    mean_abs(difference(dx, 3)) + mixed * 2.0 + mean_abs(difference(dy, 2))
}

/// `mean |d_x d*| exp(-|d_x I|) + mean |d_y d*| exp(-|d_y I|)` with `d* = d / mean(d)`.
///
/// Godard et al., ICCV 2019, Eq. 3; the mean over each picture takes the scale out, so that shrinking all disparities
/// is no way to smoothness. `|d I|` is the mean over the channels.
///
/// # Shapes
/// - `disparity`: `[batch, 1, height, width]`
/// - `image`: `[batch, channels, height, width]`, in [-1, 1]
pub fn edge_aware(disparity: Tensor<4>, image: &Tensor<4>) -> Tensor<1> {
    let mean = disparity.clone().mean_dims(&[2, 3]).clamp_min(SMALLEST_MEAN);
    let relative = disparity / mean;
    let edges = |axis: usize| difference(image.clone(), axis).abs().mean_dim(1);
    let (edges_x, edges_y) = (edges(3), edges(2));
    let (dx, dy) = (difference(relative.clone(), 3), difference(relative, 2));
    mean_abs(dx * (-edges_x).exp()) + mean_abs(dy * (-edges_y).exp())
}

/// Smoothness of a disparity map under `kind`.
///
/// # Shapes
/// - `disparity`: `[batch, 1, height, width]`
/// - `image`: the target, `[batch, channels, _, _]`, of that size or larger
pub fn smoothness(disparity: Tensor<4>, image: &Tensor<4>, kind: Smoothness) -> Tensor<1> {
    let [_, _, height, width] = disparity.dims();
    match kind {
        Smoothness::SecondOrderDisparity => second_order(disparity),
        Smoothness::SecondOrderDepth => second_order(disparity.recip()),
        Smoothness::EdgeAware => edge_aware(disparity, &shrink(image.clone(), [height, width])),
    }
}

/// Difference to the next pixel along an axis; one shorter along it, or zero where there is no next pixel.
fn difference(map: Tensor<4>, axis: usize) -> Tensor<4> {
    let length = map.dims()[axis];
    if length < 2 {
        return map.zeros_like();
    }
    map.clone().narrow(axis, 1, length - 1) - map.narrow(axis, 0, length - 1)
}

fn mean_abs(map: Tensor<4>) -> Tensor<1> {
    map.abs().mean()
}
