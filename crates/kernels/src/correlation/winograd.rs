//! Sums computed by Winograd's filtering ([`crate::points`]).
//!
//! A tile of `n x n` positions' input (`n` points) gives `m x m` outputs, `m = n + 1 - k`. Tiles side by side are `m`
//! positions apart, and vectors run over tiles. Where the input has a step of 2, its four phases are channels of their
//! own with kernels half as large; where the output has a spread of 2, its passes are.
//!
//! A piece of work goes through its tiles a few vectors at a time: transforms their inputs, `[point][channel][tile]`, first
//! along columns, with vectors along the picture's rows, then along rows, whose pixels are dealt out to their places in
//! the tiles before; then, a panel of outputs at a time, multiplies by the weights, `[point][channel][output]`, for each point a product
//! of matrices, and transforms back.

mod pack;
mod tiles;

use super::pieces::{Cut, Panel, Task};
use super::shape::Shape;
use super::{Epilogue, Method, PackedWeights};
use crate::level::Level;
use crate::memory::at_least;
use crate::tile::{self, MAX_CHANNELS};
use crate::transpose::BLOCK;
pub use pack::Pack;
use pulp::{Simd, WithSimd};
use std::cell::Cell;

/// Most vectors of tiles at a time.
const VECTORS: usize = 3;
/// Places for tiles a chunk may look at, those beyond its last ones included.
const DEALT: usize = VECTORS * 16 + BLOCK;
/// Numbers of transformed input to keep in the second level cache, from where each panel reads them.
const INPUTS: usize = 150 * 1024;
/// Tiles of a piece of work, about: enough to use every vector, few enough that there are several pieces.
const TILES: usize = 192;
/// Least panels of a piece of work: each piece transforms all of its input.
const PANELS: usize = 4;

/// How a product is computed.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Pairs of points: 2 for 6 points, 3 for 8.
    pairs: usize,
    /// Points, taps and outputs in each direction.
    points: usize,
    kernel: usize,
    outputs: usize,
    /// Channels of the input, phases counted apart.
    channels: usize,
    /// Pixels of the input from a tile to the next.
    pitch: usize,
    /// Tiles: rows and columns.
    tiles: [usize; 2],
    /// Places for tiles in a row: the last tile sees pixels of those beyond.
    row_stride: usize,
    /// For each phase of the input's columns, where the pixels of a row of a tile are dealt to.
    columns: Vec<Vec<usize>>,
}

impl Plan {
    /// `None` where the kernel is too large or a single tap, and for another method.
    pub fn new(shape: &Shape, method: Method) -> Option<Self> {
        let pairs = method.pairs()?;
        let points = 2 * pairs + 2;
        let kernel = shape.reach().into_iter().max()? + 1;
        let outputs = (points + 1).checked_sub(kernel)?;
        if kernel < 2 || outputs < 2 {
            return None;
        }
        let tiles = shape.grid.map(|length| length.div_ceil(outputs));
        let pitch = shape.step * outputs;
        let place = |pixel: usize| pixel % pitch * DEALT + pixel / pitch;
        let of_phase = |phase: usize| (0..points).map(|point| place(shape.step * point + phase)).collect();
        Some(Self {
            pairs,
            points,
            kernel,
            outputs,
            channels: shape.inputs * shape.step * shape.step,
            pitch,
            tiles,
            row_stride: tiles[1] + (shape.step * points - 1) / pitch,
            columns: (0..shape.step).map(of_phase).collect(),
        })
    }

    fn pixels(&self) -> usize {
        self.points * self.points
    }

    /// Tiles a row has room for beyond its last one.
    fn beyond(&self) -> usize {
        self.row_stride - self.tiles[1]
    }

    /// Numbers from a row of a chunk's pixels to the next: what the last block is dealt from may begin in the last tile.
    fn line_stride(&self) -> usize {
        DEALT * self.pitch + BLOCK
    }

    /// Numbers in the weights of an output channel.
    pub fn weights_of_a_channel(&self, shape: &Shape) -> usize {
        shape.passes.len() * self.pixels() * self.channels
    }

