//! How far the picture moves between two frames: enough matching to choose a frame gap or a keyframe, and no more.
//!
//! Patches on a lattice are looked up in the other picture by the sum of absolute differences of their brightness, the
//! mean of each patch taken out, so that a changing exposure does not count as motion. The median over the patches
//! ignores the wrong matches among them. Rotation moves pixels too, so this bounds parallax from above.

use endoscape_core::{Grid, Image, Mask, Size};

/// Pictures are halved until they are at most this wide, which keeps the search short.
const WIDEST: usize = 96;
/// Half-width of a patch, pixels of the shrunk picture.
const PATCH: usize = 3;
/// Half-width of the search, pixels of the shrunk picture: about a tenth of its width.
const REACH: isize = 9;
/// Patches per side of the lattice.
const LATTICE: usize = 12;
/// Mean absolute deviation, in grey levels, below which a patch has no texture to recognise.
const LEAST_TEXTURE: f32 = 1.5;
/// A match may differ by at most this share of the patch's own deviation.
const WORST_MATCH: f32 = 0.6;
/// Fewer matches say nothing.
const LEAST_MATCHES: usize = 12;

const SIDE: usize = 2 * PATCH + 1;

/// A frame shrunk for matching; make it once and compare it often.
#[derive(Clone, Debug)]
pub struct Thumbnail {
    luma: Grid<f32>,
    /// Mean brightness of the patch around each pixel; not a number where the picture ends.
    means: Grid<f32>,
    usable: Grid<bool>,
}

impl Thumbnail {
    /// Shrinks a picture and its mask of usable pixels, which have the same size.
    pub fn new(image: &Image, usable: &Mask) -> Self {
        let (mut luma, mut usable) = (image.luma(), usable.clone());
        while luma.size().width > WIDEST {
            (luma, usable) =
                (halved(&luma, |a| 0.25 * a.iter().sum::<f32>()), halved(&usable, |a| a.iter().all(|u| *u)));
        }
        Self { means: Grid::from_fn(luma.size(), |x, y| patch_mean(&luma, x, y)), luma, usable }
    }

    /// Rows of the patch around a pixel, which lies within the picture.
    fn patch(&self, x: usize, y: usize) -> impl Iterator<Item = &[f32]> {
        (y - PATCH..=y + PATCH).map(move |row| &self.luma.row(row)[x - PATCH..=x + PATCH])
    }

    /// Mean brightness of the patch around a pixel; `None` where the picture ends.
    fn mean(&self, x: isize, y: isize) -> Option<f32> {
        let mean = *self.means.get(usize::try_from(x).ok()?, usize::try_from(y).ok()?)?;
        mean.is_finite().then_some(mean)
    }
}

fn patch_mean(luma: &Grid<f32>, x: usize, y: usize) -> f32 {
    let size = luma.size();
    if x < PATCH || y < PATCH || x + PATCH >= size.width || y + PATCH >= size.height {
        return f32::NAN;
    }
    let rows = (y - PATCH..=y + PATCH).flat_map(|row| &luma.row(row)[x - PATCH..=x + PATCH]);
    rows.sum::<f32>() / (SIDE * SIDE) as f32
}

/// Median displacement between two frames as a share of the picture's width; `None` where too little is recognised.
///
/// At 160 pixels of width, 0.02 are about 3 pixels. Displacements beyond a tenth of the width are not found.
pub fn displacement(a: &Thumbnail, b: &Thumbnail) -> Option<f64> {
    let size = a.luma.size();
    if size != b.luma.size() || size.width < 4 * SIDE || size.height < 2 * SIDE {
        return None;
    }
    let mut lengths: Vec<f32> = lattice(size).filter_map(|(x, y)| follow(a, b, x, y)).collect();
    if lengths.len() < LEAST_MATCHES {
        return None;
    }
    let middle = lengths.len() / 2;
    let median = *lengths.select_nth_unstable_by(middle, f32::total_cmp).1;
    Some(f64::from(median) / size.width as f64)
}

fn halved<T: Copy, U>(grid: &Grid<T>, reduce: impl Fn([T; 4]) -> U) -> Grid<U> {
    let size = Size::new(grid.size().width / 2, grid.size().height / 2);
    Grid::from_fn(size, |x, y| {
        let (above, below) = (grid.row(2 * y), grid.row(2 * y + 1));
        reduce([above[2 * x], above[2 * x + 1], below[2 * x], below[2 * x + 1]])
    })
}

/// Patch centres spread over the picture.
fn lattice(size: Size) -> impl Iterator<Item = (usize, usize)> {
    let place = |index: usize, extent: usize| PATCH + index * (extent - SIDE) / (LATTICE - 1);
    (0..LATTICE * LATTICE).map(move |cell| (place(cell % LATTICE, size.width), place(cell / LATTICE, size.height)))
}

