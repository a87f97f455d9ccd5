//! Sums over the square around every pixel.

use endoscape_core::{Grid, Size};
use std::ops::Range;

/// Sum and number of the values in the square of `radius` around every pixel, cut at the edges; by running sums over
/// rows, then columns.
pub(super) fn box_sums<T>(values: &[T], size: Size, radius: usize, number: impl Fn(&T) -> u32) -> Vec<(u32, u32)> {
    let Size { width, height } = size;
    let window = |at: usize, extent: usize| at.saturating_sub(radius)..(at + radius + 1).min(extent);
    // Sums of up to 2^16 x 2^16 bytes would overflow; wrapping differences stay right while one window fits 32 bits.
    let mut integral = vec![0_u32; (width + 1) * (height + 1)];
    for y in 0..height {
        let mut row = 0_u32;
        for x in 0..width {
            row = row.wrapping_add(number(&values[y * width + x]));
            integral[(y + 1) * (width + 1) + x + 1] = integral[y * (width + 1) + x + 1].wrapping_add(row);
        }
    }
    let sum = |columns: &Range<usize>, rows: &Range<usize>| {
        let at = |x: usize, y: usize| integral[y * (width + 1) + x];
        let outer = at(columns.end, rows.end).wrapping_add(at(columns.start, rows.start));
        outer.wrapping_sub(at(columns.start, rows.end)).wrapping_sub(at(columns.end, rows.start))
    };
    let pixel = |x: usize, y: usize| {
        let (columns, rows) = (window(x, width), window(y, height));
        (sum(&columns, &rows), (columns.len() * rows.len()) as u32)
    };
    Grid::from_fn(size, pixel).into_values()
}
