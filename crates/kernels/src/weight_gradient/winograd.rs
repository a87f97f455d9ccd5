//! Gradients of weights by Winograd's filtering ([`crate::points`]).
//!
//! With pixels `X` of a tile, gradients `Y` of its outputs and weights `W`, `Y' = V_m^T [(SCALES V_k W) * (B^T X)]`
//! makes the gradient of the weights `V_k^T [SCALES * sum_tiles (B^T X) * (V_m Y)]` in each direction. Channels lie side
//! by side: vectors run over channels of the large picture, and for each point the sum over tiles is a product of
//! matrices. A stride of 2 makes the four phases of the large picture channels of their own, with kernels half as large.

use super::GradientWorkspace;
use super::interleaved::Interleaved;
use crate::correlation::Method;
use crate::geometry::Geometry;
use crate::level::Level;
use crate::points::{self, MAX_POINTS, Points};
use crate::tile::{self, Lines, MAX_CHANNELS};
use pulp::{Simd, WithSimd};
use rayon::prelude::*;
use std::cell::Cell;
use std::ops::Range;

/// Most tiles that are worked on together.
const TILES: usize = 32;
/// Numbers of transformed pictures to keep in the second level cache.
const WINDOW: usize = 256 * 1024;
/// Pieces of the batch that are summed apart, at most, and how many numbers their sums may have together.
const PIECES: usize = 16;
const SUMS: usize = 2 << 20;
/// However many numbers their sums have, there are so many pieces.
const LEAST_PIECES: usize = 4;
/// Channels are counted in multiples of this.
const GROUP: usize = 16;
/// Numbers between what would else fall into the same set of the cache.
const LINE: usize = 16;

/// How a gradient is computed.
#[derive(Clone, Copy)]
pub struct Plan {
    geometry: Geometry,
    batch: usize,
    pairs: usize,
    /// Points, taps and outputs of a tile in each direction.
    points: usize,
    kernel: usize,
    outputs: usize,
    /// Tiles of a picture: rows and columns.
    tiles: [usize; 2],
    large: Interleaved,
    small: Interleaved,
    /// Channels of the large picture, and of all its phases, with what fills the last vector.
    channels: usize,
    inputs: usize,
    /// Channels of the small picture that are computed side by side, and how many panels of them there are.
    width: usize,
    panels: usize,
}

impl Plan {
    /// `None` where the kernel is too large or a single tap, and for another method.
    pub fn new(geometry: &Geometry, level: Level, batch: usize, method: Method) -> Option<Self> {
        let pairs = method.pairs()?;
        let Geometry { stride, before, large, small, large_channels, small_channels, .. } = *geometry;
        let (points, kernel) = (2 * pairs + 2, geometry.kernel.div_ceil(stride));
        let outputs = (points + 1).checked_sub(kernel).filter(|outputs| *outputs > 1 && kernel > 1)?;
        let tiles = small.map(|length| length.div_ceil(outputs));
        let extent = tiles.map(|count| (count * outputs + kernel - 1) * stride);
        let channels = large_channels.next_multiple_of(GROUP);
        let width = level.panel_widths()[0];
        Some(Self {
            geometry: *geometry,
            batch,
            pairs,
            points,
            kernel,
            outputs,
            tiles,
            large: Interleaved::new(large_channels, large, before, extent),
            small: Interleaved::new(small_channels, small, [0; 2], tiles.map(|count| count * outputs)),
            channels,
            inputs: stride * stride * channels,
            width,
            panels: small_channels.div_ceil(width),
        })
    }

    pub fn method(&self) -> Method {
        if self.pairs == 2 { Method::Winograd6 } else { Method::Winograd8 }
    }

    fn pixels(&self) -> usize {
        self.points * self.points
    }

    /// Numbers in the sums of a piece: `[point][output channel][input channel]`.
    fn sums(&self) -> usize {
        self.pixels() * self.panels * self.width * self.inputs
    }

    /// Pieces of the batch, which depend on sizes alone.
    fn pieces(&self) -> usize {
        (SUMS / self.sums()).clamp(LEAST_PIECES, PIECES).min(self.batch * self.tiles[0])
    }

    /// In multiplications, about: those of the filtering, what the transforms cost beside them, and the sums of pieces.
    pub fn cost(&self) -> f64 {
        let tiles = (self.batch * self.tiles[0] * self.tiles[1]) as f64;
        let (inputs, outputs) = (self.inputs as f64, (self.panels * self.width) as f64);
        let points = self.pixels() as f64;
        tiles * points * (1.2 * inputs * outputs + 25.0 * (inputs + outputs))
            + (40 * self.pieces() * self.sums()) as f64
    }

