//! Pixels to points, and points to pixels.

use super::{BLOCK, Chunk, DEALT, LINE, Plan, Shape, Strip, Target};
use crate::points::{self, MAX_POINTS, Points};
use crate::tile;
use pulp::Simd;

/// Most pixels from a tile to the next: seven outputs two pixels apart.
const MAX_PITCH: usize = 14;
/// A row beyond the picture.
static ZEROS: [f32; DEALT * MAX_PITCH] = [0.0; DEALT * MAX_PITCH];

impl Strip<'_, '_, '_> {
    /// Transforms the input of a chunk.
    #[inline(always)]
    pub fn analyse<S: Simd, const PAIRS: usize>(&mut self, simd: S, chunk: Chunk) {
        let Shape { inputs, step, .. } = *self.work.shape;
        // Columns beyond the picture stay zero for all channels.
        self.lines.fill(0.0);
        for (input, row_phase) in (0..inputs * step).map(|index| (index / step, index % step)) {
            self.analyse_columns::<S, PAIRS>(simd, chunk, input, row_phase);
            for row in 0..Points::<PAIRS>::COUNT {
                self.deal(chunk, row);
                for column_phase in 0..step {
                    let channel = (input * step + row_phase) * step + column_phase;
                    self.analyse_row::<S, PAIRS>(simd, chunk, [row, column_phase, channel]);
                }
            }
        }
    }

    /// Transforms the columns of all tiles of a chunk, one channel and phase of rows.
    #[inline(always)]
    fn analyse_columns<S: Simd, const PAIRS: usize>(&mut self, simd: S, chunk: Chunk, input: usize, row_phase: usize) {
        let Plan { outputs, pitch, row_stride, .. } = *self.work.plan;
        let Shape { inputs, step, from: [height, width], before, .. } = *self.work.shape;
        let segment = &self.task.segments[chunk.segment];
        let [picture, first_row, last_row] = [segment.picture, segment.first_row, segment.first_row + segment.rows];
        let picture = &self.work.pictures[(picture * inputs + input) * height * width..][..height * width];
        let (mut done, all) = (0, chunk.length + self.work.plan.beyond());
        while done < all {
            let (row, column) = ((chunk.first + done) / row_stride + first_row, (chunk.first + done) % row_stride);
            if row == last_row {
                break;
            }
            let count = (row_stride - column).min(all - done);
            let skipped = before[1].saturating_sub(column * pitch);
            let first = (column * pitch).saturating_sub(before[1]);
            let length = (count * pitch).saturating_sub(skipped).min(width.saturating_sub(first));
            let mut pixels = [&ZEROS[..length]; MAX_POINTS];
            for (point, pixels) in pixels.iter_mut().enumerate() {
                let y = ((row * outputs + point) * step + row_phase).checked_sub(before[0]);
                if let Some(y) = y.filter(|y| *y < height && length > 0) {
                    *pixels = &picture[y * width + first..][..length];
                }
            }
            self.analyse_pixels::<S, PAIRS>(simd, &pixels, done * pitch + skipped);
            done += count;
        }
    }

    /// Transforms columns of pixels, of which each of the points has a row.
    #[inline(always)]
    fn analyse_pixels<S: Simd, const PAIRS: usize>(&mut self, simd: S, rows: &[&[f32]; MAX_POINTS], place: usize) {
        let stride = self.work.plan.line_stride();
        let length = rows[0].len();
        for first in (0..length).step_by(S::F32_LANES) {
            let count = S::F32_LANES.min(length - first);
            let mut pixels = [simd.splat_f32s(0.0); MAX_POINTS];
            for (value, row) in pixels.iter_mut().zip(rows).take(Points::<PAIRS>::COUNT) {
                if count == S::F32_LANES {
                    [*value] = tile::load::<S, 1>(simd, row, first);
                } else {
                    *value = simd.partial_load_f32s(&row[first..]);
                }
            }
            let values = Points::<PAIRS>::analyse(simd, &pixels);
            for (point, value) in values.iter().enumerate().take(Points::<PAIRS>::COUNT) {
                let place = &mut self.lines[point * stride + place + first..];
                if count == S::F32_LANES {
                    tile::store::<S>(place, *value);
                } else {
                    simd.partial_store_f32s(&mut place[..count], *value);
                }
            }
        }
    }

    /// Deals a row out to the places its pixels have in the tiles.
    #[inline(always)]
    fn deal(&mut self, chunk: Chunk, row: usize) {
        match self.work.plan.pitch {
            2 => self.deal_by::<2>(chunk, row),
            3 => self.deal_by::<3>(chunk, row),
            4 => self.deal_by::<4>(chunk, row),
            5 => self.deal_by::<5>(chunk, row),
            6 => self.deal_by::<6>(chunk, row),
            7 => self.deal_by::<7>(chunk, row),
            8 => self.deal_by::<8>(chunk, row),
            10 => self.deal_by::<10>(chunk, row),
            12 => self.deal_by::<12>(chunk, row),
            _ => self.deal_by::<MAX_PITCH>(chunk, row),
        }
    }

    #[inline(always)]
    fn deal_by<const PITCH: usize>(&mut self, chunk: Chunk, row: usize) {
        let line = &self.lines[row * self.work.plan.line_stride()..];
        let (dealt, _) = self.dealt.as_chunks_mut::<DEALT>();
        let dealt = &mut dealt[..PITCH];
        for first in (0..chunk.length + self.work.plan.beyond()).step_by(BLOCK) {
            let pixels = &line[first * PITCH..][..BLOCK * PITCH + BLOCK];
            let mut pixel = 0;
            while pixel < PITCH {
                // The last block may overlap the one before.
                pixel = pixel.min(PITCH.saturating_sub(BLOCK));
                let mut rows = [&[0.0; BLOCK]; BLOCK];
                for (tile, row) in rows.iter_mut().enumerate() {
                    *row = pixels[tile * PITCH + pixel..].first_chunk().unwrap_or(row);
                }
                let columns = self.work.level.transposed(rows);
                for (other, tiles) in columns.iter().enumerate().take(PITCH) {
                    dealt[pixel + other][first..][..BLOCK].copy_from_slice(tiles);
                }
                pixel += BLOCK;
            }
        }
    }

    /// Transforms rows that were dealt out: of one row of points, one phase of columns, which are those of a channel.
    #[inline(always)]
    fn analyse_row<S: Simd, const PAIRS: usize>(
        &mut self,
        simd: S,
        chunk: Chunk,
        [row, column_phase, channel]: [usize; 3],
    ) {
        let Plan { channels, columns, .. } = self.work.plan;
        let points = Points::<PAIRS>::COUNT;
        let stride = channels * chunk.length + LINE;
        for vector in (0..chunk.length).step_by(S::F32_LANES) {
            let mut pixels = [simd.splat_f32s(0.0); MAX_POINTS];
            for (value, place) in pixels.iter_mut().zip(&columns[column_phase]) {
                [*value] = tile::load::<S, 1>(simd, self.dealt, place + vector);
            }
            let values = Points::<PAIRS>::analyse(simd, &pixels);
            let inputs = &mut self.inputs[row * points * stride + channel * chunk.length + vector..];
            for (column, value) in values.iter().enumerate().take(points) {
                tile::store::<S>(&mut inputs[column * stride..], *value);
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
        let (Shape { spread, size, .. }, Plan { row_stride, tiles, .. }) = (self.work.shape, self.work.plan);
        let lines = &mut *self.task.segments[chunk.segment].channels[channel];
        let mut done = 0;
        while done < chunk.count {
            let (row, column) = ((chunk.first + done) / row_stride, (chunk.first + done) % row_stride);
            let length = (row_stride - column).min(chunk.count - done);
            let inside = length.min(tiles[1].saturating_sub(column));
            for pixel_row in 0..OUTPUTS {
                let y = (row * OUTPUTS + pixel_row) * spread + pass / spread;
                // Beyond the last row there is nothing to write.
                let Some(line) = lines.get_mut(y * size[1]..(y + 1) * size[1]) else { continue };
                let mut pixels = [&[] as &[f32]; OUTPUTS];
                for (pixel, run) in pixels.iter_mut().enumerate() {
                    *run = &self.pixels[(pixel_row * OUTPUTS + pixel) * chunk.length + done..][..inside];
                }
                let begin = column * OUTPUTS * spread + pass % spread;
                let groups = line.get_mut(begin..).unwrap_or_default().chunks_mut(OUTPUTS * spread);
                for (tile, group) in groups.enumerate().take(inside) {
                    let mut values = [0.0; OUTPUTS];
                    values.iter_mut().zip(&pixels).for_each(|(value, pixels)| *value = pixels[tile]);
                    // Whole groups of a known size are stored fastest.
                    match <&mut [f32; OUTPUTS]>::try_from(&mut *group) {
                        Ok(group) if *spread == 1 => *group = values,
                        _ => group.iter_mut().step_by(*spread).zip(values).for_each(|(to, value)| *to = value),
                    }
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
