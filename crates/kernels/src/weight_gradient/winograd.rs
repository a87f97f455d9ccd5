//! By Winograd's filtering ([`crate::points`]).
//!
//! For outputs `V_m^T [(SCALES * V_k kernel) * (B^T pixels)]` of a tile, the gradient of the kernel is the transpose,
//!
//! `d kernel = V_k^T (SCALES * sum_{tiles} [(V_m d outputs) * (B^T pixels)])`,
//!
//! in both directions: for each point a product of two matrices, gradients by tiles and tiles by pixels, and one
//! transform at the end. Vectors run over the channels of the large picture. Where the large picture has a step of 2,
//! each of its four phases has a kernel of its own, half as large.
//!
//! Tiles are transformed some at a time (a batch of tiles): as many batches as fit the memory of a round, each by one
//! thread, and then all products of that round, each thread some panels of output channels.

mod tiles;

use super::GradientWorkspace;
use super::interleaved::Interleaved;
use crate::correlation::Method;
use crate::geometry::Geometry;
use crate::level::Level;
use crate::memory::at_least;
use crate::points::{self, MAX_POINTS, Points};
use crate::tile;
use crate::transpose::transpose;
use pulp::{Simd, WithSimd};
use rayon::prelude::*;
use std::cell::Cell;
use tiles::Transform;

/// Most vectors of a block of large channels.
const VECTORS: usize = 3;
/// Channels are filled up to whole vectors of any level.
const WIDEST: usize = 16;
/// Numbers of a cache line: strides that are multiples of a page would put all points into one set of the cache.
const LINE: usize = 16;
/// Most tiles of a batch, and how many batches to aim at.
const TILES: usize = 16;
const BATCHES: usize = 8;
/// Transformed numbers of a round: a part of the third level cache.
const ROUND: usize = 1 << 19;
/// Most panels that read a block one after the other, and tasks to aim at.
const PANELS_PER_TASK: usize = 4;
const TASKS: usize = 4;

/// How a gradient is computed.
#[derive(Clone, Debug)]
pub struct Plan {
    level: Level,
    /// Pairs of points: 2 for 6 points, 3 for 8.
    pairs: usize,
    /// Points, taps (of a phase) and outputs in each direction.
    points: usize,
    kernel: usize,
    outputs: usize,
    /// Steps of the large picture for one of the small one.
    step: usize,
    /// Pictures, and their tiles: rows and columns.
    pictures: usize,
    tiles: [usize; 2],
    large: Interleaved,
    small: Interleaved,
    blocks: Vec<Block>,
    /// Small channels whose sums are kept in registers together, and how many such panels there are.
    panel: usize,
    panels: usize,
    /// Small channels that lie side by side: whole vectors and whole panels.
    group: usize,
    /// Tiles of a batch.
    batch: usize,
}

/// Large channels of one phase whose sums are kept in registers together.
#[derive(Clone, Debug)]
struct Block {
    index: usize,
    phase: usize,
    channels: std::ops::Range<usize>,
    vectors: usize,
    /// Numbers of a tile and a point in the blocks before.
    start: usize,
}

impl Plan {
    /// `None` where the kernel is too large or a single tap, and for another method.
    pub fn new(geometry: &Geometry, method: Method, level: Level, pictures: usize) -> Option<Self> {
        let pairs = method.pairs()?;
        let (points, step) = (2 * pairs + 2, geometry.stride);
        let kernel = geometry.kernel.div_ceil(step);
        let outputs = (points + 1).checked_sub(kernel)?;
        if kernel < 2 || outputs < 2 {
            return None;
        }
        let tiles = geometry.small.map(|length| length.div_ceil(outputs));
        let seen = tiles.map(|count| step * ((count - 1) * outputs + points));
        let panel = level.panel_widths()[0];
        let all = pictures * tiles[0] * tiles[1];
        Some(Self {
            level,
            pairs,
            points,
            kernel,
            outputs,
            step,
            pictures,
            tiles,
            large: Interleaved::new(geometry.large_channels, geometry.large, geometry.before, seen, WIDEST),
            small: Interleaved::new(
                geometry.small_channels,
                geometry.small,
                [0; 2],
                tiles.map(|count| count * outputs),
                WIDEST,
            ),
            blocks: blocks(geometry, level.lanes()),
            panel,
            panels: geometry.small_channels.div_ceil(panel),
            group: level.lanes().max(panel),
            batch: all.div_ceil(BATCHES).clamp(4, TILES),
        })
    }

    /// In multiplications, about: those of the filtering, what transforms of tiles and of kernels cost beside them, and
    /// laying out the pictures; factors were fitted to measured times.
    pub fn cost(&self, geometry: &Geometry) -> f64 {
        let [tiles, points] = [self.count(), self.pixels()].map(|count| count as f64);
        let [inputs, outputs] = [self.width(), self.panel * self.panels].map(|channels| channels as f64);
        let large = geometry.large_channels * geometry.large_area();
        let numbers = self.pictures * (large + geometry.small_channels * geometry.small_area());
        let products = points * inputs * outputs;
        1.1 * (tiles * (products + 20.0 * points * (inputs + outputs)) + 36.0 * products + 185.0 * numbers as f64)
    }