    /// See [`super::WeightGradient::run`].
    pub fn run(
        &self,
        level: Level,
        [large, small]: [&[f32]; 2],
        weights: &mut [f32],
        workspace: &mut GradientWorkspace,
    ) {
        let GradientWorkspace { large: large_lines, small: small_lines, sums } = workspace;
        self.large.fill(large, large_lines);
        self.small.fill(small, small_lines);
        let pieces = self.pieces();
        sums.resize(pieces * self.sums(), 0.0);
        let rows = self.batch * self.tiles[0];
        sums.par_chunks_mut(self.sums()).enumerate().for_each(|(piece, sums)| {
            let rows = piece * rows / pieces..(piece + 1) * rows / pieces;
            level.run(Piece { plan: self, lines: [large_lines, small_lines], rows, sums });
        });
        let of_a_channel = self.geometry.large_channels * self.geometry.taps();
        weights.par_chunks_mut(of_a_channel).enumerate().for_each(|(output, weights)| {
            level.run(Collect { plan: self, sums, output, weights });
        });
    }
}

thread_local!(
    /// Memory of a thread that is used again from piece to piece.
    static SCRATCH: Cell<Vec<f32>> = const { Cell::new(Vec::new()) }
);

/// The sums over some rows of tiles, those of all pictures counted on.
struct Piece<'a> {
    plan: &'a Plan,
    /// The large and the small pictures.
    lines: [&'a [f32]; 2],
    rows: Range<usize>,
    sums: &'a mut [f32],
}

/// Transformed tiles.
struct Block<'s> {
    /// How many there are.
    tiles: usize,
    /// `[point][tile][input channel]`, and numbers from a point to the next.
    large: &'s mut [f32],
    large_stride: usize,
    /// `[point][panel][tile][output channel]`, and numbers from a point to the next.
    small: &'s mut [f32],
    small_stride: usize,
}

impl WithSimd for Piece<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let Plan { panels, width, inputs, tiles, .. } = *self.plan;
        self.sums.fill(0.0);
        let of_a_tile = self.plan.pixels() * (inputs + panels * width);
        let most = (WINDOW / of_a_tile).clamp(4, TILES);
        let [large_stride, small_stride] = [most * inputs + LINE, most * panels * width + LINE];
        let length = self.plan.pixels() * (large_stride + small_stride);
        // Not lent to a closure: that would be compiled without the wide vectors.
        let mut scratch = SCRATCH.take();
        if scratch.len() < length {
            scratch.resize(length, 0.0);
        }
        let (large, small) = scratch.split_at_mut(self.plan.pixels() * large_stride);
        let mut block = Block { tiles: 0, large, large_stride, small, small_stride };
        let (first, end) = (self.rows.start * tiles[1], self.rows.end * tiles[1]);
        for begin in (first..end).step_by(most) {
            block.tiles = most.min(end - begin);
            match self.plan.pairs {
                2 => self.block::<S, 2>(simd, begin, &mut block),
                _ => self.block::<S, 3>(simd, begin, &mut block),
            }
        }
        SCRATCH.set(scratch);
    }
}