    /// In multiplications, about: those of the filtering, what the transforms cost beside them, and reading weights,
    /// which are many times as many as the taps; factors were fitted to measured times.
    pub fn cost(&self, shape: &Shape) -> f64 {
        let tiles = (self.tiles[0] * self.row_stride) as f64;
        let (inputs, outputs) = (self.channels as f64, (shape.outputs * shape.passes.len()) as f64);
        let points = self.pixels() as f64;
        let weights = points * inputs * outputs;
        tiles * (1.1 * weights + 25.0 * points * (inputs + outputs)) + 40.0 * weights
    }
}

/// A product to be computed.
pub struct Work<'a> {
    pub shape: &'a Shape,
    pub plan: &'a Plan,
    pub level: Level,
    /// The pictures as they are.
    pub pictures: &'a [f32],
    pub weights: &'a PackedWeights,
    pub epilogue: Epilogue<'a>,
}

impl Work<'_> {
    pub fn cut(&self, pictures: usize) -> Cut {
        let Plan { tiles, outputs, row_stride, .. } = self.plan;
        let panels = self.weights.panels.len();
        let wanted = rayon::current_num_threads();
        let pieces = tiles[0].div_ceil((TILES / row_stride).max(1)).max(wanted.div_ceil(pictures).min(tiles[0]));
        let groups = wanted.div_ceil(pictures * pieces).min(panels.div_ceil(PANELS));
        Cut {
            pieces,
            lines_per_row: outputs * self.shape.spread,
            grid_rows: tiles[0],
            segments_per_task: 1,
            panels_per_task: panels.div_ceil(groups.max(1)),
        }
    }
}

/// One piece of work, to be done with the widest vectors.
pub struct Run<'a, 'b> {
    pub work: &'a Work<'a>,
    pub task: Task<'b>,
}

thread_local!(
    /// Memory of a thread that is used again from piece to piece.
    static SCRATCH: Cell<Vec<f32>> = const { Cell::new(Vec::new()) }
);

/// Numbers of a cache line: strides that are multiples of a page would put all points into one set of the cache.
const LINE: usize = 16;

impl WithSimd for Run<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let plan = self.work.plan;
        let of_a_vector = plan.pixels() * plan.channels * S::F32_LANES;
        let vectors = (INPUTS / of_a_vector).clamp(1, VECTORS);
        let points = plan.pixels() * vectors * S::F32_LANES;
        let lengths = [vectors * of_a_vector + plan.pixels() * LINE, MAX_CHANNELS * (points + LINE), points];
        let [of_lines, dealt] = [plan.points * plan.line_stride(), plan.pitch * DEALT];
        // Not lent to a closure: that would be compiled without the wide vectors.
        let mut scratch = SCRATCH.take();
        let memory = at_least(&mut scratch, lengths.iter().sum::<usize>() + of_lines + dealt);
        let (inputs, rest) = memory.split_at_mut(lengths[0]);
        let (products, rest) = rest.split_at_mut(lengths[1]);
        let (pixels, rest) = rest.split_at_mut(lengths[2]);
        let (lines, dealt) = rest.split_at_mut(of_lines);
        let mut strip = Strip { work: self.work, task: self.task, inputs, products, pixels, lines, dealt };
        strip.run(simd, vectors);
        SCRATCH.set(scratch);
    }
}

/// A piece of work with its memory.
struct Strip<'a, 'b, 's> {
    work: &'a Work<'a>,
    task: Task<'b>,
    /// Transformed inputs, `[point][channel][tile]`.
    inputs: &'s mut [f32],
    /// Products of a panel, `[output channel][point][tile]`.
    products: &'s mut [f32],
    /// Results of one channel and pass, `[pixel][tile]`.
    pixels: &'s mut [f32],
    /// Rows of points of one channel and phase of rows, `[point][pixel]`, and one of them dealt out, `[pixel][tile]`.
    lines: &'s mut [f32],
    dealt: &'s mut [f32],
}

/// Tiles that are worked on together.
#[derive(Clone, Copy)]
struct Chunk {
    segment: usize,
    /// The first tile, counted from the segment's first one.
    first: usize,
    /// How many tiles are wanted, and how many numbers their vectors have.
    count: usize,
    length: usize,
}