    /// All tiles.
    fn count(&self) -> usize {
        self.pictures * self.tiles[0] * self.tiles[1]
    }

    fn pixels(&self) -> usize {
        self.points * self.points
    }

    /// Numbers of a tile and a point in all blocks.
    fn width(&self) -> usize {
        self.blocks.last().map_or(0, |block| block.start + block.vectors * self.level.lanes())
    }

    /// Transformed numbers of a batch: those of pixels, `[block][point][tile][channel]`, then those of gradients,
    /// `[group][point][tile][channel]`.
    fn lengths(&self) -> [usize; 2] {
        let inputs = self.width() * self.batch + self.blocks.len() * LINE;
        let groups = (self.panels * self.panel).div_ceil(self.group);
        [self.pixels() * inputs, self.pixels() * groups * (self.group * self.batch + LINE)]
    }

    /// Where the transformed pixels of a block begin, and numbers from a point to the next.
    fn place_of_inputs(&self, block: &Block) -> [usize; 2] {
        let width = block.vectors * self.level.lanes();
        [self.pixels() * (block.start * self.batch + block.index * LINE), width * self.batch + LINE]
    }

    /// Where the transformed gradients of a small channel begin, counted from the first group, and numbers from a point
    /// to the next.
    fn place_of_gradients(&self, channel: usize) -> [usize; 2] {
        let of_a_point = self.group * self.batch + LINE;
        [self.pixels() * (channel / self.group) * of_a_point + channel % self.group, of_a_point]
    }

    /// Writes the gradient.
    pub fn run(
        &self,
        geometry: &Geometry,
        [large, small]: [&[f32]; 2],
        weights: &mut [f32],
        workspace: &mut GradientWorkspace,
    ) {
        let lines = [self.large.fill(large, &mut workspace.large), self.small.fill(small, &mut workspace.small)];
        let length: usize = self.lengths().iter().sum();
        let batches = self.count().div_ceil(self.batch);
        let of_a_round = (ROUND / length).clamp(BATCHES.min(batches), batches);
        let values = at_least(&mut workspace.sums, of_a_round * length);
        let per_task = self.panels.div_ceil(TASKS).min(PANELS_PER_TASK);
        for first in (0..batches).step_by(of_a_round) {
            let tiles = first * self.batch..((first + of_a_round) * self.batch).min(self.count());
            let values = &mut values[..tiles.len().div_ceil(self.batch) * length];
            values.par_chunks_exact_mut(length).enumerate().for_each(|(index, values)| {
                let first = tiles.start + index * self.batch;
                let tiles = first..(first + self.batch).min(tiles.end);
                self.level.run(Transform { plan: self, lines, tiles, values });
            });
            let values = &*values;
            let of_a_task = per_task * self.panel * geometry.large_channels * geometry.taps();
            weights.par_chunks_mut(of_a_task).enumerate().for_each(|(task, weights)| {
                let first_panel = task * per_task;
                let add = first > 0;
                let tiles = tiles.len();
                self.level.run(Products { plan: self, geometry, values, tiles, first_panel, weights, add });
            });
        }
    }
}

/// Channels of all phases in blocks of at most three vectors, none of a single one where that can be avoided.
fn blocks(geometry: &Geometry, lanes: usize) -> Vec<Block> {
    let (mut blocks, mut start) = (Vec::new(), 0);
    for phase in 0..geometry.stride * geometry.stride {
        let mut first = 0;
        while first < geometry.large_channels {
            let left = (geometry.large_channels - first).div_ceil(lanes);
            let vectors = if left == 4 { 2 } else { left.min(VECTORS) };
            let end = (first + vectors * lanes).min(geometry.large_channels);
            blocks.push(Block { index: blocks.len(), phase, channels: first..end, vectors, start });
            (first, start) = (end, start + vectors * lanes);
        }
    }
    blocks
}

/// The products of some panels over the tiles of a round, and the kernels' gradients from them.
struct Products<'a> {
    plan: &'a Plan,
    geometry: &'a Geometry,
    values: &'a [f32],
    /// How many tiles `values` holds.
    tiles: usize,
    first_panel: usize,
    /// Of the task's channels.
    weights: &'a mut [f32],
    /// Whether the round is not the first.
    add: bool,
}

thread_local!(
    /// Memory of a thread that is used again.
    static SCRATCH: Cell<Vec<f32>> = const { Cell::new(Vec::new()) }
);

impl WithSimd for Products<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        match (self.plan.pairs, self.plan.panel) {
            (2, 8) => self.run::<S, 2, 8>(simd),
            (2, _) => self.run::<S, 2, 4>(simd),
            (_, 8) => self.run::<S, 3, 8>(simd),
            (_, _) => self.run::<S, 3, 4>(simd),
        }
    }
}

