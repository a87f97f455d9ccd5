//! Pixels to points, and points to pixels.

use super::{Chunk, LINE, Plan, Shape, Strip, Target};
use crate::points::{self, MAX_POINTS, Points};
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
                let mut tile = points::empty(simd);
                for (line, offsets) in tile.iter_mut().zip(offsets[phase].chunks_exact(points)) {
                    let mut pixels = [simd.splat_f32s(0.0); MAX_POINTS];
                    for (value, offset) in pixels.iter_mut().zip(offsets) {
                        [*value] = tile::load::<S, 1>(simd, plane, offset + vector);
                    }
                    *line = Points::<PAIRS>::analyse(simd, &pixels);
                }
                let inputs = &mut self.inputs[channel * chunk.length + vector..];
                for column in 0..points {
                    let values = Points::<PAIRS>::analyse(simd, &points::column::<S>(simd, &tile, column, points));
                    for (row, value) in values.iter().enumerate().take(points) {
                        tile::store::<S>(
                            &mut inputs[(row * points + column) * (channels * chunk.length + LINE)..],
                            *value,
                        );
                    }
                }
            }
        }
    }

    /// Transforms the products of a chunk back and puts the pixels into their rows.
    #[inline(always)]
    pub fn collect<S: Simd, const PAIRS: usize, const OUTPUTS: usize>(
        &mut self,
        simd: S,
        chunk: Chunk,
        target: Target,
    ) {
        let bias = self.work.epilogue.bias.map_or(0.0, |bias| bias[target.channel]);
        let start = target.index * (self.work.plan.pixels() * chunk.length + LINE);
        self.collect_channel::<S, PAIRS, OUTPUTS>(simd, start, chunk.length, bias);
        self.place::<OUTPUTS>(chunk, target.place, target.pass);
    }

    #[inline(always)]
    fn collect_channel<S: Simd, const PAIRS: usize, const OUTPUTS: usize>(
        &mut self,
        simd: S,
        start: usize,
        length: usize,
        bias: f32,
    ) {
        let points = Points::<PAIRS>::COUNT;
        let products = &self.products[start..][..points * points * length];
        let relu = self.work.epilogue.relu;
        for vector in (0..length).step_by(S::F32_LANES) {
            let mut tile = points::empty(simd);
            for (row, line) in tile.iter_mut().enumerate().take(points) {
                let mut values = [simd.splat_f32s(0.0); MAX_POINTS];
                for (column, value) in values.iter_mut().enumerate().take(points) {
                    [*value] = tile::load::<S, 1>(simd, products, (row * points + column) * length + vector);
                }
                *line = Points::<PAIRS>::collect(simd, &values, OUTPUTS);
            }
            for column in 0..OUTPUTS {
                let values = points::column::<S>(simd, &tile, column, points);
                let values = Points::<PAIRS>::collect(simd, &values, OUTPUTS);
                for (row, value) in values.iter().enumerate().take(OUTPUTS) {
                    let value = finish(simd, *value, bias, relu);
                    tile::store::<S>(&mut self.pixels[(row * OUTPUTS + column) * length + vector..], value);
                }
            }
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
                for pixel in 0..OUTPUTS {
                    let begin = (column * OUTPUTS + pixel) * spread + pass % spread;
                    let places = line.get_mut(begin..).unwrap_or_default().iter_mut().step_by(OUTPUTS * spread);
                    let pixels = &self.pixels[(pixel_row * OUTPUTS + pixel) * chunk.length + done..][..inside];
                    places.zip(pixels).for_each(|(place, pixel)| *place = *pixel);
                }
            }
            done += length;
        }
    }
}

/// Bias and ReLU.
#[inline(always)]
fn finish<S: Simd>(simd: S, value: S::f32s, bias: f32, relu: bool) -> S::f32s {
    let value = simd.add_f32s(value, simd.splat_f32s(bias));
    if relu { simd.max_f32s(value, simd.splat_f32s(0.0)) } else { value }
}
