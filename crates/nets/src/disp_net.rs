//! The depth network: DispNet as SfMLearner uses it (Zhou et al. 2017; Mayer et al. 2016).
//!
//! Seven halving stages, seven doubling stages with skips, and a disparity prediction at each of the last four, every
//! finer one seeing the coarser one enlarged. Kernels are 7, 5, then 3.

use crate::config::check_channels;
use crate::conv::{Activation, concatenate, convolve, logistic, upsample};
use crate::error::NetsError;
use crate::layers::{ConvBlock, LayerFactory, Padding, UpConvBlock, parameters, spatial_size};
use burn::module::Module;
use burn::nn::conv::Conv2d;
use burn::tensor::{Device, Tensor, assert_shape};
use serde::{Deserialize, Serialize};

/// Number of predictions, full size first.
pub const SCALES: usize = 4;

const ENCODER_KERNELS: [usize; 7] = [7, 5, 3, 3, 3, 3, 3];
const KERNEL: usize = 3;
/// The first decoder stage whose output is turned into a prediction.
pub(crate) const FIRST_HEAD: usize = 7 - SCALES;

/// Configuration of [`DispNet`]; the default is the PyTorch port of SfMLearner.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DispNetConfig {
    /// Range of the disparity, which is `alpha * sigmoid(x) + beta`. Default 10.
    pub alpha: f64,
    /// Smallest disparity, the inverse of the largest depth. Default 0.01 (SfMLearner); the paper says 0.1.
    pub beta: f64,
    /// Channels after each encoder stage. Default 32, 64, 128, 256, 512, 512, 512.
    pub encoder: [usize; 7],
    /// Channels after each decoder stage, coarsest first. Default 512, 512, 256, 128, 64, 32, 16.
    pub decoder: [usize; 7],
    /// Batch normalisation after every layer but the outputs (the paper has it, SfMLearner does not). Default off.
    pub batch_norm: bool,
    /// Padding flavour. Default symmetric.
    pub padding: Padding,
}

impl Default for DispNetConfig {
    fn default() -> Self {
        Self {
            alpha: 10.0,
            beta: 0.01,
            encoder: [32, 64, 128, 256, 512, 512, 512],
            decoder: [512, 512, 256, 128, 64, 32, 16],
            batch_norm: false,
            padding: Padding::Symmetric,
        }
    }
}

impl DispNetConfig {
    /// The same network with every layer's channels multiplied by `width` and rounded, never below one.
    pub fn with_width(mut self, width: f64) -> Self {
        let scale = |channels: usize| ((channels as f64 * width).round() as usize).max(1);
        self.encoder = self.encoder.map(scale);
        self.decoder = self.decoder.map(scale);
        self
    }

    /// # Errors
    /// [`NetsError::Config`] when a channel count is 0 or beyond reason, or alpha or beta is not positive.
    pub fn validate(&self) -> Result<(), NetsError> {
        check_channels("disp.encoder", &self.encoder)?;
        check_channels("disp.decoder", &self.decoder)?;
        for (name, value) in [("disp.alpha", self.alpha), ("disp.beta", self.beta)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(NetsError::config(name, format!("is {value} but must be a positive number")));
            }
        }
        Ok(())
    }

    /// Numbers in the network (running statistics included), known without building it.
    pub fn parameter_count(&self) -> usize {
        let encoder = (0..7).map(|stage| {
            let ([input, output], kernel) = (self.encoder_channels(stage), ENCODER_KERNELS[stage]);
            parameters([input, output], kernel, self.batch_norm) + parameters([output, output], kernel, self.batch_norm)
        });
        let decoder = (0..7).map(|stage| {
            let head = if stage < FIRST_HEAD { 0 } else { parameters([self.decoder[stage], 1], KERNEL, false) };
            head + parameters(self.up_channels(stage), KERNEL, self.batch_norm)
                + parameters(self.fuse_channels(stage), KERNEL, self.batch_norm)
        });
        encoder.chain(decoder).sum()
    }

    /// Builds the network with the fresh weights of `seed`.
    ///
    /// # Errors
    /// As [`Self::validate`].
    pub fn init(&self, seed: u64, device: &Device) -> Result<DispNet, NetsError> {
        self.build(Some(seed), device)
    }

    /// With weights of zero where there is no seed: for those of a file.
    pub(crate) fn build(&self, seed: Option<u64>, device: &Device) -> Result<DispNet, NetsError> {
        self.validate()?;
        let layers = LayerFactory::new(self.padding, self.batch_norm, seed, device);
        let encoder = std::array::from_fn(|stage| {
            let ([input, output], kernel) = (self.encoder_channels(stage), ENCODER_KERNELS[stage]);
            EncoderStage {
                halve: layers.block([input, output], kernel, 2),
                refine: layers.block([output, output], kernel, 1),
            }
        });
        let decoder = std::array::from_fn(|stage| DecoderStage {
            up: layers.up_block(self.up_channels(stage), KERNEL),
            fuse: layers.block(self.fuse_channels(stage), KERNEL, 1),
        });
        let heads = std::array::from_fn(|head| layers.conv([self.decoder[FIRST_HEAD + head], 1], KERNEL, 1));
        Ok(DispNet { encoder, decoder, heads, alpha: self.alpha, beta: self.beta })
    }

    fn encoder_channels(&self, stage: usize) -> [usize; 2] {
        [if stage == 0 { 3 } else { self.encoder[stage - 1] }, self.encoder[stage]]
    }

    fn up_channels(&self, stage: usize) -> [usize; 2] {
        [if stage == 0 { self.encoder[6] } else { self.decoder[stage - 1] }, self.decoder[stage]]
    }

    /// Channels of the enlarged features, of the skip (none at full size) and of the coarser disparity, together.
    fn fuse_channels(&self, stage: usize) -> [usize; 2] {
        let skip = if stage == 6 { 0 } else { self.encoder[5 - stage] };
        let disparity = usize::from(stage > FIRST_HEAD);
        [self.decoder[stage] + skip + disparity, self.decoder[stage]]
    }
}