impl Piece<'_> {
    #[inline(always)]
    fn block<S: Simd, const PAIRS: usize>(&mut self, simd: S, begin: usize, block: &mut Block<'_>) {
        for tile in 0..block.tiles {
            self.analyse::<S, PAIRS>(simd, begin + tile, tile, block);
            self.evaluate::<S, PAIRS>(simd, begin + tile, tile, block);
        }
        match (self.plan.width, S::F32_LANES) {
            (8, _) => self.multiply::<S, 8, 3>(simd, block),
            (_, 8) => self.multiply::<S, 4, 3>(simd, block),
            _ => self.multiply::<S, 4, 6>(simd, block),
        }
    }

    /// Where a tile begins, given numbers from a row and a column of tiles to the next.
    #[inline(always)]
    fn start(&self, tile: usize, lines: &Interleaved, step: usize) -> usize {
        let [rows, columns] = self.plan.tiles;
        let (row, column) = (tile / columns, tile % columns);
        let line = row / rows * lines.rows + row % rows * step;
        line * lines.row_stride + column * step * lines.column_stride
    }

    /// Transforms the pixels of a tile.
    #[inline(always)]
    fn analyse<S: Simd, const PAIRS: usize>(&self, simd: S, tile: usize, place: usize, block: &mut Block<'_>) {
        let Plan { points, outputs, large, channels, inputs, geometry: Geometry { stride, .. }, .. } = *self.plan;
        let start = self.start(tile, &large, outputs * stride);
        for phase in 0..stride * stride {
            let first = start + phase / stride * large.row_stride + phase % stride * large.column_stride;
            for channel in (0..channels).step_by(S::F32_LANES) {
                let pixels = &self.lines[0][first + channel..];
                let mut values = points::empty(simd);
                for (row, line) in values.iter_mut().enumerate().take(points) {
                    let mut loaded = [simd.splat_f32s(0.0); MAX_POINTS];
                    for (column, value) in loaded.iter_mut().enumerate().take(points) {
                        let at = row * stride * large.row_stride + column * stride * large.column_stride;
                        [*value] = tile::load::<S, 1>(simd, pixels, at);
                    }
                    *line = Points::<PAIRS>::analyse(simd, &loaded);
                }
                let place = place * inputs + phase * channels + channel;
                for column in 0..points {
                    let values = points::column::<S>(simd, &values, column, points);
                    let values = Points::<PAIRS>::analyse(simd, &values);
                    for (row, value) in values.iter().enumerate().take(points) {
                        let point = &mut block.large[(row * points + column) * block.large_stride + place..];
                        tile::store::<S>(point, *value);
                    }
                }
            }
        }
    }

    /// Transforms the gradients of a tile.
    #[inline(always)]
    fn evaluate<S: Simd, const PAIRS: usize>(&self, simd: S, tile: usize, place: usize, block: &mut Block<'_>) {
        let Plan { points, outputs, small, width, panels, .. } = *self.plan;
        let start = self.start(tile, &small, outputs);
        for channel in (0..panels * width).step_by(S::F32_LANES) {
            let pixels = &self.lines[1][start + channel..];
            let mut values = points::empty(simd);
            for (row, line) in values.iter_mut().enumerate().take(outputs) {
                let mut loaded = [simd.splat_f32s(0.0); MAX_POINTS];
                for (column, value) in loaded.iter_mut().enumerate().take(outputs) {
                    [*value] = tile::load::<S, 1>(simd, pixels, row * small.row_stride + column * small.column_stride);
                }
                *line = Points::<PAIRS>::evaluate(simd, &loaded, outputs);
            }
            for column in 0..points {
                let values = points::column::<S>(simd, &values, column, outputs);
                let values = Points::<PAIRS>::evaluate(simd, &values, outputs);
                for (row, value) in values.iter().enumerate().take(points) {
                    let mut lanes = [0.0; MAX_LANES];
                    tile::store::<S>(&mut lanes, *value);
                    let point = &mut block.small[(row * points + column) * block.small_stride..][..block.small_stride];
                    for (index, lanes) in lanes[..S::F32_LANES].chunks(width).enumerate() {
                        let output = channel + index * width;
                        if output < panels * width {
                            let place = (output / width * block.tiles + place) * width + output % width;
                            point[place..place + lanes.len()].copy_from_slice(lanes);
                        }
                    }
                }
            }
        }
    }

    /// Adds the products of a block to the sums.
    #[inline(always)]
    fn multiply<S: Simd, const M: usize, const N: usize>(&mut self, simd: S, block: &Block<'_>) {
        let Plan { panels, inputs, .. } = *self.plan;
        let of_a_point = panels * M * inputs;
        for (point, sums) in self.sums.chunks_exact_mut(of_a_point).enumerate() {
            let large = &block.large[point * block.large_stride..][..block.large_stride];
            let small = &block.small[point * block.small_stride..][..panels * M * block.tiles];
            let mut first = 0;
            while first < inputs {
                first += match (inputs - first) / S::F32_LANES {
                    1 => add::<S, M, 1>(simd, &large[first..], small, &mut sums[first..], [inputs, block.tiles]),
                    vectors if vectors >= N => {
                        add::<S, M, N>(simd, &large[first..], small, &mut sums[first..], [inputs, block.tiles])
                    }
                    _ => add::<S, M, 2>(simd, &large[first..], small, &mut sums[first..], [inputs, block.tiles]),
                };
            }
        }
    }
}

