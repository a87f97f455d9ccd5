//! Sums computed product by product, a panel of channels and a tile of pixels at a time.

use super::pieces::{Cut, Panel, Segment, Task};
use super::shape::Shape;
use super::{Epilogue, PackedWeights};
use crate::level::Level;
use crate::planes::Planes;
use crate::tile::{self, MAX_CHANNELS, MAX_PIXELS};
use crate::transpose::transpose;
use pulp::{Simd, WithSimd};

/// Numbers of input a piece of work may look at, so that they stay in the second level cache.
const WINDOW: usize = 96 * 1024;
/// Weights beyond this number are read once for all pictures, instead of once for every piece of a picture.
const MANY_WEIGHTS: usize = 256 * 1024;
/// Panels of a piece of work where weights are many.
const PANELS_OF_MANY: usize = 2;

/// How a product is computed directly.
#[derive(Clone, Debug)]
pub struct Plan {
    pub source: Planes,
    /// For each pass, where its taps lie, and how many taps the passes before it have.
    passes: Vec<(Vec<usize>, usize)>,
}

impl Plan {
    pub fn new(shape: &Shape) -> Self {
        let reach = shape.reach();
        let extent = [0, 1].map(|axis| shape.grid[axis] + reach[axis]);
        let source = Planes::new(shape.inputs, shape.from, shape.before, shape.step, extent);
        let (mut passes, mut before) = (Vec::with_capacity(shape.passes.len()), 0);
        for taps in &shape.passes {
            passes.push((taps.iter().map(|tap| source.offset(tap.row, tap.column)).collect(), before));
            before += taps.len();
        }
        Self { source, passes }
    }

    fn taps(&self) -> usize {
        self.passes.iter().map(|(offsets, _)| offsets.len()).sum()
    }

    /// Where the taps of a pass lie.
    pub fn taps_of_a_pass(&self, pass: usize) -> &[usize] {
        &self.passes[pass].0
    }

    /// Numbers in the weights of an output channel.
    pub fn weights_of_a_channel(&self, shape: &Shape) -> usize {
        self.taps() * shape.inputs
    }

    /// Multiplications, those at the ends of rows and vectors that are thrown away included; a single vector has too few
    /// sums for each weight that is read.
    pub fn cost(&self, shape: &Shape, level: Level) -> f64 {
        let positions = shape.grid[0] * self.source.row_stride;
        let slowness = if positions <= level.lanes() { 1.25 } else { 1.0 };
        let positions = positions.next_multiple_of(level.lanes());
        slowness * (positions * self.taps() * shape.inputs * shape.outputs) as f64
    }

    /// Weights of a panel: for each pass, `[input channel][tap][channel]`.
    pub fn pack(&self, shape: &Shape, weights: &[f32], panel: &Panel, values: &mut [f32]) {
        let (taps, width, channels) = (shape.geometry.taps(), panel.width, panel.channels.len());
        if channels < width {
            values.fill(0.0);
        }
        let first = |input: usize| shape.weight(panel.channels.start, input, 0);
        let from_channel_to_channel = shape.weight(1, 0, 0);
        if shape.passes.len() == 1 && (from_channel_to_channel > taps || shape.inputs == 1) {
            // The kernels of all inputs lie in one run.
            let columns = shape.inputs * taps;
            transpose(&weights[first(0)..], from_channel_to_channel, [channels, columns], values, width);
            return;
        }
        let mut kernels = vec![0.0; taps * width];
        for input in 0..shape.inputs {
            transpose(&weights[first(input)..], from_channel_to_channel, [channels, taps], &mut kernels, width);
            for (pass, (_, before)) in shape.passes.iter().zip(&self.passes) {
                let places = values[(before * shape.inputs + input * pass.len()) * width..].chunks_exact_mut(width);
                for (tap, place) in pass.iter().zip(places) {
                    place.copy_from_slice(&kernels[tap.index * width..][..width]);
                }
            }
        }
    }
}

