//! Sums computed product by product, with vectors along output channels.
//!
//! For deep layers, which have few pixels and many weights: vectors over pixels would hardly be filled. A tile is a few
//! pixels, of whose surroundings a matrix is made, and two vectors of channels; each vector of weights is read once for all
//! pixels of the tile, in the order in which the weights lie in memory.

use super::direct;
use super::pieces::{Cut, Panel, Segment, Task};
use super::shape::Shape;
use super::{Epilogue, PackedWeights};
use crate::level::Level;
use crate::memory::at_least;
use crate::tile;
use pulp::{Simd, WithSimd};
use std::cell::Cell;
use std::ops::Range;

/// Vectors of channels in a panel.
const VECTORS: usize = 2;
/// Most channels in a panel.
const MAX_WIDTH: usize = VECTORS * 16;
/// Pixels of a tile: with two vectors of sums for each, they leave a few of 32 registers, or (AVX2) of 16, free.
const SIZES: [usize; 7] = [14, 13, 10, 7, 4, 2, 1];
const SIZES_OF_16: [usize; 4] = [6, 4, 2, 1];
/// Channels that could be computed while all pieces of work gather their pixels; fitted to measured times.
const GATHERING: usize = 48;
/// Neighbouring pixels that are copied at once: at least as many as a tile has.
const RUN: usize = 16;
/// Numbers of input that pictures of a piece of work may have together, so that they stay in the second level cache.
const WINDOW: usize = 192 * 1024;

/// How a product is computed.
#[derive(Clone, Debug)]
pub struct Plan {
    pub direct: direct::Plan,
    /// Where each output pixel's first tap lies.
    pixels: Vec<usize>,
}

impl Plan {
    /// `None` where a position has several output pixels.
    pub fn new(shape: &Shape) -> Option<Self> {
        let direct = direct::Plan::new(shape);
        let [rows, columns] = shape.grid;
        let pixel = |index: usize| index / columns * direct.source.row_stride + index % columns;
        let pixels = (0..rows * columns).map(pixel).collect();
        (shape.spread == 1).then_some(Self { direct, pixels })
    }

    /// Channels of a panel.
    pub fn width(level: Level) -> usize {
        VECTORS * level.lanes()
    }

    /// Multiplications, those of channels that fill up the last panel included, and what gathering pixels costs beside
    /// them.
    pub fn cost(&self, shape: &Shape, level: Level) -> f64 {
        let outputs = shape.outputs.next_multiple_of(Self::width(level)) + GATHERING;
        (self.pixels.len() * self.direct.weights_of_a_channel(shape) * outputs) as f64
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
    /// Some panels of all pictures that fit the cache, cut further where there are too few panels for the threads.
    pub fn cut(&self, pictures: usize) -> Cut {
        let (grid_rows, panels) = (self.shape.grid[0], self.weights.panels.len());
        let wanted = 2 * rayon::current_num_threads();
        let segments_per_task = (WINDOW / self.plan.direct.source.picture_stride().max(1)).clamp(1, pictures);
        let pieces = wanted.div_ceil(panels * pictures.div_ceil(segments_per_task)).min(grid_rows);
        let segments_per_task = if pieces > 1 { 1 } else { segments_per_task };
        let groups = wanted.div_ceil(pieces * pictures.div_ceil(segments_per_task)).min(panels);
        Cut { pieces, lines_per_row: 1, grid_rows, segments_per_task, panels_per_task: panels.div_ceil(groups) }
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

impl WithSimd for Run<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        // Not lent to a closure: that would be compiled without the wide vectors.
        let mut scratch = SCRATCH.take();
        for segment in &mut self.task.segments {
            let mut strip = Strip { work: self.work, panels: self.task.panels.clone(), segment, scratch: &mut scratch };
            // Scalar code and AVX2 have 16 registers.
            match (S::F32_LANES, strip.tile_size(S::F32_LANES)) {
                (1 | 8, 6) => strip.run::<S, 6>(simd),
                (4 | 16, 14) => strip.run::<S, 14>(simd),
                (4 | 16, 13) => strip.run::<S, 13>(simd),
                (4 | 16, 10) => strip.run::<S, 10>(simd),
                (4 | 16, 7) => strip.run::<S, 7>(simd),
                (_, 4) => strip.run::<S, 4>(simd),
                (_, 2) => strip.run::<S, 2>(simd),
                _ => strip.run::<S, 1>(simd),
            }
        }
        SCRATCH.set(scratch);
    }
}

/// Some panels of one segment.
struct Strip<'a, 'b, 's> {
    work: &'a Work<'a>,
    panels: Range<usize>,
    segment: &'a mut Segment<'b>,
    /// What the pixels of a tile see, `[input channel][tap][pixel]`.
    scratch: &'s mut Vec<f32>,
}

