//! Reading a picture between its pixels, and the gradients of that.
//!
//! Pixel centres lie at integer coordinates; positions beyond the outermost centres take the border's value and have no
//! gradient. The gradient of the positions is a gather, that of the picture a scatter, plane by plane.

use crate::pieces::PIECE;
use rayon::prelude::*;

/// Pictures to be read, and where.
///
/// # Shapes
/// - `pictures`: `[batch, channels, rows, columns]`
/// - `positions`: `[batch, 2, new rows, new columns]`: column, then row; finite
/// - `shown`: `[batch, 1, new rows, new columns]`
#[derive(Clone, Copy, Debug)]
pub struct Sampling<'a> {
    /// What is read.
    pub pictures: &'a [f32],
    /// Channels of the pictures.
    pub channels: usize,
    /// Rows and columns of the pictures.
    pub size: [usize; 2],
    /// Where it is read.
    pub positions: &'a [f32],
    /// What colours are multiplied by, if by anything; no gradient is taken of it.
    pub shown: Option<&'a [f32]>,
    /// Rows times columns of the positions.
    pub area: usize,
}

/// The four pixels around a position and how much each counts.
#[derive(Clone, Copy)]
struct Cell {
    corner: usize,
    right: usize,
    down: usize,
    /// Shares of the right and of the lower pixels.
    share: [f32; 2],
    /// Whether moving the position along columns and rows changes anything.
    free: [bool; 2],
}

impl Sampling<'_> {
    /// The colours at the positions, `[batch, channels, new rows, new columns]`.
    ///
    /// # Panics
    /// If lengths do not fit together.
    pub fn read(&self) -> Vec<f32> {
        let mut read = vec![0.0; self.batch() * self.channels * self.area];
        let pictures = read.par_chunks_mut((self.channels * self.area).max(1)).enumerate();
        pictures.for_each(|(picture, read)| {
            let mut planes: Vec<_> = read.chunks_mut(self.area).map(|plane| plane.chunks_mut(PIECE)).collect();
            let pieces: Vec<Vec<&mut [f32]>> = (0..self.area.div_ceil(PIECE))
                .map(|_| planes.iter_mut().filter_map(Iterator::next).collect())
                .collect();
            pieces.into_par_iter().enumerate().for_each(|(piece, mut planes)| {
                self.cells(picture, piece, |place, cell, shown| {
                    for (channel, plane) in planes.iter_mut().enumerate() {
                        plane[place] = shown * cell.mix(self.plane(picture, channel));
                    }
                });
            });
        });
        read
    }

    /// The gradient of the positions, shaped like them, from that of the colours.
    ///
    /// # Panics
    /// If lengths do not fit together.
    pub fn position_gradient(&self, gradient: &[f32]) -> Vec<f32> {
        assert_eq!(gradient.len(), self.batch() * self.channels * self.area);
        let mut moved = vec![0.0; self.positions.len()];
        let pictures = moved.par_chunks_mut(2 * self.area).enumerate();
        pictures.for_each(|(picture, moved)| {
            let (columns, rows) = moved.split_at_mut(self.area);
            let pieces = columns.par_chunks_mut(PIECE).zip(rows.par_chunks_mut(PIECE)).enumerate();
            pieces.for_each(|(piece, (columns, rows))| {
                self.cells(picture, piece, |place, cell, shown| {
                    let mut slope = [0.0; 2];
                    for channel in 0..self.channels {
                        let index = (picture * self.channels + channel) * self.area + piece * PIECE + place;
                        let [along, down] = cell.slopes(self.plane(picture, channel));
                        slope = [slope[0] + gradient[index] * along, slope[1] + gradient[index] * down];
                    }
                    columns[place] = if cell.free[0] { shown * slope[0] } else { 0.0 };
                    rows[place] = if cell.free[1] { shown * slope[1] } else { 0.0 };
                });
            });
        });
        moved
    }

    /// The gradient of the pictures, shaped like them, from that of the colours.
    ///
    /// # Panics
    /// If lengths do not fit together.
    pub fn picture_gradient(&self, gradient: &[f32]) -> Vec<f32> {
        assert_eq!(gradient.len(), self.batch() * self.channels * self.area);
        let mut pictures = vec![0.0; self.pictures.len()];
        let planes = pictures.par_chunks_mut((self.size[0] * self.size[1]).max(1)).enumerate();
        planes.for_each(|(index, plane)| {
            let gradient = &gradient[index * self.area..][..self.area];
            for piece in 0..self.area.div_ceil(PIECE) {
                self.cells(index / self.channels, piece, |place, cell, shown| {
                    cell.spread(plane, shown * gradient[piece * PIECE + place]);
                });
            }
        });
        pictures
    }

    fn batch(&self) -> usize {
        self.positions.len() / (2 * self.area).max(1)
    }

    fn plane(&self, picture: usize, channel: usize) -> &[f32] {
        let area = self.size[0] * self.size[1];
        &self.pictures[(picture * self.channels + channel) * area..][..area]
    }

    /// Visits the positions of a piece of a picture, each with what its colours are multiplied by.
    fn cells(&self, picture: usize, piece: usize, mut visit: impl FnMut(usize, Cell, f32)) {
        let (columns, rows) = self.positions[2 * picture * self.area..][..2 * self.area].split_at(self.area);
        let first = piece * PIECE;
        let positions = columns[first..].iter().zip(&rows[first..]).take(PIECE);
        for (place, (column, row)) in positions.enumerate() {
            let shown = self.shown.map_or(1.0, |shown| shown[picture * self.area + first + place]);
            visit(place, self.cell(*column, *row), shown);
        }
    }

    fn cell(&self, column: f32, row: f32) -> Cell {
        let [height, width] = self.size;
        let (left, right_share, along) = enclose(column, width);
        let (top, lower_share, down) = enclose(row, height);
        Cell {
            corner: top * width + left,
            // A picture one pixel wide has no right neighbour; its share is 0 there.
            right: usize::from(width > 1),
            down: if height > 1 { width } else { 0 },
            share: [right_share, lower_share],
            free: [along, down],
        }
    }
}

