//! The motion and reliability network of SfMLearner (there "pose exp net"; Zhou et al. 2017).
//!
//! Five halving convolutions see the target and its neighbours together. Two more, a 1x1 convolution and a spatial
//! mean give one motion per neighbour; five doubling convolutions give, per neighbour, the probability that a pixel
//! obeys the static-scene assumption. The second half is needed for training only.

use crate::config::{check_channels, check_kernels};
use crate::conv::{Activation, convolve, logistic};
use crate::disp_net::SCALES;
use crate::error::NetsError;
use crate::layers::{ConvBlock, LayerFactory, Padding, UpConvBlock, parameters, spatial_size};
use burn::module::Module;
use burn::nn::conv::Conv2d;
use burn::tensor::activation::sigmoid;
use burn::tensor::{Device, Tensor, assert_shape};
use endoscape_core::Rotation;
use serde::{Deserialize, Serialize};

const ENCODER_KERNELS: [usize; 5] = [7, 5, 3, 3, 3];
const MOTION_KERNEL: usize = 3;
/// Keeps the first predictions near zero, as SfMLearner does.
pub(crate) const MOTION_SCALE: f64 = 0.01;
/// The first mask stage whose output is turned into a prediction.
const FIRST_MASK_HEAD: usize = 5 - SCALES;

/// How the network says which pixels to trust.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MaskHead {
    /// No mask at all.
    None,
    /// One sigmoid per source (the PyTorch port).
    #[default]
    Sigmoid,
    /// Two logits per source under a softmax, of which channel 1 means "reliable" (the paper).
    Softmax,
}

impl MaskHead {
    /// Output channels for the given number of sources.
    pub(crate) fn channels(self, sources: usize) -> usize {
        match self {
            Self::None => 0,
            Self::Sigmoid => sources,
            Self::Softmax => 2 * sources,
        }
    }
}

/// Configuration of [`PoseMaskNet`]; the default is the PyTorch port of SfMLearner with its mask.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PoseMaskNetConfig {
    /// Frames per snippet, target included: odd, at least 3. Default 3.
    pub snippet_length: usize,
    /// What the last three numbers of a motion mean. Default Euler angles.
    pub rotation: Rotation,
    /// How reliability is predicted. Default sigmoid.
    pub mask: MaskHead,
    /// Channels after each of the five shared stages. Default 16, 32, 64, 128, 256.
    pub encoder: [usize; 5],
    /// Channels after the two motion stages. Default 256, 256.
    pub motion: [usize; 2],
    /// Channels after each mask stage, coarsest first. Default 256, 128, 64, 32, 16.
    pub mask_decoder: [usize; 5],
    /// Kernels of the mask stages; a head has its stage's kernel if that is odd, else 3. Default 4 throughout (the
    /// port); the original has 3, 3, 3, 5, 7.
    pub mask_kernels: [usize; 5],
    /// Batch normalisation after every layer but the outputs. Default off.
    pub batch_norm: bool,
    /// Padding flavour. Default symmetric.
    pub padding: Padding,
}

impl Default for PoseMaskNetConfig {
    fn default() -> Self {
        Self {
            snippet_length: 3,
            rotation: Rotation::Euler,
            mask: MaskHead::Sigmoid,
            encoder: [16, 32, 64, 128, 256],
            motion: [256, 256],
            mask_decoder: [256, 128, 64, 32, 16],
            mask_kernels: [4; 5],
            batch_norm: false,
            padding: Padding::Symmetric,
        }
    }
}

impl PoseMaskNetConfig {
    /// The same network with every layer's channels multiplied by `width` and rounded, never below one.
    pub fn with_width(mut self, width: f64) -> Self {
        let scale = |channels: usize| ((channels as f64 * width).round() as usize).max(1);
        self.encoder = self.encoder.map(scale);
        self.motion = self.motion.map(scale);
        self.mask_decoder = self.mask_decoder.map(scale);
        self
    }

    /// Neighbours of the target in a snippet.
    pub fn sources(&self) -> usize {
        self.snippet_length.saturating_sub(1)
    }

    /// # Errors
    /// [`NetsError::Config`] when the snippet length is even, below 3 or beyond 31, or a channel count or kernel is
    /// beyond reason.
    pub fn validate(&self) -> Result<(), NetsError> {
        if !(3..=31).contains(&self.snippet_length) || self.snippet_length.is_multiple_of(2) {
            let reason = format!("is {} but must be odd and from 3 to 31", self.snippet_length);
            return Err(NetsError::config("pose.snippet_length", reason));
        }
        check_channels("pose.encoder", &self.encoder)?;
        check_channels("pose.motion", &self.motion)?;
        check_channels("pose.mask_decoder", &self.mask_decoder)?;
        check_kernels("pose.mask_kernels", &self.mask_kernels)
    }

