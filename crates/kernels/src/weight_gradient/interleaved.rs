//! Pictures with zeros around them and their channels side by side.

use crate::memory::at_least;
use crate::transpose::transpose;
use rayon::prelude::*;

/// Vectors may be read this far beyond the last pixel.
const SLACK: usize = 256;
/// Numbers of a cache line.
const LINE: usize = 16;

/// A layout, `[picture][row][column][channel]`.
#[derive(Clone, Debug)]
pub struct Interleaved {
    channels: usize,
    /// Rows and columns of the pictures.
    size: [usize; 2],
    /// Rows and columns of zeros before a picture.
    before: [usize; 2],
    /// Rows with those of zeros around.
    pub rows: usize,
    /// Numbers from a pixel to the next, from a row to the next.
    pub column_stride: usize,
    pub row_stride: usize,
}

impl Interleaved {
    /// `extent` counts rows and columns with the zeros around; channels are filled up to a multiple of `multiple` with
    /// numbers that mean nothing.
    pub fn new(channels: usize, size: [usize; 2], before: [usize; 2], extent: [usize; 2], multiple: usize) -> Self {
        let stride = channels.next_multiple_of(multiple);
        // Pixels a multiple of a kilobyte apart would all fall into a few sets of the cache.
        let column_stride = if stride.is_multiple_of(256) { stride + LINE } else { stride };
        Self { channels, size, before, rows: extent[0], column_stride, row_stride: extent[1] * column_stride }
    }

    /// Lays out pictures, `[batch, channels, height, width]`.
    pub fn fill<'a>(&self, pictures: &[f32], lines: &'a mut Vec<f32>) -> &'a [f32] {
        let [height, width] = self.size;
        let channels = self.channels;
        let batch = pictures.len() / (channels * height * width).max(1);
        let lines = at_least(lines, batch * self.rows * self.row_stride + SLACK);
        let rows = lines.par_chunks_mut(self.row_stride).take(batch * self.rows).enumerate();
        rows.with_min_len((1 << 13) / self.row_stride + 1).for_each(|(index, line)| {
            let (picture, row) = (index / self.rows, index % self.rows);
            let y = row.checked_sub(self.before[0]).filter(|y| *y < height);
            let Some(y) = y else {
                line.fill(0.0);
                return;
            };
            let start = (self.before[1] * self.column_stride).min(self.row_stride);
            let count = width.min((self.row_stride - start) / self.column_stride);
            let (inside, after) = line[start..].split_at_mut(count * self.column_stride);
            after.fill(0.0);
            let pixels = &pictures[(picture * channels * height + y) * width..];
            transpose(pixels, height * width, [channels, count], inside, self.column_stride);
            line[..start].fill(0.0);
        });
        lines
    }
}
