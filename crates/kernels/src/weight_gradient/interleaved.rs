//! Pictures with their channels side by side.

use rayon::prelude::*;

/// Vectors may be read this far beyond the last pixel.
const SLACK: usize = 256;

/// Pictures with zeros around them and their channels side by side.
#[derive(Clone, Copy)]
pub struct Interleaved {
    channels: usize,
    /// Rows and columns of a picture, and of zeros before it.
    size: [usize; 2],
    before: [usize; 2],
    /// Rows with the zeros.
    pub rows: usize,
    /// Numbers from a pixel to the next.
    pub column_stride: usize,
    /// Numbers from a row to the next.
    pub row_stride: usize,
}

impl Interleaved {
    /// Pictures that become `extent` rows and columns large.
    pub fn new(channels: usize, size: [usize; 2], before: [usize; 2], extent: [usize; 2]) -> Self {
        let [rows, columns] = extent;
        Self { channels, size, before, rows, column_stride: channels, row_stride: columns * channels }
    }

    /// Lays out `pictures`, `[batch, channels, height, width]`.
    pub fn fill(&self, pictures: &[f32], lines: &mut Vec<f32>) {
        let (channels, [height, width]) = (self.channels, self.size);
        let batch = pictures.len() / (channels * height * width).max(1);
        lines.resize(batch * self.rows * self.row_stride + SLACK, 0.0);
        let rows = lines.par_chunks_mut(self.row_stride).take(batch * self.rows).enumerate();
        rows.with_min_len((1 << 13) / self.row_stride + 1).for_each(|(index, line)| {
            let (picture, row) = (index / self.rows, index % self.rows);
            line.fill(0.0);
            let y = row.checked_sub(self.before[0]).filter(|y| *y < height);
            let Some(y) = y else { return };
            let inside = &mut line[(self.before[1] * channels).min(self.row_stride)..];
            for channel in 0..channels {
                let pixels = &pictures[((picture * channels + channel) * height + y) * width..][..width];
                let places = inside.iter_mut().skip(channel).step_by(channels);
                places.zip(pixels).for_each(|(to, from)| *to = *from);
            }
        });
    }
}
