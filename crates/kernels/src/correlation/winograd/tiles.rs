//! Pixels to points, and points to pixels.

use super::{Chunk, Epilogue, Plan, Shape, Strip, Work, at};
use crate::points::{MAX_POINTS, Points};
use crate::tile;
use pulp::Simd;

impl Strip<'_, '_, '_> {
    /// Transforms the input of a chunk.
    #[inline(always)]
    pub fn analyse<S: Simd, const PAIRS: usize>(&mut self, simd: S, chunk: Chunk) {
        let Plan { source, offsets, .. } = self.work.plan;
        let segment = &self.task.segments[chunk.segment];
        let start = segment.picture * source.picture_stride() + segment.first_row * source.row_stride + chunk.first;
        let points = Points::<PAIRS>::COUNT;
        let channels = self.work.plan.channels();
        for channel in 0..channels {
            let (input, phase) = (channel / offsets.len(), channel % offsets.len());
            let plane = &self.work.source[start + input * source.channel_stride..];
            for vector in (0..chunk.length).step_by(S::F32_LANES) {
                let line = |row: usize| {
                    let mut line = [simd.splat_f32s(0.0); MAX_POINTS];
                    for (value, offset) in line.iter_mut().zip(&offsets[phase][row * points..][..points]) {
                        [*value] = tile::load::<S, 1>(simd, plane, offset + vector);
                    }
                    line
                };
                let step = |line: &[S::f32s; MAX_POINTS]| Points::<PAIRS>::analyse(simd, line);
                let inputs = &mut self.inputs[channel * chunk.length + vector..];
                Points::<PAIRS>::both(simd, points, line, step, points, |column, values| {
                    for (row, value) in values.iter().enumerate().take(points) {
                        store(simd, &mut inputs[at(points, row, column) * channels * chunk.length..], *value);
                    }
                });
            }
        }
    }

    /// Transforms the products of a chunk back and puts the pixels into their rows.
    #[inline(always)]
    pub fn collect<S: Simd, const PAIRS: usize, const OUTPUTS: usize>(&mut self, simd: S, chunk: Chunk) {
        let Work { shape, weights, epilogue, .. } = *self.work;
        let (passes, points) = (shape.passes.len(), self.work.plan.pixels());
        let (mut first, mut place) = (0, 0);
        for panel in &weights.panels[self.task.panels.clone()] {
            for (index, channel) in panel.channels.clone().enumerate() {
                let bias = epilogue.bias.map_or(0.0, |bias| bias[channel]);
                for pass in 0..passes {
                    let start = ((first + index) * passes + pass) * points * chunk.length;
                    let finish = |value| finish(simd, value, bias, epilogue);
                    self.collect_channel::<S, PAIRS, OUTPUTS>(simd, start, chunk.length, finish);
                    self.place::<OUTPUTS>(chunk, place + index, pass);
                }
            }
            first += panel.width;
            place += panel.channels.len();
        }
    }

    #[inline(always)]
    fn collect_channel<S: Simd, const PAIRS: usize, const OUTPUTS: usize>(
        &mut self,
        simd: S,
        start: usize,
        length: usize,
        finish: impl Fn(S::f32s) -> S::f32s,
    ) {
        let points = Points::<PAIRS>::COUNT;
        let products = &self.products[start..][..points * points * length];
        for vector in (0..length).step_by(S::F32_LANES) {
            let line = |row: usize| {
                let mut line = [simd.splat_f32s(0.0); MAX_POINTS];
                for (column, value) in line.iter_mut().enumerate().take(points) {
                    [*value] = tile::load::<S, 1>(simd, products, at(points, row, column) * length + vector);
                }
                line
            };
            let step = |line: &[S::f32s; MAX_POINTS]| Points::<PAIRS>::collect(simd, line, OUTPUTS);
            let pixels = &mut self.pixels[vector..];
            Points::<PAIRS>::both(simd, points, line, step, OUTPUTS, |column, values| {
                for (row, value) in values.iter().enumerate().take(OUTPUTS) {
                    store(simd, &mut pixels[at(OUTPUTS, row, column) * length..], finish(*value));
                }
            });
        }
    }

    /// Puts the pixels of a chunk of one channel and pass into their rows.
    #[inline(always)]
    fn place<const OUTPUTS: usize>(&mut self, chunk: Chunk, channel: usize, pass: usize) {
        let (Shape { spread, size, .. }, Plan { source, tiles, .. }) = (self.work.shape, self.work.plan);
        let lines = &mut *self.task.segments[chunk.segment].channels[channel];
        let mut done = 0;
        while done < chunk.count {
            let (row, column) = ((chunk.first + done) / source.row_stride, (chunk.first + done) % source.row_stride);
            let length = (source.row_stride - column).min(chunk.count - done);
            let inside = length.min(tiles[1].saturating_sub(column));
            for pixel_row in 0..OUTPUTS {
                let y = (row * OUTPUTS + pixel_row) * spread + pass / spread;
                // Beyond the last row there is nothing to write.
                let Some(line) = lines.get_mut(y * size[1]..(y + 1) * size[1]) else { continue };
                let begin = (column * OUTPUTS * spread + pass % spread).min(size[1]);
                let pixels = &self.pixels[pixel_row * OUTPUTS * chunk.length..][..OUTPUTS * chunk.length];
                interleave::<OUTPUTS>(&mut line[begin..], *spread, pixels, done..done + inside);
            }
            done += length;
        }
    }
}

/// Writes pixels, `[column][tile]`, side by side, `spread` apart.
#[inline(always)]
fn interleave<const OUTPUTS: usize>(
    line: &mut [f32],
    spread: usize,
    pixels: &[f32],
    tiles: std::ops::Range<usize>,
) {
    let columns: [&[f32]; OUTPUTS] = {
        let mut columns = pixels.chunks_exact(pixels.len() / OUTPUTS);
        std::array::from_fn(|_| columns.next().map_or(&[] as &[f32], |column| &column[tiles.clone()]))
    };
    let count = (tiles.len() * OUTPUTS * spread).min(line.len());
    let line = &mut line[..count];
    if spread == 1 {
        for (tile, group) in line.chunks_mut(OUTPUTS).enumerate() {
            for (value, column) in group.iter_mut().zip(&columns) {
                *value = column[tile];
            }
        }
    } else {
        for (index, value) in line.iter_mut().step_by(spread).enumerate() {
            *value = columns[index % OUTPUTS][index / OUTPUTS];
        }
    }
}

/// Bias and ReLU.
#[inline(always)]
fn finish<S: Simd>(simd: S, value: S::f32s, bias: f32, epilogue: Epilogue<'_>) -> S::f32s {
    let value = simd.add_f32s(value, simd.splat_f32s(bias));
    if epilogue.relu { simd.max_f32s(value, simd.splat_f32s(0.0)) } else { value }
}

#[inline(always)]
fn store<S: Simd>(_: S, place: &mut [f32], value: S::f32s) {
    let (vectors, _) = S::as_mut_simd_f32s(&mut place[..S::F32_LANES]);
    vectors[0] = value;
}
