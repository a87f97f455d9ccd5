//! Where every convolution of the networks is computed, and what stands between them.
//!
//! On the processor (Burn's Flex device, single precision) by our own kernels, with bias and ReLU in the same pass and
//! a backward step of our own; on every other device by Burn's operations, which are also the reference the tests
//! compare with.

mod flex;
mod join;
mod memory;
mod unary;

pub use memory::recycle;

use crate::layers::{crop, spatial_size};
use burn::nn::PaddingConfig2d;
use burn::nn::conv::{Conv2d, ConvTranspose2d};
use burn::tensor::activation::{relu, sigmoid};
use burn::tensor::{DType, Tensor, TensorData};
use endoscape_kernels::{Geometry, interpolation};

/// What follows a convolution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Activation {
    /// Nothing.
    None,
    /// Negative numbers become zero.
    Relu,
}

/// A convolution.
///
/// # Shapes
/// - `input`: `[batch, channels_in, height, width]`
/// - returns: `[batch, channels_out, ceil(height / stride), ceil(width / stride)]`
pub(crate) fn convolve(layer: &Conv2d, input: Tensor<4>, activation: Activation) -> Tensor<4> {
    let product = || {
        let geometry = geometry_of(layer, spatial_size(&input))?;
        let bias = layer.bias.as_ref()?.val();
        flex::product(flex::Direction::ToSmall, geometry, [&input, &layer.weight.val()], &bias, activation)
    };
    let computed = product();
    computed.unwrap_or_else(|| activate(layer.forward(input), activation))
}

/// A transposed convolution, cut to the upper left `size`.
///
/// # Shapes
/// - `input`: `[batch, channels_in, height, width]`
/// - `size`: `[rows, columns]`
/// - returns: `[batch, channels_out, rows, columns]`
pub(crate) fn convolve_up(
    layer: &ConvTranspose2d,
    input: Tensor<4>,
    size: [usize; 2],
    activation: Activation,
) -> Tensor<4> {
    let product = || {
        let geometry = up_geometry_of(layer, spatial_size(&input), size)?;
        let bias = layer.bias.as_ref()?.val();
        flex::product(flex::Direction::ToLarge, geometry, [&input, &layer.weight.val()], &bias, activation)
    };
    let computed = product();
    computed.unwrap_or_else(|| activate(crop(layer.forward(input), size), activation))
}

/// The channels of several tensors side by side.
///
/// # Shapes
/// - `tensors`: `[batch, any, height, width]` each
pub(crate) fn concatenate(tensors: Vec<Tensor<4>>) -> Tensor<4> {
    join::concatenate(&tensors).unwrap_or_else(|| Tensor::cat(tensors, 1))
}

/// `scale * sigmoid(x) + offset`.
pub(crate) fn logistic(input: Tensor<4>, scale: f64, offset: f64) -> Tensor<4> {
    unary::logistic(&input, scale, offset).unwrap_or_else(|| logistic_reference(input, scale, offset))
}

fn logistic_reference(input: Tensor<4>, scale: f64, offset: f64) -> Tensor<4> {
    sigmoid(input).mul_scalar(scale).add_scalar(offset)
}

/// Doubles a picture bilinearly (pixel areas aligned, not corner centres) and cuts it to `size`.
///
/// # Shapes
/// - `picture`: `[batch, channels, height, width]`
/// - `size`: `[rows, columns]`, at most `[2 * height, 2 * width]`
/// - returns: `[batch, channels, rows, columns]`
pub(crate) fn upsample(picture: Tensor<4>, size: [usize; 2]) -> Tensor<4> {
    unary::doubled(&picture, size).unwrap_or_else(|| upsample_reference(picture, size))
}

/// As products of matrices, because Burn's interpolation has no gradient on GPUs.
fn upsample_reference(picture: Tensor<4>, size: [usize; 2]) -> Tensor<4> {
    let from = spatial_size(&picture);
    let [rows, columns] = [0, 1].map(|axis| {
        let weights = TensorData::new(interpolation(from[axis], size[axis], 2.0), [1, 1, size[axis], from[axis]]);
        Tensor::<4>::from_data(weights, (&picture.device(), picture.dtype()))
    });
    rows.matmul(picture).matmul(columns.transpose())
}

fn activate(features: Tensor<4>, activation: Activation) -> Tensor<4> {
    match activation {
        Activation::None => features,
        Activation::Relu => relu(features),
    }
}

/// The sizes as the kernels want them; `None` if they do not cover the layer.
pub(crate) fn geometry_of(layer: &Conv2d, large: [usize; 2]) -> Option<Geometry> {
    let [small_channels, large_channels, kernel, kernel_columns] = layer.weight.dims();
    let stride = layer.stride[0];
    let plain = layer.stride == [stride; 2] && layer.dilation == [1, 1] && layer.groups == 1;
    let known =
        plain && kernel == kernel_columns && matches!(stride, 1 | 2) && layer.weight.val().dtype() == DType::F32;
    let (before, small) = match layer.padding {
        PaddingConfig2d::Explicit(top, left, bottom, right) => {
            let rows = (large[0] + top + bottom).checked_sub(kernel)? / stride + 1;
            let columns = (large[1] + left + right).checked_sub(kernel)? / stride + 1;
            ([top, left], [rows, columns])
        }
        PaddingConfig2d::Same => {
            let small = large.map(|length| length.div_ceil(stride));
            let total = |axis: usize| ((small[axis] - 1) * stride + kernel).saturating_sub(large[axis]);
            ([total(0) / 2, total(1) / 2], small)
        }
        PaddingConfig2d::Valid => return None,
    };
    known.then_some(Geometry { large_channels, small_channels, kernel, stride, before, large, small })
}

/// As [`geometry_of`], for an up-convolution cut to `large`.
pub(crate) fn up_geometry_of(layer: &ConvTranspose2d, small: [usize; 2], large: [usize; 2]) -> Option<Geometry> {
    let [small_channels, large_channels, kernel, kernel_columns] = layer.weight.dims();
    let stride = layer.stride[0];
    let plain = layer.stride == [stride; 2] && layer.dilation == [1, 1] && layer.groups == 1;
    let known =
        plain && kernel == kernel_columns && matches!(stride, 1 | 2) && layer.weight.val().dtype() == DType::F32;
    let before = layer.padding;
    known.then_some(Geometry { large_channels, small_channels, kernel, stride, before, large, small })
}

#[cfg(test)]
mod tests;