/// Most lanes of a vector.
const MAX_LANES: usize = 16;

/// Adds `N` vectors of input channels times all panels; returns how many channels that is.
#[inline(always)]
fn add<S: Simd, const M: usize, const N: usize>(
    simd: S,
    large: &[f32],
    small: &[f32],
    sums: &mut [f32],
    [inputs, tiles]: [usize; 2],
) -> usize {
    debug_assert!(M <= MAX_CHANNELS);
    let lines = Lines { rows: 1, columns: tiles, row_stride: 0, column_stride: inputs };
    for (panel, gradients) in small.chunks_exact(M * tiles).enumerate() {
        let (gradients, _) = gradients.as_chunks::<M>();
        let added = tile::add_outer::<S, M, N>(simd, tile::zero::<S, M, N>(simd), large, lines, gradients);
        for (output, added) in added.iter().enumerate() {
            let line = &mut sums[(panel * M + output) * inputs..][..N * S::F32_LANES];
            let (vectors, _) = S::as_mut_simd_f32s(line);
            for (sum, added) in vectors.iter_mut().zip(added) {
                *sum = simd.add_f32s(*sum, *added);
            }
        }
    }
    N * S::F32_LANES
}

/// Adds the pieces up, in their order, and transforms the sums of an output channel back.
struct Collect<'a> {
    plan: &'a Plan,
    sums: &'a [f32],
    output: usize,
    weights: &'a mut [f32],
}

impl WithSimd for Collect<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        match self.plan.pairs {
            2 => self.run::<S, 2>(simd),
            _ => self.run::<S, 3>(simd),
        }
    }
}

impl Collect<'_> {
    #[inline(always)]
    fn run<S: Simd, const PAIRS: usize>(&mut self, simd: S) {
        let Plan { points, kernel, channels, inputs, .. } = *self.plan;
        for input in (0..inputs).step_by(S::F32_LANES) {
            let mut values = points::empty(simd);
            for (row, line) in values.iter_mut().enumerate().take(points) {
                let mut summed = [simd.splat_f32s(0.0); MAX_POINTS];
                for (column, value) in summed.iter_mut().enumerate().take(points) {
                    *value = self.summed(simd, row * points + column, input);
                }
                *line = collected::<S, PAIRS>(simd, summed, kernel);
            }
            for column in 0..kernel {
                let values = points::column::<S>(simd, &values, column, points);
                let values = collected::<S, PAIRS>(simd, values, kernel);
                for (row, value) in values.iter().enumerate().take(kernel) {
                    let mut lanes = [0.0; MAX_LANES];
                    tile::store::<S>(&mut lanes, *value);
                    self.put(input % channels, input / channels, [row, column], &lanes[..S::F32_LANES]);
                }
            }
        }
    }

    /// The sum of all pieces at a point.
    #[inline(always)]
    fn summed<S: Simd>(&self, simd: S, point: usize, input: usize) -> S::f32s {
        let Plan { panels, width, inputs, .. } = *self.plan;
        let first = (point * panels * width + self.output) * inputs + input;
        let mut sum = simd.splat_f32s(0.0);
        for sums in self.sums.chunks_exact(self.plan.sums()) {
            let [value] = tile::load::<S, 1>(simd, sums, first);
            sum = simd.add_f32s(sum, value);
        }
        sum
    }

    /// Puts a tap of several channels of a phase into the weights.
    #[inline(always)]
    fn put(&mut self, channel: usize, phase: usize, [row, column]: [usize; 2], lanes: &[f32]) {
        let Geometry { kernel, stride, .. } = self.plan.geometry;
        let (row, column) = (row * stride + phase / stride, column * stride + phase % stride);
        if row >= kernel || column >= kernel {
            return;
        }
        for (weights, lane) in self.weights.chunks_exact_mut(kernel * kernel).skip(channel).zip(lanes) {
            weights[row * kernel + column] = *lane;
        }
    }
}

/// Sums at the points as the gradient of a kernel.
#[inline(always)]
fn collected<S: Simd, const PAIRS: usize>(
    simd: S,
    mut values: [S::f32s; MAX_POINTS],
    taps: usize,
) -> [S::f32s; MAX_POINTS] {
    for (value, scale) in values.iter_mut().zip(Points::<PAIRS>::SCALES) {
        *value = simd.mul_f32s(*value, simd.splat_f32s(scale));
    }
    Points::<PAIRS>::collect(simd, &values, taps)
}