impl Strip<'_, '_, '_> {
    /// The size of tiles that takes least time; a tile costs about a pixel more than it has.
    fn tile_size(&self, lanes: usize) -> usize {
        let count = self.segment.rows * self.work.shape.size[1];
        let sizes: &[usize] = if matches!(lanes, 4 | 16) { &SIZES } else { &SIZES_OF_16 };
        let possible = sizes.iter().copied().filter(|size| *size <= count);
        possible.min_by_key(|size| count.div_ceil(*size) * (size + 1)).unwrap_or(1)
    }

    #[inline(always)]
    fn run<S: Simd, const M: usize>(&mut self, simd: S) {
        let Work { shape, plan, weights, .. } = self.work;
        let count = self.segment.rows * shape.size[1];
        let numbers = plan.direct.weights_of_a_channel(shape);
        let mut first = 0;
        while first < count {
            // The last tile may overlap the one before: the same numbers once more.
            first = first.min(count - M);
            self.gather::<M>(first);
            let mut channel = 0;
            for panel in &weights.panels[self.panels.clone()] {
                let (pixels, _) = self.scratch[..numbers * M].as_chunks::<M>();
                let weights = &weights.values[panel.start..][..numbers * panel.width];
                let sums = tile::multiply::<S, M, VECTORS>(simd, weights, pixels);
                let mut turned = [[0.0; MAX_WIDTH]; M];
                for (line, sums) in turned.iter_mut().zip(&sums) {
                    let (vectors, _) = S::as_mut_simd_f32s(&mut line[..VECTORS * S::F32_LANES]);
                    vectors.copy_from_slice(sums);
                }
                self.store(panel, channel, first, &turned);
                channel += panel.channels.len();
            }
            first += M;
        }
    }

    /// Puts what the pixels of a tile see side by side.
    #[inline(always)]
    fn gather<const M: usize>(&mut self, first: usize) {
        let Work { shape, plan, source, .. } = self.work;
        let (layout, columns) = (&plan.direct.source, shape.size[1]);
        let source = &source[self.segment.picture * layout.picture_stride()..];
        let first = self.segment.first_row * columns + first;
        let taps = plan.direct.taps_of_a_pass(0);
        // As far as a row goes; what is copied beyond its end is overwritten by what follows.
        let (mut runs, mut count, mut done) = ([(0, 0); M], 0, 0);
        while done < M {
            runs[count] = (done, plan.pixels[first + done]);
            done += columns - (first + done) % columns;
            count += 1;
        }
        let places = at_least(self.scratch, shape.inputs * taps.len() * M + RUN);
        for channel in 0..shape.inputs {
            let plane = &source[channel * layout.channel_stride..];
            for (index, tap) in taps.iter().enumerate() {
                let places = &mut places[(channel * taps.len() + index) * M..];
                for (place, pixel) in &runs[..count] {
                    places[*place..][..RUN].copy_from_slice(&plane[tap + pixel..][..RUN]);
                }
            }
        }
    }

    /// Adds the bias, applies the ReLU and puts the pixels of each channel of a panel into their row.
    #[inline(always)]
    fn store<const M: usize>(&mut self, panel: &Panel, channel: usize, first: usize, sums: &[[f32; MAX_WIDTH]; M]) {
        let Epilogue { bias, relu } = self.work.epilogue;
        let least = if relu { 0.0 } else { f32::NEG_INFINITY };
        for (index, number) in panel.channels.clone().enumerate() {
            let bias = bias.map_or(0.0, |bias| bias[number]);
            let line = &mut self.segment.channels[channel + index][first..][..M];
            line.iter_mut().zip(sums).for_each(|(place, sums)| *place = (sums[index] + bias).max(least));
        }
    }
}