    /// Numbers in the network (mask decoder and running statistics included), known without building it.
    pub fn parameter_count(&self) -> usize {
        self.motion_parameter_count() + self.mask_parameter_count()
    }

    /// Numbers needed to predict motion alone.
    pub fn motion_parameter_count(&self) -> usize {
        let encoder = (0..5).map(|k| parameters(self.encoder_channels(k), ENCODER_KERNELS[k], self.batch_norm));
        let motion = (0..2).map(|k| parameters(self.motion_channels(k), MOTION_KERNEL, self.batch_norm));
        encoder.chain(motion).sum::<usize>() + parameters([self.motion[1], 6 * self.sources()], 1, false)
    }

    fn mask_parameter_count(&self) -> usize {
        if self.mask == MaskHead::None {
            return 0;
        }
        let ups = (0..5).map(|k| parameters(self.up_channels(k), self.mask_kernels[k], self.batch_norm));
        let heads = (0..SCALES).map(|k| parameters(self.head_channels(k), self.head_kernel(k), false));
        ups.chain(heads).sum()
    }

    /// Builds the network with the fresh weights of `seed`.
    ///
    /// # Errors
    /// As [`Self::validate`].
    pub fn init(&self, seed: u64, device: &Device) -> Result<PoseMaskNet, NetsError> {
        self.build(Some(seed), device)
    }

    /// With weights of zero where there is no seed: for those of a file.
    pub(crate) fn build(&self, seed: Option<u64>, device: &Device) -> Result<PoseMaskNet, NetsError> {
        self.validate()?;
        let layers = LayerFactory::new(self.padding, self.batch_norm, seed, device);
        Ok(PoseMaskNet {
            encoder: std::array::from_fn(|k| layers.block(self.encoder_channels(k), ENCODER_KERNELS[k], 2)),
            motion: std::array::from_fn(|k| layers.block(self.motion_channels(k), MOTION_KERNEL, 2)),
            motion_head: layers.conv([self.motion[1], 6 * self.sources()], 1, 1),
            mask: (self.mask != MaskHead::None).then(|| self.init_mask(&layers)),
            sources: self.sources(),
            rotation: self.rotation,
        })
    }

    fn init_mask(&self, layers: &LayerFactory) -> MaskDecoder {
        MaskDecoder {
            ups: std::array::from_fn(|k| layers.up_block(self.up_channels(k), self.mask_kernels[k])),
            heads: std::array::from_fn(|k| layers.conv(self.head_channels(k), self.head_kernel(k), 1)),
            kind: self.mask,
        }
    }

    fn encoder_channels(&self, stage: usize) -> [usize; 2] {
        [if stage == 0 { 3 * self.snippet_length } else { self.encoder[stage - 1] }, self.encoder[stage]]
    }

    fn motion_channels(&self, stage: usize) -> [usize; 2] {
        [if stage == 0 { self.encoder[4] } else { self.motion[stage - 1] }, self.motion[stage]]
    }

    fn up_channels(&self, stage: usize) -> [usize; 2] {
        [if stage == 0 { self.encoder[4] } else { self.mask_decoder[stage - 1] }, self.mask_decoder[stage]]
    }

    fn head_channels(&self, head: usize) -> [usize; 2] {
        [self.mask_decoder[FIRST_MASK_HEAD + head], self.mask.channels(self.sources())]
    }

    fn head_kernel(&self, head: usize) -> usize {
        let kernel = self.mask_kernels[FIRST_MASK_HEAD + head];
        if kernel.is_multiple_of(2) { 3 } else { kernel }
    }
}

/// Predicts the camera motion to each neighbour of a target picture, and where to trust it.
#[derive(Module, Debug)]
pub struct PoseMaskNet {
    pub(crate) encoder: [ConvBlock; 5],
    pub(crate) motion: [ConvBlock; 2],
    pub(crate) motion_head: Conv2d,
    pub(crate) mask: Option<MaskDecoder>,
    pub(crate) sources: usize,
    #[module(skip)]
    pub(crate) rotation: Rotation,
}

/// The half that predicts reliability.
#[derive(Module, Debug)]
pub(crate) struct MaskDecoder {
    pub ups: [UpConvBlock; 5],
    /// Coarsest first.
    pub heads: [Conv2d; SCALES],
    #[module(skip)]
    pub kind: MaskHead,
}

/// What [`PoseMaskNet`] sees in a snippet.
#[derive(Debug, Clone)]
pub struct PoseMask {
    /// `source_from_target` motions, `[batch, sources, 6]`: translation tx ty tz in the unknown unit of the training's
    /// baseline, then three numbers that [`Self::rotation`] interprets; sources in time order.
    pub motion: Tensor<3>,
    /// What the last three numbers of a motion mean.
    pub rotation: Rotation,
    /// Probability that a pixel can be trusted, full size first: scale `l` is
    /// `[batch, sources, ceil(height / 2^l), ceil(width / 2^l)]`; none if the network has no mask.
    pub mask: Option<[Tensor<4>; SCALES]>,
}

