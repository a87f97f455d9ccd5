//! The recurrent network of supervised odometry, after Deep EndoVO (Turan et al. 2017, arXiv 1708.06822) and DeepVO
//! (Wang et al. 2017).
//!
//! Two neighbouring frames stacked along the channels go through two halving convolutions and three Inception blocks
//! (Szegedy et al. 2015), each a bundle of parallel 1x1, 3x3, 5x5 and pooled branches; what is left of the picture is
//! averaged to a small grid and summarised. Two LSTM layers carry what was seen before, and a linear layer gives the
//! motion. The originals are GPU-sized; the default here is slim enough to be trained on two processor cores.
//!
//! One pair after another with the state handed on gives what all of them at once give: [`RecurrentVo::forward`] is
//! training and streaming alike.

use crate::config::{check_channels, toml_error};
use crate::error::NetsError;
use crate::layers::{ConvBlock, LayerFactory, Padding, spatial_size};
use burn::module::{Initializer, Module, Param};
use burn::nn::{GateController, Linear, LinearConfig, Lstm, LstmConfig, LstmState};
use burn::tensor::activation::relu;
use burn::tensor::module::{adaptive_avg_pool2d, max_pool2d};
use burn::tensor::ops::MaxPoolOptions;
use burn::tensor::{Device, Tensor, TensorData, assert_shape};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};
use serde::{Deserialize, Serialize};

/// Kernels of the two halving convolutions.
const STEM_KERNELS: [usize; 2] = [7, 5];
/// Frames of a pair.
const PAIR: usize = 2;
/// Numbers of a motion.
const MOTION: usize = 6;
/// Radians that one unit of the last layer's rotation numbers stands for: under the usual rotation weight of 100 an
/// error of one unit then costs as much in rotation as in translation.
const ROTATION_UNIT_RAD: f64 = 0.1;
/// Stream of the seed's generator that the layers after the convolutions are drawn from.
const LINEAR_STREAM: u64 = 1;

/// Configuration of [`RecurrentVo`], saved as `config.toml` in its checkpoint folder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecurrentVoConfig {
    /// Channels after the two halving convolutions. Default 24, 48.
    pub stem: [usize; 2],
    /// Channels of the branches of each Inception block: 1x1, 3x3, 5x5, pooled. Default 16, 24, 16, 8 in the first,
    /// half as many again and twice as many in the others.
    pub blocks: [[usize; 4]; 3],
    /// Rows and columns that the last features are averaged to. Default 4.
    pub grid: usize,
    /// Numbers that summarise a pair, and numbers in the state of each LSTM layer. Default 128.
    pub hidden: usize,
    /// Length of the network's unit of translation, metres: the mean step of the training. Default 1.
    pub unit_m: f64,
}

impl Default for RecurrentVoConfig {
    fn default() -> Self {
        Self {
            stem: [24, 48],
            blocks: [[16, 24, 16, 8], [24, 36, 24, 12], [32, 48, 32, 16]],
            grid: 4,
            hidden: 128,
            unit_m: 1.0,
        }
    }
}

impl RecurrentVoConfig {
    /// # Errors
    /// [`NetsError::Config`] naming the setting no network can be built from.
    pub fn validate(&self) -> Result<(), NetsError> {
        check_channels("stem", &self.stem)?;
        self.blocks.iter().try_for_each(|block| check_channels("blocks", block))?;
        check_channels("hidden", &[self.hidden])?;
        if !(1..=32).contains(&self.grid) {
            return Err(NetsError::config("grid", format!("is {} but must be from 1 to 32", self.grid)));
        }
        if !(self.unit_m > 0.0 && self.unit_m.is_finite()) {
            return Err(NetsError::config("unit_m", format!("is {} but must be a length above 0", self.unit_m)));
        }
        Ok(())
    }

    /// The TOML form of the configuration.
    ///
    /// # Errors
    /// [`NetsError::Config`] when a number has no TOML form.
    pub fn to_toml(&self) -> Result<String, NetsError> {
        toml::to_string(self).map_err(|error| NetsError::config("config", format!("cannot be written: {error}")))
    }

    /// Reads and validates the TOML form; settings left out keep their defaults.
    ///
    /// # Errors
    /// [`NetsError::Config`] naming the line or setting that is wrong.
    pub fn from_toml(text: &str) -> Result<Self, NetsError> {
        let config: Self = toml::from_str(text).map_err(|error| toml_error(&error, text))?;
        config.validate()?;
        Ok(config)
    }

