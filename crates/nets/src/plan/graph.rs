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
use endoscape_kernels::{Correlation, Epilogue, Geometry, Level, PackedWeights, Workspace, awake, enlarge};
use std::ops::Range;
use std::time::{Duration, Instant};

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
    /// What the network reads, which stays where it is: a run is given it.
    pub fn input(&mut self, channels: usize, size: [usize; 2]) -> Value {
        self.buffers.push(Vec::new());
        Value { buffer: self.buffers.len() - 1, first_channel: 0, channels, size }
    }

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

    /// Computes every step from the numbers of the input.
    ///
    /// # Panics
    /// If they are not as many as the input has.
    pub fn run(&mut self, input: Value, numbers: &[f32]) {
        self.run_observed(input, numbers, |_, _| ());
    }

    /// Computes every step and says how long each took.
    ///
    /// # Panics
    /// As [`Self::run`].
    pub fn profile(&mut self, input: Value, numbers: &[f32]) -> Vec<StepTime> {
        let mut times = Vec::with_capacity(self.steps.len());
        let mut mark = Instant::now();
        self.run_observed(input, numbers, |step, to| {
            let now = Instant::now();
            times.push(StepTime::new(step, to, now - mark));
            mark = now;
        });
        times
    }

    fn run_observed(&mut self, input: Value, numbers: &[f32], mut observe: impl FnMut(&Step, Value) + Send) {
        assert_eq!(numbers.len(), input.range().len(), "numbers of the input");
        let Self { buffers, steps, workspace } = self;
        awake(|| {
            for (step, from, to) in steps {
                // Nothing is computed in place but by `Squash`, whose output is its input.
                let mut output = std::mem::take(&mut buffers[to.buffer]);
                let source = if from.buffer == input.buffer { numbers } else { &buffers[from.buffer] };
                step.run(source, *from, &mut output[to.range()], to.size, workspace);
                buffers[to.buffer] = output;
                observe(step, *to);
            }
        });
    }
}

impl Step {
    /// Computes `written` from the value `from` of a buffer.
    fn run(&self, buffer: &[f32], from: Value, written: &mut [f32], size: [usize; 2], workspace: &mut Workspace) {
        let area = from.size[0] * from.size[1];
        match self {
            Self::Convolve { correlation, weights, bias, relu } => {
                let epilogue = Epilogue { bias: Some(bias), relu: *relu };
                correlation.run(&buffer[from.range()], weights, epilogue, written, workspace);
            }
            Self::Enlarge => enlarge(&buffer[from.range()], from.size, written, size),
            Self::SubtractPairs => {
                let pairs = buffer[from.range()].chunks_exact(2 * area);
                for (difference, pair) in written.chunks_exact_mut(area).zip(pairs) {
                    let (first, second) = pair.split_at(area);
                    let values = difference.iter_mut().zip(first).zip(second);
                    values.for_each(|((difference, first), second)| *difference = second - first);
                }
            }
            Self::Squash { scale, offset } => {
                written.iter_mut().for_each(|value| *value = *scale / (1.0 + (-*value).exp()) + *offset);
            }
        }
    }
}

/// What one step of a plan took.
#[derive(Debug, Clone, PartialEq)]
pub struct StepTime {
    /// What it computes, and how.
    pub name: String,
    /// Rows and columns of its output.
    pub size: [usize; 2],
    /// Multiplications and additions of a convolution computed directly, those with padding included; 0 for others.
    pub operations: usize,
    /// How long it took.
    pub seconds: f64,
}

impl StepTime {
    fn new(step: &Step, to: Value, time: Duration) -> Self {
        let (name, operations) = match step {
            Step::Convolve { correlation, .. } => {
                let Geometry { kernel, stride, large_channels, small_channels, .. } = *correlation.geometry();
                let inputs = large_channels + small_channels - to.channels;
                let method = correlation.method();
                let name = format!("{kernel}x{kernel}/{stride}, {inputs} to {} channels, {method:?}", to.channels);
                (name, correlation.geometry().operations())
            }
            Step::Enlarge => ("enlarge".to_owned(), 0),
            Step::SubtractPairs => ("subtract pairs".to_owned(), 0),
            Step::Squash { .. } => ("sigmoid".to_owned(), 0),
        };
        Self { name, size: to.size, operations, seconds: time.as_secs_f64() }
    }
}

fn unreadable(error: &ExecutionError) -> NetsError {
    NetsError::config("weights", format!("cannot be read from the device: {error:?}"))
}
