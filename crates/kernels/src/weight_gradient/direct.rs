//! Product by product.
//!
//! With the channels of the large picture side by side, the numbers that belong to all channels and all columns of a
//! row of the kernel lie in one run. A tile multiplies a vector of that run by single gradients of several output
//! channels and keeps the sums over a window of pixels in registers; the panels of a piece of work read the same
//! window one after the other, while it is in the second level cache.

use super::GradientWorkspace;
use super::interleaved::Interleaved;
use crate::geometry::Geometry;
use crate::level::Level;
use crate::memory::at_least;
use crate::tile::{self, Lines, MAX_CHANNELS, MAX_PIXELS};
use crate::transpose::transpose;
use pulp::{Simd, WithSimd};
use rayon::prelude::*;
use std::cell::Cell;
use std::ops::Range;

/// Pixels of a window, about: by measurement; more leave the second level cache, fewer spend their time on adding sums.
const WINDOW: usize = 1024;
/// Up to this many weights, pieces of the batch are summed apart and then together; beyond, panels are the pieces.
const FEW_WEIGHTS: usize = 128 * 1024;
/// Panels that read the same pixels one after the other, where panels are the pieces.
const PANELS_PER_TASK: usize = 4;
/// Pieces of the batch to aim at.
const PIECES: usize = 16;

/// Multiplications, about, with those of registers that are not full and what ordering the weights costs; the factor was
/// fitted to measured times.
pub fn cost(geometry: &Geometry, batch: usize, level: Level) -> f64 {
    let run = (geometry.kernel * geometry.large_channels).next_multiple_of(level.lanes());
    let multiplications = batch * geometry.small_area() * geometry.kernel * run * geometry.small_channels;
    (multiplications + 50 * geometry.weights()) as f64
}

/// Writes the gradient.
pub fn run(
    geometry: &Geometry,
    level: Level,
    [large, small]: [&[f32]; 2],
    weights: &mut [f32],
    workspace: &mut GradientWorkspace,
) {
    let batch = small.len() / (geometry.small_channels * geometry.small_area()).max(1);
    let extent = geometry.small.map(|length| (length - 1) * geometry.stride + geometry.kernel);
    let interleaved = Interleaved::new(geometry.large_channels, geometry.large, geometry.before, extent, 1);
    let lines = interleaved.fill(large, &mut workspace.large);
    let work = Work { geometry, interleaved, level, lines, small };
    if geometry.weights() > FEW_WEIGHTS {
        work.by_panels(batch, weights);
    } else {
        work.by_pieces(batch, weights, &mut workspace.sums);
    }
}

/// Rows of one picture.
#[derive(Clone)]
struct Piece {
    picture: usize,
    rows: Range<usize>,
}

struct Work<'a> {
    geometry: &'a Geometry,
    interleaved: Interleaved,
    level: Level,
    lines: &'a [f32],
    small: &'a [f32],
}

thread_local!(
    /// Memory of a thread that is used again: sums, and gradients of a window.
    static SCRATCH: Cell<[Vec<f32>; 2]> = const { Cell::new([Vec::new(), Vec::new()]) }
);

