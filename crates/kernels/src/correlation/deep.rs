//! Sums computed product by product, with vectors along output channels.
//!
//! For deep layers, which have few pixels and many weights: vectors over pixels would hardly be filled. A tile is a few
//! pixels, of whose surroundings a matrix is made, and two vectors of channels; each vector of weights is read once for all
//! pixels of the tile, in the order in which the weights lie in memory. Pixels are looked up where the picture has them:
//! rows are too short to be laid out with zeros around them first.

use super::direct;
use super::pieces::{Cut, Panel, Segment, Task};
use super::shape::{Shape, Tap};
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
const GATHERING: usize = 24;
/// Most output pixels: with more, vectors along pixels are well filled, and it would take long to say where each one looks.
const MOST_PIXELS: usize = 512;
/// Numbers of input that pictures of a piece of work may have together, so that they stay in the second level cache.
const WINDOW: usize = 192 * 1024;

/// How a product is computed.
#[derive(Clone, Debug)]
pub struct Plan {
    pub direct: direct::Plan,
    /// For each tap, where in a channel of the picture each output pixel sees it; what is outside lies beyond the last pixel.
    places: Vec<usize>,
}

impl Plan {
    /// `None` where a position has several output pixels, or there are many.
    pub fn new(shape: &Shape) -> Option<Self> {
        let ([_, columns], [height, width]) = (shape.grid, shape.from);
        let positions: usize = shape.grid.iter().product();
        let taps = (shape.spread == 1 && positions <= MOST_PIXELS).then(|| shape.passes.first())??;
        let place = |position: usize, tap: &Tap| {
            let row = (position / columns * shape.step + tap.row).checked_sub(shape.before[0]);
            let column = (position % columns * shape.step + tap.column).checked_sub(shape.before[1]);
            let inside = row.zip(column).filter(|(row, column)| *row < height && *column < width);
            inside.map_or(height * width, |(row, column)| row * width + column)
        };
        let places = taps.iter().flat_map(|tap| (0..positions).map(move |position| place(position, tap))).collect();
        Some(Self { direct: direct::Plan::new(shape), places })
    }

    /// Channels of a panel.
    pub fn width(level: Level) -> usize {
        VECTORS * level.lanes()
    }

    /// Multiplications, those of channels that fill up the last panel included, and what gathering pixels costs beside
    /// them.
    pub fn cost(&self, shape: &Shape, level: Level) -> f64 {
        let outputs = shape.outputs.next_multiple_of(Self::width(level)) + GATHERING;
        (self.places.len() * shape.inputs * outputs) as f64
    }
}

/// A product to be computed.
pub struct Work<'a> {
    pub shape: &'a Shape,
    pub plan: &'a Plan,
    /// The pictures as they are.
    pub pictures: &'a [f32],
    pub weights: &'a PackedWeights,
    pub epilogue: Epilogue<'a>,
}

impl Work<'_> {
    /// Some panels of all pictures that fit the cache, cut further where there are too few panels for the threads.
    pub fn cut(&self, pictures: usize) -> Cut {
        let (grid_rows, panels) = (self.shape.grid[0], self.weights.panels.len());
        // Each gathers all pixels of its own.
        let wanted = rayon::current_num_threads();
        let segments_per_task = (WINDOW / self.shape.input_length().max(1)).clamp(1, pictures);
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
        let Work { shape, plan, pictures, .. } = self.work;
        let (taps, area) = (plan.direct.taps_of_a_pass(0).len(), shape.from[0] * shape.from[1]);
        let numbers = shape.inputs * taps * M;
        let (matrix, rest) = at_least(self.scratch, numbers + area + 1).split_at_mut(numbers);
        // The channel being looked at, and the zero that lies around it.
        let channel = &mut rest[..=area];
        channel[area] = 0.0;
        let first = self.segment.first_row * shape.size[1] + first;
        let places = plan.places.chunks_exact(plan.places.len() / taps);
        let picture = &pictures[self.segment.picture * shape.input_length()..][..shape.input_length()];
        for (pixels, lines) in picture.chunks_exact(area).zip(matrix.chunks_exact_mut(taps * M)) {
            channel[..area].copy_from_slice(pixels);
            let (lines, _) = lines.as_chunks_mut::<M>();
            for (line, places) in lines.iter_mut().zip(places.clone()) {
                line.iter_mut().zip(&places[first..][..M]).for_each(|(number, place)| *number = channel[*place]);
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
