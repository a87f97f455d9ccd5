//! The alignment network: the motion that is left between a picture and a neighbour rebuilt to look like it.
//!
//! [`PoseMaskNet`](crate::PoseMaskNet) sees pictures as they are and has to know what a motion looks like at every depth;
//! from a few recordings it learns how the camera moved where. This network sees what is wrong with a motion: evidence of
//! the difference between the target and the source rebuilt by that motion, which vanishes where the motion is right
//! (`endoscape-synthesis`, `alignment`, makes it). It looks several times, each time after rebuilding by its own last
//! answer, as render-and-compare methods do (Li et al., DeepIM, ECCV 2018).
//!
//! Five halving convolutions, the means over a grid of 4 x 5 areas of the picture, and one linear layer.

use crate::config::check_channels;
use crate::error::NetsError;
use crate::layers::{ConvBlock, LayerFactory, Padding, parameters, spatial_size};
use burn::module::{Initializer, Module};
use burn::nn::{Linear, LinearConfig};
use burn::tensor::{Device, Tensor, TensorData, assert_shape};
use serde::{Deserialize, Serialize};

/// Channels of evidence the network reads.
pub const EVIDENCE_CHANNELS: usize = 17;

/// Rows and columns of areas over which features are averaged: what a picture of 160x128 has left after five halvings.
const GRID: [usize; 2] = [4, 5];
const KERNELS: [usize; 5] = [5, 3, 3, 3, 3];

/// What a one in the network's output means: a tenth of the distance to the scene, and 0.03 radians. Either moves a
/// picture by some hundredths of its width.
const MOTION_SCALE: [f32; 6] = [0.1, 0.1, 0.1, 0.03, 0.03, 0.03];

/// Configuration of [`AlignNet`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AlignNetConfig {
    /// Channels after each halving. Default 16, 24, 48, 64, 96: enough to be trained in minutes on two cores.
    pub encoder: [usize; 5],
}

impl Default for AlignNetConfig {
    fn default() -> Self {
        Self { encoder: [16, 24, 48, 64, 96] }
    }
}

impl AlignNetConfig {
    /// # Errors
    /// [`NetsError::Config`] for a channel count beyond reason.
    pub fn validate(&self) -> Result<(), NetsError> {
        check_channels("align.encoder", &self.encoder)
    }

    /// Numbers in the network, known without building it.
    pub fn parameter_count(&self) -> usize {
        let encoder: usize = (0..5).map(|stage| parameters(self.channels(stage), KERNELS[stage], false)).sum();
        encoder + parameters([self.features(), 6], 1, false)
    }

    /// Builds the network with the fresh weights of `seed`; its first answer is that nothing is left to move.
    ///
    /// # Errors
    /// As [`Self::validate`].
    pub fn init(&self, seed: u64, device: &Device) -> Result<AlignNet, NetsError> {
        self.build(Some(seed), device)
    }

    /// With weights of zero where there is no seed: for those of a file.
    pub(crate) fn build(&self, seed: Option<u64>, device: &Device) -> Result<AlignNet, NetsError> {
        self.validate()?;
        let layers = LayerFactory::new(Padding::Symmetric, false, seed, device);
        Ok(AlignNet {
            encoder: std::array::from_fn(|stage| layers.block(self.channels(stage), KERNELS[stage], 2)),
            head: LinearConfig::new(self.features(), 6).with_initializer(Initializer::Zeros).init(device),
        })
    }

    fn channels(&self, stage: usize) -> [usize; 2] {
        [if stage == 0 { EVIDENCE_CHANNELS } else { self.encoder[stage - 1] }, self.encoder[stage]]
    }

    /// Numbers that the linear layer reads.
    fn features(&self) -> usize {
        self.encoder[4] * GRID[0] * GRID[1]
    }
}

/// Says from the evidence against a motion what motion is left.
#[derive(Module, Debug)]
pub struct AlignNet {
    pub(crate) encoder: [ConvBlock; 5],
    pub(crate) head: Linear,
}