    /// Numbers in the network, known without building it.
    pub fn parameter_count(&self) -> usize {
        let convolution = |channels: [usize; 2], kernel: usize| (channels[0] * kernel * kernel + 1) * channels[1];
        let linear = |channels: [usize; 2]| (channels[0] + 1) * channels[1];
        let stem = (0..2).map(|stage| convolution(self.stem_channels(stage), STEM_KERNELS[stage]));
        let blocks = (0..3).map(|stage| {
            let (input, [one, three, five, pooled]) = (self.block_input(stage), self.blocks[stage]);
            let narrow = |branch: usize, kernel: usize| {
                convolution([input, reduced(branch)], 1) + convolution([reduced(branch), branch], kernel)
            };
            convolution([input, one + pooled], 1) + narrow(three, 3) + narrow(five, 5)
        });
        let lstm = 2 * 4 * 2 * linear([self.hidden; 2]);
        stem.chain(blocks).sum::<usize>()
            + linear([self.features(), self.hidden])
            + lstm
            + linear([self.hidden, MOTION])
    }

    /// Builds the network with the fresh weights of `seed`.
    ///
    /// # Errors
    /// As [`Self::validate`].
    pub fn init(&self, seed: u64, device: &Device) -> Result<RecurrentVo, NetsError> {
        self.validate()?;
        let layers = LayerFactory::new(Padding::Symmetric, false, Some(seed), device);
        let mut numbers = ChaCha8Rng::seed_from_u64(seed);
        numbers.set_stream(LINEAR_STREAM);
        Ok(RecurrentVo {
            stem: std::array::from_fn(|stage| layers.block(self.stem_channels(stage), STEM_KERNELS[stage], 2)),
            blocks: std::array::from_fn(|stage| {
                InceptionBlock::new(&layers, self.block_input(stage), self.blocks[stage])
            }),
            summary: linear([self.features(), self.hidden], &mut numbers, device),
            memory: std::array::from_fn(|_| lstm(self.hidden, &mut numbers, device)),
            motion: linear([self.hidden, MOTION], &mut numbers, device),
            grid: self.grid,
        })
    }

    fn stem_channels(&self, stage: usize) -> [usize; 2] {
        [if stage == 0 { 3 * PAIR } else { self.stem[0] }, self.stem[stage]]
    }

    fn block_input(&self, stage: usize) -> usize {
        if stage == 0 { self.stem[1] } else { self.blocks[stage - 1].iter().sum() }
    }

    fn features(&self) -> usize {
        self.blocks[2].iter().sum::<usize>() * self.grid * self.grid
    }
}

/// Channels in front of a 3x3 or 5x5 branch: half of what it gives.
fn reduced(branch: usize) -> usize {
    branch.div_ceil(2)
}

/// A linear layer, Xavier-uniform with zero bias, drawn from a generator of our own: that of a device is shared by the
/// whole process.
fn linear(channels: [usize; 2], numbers: &mut ChaCha8Rng, device: &Device) -> Linear {
    let [from, to] = channels;
    let layer = LinearConfig::new(from, to).with_initializer(Initializer::Zeros).init(device);
    Linear { weight: xavier(channels, numbers, device), ..layer }
}

fn xavier(shape: [usize; 2], numbers: &mut ChaCha8Rng, device: &Device) -> Param<Tensor<2>> {
    let bound = (6.0 / shape.iter().sum::<usize>() as f64).sqrt() as f32;
    let weights = (0..shape.iter().product()).map(|_| bound * (2.0 * numbers.random::<f32>() - 1.0)).collect();
    Param::from_data(TensorData::new::<f32, _>(weights, shape), device)
}

/// An LSTM layer as wide as its input. The forget gate begins open (bias 1), so that memory is there to be learned from
/// (Jozefowicz et al. 2015).
fn lstm(hidden: usize, numbers: &mut ChaCha8Rng, device: &Device) -> Lstm {
    let mut layer = LstmConfig::new(hidden, hidden, true).with_initializer(Initializer::Zeros).init(device);
    let mut draw = |gate: &mut GateController| {
        gate.input_transform.weight = xavier([hidden; 2], numbers, device);
        gate.hidden_transform.weight = xavier([hidden; 2], numbers, device);
    };
    draw(&mut layer.input_gate);
    draw(&mut layer.output_gate);
    draw(&mut layer.cell_gate);
    if let Some(gate) = &mut layer.forget_gate {
        draw(gate);
        gate.input_transform.bias = Some(Initializer::Ones.init([hidden], device));
    }
    layer
}