impl Work<'_> {
    /// Every task sums some output channels over the whole batch.
    fn by_panels(&self, batch: usize, weights: &mut [f32]) {
        let width = PANELS_PER_TASK * self.level.panel_widths()[0];
        let all = (0..batch).map(|picture| Piece { picture, rows: 0..self.geometry.small[0] });
        let windows = self.windows(&all.collect::<Vec<_>>());
        let of_a_channel = self.geometry.large_channels * self.geometry.taps();
        weights.par_chunks_mut(width * of_a_channel).enumerate().for_each(|(task, weights)| {
            let channels = task * width..((task + 1) * width).min(self.geometry.small_channels);
            let [mut memory, mut gradients] = SCRATCH.take();
            let sums = at_least(&mut memory, channels.len() * self.sums_of_a_channel());
            self.add(&windows, channels, sums, &mut gradients);
            let pairs = weights.chunks_exact_mut(of_a_channel).zip(sums.chunks_exact(self.sums_of_a_channel()));
            pairs.for_each(|(weights, sums)| self.ordered(sums, weights));
            SCRATCH.set([memory, gradients]);
        });
    }

    /// Every task sums all output channels over a piece of the batch; then the pieces are added up, in their order.
    fn by_pieces(&self, batch: usize, weights: &mut [f32], memory: &mut Vec<f32>) {
        let (pieces, channels) = (self.pieces(batch), self.geometry.small_channels);
        let of_a_piece = channels * self.sums_of_a_channel();
        let sums = at_least(memory, pieces.len() * of_a_piece);
        sums.par_chunks_mut(of_a_piece).zip(&pieces).for_each(|(sums, piece)| {
            let [memory, mut gradients] = SCRATCH.take();
            self.add(&self.windows(std::slice::from_ref(piece)), 0..channels, sums, &mut gradients);
            SCRATCH.set([memory, gradients]);
        });
        let of_a_channel = self.sums_of_a_channel();
        let weights = weights.par_chunks_mut(self.geometry.large_channels * self.geometry.taps());
        weights.enumerate().for_each(|(channel, weights)| {
            let mut parts = sums.chunks_exact(of_a_piece).map(|sums| &sums[channel * of_a_channel..][..of_a_channel]);
            let mut total = parts.next().unwrap_or_default().to_vec();
            for part in parts {
                total.iter_mut().zip(part).for_each(|(total, part)| *total += part);
            }
            self.ordered(&total, weights);
        });
    }

    /// Numbers in the sums of an output channel, `[kernel row][kernel column][large channel]`.
    fn sums_of_a_channel(&self) -> usize {
        self.geometry.taps() * self.interleaved.column_stride
    }

    /// Brings the sums of an output channel into the order of the weights.
    fn ordered(&self, sums: &[f32], weights: &mut [f32]) {
        let (taps, channels) = (self.geometry.taps(), self.geometry.large_channels);
        transpose(sums, self.interleaved.column_stride, [taps, channels], weights, taps);
    }

    /// How the batch is cut, which depends on sizes alone.
    fn pieces(&self, batch: usize) -> Vec<Piece> {
        let rows = self.geometry.small[0];
        let step = rows.div_ceil(PIECES.div_ceil(batch.max(1)));
        let pieces = |picture: usize| {
            (0..rows).step_by(step).map(move |row| Piece { picture, rows: row..(row + step).min(rows) })
        };
        (0..batch).flat_map(pieces).collect()
    }

    /// Writes the sums over `windows` for some output channels.
    fn add(&self, windows: &[Vec<Piece>], channels: Range<usize>, sums: &mut [f32], gradients: &mut Vec<f32>) {
        sums.fill(0.0);
        for window in windows {
            for (panels, width) in self.panels(channels.clone()) {
                let pixels = self.gather(window, panels.clone(), width, gradients);
                let first = (panels.start - channels.start) * self.sums_of_a_channel();
                let sums = &mut sums[first..][..panels.len() * self.sums_of_a_channel()];
                self.level.run(Panels { work: self, window, width, pixels, gradients, sums });
            }
        }
    }

    /// What is gone through at a time: rows of one picture, or several small pictures.
    fn windows(&self, pieces: &[Piece]) -> Vec<Vec<Piece>> {
        let columns = self.geometry.small[1];
        let mut windows: Vec<Vec<Piece>> = Vec::new();
        let mut room = 0;
        for Piece { picture, rows } in pieces {
            let mut rows = rows.clone();
            while !rows.is_empty() {
                if room == 0 {
                    windows.push(Vec::new());
                    room = WINDOW.div_ceil(columns);
                }
                let end = (rows.start + room).min(rows.end);
                room -= end - rows.start;
                if let Some(window) = windows.last_mut() {
                    window.push(Piece { picture: *picture, rows: rows.start..end });
                }
                rows.start = end;
            }
        }
        windows
    }

    /// Output channels in panels of the widest width, and what is left in a narrower one.
    fn panels(&self, channels: Range<usize>) -> Vec<(Range<usize>, usize)> {
        let widths = self.level.panel_widths();
        let whole = channels.start + channels.len() / widths[0] * widths[0];
        let left = channels.end - whole;
        let narrow = *widths.iter().rev().find(|width| **width >= left).unwrap_or(&widths[0]);
        let parts = [(channels.start..whole, widths[0]), (whole..channels.end, narrow)];
        parts.into_iter().filter(|(channels, _)| !channels.is_empty()).collect()
    }

    /// Gradients of panels, `[panel][pixel][channel]`, zero beyond the last channel; returns the number of pixels.
    fn gather(&self, window: &[Piece], panels: Range<usize>, width: usize, gradients: &mut Vec<f32>) -> usize {
        let [height, columns] = self.geometry.small;
        let pixels: usize = window.iter().map(|piece| piece.rows.len() * columns).sum();
        gradients.clear();
        gradients.resize(panels.len().div_ceil(width) * width * pixels, 0.0);
        for (panel, places) in gradients.chunks_exact_mut(width * pixels).enumerate() {
            let first = panels.start + panel * width;
            let channels = width.min(panels.end - first);
            let mut done = 0;
            for piece in window {
                let count = piece.rows.len() * columns;
                let plane = (piece.picture * self.geometry.small_channels + first) * height + piece.rows.start;
                let places = &mut places[done * width..][..count * width];
                transpose(&self.small[plane * columns..], height * columns, [channels, count], places, width);
                done += count;
            }
        }
        pixels
    }
}