/// A product to be computed.
pub struct Work<'a> {
    pub shape: &'a Shape,
    pub plan: &'a Plan,
    pub source: &'a [f32],
    pub weights: &'a PackedWeights,
    pub epilogue: Epilogue<'a>,
}

impl Work<'_> {
    pub fn cut(&self, pictures: usize) -> Cut {
        let (source, grid_rows) = (&self.plan.source, self.shape.grid[0]);
        let lines_per_row = self.shape.spread;
        let panels = self.weights.panels.len();
        let many = self.weights.length > MANY_WEIGHTS;
        let picture = source.picture_stride();
        if many && picture <= 2 * WINDOW {
            let segments_per_task = (2 * WINDOW / picture.max(1)).clamp(1, pictures);
            let panels_per_task = PANELS_OF_MANY.min(panels);
            return Cut { pieces: 1, lines_per_row, grid_rows, segments_per_task, panels_per_task };
        }
        let of_a_row = (source.channels * source.row_stride * self.shape.geometry.stride).max(1);
        let wanted = (WINDOW / of_a_row).max(MAX_PIXELS / source.row_stride + 1);
        // Equal pieces, at least one for each thread; the ends of short ones would fill vectors badly.
        let threads = rayon::current_num_threads();
        let pieces = grid_rows.div_ceil(wanted).max(threads.div_ceil(pictures).min(grid_rows));
        let groups = (4 * threads).div_ceil(pictures * pieces).min(panels);
        let panels_per_task = panels.div_ceil(groups.max(1));
        Cut { pieces, lines_per_row, grid_rows, segments_per_task: 1, panels_per_task }
    }
}

/// One piece of work, to be done with the widest vectors.
pub struct Run<'a, 'b> {
    pub work: &'a Work<'a>,
    pub task: Task<'b>,
}

/// Results of a tile before they are put into their rows: for even and odd columns, `[channel][pixel]`.
type Scratch = [[[f32; MAX_PIXELS]; MAX_CHANNELS]; 2];

impl WithSimd for Run<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let mut scratch = [[[0.0; MAX_PIXELS]; MAX_CHANNELS]; 2];
        let mut first = 0;
        for panel in &self.work.weights.panels[self.task.panels.clone()] {
            for segment in &mut self.task.segments {
                let mut strip = Strip { work: self.work, panel, segment, first, scratch: &mut scratch };
                // Sums fill three quarters of the registers, of which there are 32 or (AVX2) 16.
                match (panel.width, S::F32_LANES) {
                    (8, _) => strip.run::<S, 8, 3>(simd),
                    (4, 8) => strip.run::<S, 4, 3>(simd),
                    (4, _) => strip.run::<S, 4, 6>(simd),
                    _ => strip.run::<S, 1, 8>(simd),
                }
            }
            first += panel.channels.len();
        }
    }
}

/// One panel of one segment.
struct Strip<'a, 'b> {
    work: &'a Work<'a>,
    panel: &'a Panel,
    segment: &'a mut Segment<'b>,
    /// The panel's first channel among those of the task.
    first: usize,
    scratch: &'a mut Scratch,
}

impl Strip<'_, '_> {
    #[inline(always)]
    fn run<S: Simd, const M: usize, const N: usize>(&mut self, simd: S) {
        let (source, Shape { grid, spread, .. }) = (&self.work.plan.source, self.work.shape);
        // What lies beyond the last column of the last row is nobody's pixel.
        let positions = (self.segment.rows - 1) * source.row_stride + grid[1];
        for phase in 0..*spread {
            let mut position = 0;
            while position < positions {
                let vectors = (positions - position).div_ceil(S::F32_LANES);
                position += match vectors {
                    1 => self.tile::<S, M, 1>(simd, phase, position, positions),
                    // Two and two: a single vector has too few sums for a load to pay off.
                    vectors if vectors >= N && vectors != 4 => self.tile::<S, M, N>(simd, phase, position, positions),
                    _ => self.tile::<S, M, 2>(simd, phase, position, positions),
                };
            }
        }
    }