/// First pixel of the pair that encloses a coordinate along an axis of `length` pixels, the share of the second, and
/// whether the coordinate lies inside.
fn enclose(coordinate: f32, length: usize) -> (usize, f32, bool) {
    let last = length.saturating_sub(1) as f32;
    let clamped = coordinate.clamp(0.0, last);
    // Nothing is negative here, so cutting off the fraction rounds down.
    let first = (clamped as usize).min(length.saturating_sub(2));
    (first, clamped - first as f32, (0.0..=last).contains(&coordinate))
}

impl Cell {
    fn corners(self, plane: &[f32]) -> [f32; 4] {
        let upper = self.corner;
        let lower = upper + self.down;
        [plane[upper], plane[upper + self.right], plane[lower], plane[lower + self.right]]
    }

    fn mix(self, plane: &[f32]) -> f32 {
        let [a, b, c, d] = self.corners(plane);
        let upper = a + (b - a) * self.share[0];
        let lower = c + (d - c) * self.share[0];
        upper + (lower - upper) * self.share[1]
    }

    /// Derivatives along columns and rows.
    fn slopes(self, plane: &[f32]) -> [f32; 2] {
        let [a, b, c, d] = self.corners(plane);
        let [right, lower] = self.share;
        [(b - a) * (1.0 - lower) + (d - c) * lower, (c - a) * (1.0 - right) + (d - b) * right]
    }

    fn spread(self, plane: &mut [f32], gradient: f32) {
        let [right, lower] = self.share;
        let (upper, below) = (gradient * (1.0 - lower), gradient * lower);
        plane[self.corner] += upper * (1.0 - right);
        plane[self.corner + self.right] += upper * right;
        plane[self.corner + self.down] += below * (1.0 - right);
        plane[self.corner + self.down + self.right] += below * right;
    }
}
