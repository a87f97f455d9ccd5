//! The gradient of a convolution's weights and bias.
//!
//! `d weights[o][i][ky][kx] = sum_{batch, y, x} d small[o][y][x] * large[i][s y + ky - before_y][s x + kx - before_x]`.
//!
//! With the channels of the large picture side by side, the numbers that belong to all channels and all columns of a
//! row of the kernel lie in one run. A tile multiplies a vector of that run by single gradients of several output
//! channels and keeps the sums over many pixels in registers.

use crate::geometry::Geometry;
use crate::level::Level;
use crate::tile::{self, Lines, MAX_CHANNELS, MAX_PIXELS};
use pulp::{Simd, WithSimd};
use rayon::prelude::*;
use std::ops::Range;

/// Vectors may be read this far beyond the last pixel.
const SLACK: usize = 256;
/// Numbers of the large picture to go through at a time, so that they stay in the second level cache.
const WINDOW: usize = 64 * 1024;
/// Up to this many weights, pieces of the batch are summed apart and then together; beyond, panels are the pieces.
const FEW_WEIGHTS: usize = 128 * 1024;
/// Panels that read the same pixels one after the other, where panels are the pieces.
const PANELS_PER_TASK: usize = 4;
/// Pieces of the batch to aim at.
const PIECES: usize = 16;

/// Memory that is used again from call to call.
#[derive(Clone, Debug, Default)]
pub struct GradientWorkspace {
    lines: Vec<f32>,
    sums: Vec<f32>,
}

/// The gradient of the weights, `[small channels, large channels, kernel, kernel]`.
///
/// # Shapes
/// - `large`: `[batch, large channels, height, width]`, the picture on the large side
/// - `small`: `[batch, small channels, height, width]`, the one on the small side; either may be the gradient
/// - `weights`: all of it is written
///
/// # Panics
/// If lengths do not fit the geometry.
pub fn weight_gradient(
    geometry: &Geometry,
    level: Level,
    large: &[f32],
    small: &[f32],
    weights: &mut [f32],
    workspace: &mut GradientWorkspace,
) {
    let batch = small.len() / (geometry.small_channels * geometry.small_area()).max(1);
    assert_eq!(small.len(), batch * geometry.small_channels * geometry.small_area(), "small of {geometry:?}");
    assert_eq!(large.len(), batch * geometry.large_channels * geometry.large_area(), "large of {geometry:?}");
    assert_eq!(weights.len(), geometry.weights(), "weights of {geometry:?}");
    let interleaved = Interleaved::new(geometry);
    interleaved.fill(geometry, large, &mut workspace.lines);
    let work = Work { geometry, interleaved, level, lines: &workspace.lines, small };
    let pieces = work.pieces(batch);
    workspace.sums.resize(pieces.len() * geometry.weights(), 0.0);
    if pieces.len() > 1 {
        let parts = workspace.sums.par_chunks_mut(geometry.weights()).zip(pieces);
        parts.for_each(|(sums, piece)| work.add(&[piece], 0..geometry.small_channels, sums));
    } else {
        let width = PANELS_PER_TASK * level.panel_widths()[0];
        workspace.sums.par_chunks_mut(width * work.of_a_channel()).enumerate().for_each(|(task, sums)| {
            let channels = task * width..((task + 1) * width).min(geometry.small_channels);
            work.add(&work.all_rows(batch), channels, sums);
        });
    }
    collect(geometry, &workspace.sums, weights);
}

/// The gradient of the bias: the sum of each channel over the batch and all pixels, added to nothing else.
///
/// # Shapes
/// - `gradient`: `[batch, channels, area]`
/// - `bias`: `[channels]`, all of it is written
pub fn bias_gradient(gradient: &[f32], area: usize, bias: &mut [f32]) {
    let channels = bias.len();
    bias.par_iter_mut().enumerate().for_each(|(channel, bias)| {
        let planes = gradient.chunks_exact(area).skip(channel).step_by(channels);
        *bias = planes.map(sum).sum();
    });
}

/// A sum in several lanes, which vectors can compute and which loses fewer digits than one lane.
fn sum(values: &[f32]) -> f32 {
    let (lanes, rest) = values.as_chunks::<16>();
    let mut sums = [0.0_f32; 16];
    for values in lanes {
        sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
    }
    sums.iter().chain(rest).sum()
}

/// The large pictures with zeros around them and their channels side by side.
#[derive(Clone, Copy)]
struct Interleaved {
    rows: usize,
    column_stride: usize,
    row_stride: usize,
}

impl Interleaved {
    fn new(geometry: &Geometry) -> Self {
        let extent = |axis: usize| (geometry.small[axis] - 1) * geometry.stride + geometry.kernel;
        let column_stride = geometry.large_channels;
        Self { rows: extent(0), column_stride, row_stride: extent(1) * column_stride }
    }

