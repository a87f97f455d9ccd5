//! Sums computed by Winograd's filtering ([`crate::points`]).
//!
//! A tile of `n x n` positions' input (`n` points) gives `m x m` outputs, `m = n + 1 - k`. Tiles side by side are `m`
//! positions apart, so input planes are kept apart by phases of `m` positions and vectors run over tiles. Where the
//! input has a step of 2, its four phases are channels of their own with kernels half as large; where the output
//! has a spread of 2, its passes are.
//!
//! A piece of work goes through its tiles a few vectors at a time: transforms their inputs, `[point][channel][tile]`;
//! multiplies by the weights, `[point][channel][output]`, for each point a product of matrices; transforms back.

mod pack;
mod tiles;

use super::pieces::{Cut, Task};
use super::shape::Shape;
use super::{Epilogue, Method, PackedWeights};
use crate::planes::Planes;
use crate::points::MAX_POINTS;
use crate::tile;
pub use pack::Pack;
use pulp::{Simd, WithSimd};
use std::cell::Cell;

/// Most vectors of tiles at a time.
const VECTORS: usize = 3;
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
    pub source: Planes,
    /// Tiles: rows and columns.
    tiles: [usize; 2],
    /// For each phase of the input, where the pixels of a tile lie.
    offsets: Vec<Vec<usize>>,
}

impl Plan {
    /// `None` where the kernel is too large or a single tap.
    pub fn new(shape: &Shape, method: Method) -> Option<Self> {
        let pairs: usize = if method == Method::Winograd6 { 2 } else { 3 };
        let points = 2 * pairs + 2;
        let kernel = shape.reach().into_iter().max()? + 1;
        let outputs = (points + 1).checked_sub(kernel)?;
        if kernel < 2 || outputs < 2 {
            return None;
        }
        let tiles = shape.grid.map(|length| length.div_ceil(outputs));
        let phases = shape.step * outputs;
        let beyond = (shape.step * points - 1) / phases;
        let source =
            Planes::new(shape.inputs, shape.from, shape.before, phases, tiles.map(|length| length + beyond));
        let offset = |phase: usize, pixel: usize| {
            let row = shape.step * (pixel / points) + phase / shape.step;
            source.offset(row, shape.step * (pixel % points) + phase % shape.step)
        };
        let of_phase = |phase: usize| (0..points * points).map(|pixel| offset(phase, pixel)).collect();
        let offsets = (0..shape.step * shape.step).map(of_phase).collect();
        Some(Self { pairs, points, kernel, outputs, source, tiles, offsets })
    }

    fn pixels(&self) -> usize {
        self.points * self.points
    }

    /// Channels of the input, phases counted apart.
    fn channels(&self) -> usize {
        self.source.channels * self.offsets.len()
    }

    /// Numbers in the weights of an output channel.
    pub fn weights_of_a_channel(&self, shape: &Shape) -> usize {
        shape.passes.len() * self.pixels() * self.channels()
    }

