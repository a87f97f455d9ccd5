//! Pictures with zeros around them, laid out so that every tap of a kernel is a constant offset.
//!
//! With a border of zeros the pixel a tap sees lies at `position + offset` for all positions, rows run into each other
//! without a gap, and a tile of pixels may cross the end of a row: what it computes there is thrown away. Where
//! positions are several pixels apart, rows and columns that lie at the same place between positions (their phase) are
//! kept together, which makes the steps between neighbours one again.

use crate::level::Level;
use crate::memory::at_least;
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

/// Vectors may be read this far beyond the last plane.
const SLACK: usize = 256;

/// The layout of the planes of one picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Planes {
    /// Channels of the picture.
    pub channels: usize,
    /// Rows and columns of the picture.
    size: [usize; 2],
    /// Rows and columns of zeros before the picture.
    before: [usize; 2],
    /// Pixels from a position to the next: 1 or 2.
    phases: usize,
    /// Numbers from a row to the next.
    pub row_stride: usize,
    /// Numbers in the plane of one phase.
    plane: usize,
    /// Numbers from a channel to the next.
    pub channel_stride: usize,
}

impl Planes {
    /// Planes whose phases have `rows` rows of `row_stride` numbers.
    pub fn new(channels: usize, size: [usize; 2], before: [usize; 2], phases: usize, extent: [usize; 2]) -> Self {
        let [rows, row_stride] = extent;
        let plane = rows * row_stride;
        // An odd number of cache lines between channels: powers of two would all fall into the same cache sets.
        let channel_stride = ((phases * phases * plane).div_ceil(16) | 1) * 16;
        Self { channels, size, before, phases, row_stride, plane, channel_stride }
    }

    /// Offset of the pixel `row`, `column` of the padded picture from the one at position 0.
    pub fn offset(&self, row: usize, column: usize) -> usize {
        let phase = (row % self.phases) * self.phases + column % self.phases;
        phase * self.plane + (row / self.phases) * self.row_stride + column / self.phases
    }

    /// Numbers from a picture to the next.
    pub fn picture_stride(&self) -> usize {
        self.channels * self.channel_stride
    }

    /// Lays out `pictures`, `[batch, channels, height, width]`.
    pub fn fill(&self, level: Level, pictures: &[f32], planes: &mut Vec<f32>) {
        let area = self.size[0] * self.size[1];
        let count = pictures.len() / area.max(1);
        let planes = at_least(planes, count * self.channel_stride + SLACK);
        let channels = planes.par_chunks_mut(self.channel_stride).zip(pictures.par_chunks(area));
        // A few thousand numbers are a sensible piece of work.
        channels.with_min_len((1 << 14) / self.channel_stride + 1).for_each(|(planes, picture)| {
            level.run(Fill { layout: self, picture, planes });
        });
    }

    #[inline(always)]
    fn fill_phase(&self, [phase_row, phase_column]: [usize; 2], picture: &[f32], plane: &mut [f32]) {
        let [height, width] = self.size;
        for (row, line) in plane.chunks_exact_mut(self.row_stride).enumerate() {
            let y = (row * self.phases + phase_row).checked_sub(self.before[0]).filter(|y| *y < height);
            match y {
                Some(y) => self.fill_line(phase_column, &picture[y * width..][..width], line),
                None => line.fill(0.0),
            }
        }
    }

    /// A row of one phase of columns.
    #[inline(always)]
    fn fill_line(&self, phase: usize, pixels: &[f32], line: &mut [f32]) {
        // The first column of the phase that lies inside the picture, and where that is.
        let first = self.before[1].saturating_sub(phase).div_ceil(self.phases);
        let start = (first * self.phases + phase) - self.before[1];
        let count = pixels.len().saturating_sub(start).div_ceil(self.phases).min(self.row_stride - first);
        line[..first].fill(0.0);
        line[first + count..].fill(0.0);
        let inside = &mut line[first..first + count];
        // A phase may have no pixel at all in a small picture.
        let pixels = pixels.get(start..).unwrap_or(&[]);
        if self.phases == 1 { inside.copy_from_slice(&pixels[..count]) } else { take_every_other(inside, pixels) }
    }
}

/// Lays out one channel, with the widest vectors.
struct Fill<'a> {
    layout: &'a Planes,
    picture: &'a [f32],
    planes: &'a mut [f32],
}

impl WithSimd for Fill<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let phases = self.layout.phases;
        for (phase, plane) in self.planes.chunks_exact_mut(self.layout.plane).take(phases * phases).enumerate() {
            self.layout.fill_phase([phase / phases, phase % phases], self.picture, plane);
        }
    }
}

/// Takes the first of each two pixels; the last may have no partner.
#[inline(always)]
fn take_every_other(to: &mut [f32], from: &[f32]) {
    let (pairs, rest) = from.as_chunks::<2>();
    to.iter_mut().zip(pairs).for_each(|(to, pair)| *to = pair[0]);
    if let (Some(to), Some(from)) = (to.get_mut(pairs.len()), rest.first()) {
        *to = *from;
    }
}
