//! Points followed from one picture to the next: just enough matching to judge a convention where no depth exists.
//!
//! Corners (J. Shi, C. Tomasi, CVPR 1994) are followed by normalised cross-correlation from a coarse to a fine copy of
//! the picture and kept only if following them back ends where they began.

use endoscape_core::{Grid, Image, Size};
use nalgebra::{Matrix2, Point2, Vector2};

/// Pictures are halved until they are at most this wide: motion between neighbours then stays within reach.
const WIDEST: usize = 640;

/// Cells per side of the lattice in which one corner each is looked for.
const CELLS: usize = 20;

/// Half-width of the compared patch in pixels.
const PATCH: isize = 5;

/// Half-width of the search at the coarsest level, and at the finer ones.
const SEARCH: [isize; 2] = [10, 2];

/// Halvings between the finest and the coarsest level.
const LEVELS: usize = 2;

/// A match must correlate at least so well.
const LEAST_CORRELATION: f32 = 0.8;

/// Following back must end this near the start, in pixels.
const LARGEST_RETURN: f64 = 1.0;

/// One point in both pictures, in pixels of the full-size pictures.
#[derive(Clone, Copy, Debug)]
pub struct Track {
    /// Where it is in the first picture.
    pub first: Point2<f64>,
    /// Where it is in the second.
    pub second: Point2<f64>,
}

/// Follows corners of one picture into another of the same size.
pub fn follow(first: &Image, second: &Image) -> Vec<Track> {
    let (a, b) = (Pyramid::new(first), Pyramid::new(second));
    let there_and_back = |start: Point2<f64>| {
        let second = a.find_in(&b, start)?;
        let back = b.find_in(&a, second)?;
        ((back - start).norm() <= LARGEST_RETURN).then_some((start, second))
    };
    let full = |p: Point2<f64>| Point2::from((p.coords.add_scalar(0.5)) * a.scale - Vector2::repeat(0.5));
    let tracks = corners(a.finest()).into_iter().filter_map(there_and_back);
    tracks.map(|(start, end)| Track { first: full(start), second: full(end) }).collect()
}

/// A picture in brightness, each level half the size of the one before.
struct Pyramid {
    levels: Vec<Grid<f32>>,
    /// Full-size pixels per pixel of the finest level.
    scale: f64,
}

impl Pyramid {
    fn new(image: &Image) -> Self {
        let mut finest = image.luma();
        let mut scale = 1.0;
        while finest.size().width > WIDEST {
            finest = halved(&finest);
            scale *= 2.0;
        }
        let mut levels = vec![finest];
        for _ in 0..LEVELS {
            let next = levels.last().map(halved);
            levels.extend(next);
        }
        Self { levels, scale }
    }

    fn finest(&self) -> &Grid<f32> {
        &self.levels[0]
    }

    /// Where the patch around `start` (finest level) is in another picture.
    fn find_in(&self, other: &Self, start: Point2<f64>) -> Option<Point2<f64>> {
        let mut shift = Vector2::<f64>::zeros();
        for level in (0..self.levels.len()).rev() {
            let factor = f64::from(1_u32 << level);
            let at = Point2::from(start.coords.add_scalar(0.5) / factor - Vector2::repeat(0.5));
            let reach = SEARCH[usize::from(level < LEVELS)];
            let (x, y) = (at.x.round() as isize, at.y.round() as isize);
            let guess = (shift.x.round() as isize, shift.y.round() as isize);
            let found = best_match(&self.levels[level], &other.levels[level], (x, y), guess, reach)?;
            shift = if level == 0 { found } else { found * 2.0 };
        }
        Some(start + shift)
    }
}

fn halved(grid: &Grid<f32>) -> Grid<f32> {
    let size = Size::new(grid.size().width / 2, grid.size().height / 2);
    let at = |x: usize, y: usize| grid.get(x, y).copied().unwrap_or_default();
    Grid::from_fn(size, |x, y| {
        let (x, y) = (2 * x, 2 * y);
        0.25 * (at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1))
    })
}

/// Shift of the best correlating patch near `guess`, to a fraction of a pixel.
fn best_match(
    a: &Grid<f32>,
    b: &Grid<f32>,
    (x, y): (isize, isize),
    guess: (isize, isize),
    reach: isize,
) -> Option<Vector2<f64>> {
    let patch = patch(a, x, y)?;
    let score = |dx: isize, dy: isize| self::patch(b, x + dx, y + dy).map_or(-1.0, |other| correlation(&patch, &other));
    let mut best = (-1.0_f32, 0, 0);
    for dy in guess.1 - reach..=guess.1 + reach {
        for dx in guess.0 - reach..=guess.0 + reach {
            let value = score(dx, dy);
            if value > best.0 {
                best = (value, dx, dy);
            }
        }
    }
    let (value, dx, dy) = best;
    let inside = (dx - guess.0).abs() < reach && (dy - guess.1).abs() < reach;
    if value < LEAST_CORRELATION || !inside {
        return None;
    }
    Some(Vector2::new(dx as f64, dy as f64) + peak(|u, v| f64::from(score(dx + u, dy + v))))
}