impl AlignNet {
    /// The motion from the source as rebuilt to the source as it is: translation in typical depths of the target, then
    /// rotation as axis times angle, both in the source's camera frame.
    ///
    /// # Shapes
    /// - `evidence`: `[batch, EVIDENCE_CHANNELS, height, width]`
    /// - returns: `[batch, 6]`
    pub fn forward(&self, evidence: Tensor<4>) -> Tensor<2> {
        assert_shape!(evidence, [_, EVIDENCE_CHANNELS, _, _]);
        let features = self.encoder.iter().fold(evidence, |features, stage| stage.forward(features));
        let motion = self.head.forward(area_mean(features).flatten(1, 3));
        let scale =
            Tensor::<2>::from_data(TensorData::new(MOTION_SCALE.to_vec(), [1, 6]), (&motion.device(), motion.dtype()));
        motion * scale
    }
}

/// Means over [`GRID`] areas of a picture, by products of matrices.
///
/// # Shapes
/// - `features`: `[batch, channels, height, width]`
/// - returns: `[batch, channels, GRID[0], GRID[1]]`
fn area_mean(features: Tensor<4>) -> Tensor<4> {
    let from = spatial_size(&features);
    if from == GRID {
        return features;
    }
    let [rows, columns] = [0, 1].map(|axis| {
        let weights = TensorData::new(area_means(from[axis], GRID[axis]), [1, 1, GRID[axis], from[axis]]);
        Tensor::<4>::from_data(weights, (&features.device(), features.dtype()))
    });
    rows.matmul(features).matmul(columns.transpose())
}

/// The matrix that averages a line over `to` areas of equal length; pixels that lie in two count in both by their share.
///
/// # Shapes
/// - returns: `[to, from]`
fn area_means(from: usize, to: usize) -> Vec<f64> {
    let length = from as f64 / to as f64;
    let share = move |area: usize, pixel: usize| {
        let (start, end) = (area as f64 * length, (area + 1) as f64 * length);
        (end.min((pixel + 1) as f64) - start.max(pixel as f64)).max(0.0) / length
    };
    (0..to).flat_map(|area| (0..from).map(move |pixel| share(area, pixel))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::Distribution;

    #[test]
    fn nothing_is_left_before_anything_is_learned() {
        let device = Device::flex();
        let net = AlignNetConfig::default().init(0, &device).unwrap();
        for [height, width] in [[128, 160], [33, 47], [1, 1]] {
            let evidence = Tensor::random([2, EVIDENCE_CHANNELS, height, width], Distribution::Default, &device);
            let motion = net.forward(evidence);
            assert_eq!(motion.dims(), [2, 6]);
            assert_eq!(motion.abs().max().into_scalar::<f32>(), 0.0);
        }
    }

    #[test]
    fn the_count_of_parameters_is_that_of_the_network() {
        let config = AlignNetConfig { encoder: [3, 4, 5, 6, 7] };
        assert_eq!(config.init(0, &Device::flex()).unwrap().num_params(), config.parameter_count());
    }

    #[test]
    fn areas_are_averaged_whatever_the_size() {
        let device = Device::flex();
        for [height, width] in [[8, 10], [5, 7], [2, 3]] {
            let constant = Tensor::<4>::ones([1, 1, height, width], &device) * 3.0;
            let difference = (area_mean(constant) - 3.0).abs().max().into_scalar::<f32>();
            assert!(difference < 1e-6, "{height}x{width}: {difference}");
        }
        // By hand: 10 columns to 5, pairs; 8 rows to 4, pairs. The ramp over columns has means 0.5, 2.5, ...
        let ramp = Tensor::<1>::from_floats([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0], &device);
        let means: Vec<f32> = area_mean(ramp.reshape([1, 1, 1, 10]).repeat_dim(2, 8)).into_data().iter().collect();
        assert_eq!(means[..5], [0.5, 2.5, 4.5, 6.5, 8.5]);
    }
}
