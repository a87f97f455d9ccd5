//! View synthesis: the target view painted with the pixels of a source view.
//!
//! Back-project the target's pixels with their depth, move the points into the source camera, project them, and read
//! the source picture there: `p_s ~ K T(source <- target) D(p_t) K^-1 p_t` (Eq. 2 of docs/math.md), with any lens in
//! the place of `K`. Everything is built from tensor operations that differentiate by themselves; where `flex.rs` or
//! `cube.rs` has a faster kernel, they are its reference.
//!
//! Pixel centres lie at integer coordinates. [`sample_bilinear`] is the only place that reads a picture between its
//! pixels, so the only place where that convention can be broken; it equals `grid_sample` with `align_corners = true`.

use crate::camera::{CameraBatch, Projected};
#[cfg(feature = "cube")]
use crate::cube;
use crate::flex;
use burn::tensor::{Bool, Int, Tensor};
use endoscape_kernels::correspondence::Limits;
use serde::{Deserialize, Serialize};

/// Depths outside this range, NaN among them, mark their pixels invalid. Networks predict 0.1 to 10 and pictures in
/// metres hold 1e-4 to 1, so nothing real is lost, and squares of coordinates stay far from overflow.
const DEPTH_RANGE: [f64; 2] = [1e-6, 1e6];

/// Disparities outside this range are none: the inverses of twice [`DEPTH_RANGE`].
pub(crate) const DISPARITY_RANGE: [f64; 2] = [0.5 / DEPTH_RANGE[1], 2.0 / DEPTH_RANGE[0]];

/// A point closer to the source camera than this fraction of its depth in the target counts as behind the lens. A
/// fraction, not a length, so that scaling depth and translation together changes nothing.
const NEAREST: f64 = 1e-3;

/// Positions may pass the outermost pixel centres by this fraction of the picture: what single precision makes of a
/// border pixel that did not move. Without it a still camera would lose its border.
const BORDER_SLACK: f64 = 1e-6;

/// What happens to pixels whose source position lies outside the source picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OutOfView {
    /// They become mid-grey, 0, and count: without gradient, but with a price (SfMLearner in TensorFlow).
    Grey,
    /// They do not count.
    #[default]
    Masked,
    /// They take the colour of the nearest border pixel and count.
    Border,
}

/// A synthesised target view.
#[derive(Clone, Debug)]
pub struct Synthesized {
    /// `[batch, channels, height, width]`, the source's colours at the target's pixels.
    pub image: Tensor<4>,
    /// `[batch, 1, height, width]`, 1 where the pixel counts under the policy, else 0; never NaN, no gradient.
    pub valid: Tensor<4>,
    /// Where the colours were read.
    pub correspondence: Correspondence,
}

/// Where the target's pixels lie in the source view.
#[derive(Clone, Debug)]
pub struct Correspondence {
    /// `[batch, 2, height, width]`: column, then row, in the source picture; finite everywhere.
    pub pixels: Tensor<4>,
    /// `[batch, 1, height, width]`: depth along the source's optical axis, in the unit of the target's depth; 1 where
    /// not defined.
    pub depth: Tensor<4>,
    /// `[batch, 1, height, width]`: 1 where the pixel has a ray, a sane depth, and a point the source lens can image,
    /// else 0; no gradient.
    pub defined: Tensor<4>,
    /// `[batch, 1, height, width]`: 1 where the source picture shows the pixel besides, else 0; no gradient.
    pub in_view: Tensor<4>,
}

/// Paints the target view with the source picture.
///
/// # Shapes
/// - `source`: `[batch, channels, height, width]`
/// - `depth`: `[batch, 1, height, width]`, along the target's optical axis
/// - `source_from_target`: `[batch, 3, 4]`, translation in the unit of `depth`
/// - `cameras`: of that batch and size, the same for target and source
pub fn synthesize(
    source: Tensor<4>,
    depth: Tensor<4>,
    source_from_target: Tensor<3>,
    cameras: &CameraBatch,
    out_of_view: OutOfView,
) -> Synthesized {
    let correspondence = correspond(depth, source_from_target, cameras);
    let Correspondence { pixels, defined, in_view, .. } = correspondence.clone();
    let (image, valid) = match out_of_view {
        OutOfView::Grey => (sample_shown(source, pixels, in_view), cameras.seen().expand(defined.dims())),
        OutOfView::Masked => (sample_bilinear(source, pixels), in_view),
        OutOfView::Border => (sample_bilinear(source, pixels), defined),
    };
    Synthesized { image, valid, correspondence }
}

