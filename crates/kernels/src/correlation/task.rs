//! Cutting a product into pieces of work, and doing one piece.

use super::{Correlation, Epilogue, PackedWeights, Panel};
use crate::tile::{self, MAX_CHANNELS, MAX_PIXELS};
use pulp::{Simd, WithSimd};
use std::ops::Range;

/// Numbers of input a piece of work may look at, so that they stay in the second level cache.
const WINDOW: usize = 96 * 1024;
/// Weights beyond this number are read once for all pictures, instead of once for every piece of a picture.
const MANY_WEIGHTS: usize = 256 * 1024;
/// Panels of a piece of work where weights are many.
const PANELS_OF_MANY: usize = 2;

/// A product to be computed.
pub struct Work<'a> {
    pub correlation: &'a Correlation,
    pub source: &'a [f32],
    pub weights: &'a PackedWeights,
    pub epilogue: Epilogue<'a>,
}

/// Some panels of some rows.
pub struct Task<'a> {
    panels: Range<usize>,
    segments: Vec<Segment<'a>>,
}

/// Rows of one picture, as far as a task writes them.
struct Segment<'a> {
    picture: usize,
    /// First row of positions, and how many.
    first_row: usize,
    rows: usize,
    /// The rows of each channel of the task's panels.
    channels: Vec<&'a mut [f32]>,
}

/// How a product is cut.
struct Cut {
    rows: usize,
    segments_per_task: usize,
    panels_per_task: usize,
}

impl Work<'_> {
    fn cut(&self, pictures: usize) -> Cut {
        let Correlation { source, grid, .. } = self.correlation;
        let panels = self.weights.panels.len();
        let many = self.weights.values.len() > MANY_WEIGHTS;
        let picture = source.picture_stride();
        if many && picture <= 2 * WINDOW {
            let together = (2 * WINDOW / picture.max(1)).clamp(1, pictures);
            return Cut { rows: grid[0], segments_per_task: together, panels_per_task: PANELS_OF_MANY.min(panels) };
        }
        let of_a_row = (source.channels * source.row_stride * self.correlation.geometry.stride).max(1);
        let wanted = (WINDOW / of_a_row).max(MAX_PIXELS / source.row_stride + 1);
        // Equal pieces, and at least a few of them.
        let pieces = grid[0].div_ceil(wanted).max(4_usize.div_ceil(pictures).min(grid[0]));
        let rows = grid[0].div_ceil(pieces);
        let segments = pictures * grid[0].div_ceil(rows);
        let groups = (4 * rayon::current_num_threads()).div_ceil(segments).min(panels);
        Cut { rows, segments_per_task: 1, panels_per_task: panels.div_ceil(groups.max(1)) }
    }

    /// Pieces that together write all of `output`.
    pub fn tasks<'a>(&self, output: &'a mut [f32]) -> Vec<Task<'a>> {
        let Correlation { size, spread, grid, channels, .. } = *self.correlation;
        let pictures = output.len() / (channels * size[0] * size[1]).max(1);
        let Cut { rows, segments_per_task, panels_per_task } = self.cut(pictures);
        let width = self.weights.panels.first().map_or(1, |panel| panel.width);
        let per_picture = grid[0].div_ceil(rows);
        let segment_groups = (pictures * per_picture).div_ceil(segments_per_task);
        let panel_groups = self.weights.panels.len().div_ceil(panels_per_task);
        let task = |index: usize| {
            let (segments, panels) = (index / panel_groups, index % panel_groups);
            let segments =
                segments * segments_per_task..((segments + 1) * segments_per_task).min(pictures * per_picture);
            let panels = panels * panels_per_task..((panels + 1) * panels_per_task).min(self.weights.panels.len());
            let segment = |segment: usize| {
                let first_row = segment % per_picture * rows;
                let rows = rows.min(grid[0] - first_row);
                let channels = Vec::with_capacity(panels.len() * width);
                Segment { picture: segment / per_picture, first_row, rows, channels }
            };
            Task { segments: segments.map(segment).collect(), panels: panels.clone() }
        };
        let mut tasks: Vec<Task<'a>> = (0..segment_groups * panel_groups).map(task).collect();
        for (index, plane) in output.chunks_mut(size[0] * size[1]).enumerate() {
            let (picture, channel) = (index / channels, index % channels);
            for (piece, lines) in plane.chunks_mut(rows * spread * size[1]).enumerate() {
                let segment = picture * per_picture + piece;
                let group = segment / segments_per_task * panel_groups + channel / width / panels_per_task;
                tasks[group].segments[segment % segments_per_task].channels.push(lines);
            }
        }
        tasks
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
        let Correlation { source, grid, spread, .. } = self.work.correlation;
        // What lies beyond the last column of the last row is nobody's pixel.
        let positions = (self.segment.rows - 1) * source.row_stride + grid[1];
        for phase in 0..*spread {
            let mut position = 0;
            while position < positions {
                let vectors = (positions - position).div_ceil(S::F32_LANES);
                position += match vectors {
                    1 => self.tile::<S, M, 1>(simd, phase, position, positions),
                    vectors if vectors >= N => self.tile::<S, M, N>(simd, phase, position, positions),
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
        let Correlation { source, spread, offsets, .. } = self.work.correlation;
        let start = self.segment.picture * source.picture_stride() + self.segment.first_row * source.row_stride;
        let pixels = &self.work.source[start + position..];
        for column in 0..*spread {
            let pass = phase * spread + column;
            let taps = &offsets[pass];
            let length = M * source.channels * taps.len();
            let (weights, _) = self.work.weights.values[self.panel.starts[pass]..][..length].as_chunks::<M>();
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
        let Correlation { source, grid, spread, size, .. } = self.work.correlation;
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
