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
        let width = level.panel_widths()[0];
        let of_a_channel = geometry.weights() / geometry.small_channels;
        workspace.sums.par_chunks_mut(width * of_a_channel).enumerate().for_each(|(panel, sums)| {
            let channels = panel * width..((panel + 1) * width).min(geometry.small_channels);
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
        let run = (self.interleaved.row_stride * self.geometry.stride).max(1);
        let step = (WINDOW / run).max(1);
        let mut gradients = Vec::new();
        for piece in pieces {
            for first in piece.rows.clone().step_by(step) {
                let rows = first..(first + step).min(piece.rows.end);
                let part = Piece { picture: piece.picture, rows };
                self.add_part(&part, channels.clone(), &mut gradients, sums);
            }
        }
    }

    fn add_part(&self, part: &Piece, channels: Range<usize>, gradients: &mut Vec<f32>, sums: &mut [f32]) {
        let of_a_channel = self.geometry.weights() / self.geometry.small_channels;
        let widths = self.level.panel_widths();
        let mut channel = channels.start;
        while channel < channels.end {
            let left = channels.end - channel;
            let width = *widths.iter().rev().find(|width| **width >= left).unwrap_or(&widths[0]);
            let panel = channel..channel + width.min(left);
            self.gather(part, panel.clone(), width, gradients);
            let sums = &mut sums[(channel - channels.start) * of_a_channel..][..panel.len() * of_a_channel];
            self.level.run(Panel { work: self, part, width, gradients, sums });
            channel += width;
        }
    }

    /// Gradients of a panel, `[pixel][channel]`; zero beyond the last channel.
    fn gather(&self, part: &Piece, panel: Range<usize>, width: usize, gradients: &mut Vec<f32>) {
        let [height, columns] = self.geometry.small;
        let pixels = part.rows.len() * columns;
        gradients.clear();
        gradients.resize(pixels * width, 0.0);
        for (place, channel) in panel.enumerate() {
            let plane = (part.picture * self.geometry.small_channels + channel) * height + part.rows.start;
            let values = &self.small[plane * columns..][..pixels];
            let places = gradients.iter_mut().skip(place).step_by(width);
            places.zip(values).for_each(|(to, from)| *to = *from);
        }
    }
}

/// A few output channels of a part, to be done with the widest vectors.
struct Panel<'a> {
    work: &'a Work<'a>,
    part: &'a Piece,
    width: usize,
    gradients: &'a [f32],
    sums: &'a mut [f32],
}

impl WithSimd for Panel<'_> {
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

impl Panel<'_> {
    #[inline(always)]
    fn run<S: Simd, const M: usize, const N: usize>(&mut self, simd: S) {
        let geometry = self.work.geometry;
        let run = geometry.kernel * geometry.large_channels;
        for kernel_row in 0..geometry.kernel {
            let mut place = 0;
            while place < run {
                place += match (run - place).div_ceil(S::F32_LANES) {
                    1 => self.tile::<S, M, 1>(simd, kernel_row, place, run),
                    vectors if vectors >= N => self.tile::<S, M, N>(simd, kernel_row, place, run),
                    _ => self.tile::<S, M, 2>(simd, kernel_row, place, run),
                };
            }
        }
    }

    #[inline(always)]
    fn tile<S: Simd, const M: usize, const N: usize>(
        &mut self,
        simd: S,
        kernel_row: usize,
        place: usize,
        run: usize,
    ) -> usize {
        let Work { geometry, interleaved, lines, .. } = self.work;
        let row = self.part.picture * interleaved.rows + self.part.rows.start * geometry.stride + kernel_row;
        let source = &lines[row * interleaved.row_stride + place..];
        let shape = Lines {
            rows: self.part.rows.len(),
            columns: geometry.small[1],
            row_stride: interleaved.row_stride * geometry.stride,
            column_stride: interleaved.column_stride * geometry.stride,
        };
        let (gradients, _) = self.gradients.as_chunks::<M>();
        let added = tile::outer::<S, M, N>(simd, source, shape, gradients);
        let mut scratch = [[0.0; MAX_PIXELS]; MAX_CHANNELS];
        let count = (N * S::F32_LANES).min(run - place);
        let channels = self.sums.chunks_exact_mut(geometry.kernel * run);
        for ((channel, added), line) in channels.zip(&added).zip(&mut scratch) {
            let (vectors, _) = S::as_mut_simd_f32s(&mut line[..N * S::F32_LANES]);
            vectors.copy_from_slice(added);
            let sums = &mut channel[kernel_row * run + place..][..count];
            sums.iter_mut().zip(&line[..count]).for_each(|(sum, added)| *sum += added);
        }
        N * S::F32_LANES
    }
}

/// Adds the pieces up, in their order, and brings the result into the order of the weights.
fn collect(geometry: &Geometry, sums: &[f32], weights: &mut [f32]) {
    let (taps, channels) = (geometry.taps(), geometry.large_channels);
    weights.par_chunks_mut(channels * taps).enumerate().for_each(|(output, weights)| {
        for (piece, sums) in sums.chunks_exact(geometry.weights()).enumerate() {
            let sums = &sums[output * channels * taps..][..channels * taps];
            for (tap, sums) in sums.chunks_exact(channels).enumerate() {
                let places = weights.iter_mut().skip(tap).step_by(taps);
                if piece == 0 {
                    places.zip(sums).for_each(|(to, from)| *to = *from);
                } else {
                    places.zip(sums).for_each(|(to, from)| *to += from);
                }
            }
        }
    });
}
