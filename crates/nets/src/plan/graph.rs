//! Layers in the order of their computation, over buffers that are allocated once.
//!
//! A value is a run of channels of a buffer. Layers write where the next one reads: what the network concatenates is
//! computed side by side into one buffer and never copied.

use crate::conv;
use crate::error::NetsError;
use crate::folding::{Kernel, folded};
use crate::layers::{ConvBlock, UpConvBlock};
use burn::nn::conv::Conv2d;
use burn::tensor::ExecutionError;
use endoscape_kernels::{Correlation, Epilogue, Geometry, Level, PackedWeights, Workspace, enlarge};
use std::ops::Range;

/// A run of channels of a buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Value {
    buffer: usize,
    first_channel: usize,
    pub channels: usize,
    /// Rows and columns.
    pub size: [usize; 2],
}

impl Value {
    /// Some of the channels.
    pub fn channels(self, range: Range<usize>) -> Self {
        Self { first_channel: self.first_channel + range.start, channels: range.len(), ..self }
    }

    fn range(self) -> Range<usize> {
        let area = self.size[0] * self.size[1];
        self.first_channel * area..(self.first_channel + self.channels) * area
    }
}

/// One step of the computation.
#[derive(Debug)]
enum Step {
    Convolve {
        correlation: Box<Correlation>,
        weights: PackedWeights,
        bias: Vec<f32>,
        relu: bool,
    },
    /// Twice the size, bilinearly, cut to the size of the output.
    Enlarge,
    /// Of each pair of channels, the second minus the first.
    SubtractPairs,
    /// `scale * sigmoid(x) + offset`, in place.
    Squash {
        scale: f32,
        offset: f32,
    },
}

/// A network without branches that depend on its input.
#[derive(Debug, Default)]
pub struct Graph {
    buffers: Vec<Vec<f32>>,
    steps: Vec<(Step, Value, Value)>,
    workspace: Workspace,
}

impl Graph {
    /// A new buffer.
    pub fn buffer(&mut self, channels: usize, size: [usize; 2]) -> Value {
        self.buffers.push(vec![0.0; channels * size[0] * size[1]]);
        Value { buffer: self.buffers.len() - 1, first_channel: 0, channels, size }
    }

    /// Convolution, normalisation, ReLU.
    pub fn block(&mut self, block: &ConvBlock, from: Value, to: Value) -> Result<(), NetsError> {
        let bias = block.conv.bias.as_ref().map(|bias| bias.val());
        let kernel =
            folded(block.conv.weight.val(), bias, block.norm.as_ref(), 0).map_err(|error| unreadable(&error))?;
        let geometry = conv::geometry_of(&block.conv, from.size);
        self.convolve(geometry, Correlation::to_small, kernel, true, [from, to])
    }

    /// Transposed convolution, normalisation, ReLU, cut to the size of `to`.
    pub fn up_block(&mut self, block: &UpConvBlock, from: Value, to: Value) -> Result<(), NetsError> {
        let bias = block.conv.bias.as_ref().map(|bias| bias.val());
        let kernel =
            folded(block.conv.weight.val(), bias, block.norm.as_ref(), 1).map_err(|error| unreadable(&error))?;
        let geometry = conv::up_geometry_of(&block.conv, from.size, to.size);
        self.convolve(geometry, Correlation::to_large, kernel, true, [from, to])
    }

    /// A bare convolution.
    pub fn conv(&mut self, layer: &Conv2d, from: Value, to: Value) -> Result<(), NetsError> {
        let bias = layer.bias.as_ref().map(|bias| bias.val());
        let kernel = folded(layer.weight.val(), bias, None, 0).map_err(|error| unreadable(&error))?;
        self.convolve(conv::geometry_of(layer, from.size), Correlation::to_small, kernel, false, [from, to])
    }

    fn convolve(
        &mut self,
        geometry: Option<Geometry>,
        direction: fn(&Geometry, Level) -> Correlation,
        kernel: Kernel,
        relu: bool,
        [from, to]: [Value; 2],
    ) -> Result<(), NetsError> {
        let unknown = || NetsError::config("size", format!("is too small for a kernel of {}", kernel.dims[2]));
        let correlation = Box::new(direction(&geometry.ok_or_else(unknown)?, Level::default()));
        let weights = correlation.pack(&kernel.weight);
        self.steps.push((Step::Convolve { correlation, weights, bias: kernel.bias, relu }, from, to));
        Ok(())
    }

    /// Twice the size, pixel areas aligned.
    pub fn enlarge(&mut self, from: Value, to: Value) {
        self.steps.push((Step::Enlarge, from, to));
    }

    /// Of each pair of channels, the second minus the first.
    pub fn subtract_pairs(&mut self, from: Value, to: Value) {
        self.steps.push((Step::SubtractPairs, from, to));
    }

    /// `scale * sigmoid(x) + offset`, in place.
    pub fn squash(&mut self, value: Value, scale: f64, offset: f64) {
        self.steps.push((Step::Squash { scale: scale as f32, offset: offset as f32 }, value, value));
    }

    /// The numbers of a value.
    pub fn values(&self, value: Value) -> &[f32] {
        &self.buffers[value.buffer][value.range()]
    }

    /// The numbers of a value, to be written.
    pub fn values_mut(&mut self, value: Value) -> &mut [f32] {
        &mut self.buffers[value.buffer][value.range()]
    }

    /// Computes every step.
    pub fn run(&mut self) {
        // On a thread of the pool: handing every layer over from outside takes longer than a small layer.
        rayon::scope(|_| self.run_steps());
    }

    fn run_steps(&mut self) {
        let Self { buffers, steps, workspace } = self;
        for (step, from, to) in steps {
            let mut output = std::mem::take(&mut buffers[to.buffer]);
            let written = &mut output[to.range()];
            match step {
                Step::Convolve { correlation, weights, bias, relu } => {
                    let epilogue = Epilogue { bias: Some(bias), relu: *relu };
                    correlation.run(&buffers[from.buffer][from.range()], weights, epilogue, written, workspace);
                }
                Step::Enlarge => enlarge(&buffers[from.buffer][from.range()], from.size, written, to.size),
                Step::SubtractPairs => {
                    let area = from.size[0] * from.size[1];
                    let pairs = buffers[from.buffer][from.range()].chunks_exact(2 * area);
                    for (difference, pair) in written.chunks_exact_mut(area).zip(pairs) {
                        let (first, second) = pair.split_at(area);
                        let values = difference.iter_mut().zip(first).zip(second);
                        values.for_each(|((difference, first), second)| *difference = second - first);
                    }
                }
                Step::Squash { scale, offset } => {
                    written.iter_mut().for_each(|value| *value = *scale / (1.0 + (-*value).exp()) + *offset);
                }
            }
            buffers[to.buffer] = output;
        }
    }
}

fn unreadable(error: &ExecutionError) -> NetsError {
    NetsError::config("weights", format!("cannot be read from the device: {error:?}"))
}