/// Regresses the camera's motion from pairs of neighbouring frames, with a memory of the pairs before.
#[derive(Module, Debug)]
pub struct RecurrentVo {
    stem: [ConvBlock; 2],
    blocks: [InceptionBlock; 3],
    summary: Linear,
    memory: [Lstm; 2],
    motion: Linear,
    grid: usize,
}

/// What the network remembers of the pairs before: the state of both LSTM layers, each `[batch, hidden]`.
#[derive(Debug, Clone)]
pub struct Memory([LstmState<2>; 2]);

impl Memory {
    /// The same numbers cut off from what made them: gradients end here (truncated back-propagation through time).
    pub fn detached(self) -> Self {
        Self(self.0.map(|state| LstmState::new(state.cell.detach(), state.hidden.detach())))
    }
}

impl RecurrentVo {
    /// Motions of pairs in time order, and the memory to go on with; `None` begins without any.
    ///
    /// # Shapes
    /// - `pairs`: `[batch, time, 6, height, width]`, the earlier frame's RGB then the later's, in [-1, 1], any size
    /// - returns: `[batch, time, 6]`: `previous_from_current`, translation in the network's unit
    ///   ([`RecurrentVoConfig::unit_m`]), then rotation as axis times angle in radians
    pub fn forward(&self, pairs: Tensor<5>, memory: Option<Memory>) -> (Tensor<3>, Memory) {
        let channels = 3 * PAIR;
        assert_shape!(pairs, [_, _, channels, _, _]);
        let [batch, time, _, height, width] = pairs.dims();
        let features = self.features(pairs.reshape([batch * time, channels, height, width]));
        let features = relu(self.summary.forward(features));
        let [hidden, _] = self.motion.weight.dims();
        let [first, second] = memory.map_or([None, None], |Memory(states)| states.map(Some));
        let (features, first) = self.memory[0].forward(features.reshape([batch, time, hidden]), first);
        let (features, second) = self.memory[1].forward(features, second);
        let motion = self.motion.forward(features);
        let (translation, rotation) = (motion.clone().narrow(2, 0, 3), motion.narrow(2, 3, 3));
        (Tensor::cat(vec![translation, rotation.mul_scalar(ROTATION_UNIT_RAD)], 2), Memory([first, second]))
    }

    /// `[batch, 6, height, width]` to `[batch, features]`.
    fn features(&self, pairs: Tensor<4>) -> Tensor<2> {
        let seen = self.stem.iter().fold(pairs, |features, stage| stage.forward(features));
        let seen = self.blocks.iter().fold(seen, |features, block| halved(block.forward(&features)));
        adaptive_avg_pool2d(seen, [self.grid; 2]).flatten(1, 3)
    }
}

/// The largest of every 3x3 neighbourhood, at every second place; a single row or column stays.
fn halved(features: Tensor<4>) -> Tensor<4> {
    let stride = spatial_size(&features).map(|extent| if extent > 1 { 2 } else { 1 });
    max_pool2d(features, MaxPoolOptions::new([3, 3]).with_stride(stride).with_padding([1, 1]))
}

/// Parallel branches of different reach over the same features, side by side in the result; the wide ones see fewer
/// channels, which a 1x1 convolution makes for them.
#[derive(Module, Debug)]
struct InceptionBlock {
    one: ConvBlock,
    three: [ConvBlock; 2],
    five: [ConvBlock; 2],
    pooled: ConvBlock,
}

impl InceptionBlock {
    fn new(layers: &LayerFactory, input: usize, [one, three, five, pooled]: [usize; 4]) -> Self {
        let narrow = |branch: usize, kernel: usize| {
            [layers.block([input, reduced(branch)], 1, 1), layers.block([reduced(branch), branch], kernel, 1)]
        };
        Self {
            one: layers.block([input, one], 1, 1),
            three: narrow(three, 3),
            five: narrow(five, 5),
            pooled: layers.block([input, pooled], 1, 1),
        }
    }

    /// # Shapes
    /// - `features`: `[batch, channels_in, height, width]`
    /// - returns: `[batch, sum of the branches' channels, height, width]`
    fn forward(&self, features: &Tensor<4>) -> Tensor<4> {
        let narrow = |[reduce, widen]: &[ConvBlock; 2]| widen.forward(reduce.forward(features.clone()));
        let around = MaxPoolOptions::new([3, 3]).with_stride([1, 1]).with_padding([1, 1]);
        // The original takes the maximum first; over the fewer channels after the convolution it costs a sixth.
        let pooled = max_pool2d(self.pooled.forward(features.clone()), around);
        Tensor::cat(vec![self.one.forward(features.clone()), narrow(&self.three), narrow(&self.five), pooled], 1)
    }
}

#[cfg(test)]
mod tests;