    /// Computes `N` vectors of positions and returns how many positions that is.
    #[inline(always)]
    fn tile<S: Simd, const M: usize, const N: usize>(
        &mut self,
        simd: S,
        phase: usize,
        position: usize,
        positions: usize,
    ) -> usize {
        let Plan { source, passes } = self.work.plan;
        let spread = self.work.shape.spread;
        let start = self.segment.picture * source.picture_stride() + self.segment.first_row * source.row_stride;
        let pixels = &self.work.source[start + position..];
        for column in 0..spread {
            let (taps, taps_before) = &passes[phase * spread + column];
            let first = self.panel.start + M * source.channels * taps_before;
            let (weights, _) = self.work.weights.values[first..][..M * source.channels * taps.len()].as_chunks::<M>();
            let mut sums = tile::correlate::<S, M, N>(simd, pixels, source.channel_stride, taps, weights);
            self.finish::<S, M, N>(simd, &mut sums);
            for (line, sums) in self.scratch[column].iter_mut().zip(&sums) {
                let (vectors, _) = S::as_mut_simd_f32s(&mut line[..N * S::F32_LANES]);
                vectors.copy_from_slice(sums);
            }
        }
        self.store(phase, position, (N * S::F32_LANES).min(positions - position));
        N * S::F32_LANES
    }

    /// Bias and ReLU.
    #[inline(always)]
    fn finish<S: Simd, const M: usize, const N: usize>(&self, simd: S, sums: &mut tile::Sums<S, M, N>) {
        let Epilogue { bias, relu } = self.work.epilogue;
        if let Some(bias) = bias {
            for (row, bias) in sums.iter_mut().zip(&bias[self.panel.channels.clone()]) {
                let bias = simd.splat_f32s(*bias);
                row.iter_mut().for_each(|sum| *sum = simd.add_f32s(*sum, bias));
            }
        }
        if relu {
            let zero = simd.splat_f32s(0.0);
            sums.iter_mut().flatten().for_each(|sum| *sum = simd.max_f32s(*sum, zero));
        }
    }

    /// Puts `count` positions of the scratch into the rows they belong to.
    #[inline(always)]
    fn store(&mut self, phase: usize, position: usize, count: usize) {
        let (source, Shape { grid, spread, size, .. }) = (&self.work.plan.source, self.work.shape);
        let channels = self.first..self.first + self.panel.channels.len();
        let mut done = 0;
        while done < count {
            let (row, column) = ((position + done) / source.row_stride, (position + done) % source.row_stride);
            let length = (source.row_stride - column).min(count - done);
            let inside = length.min(grid[1].saturating_sub(column));
            done += length;
            if inside == 0 {
                continue;
            }
            let first = done - length;
            let start = (row * spread + phase) * size[1];
            for (channel, lines) in self.segment.channels[channels.clone()].iter_mut().enumerate() {
                // With an odd height the last position has no second row.
                let Some(line) = lines.get_mut(start..start + size[1]) else { continue };
                let [even, odd] = &self.scratch;
                if *spread == 1 {
                    line[column..column + inside].copy_from_slice(&even[channel][first..first + inside]);
                } else {
                    let pixels = even[channel][first..first + inside].iter().zip(&odd[channel][first..first + inside]);
                    interleave(&mut line[2 * column..], pixels);
                }
            }
        }
    }
}

/// Alternates two rows of pixels; with an odd width the last has no partner.
#[inline(always)]
fn interleave<'a>(line: &mut [f32], pixels: impl ExactSizeIterator<Item = (&'a f32, &'a f32)> + Clone) {
    let (pairs, last) = line.as_chunks_mut::<2>();
    let count = pixels.len();
    pairs.iter_mut().zip(pixels.clone()).for_each(|(pair, (even, odd))| *pair = [*even, *odd]);
    if let (Some(last), true) = (last.first_mut(), count > pairs.len()) {
        pixels.skip(pairs.len()).for_each(|(even, _)| *last = *even);
    }
}