/// Predicts the disparity of one picture at four scales.
#[derive(Module, Debug)]
pub struct DispNet {
    pub(crate) encoder: [EncoderStage; 7],
    pub(crate) decoder: [DecoderStage; 7],
    /// Coarsest first.
    pub(crate) heads: [Conv2d; SCALES],
    pub(crate) alpha: f64,
    pub(crate) beta: f64,
}

/// A halving convolution and one at the new size.
#[derive(Module, Debug)]
pub(crate) struct EncoderStage {
    pub halve: ConvBlock,
    pub refine: ConvBlock,
}

impl EncoderStage {
    fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        self.refine.forward(self.halve.forward(input))
    }
}

/// A doubling convolution and one over what arrives at that size.
#[derive(Module, Debug)]
pub(crate) struct DecoderStage {
    pub up: UpConvBlock,
    pub fuse: ConvBlock,
}

/// Disparity at four scales; depth is its inverse, in the unknown unit of the training's baseline.
#[derive(Debug, Clone)]
pub struct DisparityPyramid {
    /// Full size first: scale `l` is `[batch, 1, ceil(height / 2^l), ceil(width / 2^l)]`, between beta and alpha + beta.
    pub scales: [Tensor<4>; SCALES],
}

impl DisparityPyramid {
    /// Depth at the given scale.
    ///
    /// # Shapes
    /// - returns: `[batch, 1, ceil(height / 2^scale), ceil(width / 2^scale)]`
    ///
    /// # Panics
    /// If `scale` is 4 or more.
    pub fn depth(&self, scale: usize) -> Tensor<4> {
        self.scales[scale].clone().recip()
    }
}

impl DispNet {
    /// Predicts disparity at four scales.
    ///
    /// # Shapes
    /// - `image`: `[batch, 3, height, width]`, RGB in [-1, 1], any size
    /// - returns: scale `l` is `[batch, 1, ceil(height / 2^l), ceil(width / 2^l)]`
    ///
    /// # Panics
    /// If the image has not three channels.
    pub fn forward(&self, image: Tensor<4>) -> DisparityPyramid {
        self.forward_tapped(image, |_, disparity| disparity)
    }

    /// [`Self::forward`], each prediction (scale, disparity) passing through `tap` before the finer ones see it.
    ///
    /// # Shapes
    /// As [`Self::forward`]; `tap` keeps the shape.
    pub(crate) fn forward_tapped(
        &self,
        image: Tensor<4>,
        mut tap: impl FnMut(usize, Tensor<4>) -> Tensor<4>,
    ) -> DisparityPyramid {
        assert_shape!(image, [_, 3, _, _]);
        let full_size = spatial_size(&image);
        let (mut skips, mut features) = self.encode(image);
        let mut scales: Vec<Tensor<4>> = Vec::with_capacity(SCALES);
        for (index, stage) in self.decoder.iter().enumerate() {
            let skip = skips.pop();
            let size = skip.as_ref().map_or(full_size, spatial_size);
            let mut inputs = vec![stage.up.forward(features, size)];
            inputs.extend(skip);
            inputs.extend(scales.last().map(|coarser| upsample(coarser.clone(), size)));
            features = stage.fuse.forward(concatenate(inputs));
            if index >= FIRST_HEAD {
                let head = &self.heads[index - FIRST_HEAD];
                let disparity = self.disparity(convolve(head, features.clone(), Activation::None));
                scales.push(tap(SCALES - 1 - scales.len(), disparity));
            }
        }
        DisparityPyramid { scales: std::array::from_fn(|scale| scales[SCALES - 1 - scale].clone()) }
    }

    /// Features after the first six encoder stages, finest first, and after the last.
    fn encode(&self, image: Tensor<4>) -> (Vec<Tensor<4>>, Tensor<4>) {
        let [first, rest @ ..] = &self.encoder;
        let mut features = first.forward(image);
        let mut skips = Vec::with_capacity(rest.len());
        for stage in rest {
            skips.push(features.clone());
            features = stage.forward(features);
        }
        (skips, features)
    }

    /// `alpha * sigmoid(x) + beta`, section III-B of the paper.
    fn disparity(&self, activation: Tensor<4>) -> Tensor<4> {
        logistic(activation, self.alpha, self.beta)
    }
}