impl Strip<'_, '_, '_> {
    #[inline(always)]
    fn run<S: Simd>(&mut self, simd: S, most_vectors: usize) {
        let Plan { row_stride, tiles, pairs, .. } = self.work.plan;
        for segment in 0..self.task.segments.len() {
            // What lies beyond the last column of the last row is nobody's tile.
            let all = (self.task.segments[segment].rows - 1) * row_stride + tiles[1];
            let mut first = 0;
            while first < all {
                // Equal chunks: a single vector has few sums for each weight that is read.
                let vectors = (all - first).div_ceil(S::F32_LANES);
                let length = vectors.div_ceil(vectors.div_ceil(most_vectors)) * S::F32_LANES;
                let chunk = Chunk { segment, first, count: length.min(all - first), length };
                match pairs {
                    2 => self.chunk::<S, 2>(simd, chunk),
                    _ => self.chunk::<S, 3>(simd, chunk),
                }
                first += length;
            }
        }
    }

    #[inline(always)]
    fn chunk<S: Simd, const PAIRS: usize>(&mut self, simd: S, chunk: Chunk) {
        self.analyse::<S, PAIRS>(simd, chunk);
        let Work { shape, weights, .. } = *self.work;
        let mut place = 0;
        for panel in &weights.panels[self.task.panels.clone()] {
            for pass in 0..shape.passes.len() {
                match panel.width {
                    8 => self.multiply::<S, 8>(simd, panel, pass, chunk.length),
                    4 => self.multiply::<S, 4>(simd, panel, pass, chunk.length),
                    _ => self.multiply::<S, 1>(simd, panel, pass, chunk.length),
                }
                for (index, channel) in panel.channels.clone().enumerate() {
                    let target = Target { index, channel, place: place + index, pass };
                    match self.work.plan.outputs {
                        2 => self.collect::<S, PAIRS, 2>(simd, chunk, target),
                        3 => self.collect::<S, PAIRS, 3>(simd, chunk, target),
                        4 => self.collect::<S, PAIRS, 4>(simd, chunk, target),
                        5 => self.collect::<S, PAIRS, 5>(simd, chunk, target),
                        6 => self.collect::<S, PAIRS, 6>(simd, chunk, target),
                        _ => self.collect::<S, PAIRS, 7>(simd, chunk, target),
                    }
                }
            }
            place += panel.channels.len();
        }
    }

    /// A product of matrices for each point.
    #[inline(always)]
    fn multiply<S: Simd, const M: usize>(&mut self, simd: S, panel: &Panel, pass: usize, length: usize) {
        let (points, channels) = (self.work.plan.pixels(), self.work.plan.channels);
        let weights = &self.work.weights.values[panel.start + pass * points * channels * M..];
        let (weights, _) = weights.as_chunks::<M>();
        let inputs = self.inputs.chunks_exact(channels * length + LINE);
        for (point, (weights, inputs)) in weights.chunks_exact(channels).zip(inputs).enumerate().take(points) {
            let inputs = &inputs[..channels * length];
            let products = &mut self.products[point * length..];
            let stride = points * length + LINE;
            match length / S::F32_LANES {
                1 => put::<S, M, 1>(&tile::multiply(simd, inputs, weights), products, stride),
                2 => put::<S, M, 2>(&tile::multiply(simd, inputs, weights), products, stride),
                _ => put::<S, M, VECTORS>(&tile::multiply(simd, inputs, weights), products, stride),
            }
        }
    }
}

/// Where products go.
#[derive(Clone, Copy)]
struct Target {
    /// The channel's place in its panel, among all, and among those of the task.
    index: usize,
    channel: usize,
    place: usize,
    pass: usize,
}

/// Stores sums, those of a channel `stride` after those of the one before.
#[inline(always)]
fn put<S: Simd, const M: usize, const N: usize>(sums: &tile::Sums<S, M, N>, products: &mut [f32], stride: usize) {
    for (sums, line) in sums.iter().zip(products.chunks_mut(stride)) {
        let (vectors, _) = S::as_mut_simd_f32s(&mut line[..N * S::F32_LANES]);
        vectors.copy_from_slice(sums);
    }
}