    /// In multiplications of vectors of pixels, about; measured.
    pub fn cost(&self, shape: &Shape) -> f64 {
        let tiles = (self.tiles[0] * self.source.row_stride) as f64;
        let (inputs, outputs) = (self.channels() as f64, (shape.outputs * shape.passes.len()) as f64);
        let transform = 10.0 * self.pixels() as f64;
        tiles * (self.pixels() as f64 * inputs * outputs + transform * (inputs + outputs))
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
        let Plan { tiles, outputs, source, .. } = self.plan;
        let panels = self.weights.panels.len();
        let wanted = 2 * rayon::current_num_threads();
        let pieces = tiles[0].div_ceil((TILES / source.row_stride).max(1)).max(wanted.div_ceil(pictures).min(tiles[0]));
        let rows = tiles[0].div_ceil(pieces);
        let segments = pictures * tiles[0].div_ceil(rows);
        let groups = wanted.div_ceil(segments).min(panels.div_ceil(PANELS));
        Cut {
            rows,
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

/// Lends memory of the thread.
fn with_scratch<R>(length: usize, work: impl FnOnce(&mut [f32]) -> R) -> R {
    thread_local!(static SCRATCH: Cell<Vec<f32>> = const { Cell::new(Vec::new()) });
    let mut scratch = SCRATCH.take();
    if scratch.len() < length {
        scratch.resize(length, 0.0);
    }
    let result = work(&mut scratch[..length]);
    SCRATCH.set(scratch);
    result
}

impl WithSimd for Run<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Work { shape, plan, weights, .. } = *self.work;
        let numbers = plan.pixels() * VECTORS * S::F32_LANES;
        let channels: usize = weights.panels[self.task.panels.clone()].iter().map(|panel| panel.width).sum();
        let lengths = [numbers * plan.channels(), numbers * channels * shape.passes.len(), numbers];
        with_scratch(lengths.iter().sum(), |scratch| {
            let (inputs, rest) = scratch.split_at_mut(lengths[0]);
            let (products, pixels) = rest.split_at_mut(lengths[1]);
            let mut strip = Strip { work: self.work, task: self.task, inputs, products, pixels };
            strip.run(simd);
        });
    }
}

/// A piece of work with its memory.
struct Strip<'a, 'b, 's> {
    work: &'a Work<'a>,
    task: Task<'b>,
    /// Transformed inputs, `[point][channel][tile]`.
    inputs: &'s mut [f32],
    /// Products, `[output channel][pass][point][tile]`.
    products: &'s mut [f32],
    /// Results of one channel and pass, `[pixel][tile]`.
    pixels: &'s mut [f32],
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
    fn run<S: Simd>(&mut self, simd: S) {
        let Plan { source, tiles, pairs, .. } = self.work.plan;
        for segment in 0..self.task.segments.len() {
            // What lies beyond the last column of the last row is nobody's tile.
            let all = (self.task.segments[segment].rows - 1) * source.row_stride + tiles[1];
            let mut first = 0;
            while first < all {
                let vectors = (all - first).div_ceil(S::F32_LANES).min(VECTORS);
                let length = vectors * S::F32_LANES;
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
        self.multiply(simd, chunk.length);
        match self.work.plan.outputs {
            2 => self.collect::<S, PAIRS, 2>(simd, chunk),
            3 => self.collect::<S, PAIRS, 3>(simd, chunk),
            4 => self.collect::<S, PAIRS, 4>(simd, chunk),
            5 => self.collect::<S, PAIRS, 5>(simd, chunk),
            6 => self.collect::<S, PAIRS, 6>(simd, chunk),
            _ => self.collect::<S, PAIRS, 7>(simd, chunk),
        }
    }

    /// A product of matrices for each point.
    #[inline(always)]
    fn multiply<S: Simd>(&mut self, simd: S, length: usize) {
        let Work { shape, plan, weights, .. } = *self.work;
        let (passes, points, channels) = (shape.passes.len(), plan.pixels(), plan.channels());
        for point in 0..points {
            let inputs = &self.inputs[point * channels * length..][..channels * length];
            let mut products = &mut self.products[point * length..];
            for panel in &weights.panels[self.task.panels.clone()] {
                for pass in 0..passes {
                    let weights = &weights.values[panel.start + (pass * points + point) * channels * panel.width..];
                    let weights = &weights[..channels * panel.width];
                    let stride = passes * points * length;
                    let products = &mut products[pass * points * length..];
                    let vectors = length / S::F32_LANES;
                    match panel.width {
                        8 => product_of::<S, 8>(simd, inputs, weights, products, [stride, vectors]),
                        4 => product_of::<S, 4>(simd, inputs, weights, products, [stride, vectors]),
                        _ => product_of::<S, 1>(simd, inputs, weights, products, [stride, vectors]),
                    }
                }
                let next = (panel.width * passes * points * length).min(products.len());
                products = &mut products[next..];
            }
        }
    }
}

/// Products of one panel, `stride` apart from channel to channel.
#[inline(always)]
fn product_of<S: Simd, const M: usize>(
    simd: S,
    inputs: &[f32],
    weights: &[f32],
    products: &mut [f32],
    [stride, vectors]: [usize; 2],
) {
    let (weights, _) = weights.as_chunks::<M>();
    match vectors {
        1 => put::<S, M, _>(&tile::multiply::<S, M, 1>(simd, inputs, weights), products, stride),
        2 => put::<S, M, _>(&tile::multiply::<S, M, 2>(simd, inputs, weights), products, stride),
        _ => put::<S, M, _>(&tile::multiply::<S, M, VECTORS>(simd, inputs, weights), products, stride),
    }

    #[inline(always)]
    fn put<S: Simd, const M: usize, const N: usize>(sums: &[[S::f32s; N]; M], products: &mut [f32], stride: usize) {
        for (sums, line) in sums.iter().zip(products.chunks_mut(stride)) {
            let (vectors, _) = S::as_mut_simd_f32s(&mut line[..N * S::F32_LANES]);
            vectors.copy_from_slice(sums);
        }
    }
}

/// Index of a point of a tile.
const fn at(points: usize, row: usize, column: usize) -> usize {
    debug_assert!(points <= MAX_POINTS);
    row * points + column
}