/// Top of the quadratic surface through the nine values around the best one; the mixed term matters where texture runs
/// diagonally.
fn peak(value: impl Fn(isize, isize) -> f64) -> Vector2<f64> {
    let middle = value(0, 0);
    let gradient = 0.5 * Vector2::new(value(1, 0) - value(-1, 0), value(0, 1) - value(0, -1));
    let mixed = 0.25 * (value(1, 1) - value(1, -1) - value(-1, 1) + value(-1, -1));
    let along = |plus: f64, minus: f64| plus - 2.0 * middle + minus;
    let hessian = Matrix2::new(along(value(1, 0), value(-1, 0)), mixed, mixed, along(value(0, 1), value(0, -1)));
    let top = hessian.try_inverse().map(|inverse| -(inverse * gradient));
    top.filter(|top| top.amax() <= 1.0).unwrap_or_default()
}

const SIDE: usize = (2 * PATCH + 1) as usize;

/// The patch around a pixel with mean 0 and length 1; `None` at the border or without texture.
fn patch(grid: &Grid<f32>, x: isize, y: isize) -> Option<[f32; SIDE * SIDE]> {
    let size = grid.size();
    let inside = |at: isize, extent: usize| at >= PATCH && at + PATCH < extent as isize;
    if !(inside(x, size.width) && inside(y, size.height)) {
        return None;
    }
    let mut values = [0.0; SIDE * SIDE];
    for (row, chunk) in values.chunks_exact_mut(SIDE).enumerate() {
        let start = (x - PATCH) as usize;
        chunk.copy_from_slice(&grid.row((y - PATCH) as usize + row)[start..start + SIDE]);
    }
    let mean = values.iter().sum::<f32>() / values.len() as f32;
    values.iter_mut().for_each(|value| *value -= mean);
    let norm = values.iter().map(|value| value * value).sum::<f32>().sqrt();
    values.iter_mut().for_each(|value| *value /= norm);
    // Less contrast than one grey level per pixel is noise.
    (norm > SIDE as f32).then_some(values)
}

fn correlation(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The strongest corner of each cell of the lattice.
fn corners(grid: &Grid<f32>) -> Vec<Point2<f64>> {
    let size = grid.size();
    let margin = PATCH as usize + 2;
    if size.width <= 2 * margin + CELLS || size.height <= 2 * margin + CELLS {
        return Vec::new();
    }
    let edge = |cell: usize, extent: usize| margin + cell * (extent - 2 * margin) / CELLS;
    let cells = (0..CELLS * CELLS).map(|cell| (cell % CELLS, cell / CELLS));
    let strongest = cells.filter_map(|(cx, cy)| {
        let columns = edge(cx, size.width)..edge(cx + 1, size.width);
        let rows = edge(cy, size.height)..edge(cy + 1, size.height);
        let candidates = rows.step_by(2).flat_map(|y| columns.clone().step_by(2).map(move |x| (x, y)));
        candidates.map(|(x, y)| (cornerness(grid, x, y), x, y)).max_by(|a, b| a.0.total_cmp(&b.0))
    });
    strongest.filter(|(value, ..)| *value > 20.0).map(|(_, x, y)| Point2::new(x as f64, y as f64)).collect()
}

/// Smaller eigenvalue of the gradient covariance over a 5x5 window.
fn cornerness(grid: &Grid<f32>, x: usize, y: usize) -> f32 {
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for row in y - 2..=y + 2 {
        let (above, here, below) = (grid.row(row - 1), grid.row(row), grid.row(row + 1));
        for column in x - 2..=x + 2 {
            let (gx, gy) = (0.5 * (here[column + 1] - here[column - 1]), 0.5 * (below[column] - above[column]));
            (xx, xy, yy) = (xx + gx * gx, xy + gx * gy, yy + gy * gy);
        }
    }
    0.5 * (xx + yy - ((xx - yy).powi(2) + 4.0 * xy * xy).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A smooth random texture with detail at the scale of the patch.
    fn texture(u: f64, v: f64) -> u8 {
        let wave = |a: f64, b: f64, c: f64| (a * u + b * v + c).sin();
        let sum = wave(0.31, 0.12, 0.3) + wave(-0.17, 0.39, 1.0) + wave(0.23, -0.28, 2.0) + wave(0.61, 0.45, 0.7);
        (128.0 + 28.0 * sum) as u8
    }

    fn picture(shift: Vector2<f64>) -> Image {
        Image::from_fn(Size::new(320, 240), |x, y| {
            let value = texture(x as f64 - shift.x, y as f64 - shift.y);
            [value; 3]
        })
    }

    #[test]
    fn a_shift_is_found_to_a_fraction_of_a_pixel() {
        let shift = Vector2::new(7.4, -3.3);
        let tracks = follow(&picture(Vector2::zeros()), &picture(shift));
        assert!(tracks.len() > 200, "{} tracks", tracks.len());
        let mut errors: Vec<f64> = tracks.iter().map(|track| (track.second - track.first - shift).norm()).collect();
        errors.sort_by(f64::total_cmp);
        assert!(errors[errors.len() / 2] < 0.1, "median error {}", errors[errors.len() / 2]);
    }

    #[test]
    fn nothing_is_followed_where_nothing_is_seen() {
        let grey = Image::from_fn(Size::new(320, 240), |_, _| [90; 3]);
        assert!(follow(&grey, &grey).is_empty());
        let tiny = Image::from_fn(Size::new(8, 8), |x, y| [(x * y) as u8; 3]);
        assert!(follow(&tiny, &tiny).is_empty());
    }
}