/// Positions of the target's pixels in the source view.
///
/// # Shapes
/// - `depth`: `[batch, 1, height, width]`
/// - `source_from_target`: `[batch, 3, 4]`, translation in the unit of `depth`
pub fn correspond(depth: Tensor<4>, source_from_target: Tensor<3>, cameras: &CameraBatch) -> Correspondence {
    let limits = Limits {
        depth: DEPTH_RANGE.map(|depth| depth as f32),
        nearest: NEAREST as f32,
        border_slack: BORDER_SLACK as f32,
    };
    let found = flex::correspond(&depth, &source_from_target, cameras, limits);
    #[cfg(feature = "cube")]
    let found = found.or_else(|| cube::correspond(&depth, &source_from_target, cameras, limits));
    found.unwrap_or_else(|| correspond_reference(depth, source_from_target, cameras))
}

/// [`correspond`] in plain tensor operations.
pub(crate) fn correspond_reference(
    depth: Tensor<4>,
    source_from_target: Tensor<3>,
    cameras: &CameraBatch,
) -> Correspondence {
    let [low, high] = DEPTH_RANGE;
    // Comparisons are false for NaN, which must be gone before the first multiplication: 0 * NaN is NaN in gradients.
    let sane = depth.clone().greater_scalar(low).bool_and(depth.clone().lower_scalar(high));
    let depth = depth.mask_fill(sane.clone().bool_not(), 1.0);
    let points_in_target = cameras.backproject(depth.clone());
    let points_in_source = transform(source_from_target, points_in_target);
    let depth_in_source = points_in_source.clone().narrow(1, 2, 1);
    let Projected { pixels, in_domain } = cameras.project(points_in_source, depth.detach() * NEAREST);
    let seen = cameras.seen().greater_scalar(0.5).expand(sane.dims());
    let defined = in_domain.bool_and(sane).bool_and(seen);
    let depth = depth_in_source.mask_fill(defined.clone().bool_not(), 1.0);
    let defined = indicator(defined, &depth);
    let in_picture = indicator(inside(&pixels, [cameras.size().height, cameras.size().width]), &pixels);
    Correspondence { pixels, depth, in_view: defined.clone() * in_picture, defined }
}

/// `1 / disparity`. Disparities that are zero, negative or NaN give a depth beyond every sane one, without gradient, so
/// that their pixels do not count.
///
/// # Shapes
/// - `disparity`, returns: `[batch, 1, height, width]`
pub fn depth_from_disparity(disparity: Tensor<4>) -> Tensor<4> {
    flex::inverse_within(&disparity, DISPARITY_RANGE).unwrap_or_else(|| finite_disparity_reference(disparity).recip())
}

/// Replaces what is no disparity by one too small to count.
pub(crate) fn finite_disparity(disparity: Tensor<4>) -> Tensor<4> {
    flex::within(&disparity, DISPARITY_RANGE).unwrap_or_else(|| finite_disparity_reference(disparity))
}

/// [`finite_disparity`] in plain tensor operations.
pub(crate) fn finite_disparity_reference(disparity: Tensor<4>) -> Tensor<4> {
    let [smallest, largest] = DISPARITY_RANGE;
    let sane = disparity.clone().greater_scalar(smallest).bool_and(disparity.clone().lower_scalar(largest));
    disparity.mask_fill(sane.bool_not(), smallest)
}

/// Applies a rigid transform to every point, `p' = R p + t`.
///
/// # Shapes
/// - `transform`: `[batch, 3, 4]`
/// - `points`: `[batch, 3, height, width]`
pub fn transform(transform: Tensor<3>, points: Tensor<4>) -> Tensor<4> {
    let shape = points.dims();
    let [batch, _, height, width] = shape;
    let rotation = transform.clone().narrow(2, 0, 3);
    let translation = transform.narrow(2, 3, 1);
    (rotation.matmul(points.reshape([batch, 3, height * width])) + translation).reshape(shape)
}

