//! The pixels a keyframe is followed by: where the picture changes, spread over all of it.

use super::lens::Lens;
use super::pyramid::{Level, Pyramid};
use endoscape_core::Size;
use nalgebra::{Vector2, Vector3};

/// The pixel and its neighbours that are compared when depth is searched: eight of a 5 x 5 block, after J. Engel,
/// V. Koltun, D. Cremers, "Direct sparse odometry" (2018), figure 4.
pub const PATTERN: [[f64; 2]; 8] =
    [[0.0, 0.0], [-2.0, 0.0], [2.0, 0.0], [0.0, 2.0], [0.0, -2.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]];
/// Half the block the pattern needs.
pub const MARGIN: usize = 3;
/// Side of the blocks whose median gradient sets the threshold, pixels.
const BLOCK: usize = 32;
/// How far above its block's median a gradient must be, grey levels per pixel: above the noise of 8-bit video.
const ABOVE_MEDIAN: f32 = 3.0;
/// Brightness at which a pixel is taken for saturated.
const SATURATED: f32 = 250.0;

/// Inverse depth with its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InverseDepth {
    /// One over the depth along the optical axis.
    pub mean: f64,
    /// Its variance.
    pub variance: f64,
}

impl InverseDepth {
    /// Standard deviation as a share of the inverse depth.
    pub fn doubt(&self) -> f64 {
        self.variance.sqrt() / self.mean
    }
}

/// A pixel of a keyframe.
#[derive(Clone, Debug)]
pub struct Point {
    /// Where it is in the full picture.
    pub pixel: Vector2<f64>,
    /// Its ray, of depth 1.
    pub ray: Vector3<f64>,
    /// What is known of its depth.
    pub inverse_depth: InverseDepth,
    /// Trust given from outside, 0 to 1; multiplies its weight.
    pub weight: f64,
    /// Brightness of the pattern in the keyframe.
    pub brightness: [f64; PATTERN.len()],
    /// Rays of the pattern, of depth 1.
    pub rays: [Vector3<f64>; PATTERN.len()],
    /// Frames its depth was found in.
    pub found: u32,
    /// Frames its depth was not found in, since it was found last.
    pub missed: u32,
}

impl Point {
    /// A point at a place of a picture; `None` where the camera has no rays for it or the picture ends.
    pub fn new(level: &Level, lens: &Lens, pixel: Vector2<f64>, inverse_depth: InverseDepth) -> Option<Self> {
        let ray = lens.ray(&pixel)?;
        let (mut brightness, mut rays) = ([0.0; PATTERN.len()], [ray; PATTERN.len()]);
        for (index, offset) in PATTERN.iter().enumerate() {
            let at = pixel + Vector2::from(*offset);
            brightness[index] = level.sample(&at)?.value;
            rays[index] = lens.ray(&at)?;
        }
        Some(Self { pixel, ray, inverse_depth, weight: 1.0, brightness, rays, found: 0, missed: 0 })
    }
}

/// Side of the cells that each give at most one of about `count` pixels.
pub fn cell_side(size: Size, count: usize) -> usize {
    // Not every cell has a pixel to give.
    ((size.area() as f64 / (1.6 * count.max(1) as f64)).sqrt().floor() as usize).max(2)
}

/// Chooses about `count` pixels: the steepest of each cell of a grid, where it stands out from its surroundings.
pub fn select(pyramid: &Pyramid, count: usize) -> Vec<(usize, usize)> {
    let level = pyramid.level(0);
    let size = level.size();
    let cell = cell_side(size, count);
    let thresholds = thresholds(level);
    let blocks = size.width.div_ceil(BLOCK);
    let mut chosen = Vec::new();
    for top in (0..size.height).step_by(cell) {
        for left in (0..size.width).step_by(cell) {
            let threshold = thresholds[(top / BLOCK) * blocks + left / BLOCK];
            chosen.extend(steepest(pyramid, (left, top), cell, threshold));
        }
    }
    chosen
}

fn steepest(pyramid: &Pyramid, (left, top): (usize, usize), cell: usize, threshold: f32) -> Option<(usize, usize)> {
    let level = pyramid.level(0);
    let (right, bottom) = ((left + cell).min(level.size().width), (top + cell).min(level.size().height));
    let mut best = (threshold * threshold, None);
    for y in top..bottom {
        for x in left..right {
            let [value, dx, dy] = level.texel(x, y);
            let squared = dx * dx + dy * dy;
            if squared > best.0 && value < SATURATED && pyramid.is_usable(x, y, MARGIN) {
                best = (squared, Some((x, y)));
            }
        }
    }
    best.1
}

/// Median gradient of each block, raised above the noise.
fn thresholds(level: &Level) -> Vec<f32> {
    let size = level.size();
    let mut thresholds = Vec::new();
    for top in (0..size.height).step_by(BLOCK) {
        for left in (0..size.width).step_by(BLOCK) {
            let (right, bottom) = ((left + BLOCK).min(size.width), (top + BLOCK).min(size.height));
            let norm = |(x, y)| {
                let [_, dx, dy] = level.texel(x, y);
                dx.hypot(dy)
            };
            let mut norms: Vec<f32> =
                (top..bottom).flat_map(|y| (left..right).map(move |x| (x, y))).map(norm).collect();
            let middle = norms.len() / 2;
            let median = *norms.select_nth_unstable_by(middle, f32::total_cmp).1;
            thresholds.push(median + ABOVE_MEDIAN);
        }
    }
    thresholds
}