impl Products<'_> {
    #[inline(always)]
    fn run<S: Simd, const PAIRS: usize, const M: usize>(&mut self, simd: S) {
        let plan = self.plan;
        let of_a_channel = self.geometry.large_channels * self.geometry.taps();
        let channels = self.weights.len() / of_a_channel;
        // Not lent to a closure: that would be compiled without the wide vectors.
        let mut memory = SCRATCH.take();
        for block in &plan.blocks {
            let width = block.vectors * S::F32_LANES;
            let kernel = plan.kernel * plan.kernel * width;
            let scratch = at_least(&mut memory, kernel + channels.next_multiple_of(M) * plan.pixels() * width);
            let (kernel, sums) = scratch.split_at_mut(kernel);
            for point in 0..plan.pixels() {
                for panel in 0..channels.div_ceil(M) {
                    let sums = &mut sums[(panel * M * plan.pixels() + point) * width..];
                    match block.vectors {
                        1 => self.product::<S, M, 1>(simd, block, point, panel, sums),
                        2 => self.product::<S, M, 2>(simd, block, point, panel, sums),
                        _ => self.product::<S, M, VECTORS>(simd, block, point, panel, sums),
                    }
                }
            }
            for (channel, sums) in sums.chunks_exact(plan.pixels() * width).enumerate().take(channels) {
                for vector in (0..width).step_by(S::F32_LANES) {
                    collect::<S, PAIRS>(simd, plan.kernel, width, &sums[vector..], &mut kernel[vector..]);
                }
                self.place(block, kernel, channel * of_a_channel);
            }
        }
        SCRATCH.set(memory);
    }

    /// The product of a block and a panel at one point, over all tiles; `sums` are `[channel][point][lane]`.
    #[inline(always)]
    fn product<S: Simd, const M: usize, const N: usize>(
        &self,
        simd: S,
        block: &Block,
        point: usize,
        panel: usize,
        sums: &mut [f32],
    ) {
        let plan = self.plan;
        let ([inputs, gradients], width) = (plan.lengths(), N * S::F32_LANES);
        let [first, of_a_point] = plan.place_of_inputs(block);
        let of_inputs = first + point * of_a_point;
        let [first, of_a_point] = plan.place_of_gradients((self.first_panel + panel) * M);
        let of_gradients = inputs + first + point * of_a_point;
        let mut added = tile::zero::<S, M, N>(simd);
        let mut left = self.tiles;
        for values in self.values.chunks_exact(inputs + gradients) {
            let count = left.min(plan.batch);
            let inputs = &values[of_inputs..][..count * width];
            added = tile::add_product::<S, M, N>(simd, added, inputs, &values[of_gradients..], plan.group);
            left -= count;
        }
        for (channel, added) in added.iter().enumerate() {
            let place = &mut sums[channel * plan.pixels() * width..][..width];
            let (vectors, _) = S::as_mut_simd_f32s(place);
            vectors.copy_from_slice(added);
        }
    }

    /// Puts the kernels of a block's channels and one small channel, `[tap of the phase][lane]`, where they belong.
    #[inline(always)]
    fn place(&mut self, block: &Block, kernel: &[f32], start: usize) {
        let (step, taps) = (self.plan.step, self.geometry.taps());
        let width = kernel.len() / (self.plan.kernel * self.plan.kernel);
        let [row, column] = [block.phase / step, block.phase % step];
        let weights = &mut self.weights[start + block.channels.start * taps..][..block.channels.len() * taps];
        if step == 1 && !self.add {
            return transpose(kernel, width, [taps, block.channels.len()], weights, taps);
        }
        for tap_row in 0..(self.geometry.kernel - row).div_ceil(step) {
            for tap_column in 0..(self.geometry.kernel - column).div_ceil(step) {
                let tap = (tap_row * step + row) * self.geometry.kernel + tap_column * step + column;
                let values = &kernel[(tap_row * self.plan.kernel + tap_column) * width..][..width];
                let places = weights[tap..].iter_mut().step_by(taps).zip(values);
                if self.add {
                    places.for_each(|(place, value)| *place += value);
                } else {
                    places.for_each(|(place, value)| *place = *value);
                }
            }
        }
    }
}

/// Sums at the points, `[point][width]`, to taps, `[tap][width]`: one vector of each.
#[inline(always)]
fn collect<S: Simd, const PAIRS: usize>(simd: S, taps: usize, width: usize, sums: &[f32], kernel: &mut [f32]) {
    let count = Points::<PAIRS>::COUNT;
    let mut tile = points::empty(simd);
    for (row, line) in tile.iter_mut().enumerate().take(count) {
        let mut values = [simd.splat_f32s(0.0); MAX_POINTS];
        for (column, value) in values.iter_mut().enumerate().take(count) {
            let scale = simd.splat_f32s(Points::<PAIRS>::SCALES[row] * Points::<PAIRS>::SCALES[column]);
            let [sum] = tile::load::<S, 1>(simd, sums, (row * count + column) * width);
            *value = simd.mul_f32s(scale, sum);
        }
        *line = Points::<PAIRS>::collect(simd, &values, taps);
    }
    for column in 0..taps {
        let values = Points::<PAIRS>::collect(simd, &points::column::<S>(simd, &tile, column, count), taps);
        for (row, value) in values.iter().enumerate().take(taps) {
            tile::store::<S>(&mut kernel[(row * taps + column) * width..], *value);
        }
    }
}
