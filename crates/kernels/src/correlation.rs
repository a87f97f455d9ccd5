//! The products that make a picture: every output pixel is a sum over input channels and taps.
//!
//! Both directions of a convolution become the same loop. The input is laid out with zeros around it (`planes.rs`), so
//! that a tap is a constant offset; then channels of the output are computed a panel at a time, and pixels a tile at a
//! time (`tile.rs`), each sum in registers from its first product to its last. Going from the small to the large
//! picture with stride 2, output pixels of even and odd rows and columns see different taps: they are four passes over
//! the same input, whose results are interleaved when they are stored.

mod task;

use crate::geometry::Geometry;
use crate::level::Level;
use crate::planes::Planes;
use rayon::prelude::*;
use std::ops::Range;

/// What happens to a sum before it is stored.
#[derive(Clone, Copy, Debug, Default)]
pub struct Epilogue<'a> {
    /// Added to each channel.
    pub bias: Option<&'a [f32]>,
    /// Whether negative results become zero.
    pub relu: bool,
}

/// Memory that is used again from call to call.
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    planes: Vec<f32>,
}

/// Weights in the order in which a [`Correlation`] reads them.
#[derive(Clone, Debug)]
pub struct PackedWeights {
    panels: Vec<Panel>,
    values: Vec<f32>,
}

/// Output channels computed side by side, and their weights: for each pass, `[input channel][tap][channel]`.
#[derive(Clone, Debug)]
struct Panel {
    channels: Range<usize>,
    /// How many channels the innermost loop computes; beyond those of the panel the weights are zero.
    width: usize,
    /// Where the weights of each pass begin.
    starts: Vec<usize>,
}

/// A tap: its place in the kernel and the offset of the pixel it sees.
#[derive(Clone, Copy, Debug)]
struct Tap {
    index: usize,
    offset: usize,
}

/// One direction of a convolution, prepared for its sizes.
#[derive(Clone, Debug)]
pub struct Correlation {
    level: Level,
    geometry: Geometry,
    towards_large: bool,
    source: Planes,
    /// Channels of the output, and its rows and columns.
    channels: usize,
    size: [usize; 2],
    /// Output pixels per position and direction: 1, or 2 towards the large picture of a stride of 2.
    spread: usize,
    /// Positions: rows and columns.
    grid: [usize; 2],
    /// For each of the `spread * spread` output pixels of a position, which taps it sees.
    taps: Vec<Vec<Tap>>,
    offsets: Vec<Vec<usize>>,
}

impl Correlation {
    /// From the large to the small picture: a convolution, or the data gradient of a transposed one.
    pub fn to_small(geometry: &Geometry, level: Level) -> Self {
        let Geometry { kernel, stride, before, large, small, large_channels, small_channels } = *geometry;
        let reach = (kernel - 1) / stride;
        let source = Planes::new(large_channels, large, before, stride, [small[0] + reach, small[1] + reach]);
        let tap = |index: usize| Tap { index, offset: source.offset(index / kernel, index % kernel) };
        let taps = vec![(0..geometry.taps()).map(tap).collect()];
        Self::new(*geometry, level, false, source, taps, (small_channels, small, 1))
    }

    /// From the small to the large picture: a transposed convolution, or the data gradient of a convolution.
    pub fn to_large(geometry: &Geometry, level: Level) -> Self {
        let Geometry { kernel, stride, before, large, small, large_channels, small_channels } = *geometry;
        // `large[s q + r]` sees `small[q + d]` through the tap `r + before - s d`.
        let lowest = before.map(|before| (kernel - 1).saturating_sub(before).div_ceil(stride));
        let highest = before.map(|before| before.div_ceil(stride));
        let grid = large.map(|length| length.div_ceil(stride));
        let extent = [0, 1].map(|axis| grid[axis] + lowest[axis] + highest[axis]);
        let source = Planes::new(small_channels, small, lowest, 1, extent);
        let step = |axis: usize, phase: usize, tap: usize| {
            let ahead = (phase + before[axis] + stride * lowest[axis]).checked_sub(tap)?;
            ahead.is_multiple_of(stride).then_some(ahead / stride)
        };
        let tap = |phase: [usize; 2], index: usize| {
            let (row, column) = (step(0, phase[0], index / kernel)?, step(1, phase[1], index % kernel)?);
            Some(Tap { index, offset: source.offset(row, column) })
        };
        let seen = |pass: usize| {
            let phase = [pass / stride, pass % stride];
            (0..geometry.taps()).filter_map(|index| tap(phase, index)).collect()
        };
        let taps = (0..stride * stride).map(seen).collect();
        Self::new(*geometry, level, true, source, taps, (large_channels, large, stride))
    }