/// Panels of output channels over a window, to be done with the widest vectors.
struct Panels<'a> {
    work: &'a Work<'a>,
    window: &'a [Piece],
    width: usize,
    pixels: usize,
    gradients: &'a [f32],
    sums: &'a mut [f32],
}

impl WithSimd for Panels<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        match (self.width, S::F32_LANES) {
            (8, _) => self.run::<S, 8, 3>(simd),
            (4, 8) => self.run::<S, 4, 3>(simd),
            (4, _) => self.run::<S, 4, 6>(simd),
            _ => self.run::<S, 1, 8>(simd),
        }
    }
}

impl Panels<'_> {
    /// Panels innermost: they all read the same pixels.
    #[inline(always)]
    fn run<S: Simd, const M: usize, const N: usize>(&mut self, simd: S) {
        let run = self.work.geometry.kernel * self.work.interleaved.column_stride;
        for kernel_row in 0..self.work.geometry.kernel {
            let mut place = 0;
            while place < run {
                place += match (run - place).div_ceil(S::F32_LANES) {
                    1 => self.column::<S, M, 1>(simd, kernel_row, place, run),
                    // Two and two: a single vector has too few sums for a load to pay off.
                    vectors if vectors >= N && vectors != 4 => self.column::<S, M, N>(simd, kernel_row, place, run),
                    _ => self.column::<S, M, 2>(simd, kernel_row, place, run),
                };
            }
        }
    }

    /// `N` vectors of weights of all panels; returns how many numbers that is.
    #[inline(always)]
    fn column<S: Simd, const M: usize, const N: usize>(
        &mut self,
        simd: S,
        kernel_row: usize,
        place: usize,
        run: usize,
    ) -> usize {
        let mut scratch = [[0.0; MAX_PIXELS]; MAX_CHANNELS];
        let count = (N * S::F32_LANES).min(run - place);
        let panels =
            self.sums.chunks_mut(M * self.work.sums_of_a_channel()).zip(self.gradients.chunks_exact(M * self.pixels));
        for (sums, gradients) in panels {
            let (mut gradients, _) = gradients.as_chunks::<M>();
            let mut added = tile::zero::<S, M, N>(simd);
            for piece in self.window {
                let (of_piece, rest) = gradients.split_at(piece.rows.len() * self.work.geometry.small[1]);
                let (source, lines) = self.work.lines(piece, kernel_row, place);
                added = tile::add_outer::<S, M, N>(simd, added, source, lines, of_piece);
                gradients = rest;
            }
            let channels = sums.chunks_exact_mut(self.work.sums_of_a_channel());
            for ((channel, added), line) in channels.zip(&added).zip(&mut scratch) {
                let (vectors, _) = S::as_mut_simd_f32s(&mut line[..N * S::F32_LANES]);
                vectors.copy_from_slice(added);
                let sums = &mut channel[kernel_row * run + place..][..count];
                sums.iter_mut().zip(&line[..count]).for_each(|(sum, added)| *sum += added);
            }
        }
        N * S::F32_LANES
    }
}

impl Work<'_> {
    /// The pixels that a row of the kernel sees from a piece of the small picture, beginning at a place of its run.
    fn lines(&self, piece: &Piece, kernel_row: usize, place: usize) -> (&[f32], Lines) {
        let Work { geometry, interleaved, lines, .. } = self;
        let row = piece.picture * interleaved.rows + piece.rows.start * geometry.stride + kernel_row;
        let shape = Lines {
            rows: piece.rows.len(),
            columns: geometry.small[1],
            row_stride: interleaved.row_stride * geometry.stride,
            column_stride: interleaved.column_stride * geometry.stride,
        };
        (&lines[row * interleaved.row_stride + place..], shape)
    }
}