/// Reads a picture at positions between its pixels, whose centres lie at integer coordinates.
///
/// Positions outside take the value of the nearest border pixel and have no gradient. The gradient runs to `pixels`
/// and, where it is tracked, to `picture`.
///
/// # Shapes
/// - `picture`: `[batch, channels, height, width]`
/// - `pixels`: `[batch, 2, rows, columns]`: column, then row; finite
/// - returns: `[batch, channels, rows, columns]`
pub fn sample_bilinear(picture: Tensor<4>, pixels: Tensor<4>) -> Tensor<4> {
    let read = flex::sample_bilinear(&picture, &pixels, None);
    #[cfg(feature = "cube")]
    let read = read.or_else(|| cube::sample_bilinear(&picture, &pixels));
    read.unwrap_or_else(|| sample_bilinear_reference(picture, pixels))
}

/// [`sample_bilinear`] where a pixel is shown, else 0.
///
/// # Shapes
/// - `shown`: `[batch, 1, height, width]` as `pixels`, 1 or 0, without a gradient
fn sample_shown(picture: Tensor<4>, pixels: Tensor<4>, shown: Tensor<4>) -> Tensor<4> {
    flex::sample_bilinear(&picture, &pixels, Some(&shown)).unwrap_or_else(|| sample_bilinear(picture, pixels) * shown)
}

/// [`sample_bilinear`] in plain tensor operations.
pub(crate) fn sample_bilinear_reference(picture: Tensor<4>, pixels: Tensor<4>) -> Tensor<4> {
    let [batch, channels, height, width] = picture.dims();
    let [_, _, rows, columns] = pixels.dims();
    let (left, right_share) = cell(pixels.clone().narrow(1, 0, 1), width);
    let (top, lower_share) = cell(pixels.narrow(1, 1, 1), height);
    let first_of_item =
        Tensor::<1, Int>::arange(0..batch as i64, &picture.device()).mul_scalar((height * width) as i64);
    let corner = top.mul_scalar(width as i64).add(left).add(first_of_item.reshape([batch, 1, 1, 1]));
    let corner: Tensor<1, Int> = corner.reshape([batch * rows * columns]);
    // Colours side by side: one index reads all channels of a pixel, which is many times faster than one per channel.
    let colours = picture.permute([0, 2, 3, 1]).reshape([batch * height * width, channels]);
    let read = |offset: usize| {
        let read = colours.clone().select(0, corner.clone().add_scalar(offset as i64));
        read.reshape([batch, rows, columns, channels])
    };
    let last = |share: Tensor<4>| share.reshape([batch, rows, columns, 1]);
    let (right_share, lower_share) = (last(right_share), last(lower_share));
    // A picture one pixel wide has no right neighbour; its share is 0 there.
    let (right, down) = (usize::from(width > 1), if height > 1 { width } else { 0 });
    let upper = mix(read(0), read(right), right_share.clone());
    let lower = mix(read(down), read(down + right), right_share);
    mix(upper, lower, lower_share).permute([0, 3, 1, 2])
}

/// First pixel of the pair that encloses a coordinate along an axis of `length` pixels, and the share of the second.
fn cell(coordinate: Tensor<4>, length: usize) -> (Tensor<4, Int>, Tensor<4>) {
    let coordinate = coordinate.clamp(0.0, length.saturating_sub(1) as f64);
    // Nothing is negative here, so cutting off the fraction rounds down.
    let first = coordinate.clone().detach().int().clamp_max(length.saturating_sub(2) as i64);
    let share = coordinate.clone() - first.clone().float().cast(coordinate.dtype());
    (first, share)
}

fn mix(from: Tensor<4>, to: Tensor<4>, share: Tensor<4>) -> Tensor<4> {
    from.clone() + (to - from) * share
}

/// Whether positions lie within the centres of the outermost pixels of a picture of `[height, width]`.
pub fn inside(pixels: &Tensor<4>, [height, width]: [usize; 2]) -> Tensor<4, Bool> {
    let within = |axis: usize, length: usize| {
        let coordinate = pixels.clone().detach().narrow(1, axis, 1);
        let slack = BORDER_SLACK * length as f64;
        let last = length.saturating_sub(1) as f64 + slack;
        coordinate.clone().greater_equal_scalar(-slack).bool_and(coordinate.lower_equal_scalar(last))
    };
    within(0, width).bool_and(within(1, height))
}

/// 1 where `mask` holds, else 0, on the device and in the type of `like`.
pub(crate) fn indicator(mask: Tensor<4, Bool>, like: &Tensor<4>) -> Tensor<4> {
    mask.float().cast(like.dtype())
}