    fn new(
        geometry: Geometry,
        level: Level,
        towards_large: bool,
        source: Planes,
        taps: Vec<Vec<Tap>>,
        (channels, size, spread): (usize, [usize; 2], usize),
    ) -> Self {
        assert!(matches!(geometry.stride, 1 | 2), "strides are 1 or 2");
        let grid = size.map(|length| length.div_ceil(spread));
        let offsets = taps.iter().map(|taps| taps.iter().map(|tap| tap.offset).collect()).collect();
        Self { level, geometry, towards_large, source, channels, size, spread, grid, taps, offsets }
    }

    /// Brings weights, `[small channels, large channels, kernel, kernel]`, into the order they are read in.
    ///
    /// # Panics
    /// If their number is not the geometry's.
    pub fn pack(&self, weights: &[f32]) -> PackedWeights {
        let mut packed = PackedWeights { panels: Vec::new(), values: Vec::new() };
        self.pack_into(weights, &mut packed);
        packed
    }

    /// As [`Self::pack`], into memory that is used again.
    ///
    /// # Panics
    /// If the number of weights is not the geometry's.
    pub fn pack_into(&self, weights: &[f32], packed: &mut PackedWeights) {
        assert_eq!(weights.len(), self.geometry.weights(), "weights of {:?}", self.geometry);
        packed.panels = self.panels();
        let ends: Vec<usize> = packed.panels.iter().map(|panel| panel.end(self)).collect();
        packed.values.resize(ends.last().copied().unwrap_or(0), 0.0);
        let mut rest = packed.values.as_mut_slice();
        let mut parts = Vec::with_capacity(packed.panels.len());
        for panel in &packed.panels {
            let (part, after) = rest.split_at_mut(panel.end(self) - panel.starts[0]);
            parts.push((panel, part));
            rest = after;
        }
        parts.into_par_iter().for_each(|(panel, part)| self.pack_panel(weights, panel, part));
    }

    fn panels(&self) -> Vec<Panel> {
        let widths = self.level.panel_widths();
        let (mut panels, mut channel, mut start) = (Vec::new(), 0, 0);
        while channel < self.channels {
            let left = self.channels - channel;
            // The narrowest panel that takes all that is left, else the widest.
            let width = *widths.iter().rev().find(|width| **width >= left).unwrap_or(&widths[0]);
            let mut starts = Vec::with_capacity(self.taps.len());
            for taps in &self.taps {
                starts.push(start);
                start += width * self.source.channels * taps.len();
            }
            panels.push(Panel { channels: channel..channel + width.min(left), width, starts });
            channel += width;
        }
        panels
    }

    fn pack_panel(&self, weights: &[f32], panel: &Panel, values: &mut [f32]) {
        let kernel = self.geometry.taps();
        let large = self.geometry.large_channels;
        let mut groups = values.chunks_exact_mut(panel.width);
        for taps in &self.taps {
            for input in 0..self.source.channels {
                for (tap, group) in taps.iter().zip(groups.by_ref()) {
                    for (value, output) in group.iter_mut().zip(panel.channels.clone()) {
                        let pair = if self.towards_large { input * large + output } else { output * large + input };
                        *value = weights[pair * kernel + tap.index];
                    }
                    group[panel.channels.len()..].fill(0.0);
                }
            }
        }
    }

    /// Computes the product for a batch of pictures.
    ///
    /// # Shapes
    /// - `input`: `[batch, channels, height, width]`, of the large picture for [`Self::to_small`], else of the small one
    /// - `output`: as many pictures of the other one; all of it is written
    ///
    /// # Panics
    /// If lengths do not fit the geometry, or `weights` were packed for another one.
    pub fn run(
        &self,
        input: &[f32],
        weights: &PackedWeights,
        epilogue: Epilogue<'_>,
        output: &mut [f32],
        workspace: &mut Workspace,
    ) {
        let Geometry { large_channels, small_channels, .. } = self.geometry;
        let sizes = [large_channels * self.geometry.large_area(), small_channels * self.geometry.small_area()];
        let [from, to] = if self.towards_large { [sizes[1], sizes[0]] } else { sizes };
        assert!(input.len().is_multiple_of(from), "input of {:?}", self.geometry);
        assert_eq!(output.len(), input.len() / from * to, "output of {:?}", self.geometry);
        assert_eq!(weights.values.len(), weights.panels.last().map_or(0, |panel| panel.end(self)));
        self.source.fill(input, &mut workspace.planes);
        let source = workspace.planes.as_slice();
        let work = task::Work { correlation: self, source, weights, epilogue };
        work.tasks(output).into_par_iter().for_each(|task| self.level.run(task::Run { work: &work, task }));
    }
}

impl Panel {
    /// Where the panel's weights end.
    fn end(&self, correlation: &Correlation) -> usize {
        let pairs: usize = correlation.taps.iter().map(Vec::len).sum();
        self.starts[0] + self.width * correlation.source.channels * pairs
    }
}