/// Length of the displacement of the patch around a pixel, in pixels; `None` without texture or without a good match.
fn follow(a: &Thumbnail, b: &Thumbnail, x: usize, y: usize) -> Option<f32> {
    if !*a.usable.get(x, y)? {
        return None;
    }
    let patch = Patch::at(a, x, y)?;
    let texture = patch.0.iter().map(|value| value.abs()).sum::<f32>() / patch.0.len() as f32;
    if texture < LEAST_TEXTURE {
        return None;
    }
    let cost = |dx: isize, dy: isize| patch.difference(b, x as isize + dx, y as isize + dy);
    let offsets = (-REACH..=REACH).flat_map(|dy| (-REACH..=REACH).map(move |dx| (dx, dy)));
    let costs = offsets.map(|(dx, dy)| (cost(dx, dy), dx, dy));
    let (best, dx, dy) = costs.min_by(|a, b| a.0.total_cmp(&b.0))?;
    let at_rim = dx.abs() == REACH || dy.abs() == REACH;
    if at_rim || best > WORST_MATCH * texture {
        return None;
    }
    let u = dx as f32 + valley(cost(dx - 1, dy), best, cost(dx + 1, dy));
    let v = dy as f32 + valley(cost(dx, dy - 1), best, cost(dx, dy + 1));
    Some(u.hypot(v))
}

/// Bottom of the symmetric V through three costs at -1, 0 and 1, the shape sums of absolute differences have.
fn valley(left: f32, middle: f32, right: f32) -> f32 {
    let steeper = left.max(right) - middle;
    if !steeper.is_finite() || steeper <= 0.0 { 0.0 } else { (0.5 * (left - right) / steeper).clamp(-0.5, 0.5) }
}

/// Brightness around a pixel with the mean taken out.
struct Patch([f32; SIDE * SIDE]);

impl Patch {
    fn at(picture: &Thumbnail, x: usize, y: usize) -> Option<Self> {
        let mean = picture.mean(x as isize, y as isize)?;
        let mut values = [0.0; SIDE * SIDE];
        for (chunk, row) in values.chunks_exact_mut(SIDE).zip(picture.patch(x, y)) {
            chunk.iter_mut().zip(row).for_each(|(value, luma)| *value = luma - mean);
        }
        Some(Self(values))
    }

    /// Mean absolute difference to the patch around a pixel of another picture; infinite where that ends.
    fn difference(&self, other: &Thumbnail, x: isize, y: isize) -> f32 {
        let Some(mean) = other.mean(x, y) else { return f32::INFINITY };
        // A sum for each column: they do not wait for each other.
        let mut sums = [0.0_f32; SIDE];
        for (own, row) in self.0.chunks_exact(SIDE).zip(other.patch(x as usize, y as usize)) {
            for ((sum, own), luma) in sums.iter_mut().zip(own).zip(row) {
                *sum += (own - (luma - mean)).abs();
            }
        }
        sums.iter().sum::<f32>() / self.0.len() as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(size: Size, shift: [f64; 2], gain: f64) -> Thumbnail {
        let image = Image::from_fn(size, |x, y| {
            let (u, v) = (x as f64 - shift[0], y as f64 - shift[1]);
            let wave = |a: f64, b: f64, c: f64| (a * u + b * v + c).sin();
            let sum = wave(0.31, 0.12, 0.3) + wave(-0.17, 0.39, 1.0) + wave(0.23, -0.28, 2.0) + wave(0.61, 0.45, 0.7);
            [(gain * (110.0 + 25.0 * sum)) as u8; 3]
        });
        Thumbnail::new(&image, &Grid::filled(size, true))
    }

    #[test]
    fn shifts_are_measured_as_a_share_of_the_width_whatever_the_exposure() {
        for (size, factor) in [(Size::new(160, 128), 1.0), (Size::new(90, 60), 1.0)] {
            for shift in [[0.0, 0.0], [2.0, 1.0], [-5.0, 4.0]] {
                let moved = scene(size, [shift[0] * factor, shift[1] * factor], 1.2);
                let found = displacement(&scene(size, [0.0; 2], 1.0), &moved).unwrap();
                let expected = shift[0].hypot(shift[1]) / size.width as f64;
                assert!((found - expected).abs() < 0.006, "{size} {shift:?}: {found} instead of {expected}");
            }
        }
    }

    #[test]
    fn nothing_is_measured_without_texture_or_behind_a_mask() {
        let size = Size::new(96, 64);
        let grey = Thumbnail::new(&Image::from_fn(size, |_, _| [90; 3]), &Grid::filled(size, true));
        assert_eq!(displacement(&grey, &grey), None);
        let hidden = Thumbnail { usable: Grid::filled(size, false), ..scene(size, [0.0; 2], 1.0) };
        assert_eq!(displacement(&hidden, &hidden), None);
        let tiny =
            Thumbnail::new(&Image::from_fn(Size::new(3, 2), |_, _| [9; 3]), &Grid::filled(Size::new(3, 2), true));
        assert_eq!(displacement(&tiny, &tiny), None);
    }
}
