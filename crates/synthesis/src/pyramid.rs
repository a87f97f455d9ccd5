//! Scales of a picture.

use burn::tensor::module::adaptive_avg_pool2d;
use burn::tensor::{Tensor, TensorData};
use endoscape_core::Size;
use endoscape_kernels::interpolation;

/// Sizes of `count` scales, finest first, each half the one before, rounded up as convolutions of stride 2 do.
pub fn sizes(full: Size, count: usize) -> Vec<Size> {
    let half = |size: &Size| Some(Size::new(size.width.div_ceil(2), size.height.div_ceil(2)));
    std::iter::successors(Some(full), half).take(count).collect()
}

/// Shrinks a picture by averaging over areas; unchanged at its own size.
///
/// # Shapes
/// - `picture`: `[batch, channels, _, _]`
/// - returns: `[batch, channels, height, width]`
pub fn shrink(picture: Tensor<4>, [height, width]: [usize; 2]) -> Tensor<4> {
    let [_, _, rows, columns] = picture.dims();
    if [rows, columns] == [height, width] { picture } else { adaptive_avg_pool2d(picture, [height, width]) }
}

/// Shrinks a map of 0 and 1; a single bad pixel spoils the whole pixel it falls into.
///
/// # Shapes
/// - `usable`: `[batch, 1, _, _]`
/// - returns: `[batch, 1, height, width]`
pub fn shrink_usable(usable: Tensor<4>, size: [usize; 2]) -> Tensor<4> {
    let dtype = usable.dtype();
    shrink(usable, size).greater_scalar(WHOLLY).float().cast(dtype)
}

/// Share from which a mean of zeros and ones counts as all ones, rounding aside.
pub(crate) const WHOLLY: f64 = 0.999;

/// Enlarges a map bilinearly so that picture edges map to picture edges; unchanged at its own size.
///
/// # Shapes
/// - `map`: `[batch, channels, _, _]`
/// - returns: `[batch, channels, height, width]`
pub fn enlarge(map: Tensor<4>, [height, width]: [usize; 2]) -> Tensor<4> {
    let [_, _, rows, columns] = map.dims();
    if [rows, columns] == [height, width] {
        return map;
    }
    // As products of matrices, because Burn's interpolation has no gradient on GPUs.
    let [down, across] = [(rows, height), (columns, width)].map(|(from, to)| {
        let weights = TensorData::new(interpolation(from, to, to as f64 / from as f64), [1, 1, to, from]);
        Tensor::<4>::from_data(weights, (&map.device(), map.dtype()))
    });
    down.matmul(map).matmul(across.transpose())
}
