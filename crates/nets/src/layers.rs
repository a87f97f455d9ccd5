//! The few building blocks both networks are made of.
//!
//! Every stride-2 convolution maps `n` rows to `ceil(n / 2)` and every up-convolution maps them to `2 n`, cut back to
//! the size asked for. That pair of facts is what lets the networks take pictures of any size.

use crate::conv::{Activation, convolve, convolve_up};
use burn::module::{Initializer, Module, Param};
use burn::nn::conv::{Conv2d, ConvTranspose2d};
use burn::nn::{BatchNorm, BatchNormConfig, PaddingConfig2d};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor, TensorData};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};
use serde::{Deserialize, Serialize};
use std::cell::RefCell;

/// How pictures are padded at their borders, which decides where a stride-2 convolution places its samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Padding {
    /// `(kernel - 1) / 2` on every side, as the PyTorch port of SfMLearner does.
    #[default]
    Symmetric,
    /// TensorFlow's SAME, as the original SfMLearner does: the smaller half before, the larger half after
    /// (2 and 3 for kernel 7, stride 2 and an even size).
    Same,
}

impl Padding {
    fn of_convolution(self, kernel: usize) -> PaddingConfig2d {
        let side = (kernel - 1) / 2;
        match self {
            Self::Symmetric => PaddingConfig2d::Explicit(side, side, side, side),
            Self::Same => PaddingConfig2d::Same,
        }
    }

    /// Rows an up-convolution drops before the first one it keeps; of the `2 n + kernel - 2` rows a stride-2
    /// transposed convolution makes from `n`, it keeps `2 n`.
    pub(crate) fn of_up_convolution(self, kernel: usize) -> usize {
        match self {
            Self::Symmetric => (kernel - 1) / 2,
            Self::Same => (kernel - 2) / 2,
        }
    }
}

/// Makes layers that share a padding, a normalisation switch and a device.
///
/// Weights are Xavier-uniform and biases zero (section 2 of the method, after SfMLearner). They are drawn in the order
/// of the calls from a generator of the factory's own: that of a device is shared by the whole process, where two
/// networks made at once would take numbers from each other. One seed is one network, on every device.
pub(crate) struct LayerFactory<'a> {
    padding: Padding,
    batch_norm: bool,
    device: &'a Device,
    /// `None` leaves all weights zero: those of a file will replace them.
    numbers: Option<RefCell<ChaCha8Rng>>,
}

impl<'a> LayerFactory<'a> {
    pub fn new(padding: Padding, batch_norm: bool, seed: Option<u64>, device: &'a Device) -> Self {
        let numbers = seed.map(|seed| RefCell::new(ChaCha8Rng::seed_from_u64(seed)));
        Self { padding, batch_norm, device, numbers }
    }

    /// Convolution, normalisation if switched on, ReLU.
    pub fn block(&self, channels: [usize; 2], kernel: usize, stride: usize) -> ConvBlock {
        ConvBlock { conv: self.conv(channels, kernel, stride), norm: self.norm(channels[1]) }
    }

    /// Stride-2 transposed convolution, normalisation if switched on, ReLU.
    pub fn up_block(&self, channels: [usize; 2], kernel: usize) -> UpConvBlock {
        let dropped = self.padding.of_up_convolution(kernel);
        let conv = ConvTranspose2d {
            weight: self.xavier([channels[0], channels[1], kernel, kernel]),
            bias: Some(self.zeros(channels[1])),
            stride: [2, 2],
            kernel_size: [kernel, kernel],
            dilation: [1, 1],
            groups: 1,
            padding: [dropped, dropped],
            padding_out: [(2 * dropped + 2).saturating_sub(kernel); 2],
            channels,
        };
        UpConvBlock { conv, norm: self.norm(channels[1]) }
    }

    /// A bare convolution: the output layers have neither normalisation nor ReLU.
    pub fn conv(&self, channels: [usize; 2], kernel: usize, stride: usize) -> Conv2d {
        Conv2d {
            weight: self.xavier([channels[1], channels[0], kernel, kernel]),
            bias: Some(self.zeros(channels[1])),
            stride: [stride, stride],
            kernel_size: [kernel, kernel],
            dilation: [1, 1],
            groups: 1,
            padding: self.padding.of_convolution(kernel),
        }
    }

    fn norm(&self, channels: usize) -> Option<BatchNorm> {
        self.batch_norm.then(|| BatchNormConfig::new(channels).init(self.device))
    }

    /// Uniform in `+-sqrt(6 / (fan_in + fan_out))` (Glorot and Bengio 2010, equation 16).
    fn xavier(&self, shape: [usize; 4]) -> Param<Tensor<4>> {
        let fans = (shape[0] + shape[1]) * shape[2] * shape[3];
        let bound = (6.0 / fans as f64).sqrt() as f32;
        let Some(numbers) = &self.numbers else {
            return Param::from_tensor(Tensor::zeros(shape, self.device));
        };
        let mut numbers = numbers.borrow_mut();
        let weights = (0..shape.iter().product()).map(|_| bound * (2.0 * numbers.random::<f32>() - 1.0)).collect();
        Param::from_data(TensorData::new::<f32, _>(weights, shape), self.device)
    }

    fn zeros(&self, channels: usize) -> Param<Tensor<1>> {
        Initializer::Zeros.init([channels], self.device)
    }
}

/// Convolution, optional batch normalisation, ReLU.
#[derive(Module, Debug)]
pub struct ConvBlock {
    pub(crate) conv: Conv2d,
    pub(crate) norm: Option<BatchNorm>,
}