    fn fill(&self, geometry: &Geometry, large: &[f32], lines: &mut Vec<f32>) {
        let [height, width] = geometry.large;
        let channels = geometry.large_channels;
        let batch = large.len() / (channels * height * width).max(1);
        lines.resize(batch * self.rows * self.row_stride + SLACK, 0.0);
        let rows = lines.par_chunks_mut(self.row_stride).take(batch * self.rows).enumerate();
        rows.with_min_len((1 << 13) / self.row_stride + 1).for_each(|(index, line)| {
            let (picture, row) = (index / self.rows, index % self.rows);
            line.fill(0.0);
            let y = row.checked_sub(geometry.before[0]).filter(|y| *y < height);
            let Some(y) = y else { return };
            let inside = &mut line[(geometry.before[1] * channels).min(self.row_stride)..];
            for channel in 0..channels {
                let pixels = &large[((picture * channels + channel) * height + y) * width..][..width];
                let places = inside.iter_mut().skip(channel).step_by(channels);
                places.zip(pixels).for_each(|(to, from)| *to = *from);
            }
        });
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

impl Work<'_> {
    fn all_rows(&self, batch: usize) -> Vec<Piece> {
        (0..batch).map(|picture| Piece { picture, rows: 0..self.geometry.small[0] }).collect()
    }

    /// How the batch is cut, which depends on sizes alone; a single piece where there are many weights.
    fn pieces(&self, batch: usize) -> Vec<Piece> {
        if self.geometry.weights() > FEW_WEIGHTS {
            return vec![Piece { picture: 0, rows: 0..0 }];
        }
        let rows = self.geometry.small[0];
        let step = rows.div_ceil(PIECES.div_ceil(batch.max(1)));
        let pieces = |picture: usize| {
            (0..rows).step_by(step).map(move |row| Piece { picture, rows: row..(row + step).min(rows) })
        };
        (0..batch).flat_map(pieces).collect()
    }

    /// Writes the sums over `pieces` for some output channels, `[channel][kernel row][kernel column][large channel]`.
    fn add(&self, pieces: &[Piece], channels: Range<usize>, sums: &mut [f32]) {
        sums.fill(0.0);
        let mut gradients = Vec::new();
        for window in self.windows(pieces) {
            for (panels, width) in self.panels(channels.clone()) {
                let pixels = self.gather(&window, panels.clone(), width, &mut gradients);
                let first = (panels.start - channels.start) * self.of_a_channel();
                let sums = &mut sums[first..][..panels.len() * self.of_a_channel()];
                self.level.run(Panels { work: self, window: &window, width, pixels, gradients: &gradients, sums });
            }
        }
    }

    /// What is gone through at a time: all pieces where there are many weights, which are then written once, else as
    /// many rows as the cache holds.
    fn windows(&self, pieces: &[Piece]) -> Vec<Vec<Piece>> {
        if self.geometry.weights() > FEW_WEIGHTS {
            return vec![pieces.to_vec()];
        }
        let step = (WINDOW / (self.interleaved.row_stride * self.geometry.stride).max(1)).max(1);
        let parts = |piece: &Piece| {
            let (picture, end) = (piece.picture, piece.rows.end);
            let part = move |first: usize| vec![Piece { picture, rows: first..(first + step).min(end) }];
            piece.rows.clone().step_by(step).map(part).collect::<Vec<_>>()
        };
        pieces.iter().flat_map(parts).collect()
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
        for (index, channel) in panels.enumerate() {
            let mut places = gradients[index / width * width * pixels..].iter_mut().skip(index % width).step_by(width);
            for piece in window {
                let plane = (piece.picture * self.geometry.small_channels + channel) * height + piece.rows.start;
                let values = &self.small[plane * columns..][..piece.rows.len() * columns];
                values.iter().zip(places.by_ref()).for_each(|(from, to)| *to = *from);
            }
        }
        pixels
    }

    fn of_a_channel(&self) -> usize {
        self.geometry.large_channels * self.geometry.taps()
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
        let run = self.work.geometry.kernel * self.work.geometry.large_channels;
        for kernel_row in 0..self.work.geometry.kernel {
            let mut place = 0;
            while place < run {
                place += match (run - place).div_ceil(S::F32_LANES) {
                    1 => self.column::<S, M, 1>(simd, kernel_row, place, run),
                    vectors if vectors >= N => self.column::<S, M, N>(simd, kernel_row, place, run),
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
            self.sums.chunks_mut(M * self.work.of_a_channel()).zip(self.gradients.chunks_exact(M * self.pixels));
        for (sums, gradients) in panels {
            let (mut gradients, _) = gradients.as_chunks::<M>();
            let mut added = tile::zero::<S, M, N>(simd);
            for piece in self.window {
                let (of_piece, rest) = gradients.split_at(piece.rows.len() * self.work.geometry.small[1]);
                let (source, lines) = self.work.lines(piece, kernel_row, place);
                added = tile::add_outer::<S, M, N>(simd, added, source, lines, of_piece);
                gradients = rest;
            }
            let channels = sums.chunks_exact_mut(self.work.of_a_channel());
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

/// Adds the pieces up, in their order, and brings the result into the order of the weights.
fn collect(geometry: &Geometry, sums: &[f32], weights: &mut [f32]) {
    let (taps, channels) = (geometry.taps(), geometry.large_channels);
    weights.par_chunks_mut(channels * taps).enumerate().for_each(|(output, weights)| {
        weights.fill(0.0);
        for sums in sums.chunks_exact(geometry.weights()) {
            let sums = &sums[output * channels * taps..][..channels * taps];
            for (channel, weights) in weights.chunks_exact_mut(taps).enumerate() {
                let of_channel = sums[channel..].iter().step_by(channels);
                weights.iter_mut().zip(of_channel).for_each(|(to, from)| *to += from);
            }
        }
    });
}