impl PoseMaskNet {
    /// Predicts motions and, if the network has a mask, reliability.
    ///
    /// # Shapes
    /// - `target`: `[batch, 3, height, width]`, RGB in [-1, 1], any size
    /// - `sources`: the neighbours in time order, each shaped like `target`
    ///
    /// # Panics
    /// If the number of sources is not the network's.
    pub fn forward(&self, target: Tensor<4>, sources: &[Tensor<4>]) -> PoseMask {
        self.forward_snippet(snippet(target, sources))
    }

    /// Predicts motions alone, which spares the mask decoder.
    ///
    /// # Shapes
    /// As [`Self::forward`]; returns `[batch, sources, 6]`.
    ///
    /// # Panics
    /// If the number of sources is not the network's.
    pub fn forward_motion(&self, target: Tensor<4>, sources: &[Tensor<4>]) -> Tensor<3> {
        let features = self.encode(snippet(target, sources));
        self.predict_motion(&features)
    }

    /// [`Self::forward`] for pictures already concatenated along the channels, target first.
    ///
    /// # Shapes
    /// - `snippet`: `[batch, 3 * (sources + 1), height, width]`, RGB in [-1, 1]
    ///
    /// # Panics
    /// If the number of channels is not the network's.
    pub fn forward_snippet(&self, snippet: Tensor<4>) -> PoseMask {
        let full_size = spatial_size(&snippet);
        let features = self.encode(snippet);
        PoseMask {
            motion: self.predict_motion(&features),
            rotation: self.rotation,
            mask: self.mask.as_ref().map(|decoder| decoder.forward(&features, full_size)),
        }
    }

    /// What the last three numbers of a motion mean.
    pub fn rotation(&self) -> Rotation {
        self.rotation
    }

    /// Neighbours the network expects beside the target.
    pub fn sources(&self) -> usize {
        self.sources
    }

    /// Whether the network predicts reliability.
    pub fn has_mask(&self) -> bool {
        self.mask.is_some()
    }

    /// Features after each shared stage, finest first.
    fn encode(&self, snippet: Tensor<4>) -> [Tensor<4>; 5] {
        let channels = 3 * (self.sources + 1);
        assert_shape!(snippet, [_, channels, _, _]);
        let mut features = snippet;
        self.encoder.each_ref().map(|stage| {
            features = stage.forward(features.clone());
            features.clone()
        })
    }

    fn predict_motion(&self, [.., deepest]: &[Tensor<4>; 5]) -> Tensor<3> {
        let features = self.motion.iter().fold(deepest.clone(), |features, stage| stage.forward(features));
        let motion =
            convolve(&self.motion_head, features, Activation::None).mean_dims(&[2, 3]).mul_scalar(MOTION_SCALE);
        let batch = motion.dims()[0];
        motion.reshape([batch, self.sources, 6])
    }
}

impl MaskDecoder {
    fn forward(&self, features: &[Tensor<4>; 5], full_size: [usize; 2]) -> [Tensor<4>; SCALES] {
        let [skips @ .., deepest] = features;
        let sizes = skips.iter().rev().map(spatial_size).chain([full_size]);
        let mut features = deepest.clone();
        let mut scales = Vec::with_capacity(SCALES);
        for (stage, size) in self.ups.iter().zip(sizes) {
            features = stage.forward(features, size);
            scales.push(features.clone());
        }
        std::array::from_fn(|scale| {
            let features = scales[SCALES - scale].clone();
            self.reliability(convolve(&self.heads[SCALES - 1 - scale], features, Activation::None))
        })
    }

    /// `[batch, sources, height, width]`: the softmax over two logits is the sigmoid of their difference.
    fn reliability(&self, logits: Tensor<4>) -> Tensor<4> {
        if self.kind != MaskHead::Softmax {
            return logistic(logits, 1.0, 0.0);
        }
        let [batch, channels, height, width] = logits.dims();
        let pairs = logits.reshape([batch, channels / 2, 2, height, width]);
        let (doubtful, reliable): (Tensor<5>, Tensor<5>) = (pairs.clone().narrow(2, 0, 1), pairs.narrow(2, 1, 1));
        sigmoid(reliable - doubtful).squeeze_dim(2)
    }
}

/// Target and sources along the channels.
fn snippet(target: Tensor<4>, sources: &[Tensor<4>]) -> Tensor<4> {
    Tensor::cat(std::iter::once(target).chain(sources.iter().cloned()).collect(), 1)
}