impl ConvBlock {
    /// # Shapes
    /// - `input`: `[batch, channels_in, height, width]`
    /// - returns: `[batch, channels_out, ceil(height / stride), ceil(width / stride)]`
    pub fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        match &self.norm {
            None => convolve(&self.conv, input, Activation::Relu),
            Some(norm) => relu(norm.forward(convolve(&self.conv, input, Activation::None))),
        }
    }
}

/// Stride-2 transposed convolution, optional batch normalisation, ReLU.
#[derive(Module, Debug)]
pub struct UpConvBlock {
    pub(crate) conv: ConvTranspose2d,
    pub(crate) norm: Option<BatchNorm>,
}

impl UpConvBlock {
    /// Doubles the picture and cuts it to `size`.
    ///
    /// # Shapes
    /// - `input`: `[batch, channels_in, height, width]`
    /// - `size`: `[rows, columns]`, at most `[2 * height, 2 * width]`
    /// - returns: `[batch, channels_out, rows, columns]`
    pub fn forward(&self, input: Tensor<4>, size: [usize; 2]) -> Tensor<4> {
        match &self.norm {
            None => convolve_up(&self.conv, input, size, Activation::Relu),
            Some(norm) => relu(norm.forward(convolve_up(&self.conv, input, size, Activation::None))),
        }
    }
}

/// Keeps the upper left `size` (rows, columns) of a picture.
pub(crate) fn crop(picture: Tensor<4>, size: [usize; 2]) -> Tensor<4> {
    if spatial_size(&picture) == size {
        return picture;
    }
    let [batch, channels, _, _] = picture.dims();
    picture.slice([0..batch, 0..channels, 0..size[0], 0..size[1]])
}

/// Rows and columns.
pub(crate) fn spatial_size(picture: &Tensor<4>) -> [usize; 2] {
    let [_, _, height, width] = picture.dims();
    [height, width]
}

/// Numbers in a convolution with bias; normalisation adds two that are trained and two running statistics.
pub(crate) fn parameters(channels: [usize; 2], kernel: usize, batch_norm: bool) -> usize {
    channels[0] * channels[1] * kernel * kernel + channels[1] * if batch_norm { 5 } else { 1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_fill_the_xavier_range_and_biases_are_zero() {
        let device = Device::flex();
        let layers = LayerFactory::new(Padding::Symmetric, false, Some(0), &device);
        // Fans 8 * 25 and 16 * 25, by hand: sqrt(6 / 600) = 0.1.
        let conv = layers.conv([8, 16], 5, 2);
        let up = layers.up_block([16, 8], 5).conv;
        for (weight, bias) in [(conv.weight.val(), conv.bias), (up.weight.val(), up.bias)] {
            let largest = weight.abs().max().into_scalar::<f32>();
            assert!(largest < 0.1 && largest > 0.095, "{largest}");
            assert_eq!(bias.unwrap().val().abs().max().into_scalar::<f32>(), 0.0);
        }
    }

    #[test]
    fn up_convolution_keeps_the_rows_each_flavour_asks_for() {
        // One input pixel spreads the kernel itself; by hand, of the rows 0 1 2 of a kernel of 3 the port keeps
        // 1 2 (padding 1, output padding 1), TensorFlow 0 1 (the adjoint of padding 0 before, 1 after).
        let device = Device::flex();
        for (padding, kept) in [(Padding::Symmetric, [1.0, 2.0]), (Padding::Same, [0.0, 1.0])] {
            let layers = LayerFactory::new(padding, false, Some(0), &device);
            let mut block = layers.up_block([1, 1], 3);
            let kernel = [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [2.0, 2.0, 2.0]];
            block.conv.weight = Param::from_data([[kernel]], &device);
            let rows = block.forward(Tensor::ones([1, 1, 1, 1], &device), [2, 1]);
            assert_eq!(rows.into_data().iter::<f32>().collect::<Vec<_>>(), kept, "{padding:?}");
        }
    }

    #[test]
    fn same_padding_puts_the_smaller_half_first() {
        // Kernel 3, stride 2, four columns 1 2 3 4: padding 0 before and 1 after gives windows 1 2 3 and 3 4 0,
        // padding 1 on both sides gives 0 1 2 and 2 3 4.
        let device = Device::flex();
        let row: Tensor<4> = Tensor::from_data([[[[1.0, 2.0, 3.0, 4.0]]]], &device);
        for (padding, sums) in [(Padding::Same, [6.0, 7.0]), (Padding::Symmetric, [3.0, 9.0])] {
            let layers = LayerFactory::new(padding, false, Some(0), &device);
            let mut block = layers.block([1, 1], 3, 2);
            block.conv.weight = Param::from_data([[[[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.0, 0.0, 0.0]]]], &device);
            // A single row has odd height: both flavours pad it by one above and below.
            assert_eq!(block.forward(row.clone()).into_data().iter::<f32>().collect::<Vec<_>>(), sums, "{padding:?}");
        }
    }

    #[test]
    fn upsampling_interpolates_between_pixel_centres_a_quarter_in() {
        let row: Tensor<4> = Tensor::from_data([[[[0.0, 4.0]]]], &Device::flex());
        let wide = crate::conv::upsample(row, [2, 4]).into_data().iter::<f32>().collect::<Vec<_>>();
        assert_eq!(wide, [0.0, 1.0, 3.0, 4.0, 0.0, 1.0, 3.0, 4.0]);
    }
}
