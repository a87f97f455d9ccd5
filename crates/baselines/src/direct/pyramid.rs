//! A picture and its halves, brightness with gradient, each with its camera.

use super::lens::Lens;
use endoscape_core::{Camera, CameraError, Grid, Image, Mask, Rect, Size};
use nalgebra::Vector2;
use std::sync::Arc;

/// Smallest side of the coarsest level, pixels.
const SMALLEST_SIDE: usize = 24;

/// Brightness and its gradient at one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Brightness, 0 to 255.
    pub value: f64,
    /// Its derivative per pixel, by column and row.
    pub gradient: Vector2<f64>,
}

/// The cameras of all levels, finest first; made once per video.
#[derive(Clone, Debug)]
pub struct Lenses(Vec<Lens>);

impl Lenses {
    /// Halves a camera up to `levels - 1` times, as long as the picture stays large enough to say something.
    ///
    /// # Errors
    /// [`CameraError`] for a camera that cannot be scaled.
    pub fn new(camera: &Camera, levels: usize) -> Result<Self, CameraError> {
        let mut lenses = vec![Lens::new(*camera)];
        while let Some(last) = lenses.last().filter(|_| lenses.len() < levels) {
            let half = half(last.camera().size());
            if half.width.min(half.height) < SMALLEST_SIDE {
                break;
            }
            // Whole pairs of pixels only, so that edges map to edges.
            let even = Rect { x: 0, y: 0, size: Size::new(2 * half.width, 2 * half.height) };
            let camera = last.camera().cropped(even)?.scaled_to(half)?;
            lenses.push(Lens::new(camera));
        }
        Ok(Self(lenses))
    }

    /// The camera of a level, 0 being the full picture.
    pub fn level(&self, level: usize) -> &Lens {
        &self.0[level]
    }

    /// Number of levels.
    pub const fn count(&self) -> usize {
        self.0.len()
    }
}

const fn half(size: Size) -> Size {
    Size::new(size.width / 2, size.height / 2)
}

/// One level: `[brightness, d/dx, d/dy]` per pixel.
#[derive(Clone, Debug)]
pub struct Level {
    size: Size,
    texels: Vec<[f32; 3]>,
}

impl Level {
    fn new(luma: &Grid<f32>) -> Self {
        let size = luma.size();
        let at = |x: usize, y: usize| luma.values()[y * size.width + x];
        let texels = Grid::from_fn(size, |x, y| {
            let (left, right) = (x.saturating_sub(1), (x + 1).min(size.width - 1));
            let (up, down) = (y.saturating_sub(1), (y + 1).min(size.height - 1));
            let slope = |high: f32, low: f32, span: usize| (high - low) / span.max(1) as f32;
            [at(x, y), slope(at(right, y), at(left, y), right - left), slope(at(x, down), at(x, up), down - up)]
        });
        Self { size, texels: texels.into_values() }
    }

    /// Extent in pixels.
    pub const fn size(&self) -> Size {
        self.size
    }

    /// Brightness and gradient at a whole pixel, which must exist.
    pub fn texel(&self, x: usize, y: usize) -> [f32; 3] {
        self.texels[y * self.size.width + x]
    }

    /// Bilinear reading between pixels; `None` outside the picture.
    pub fn sample(&self, pixel: &Vector2<f64>) -> Option<Sample> {
        let (limit_x, limit_y) = (self.size.width as f64 - 1.001, self.size.height as f64 - 1.001);
        if !(pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < limit_x && pixel.y < limit_y) {
            return None;
        }
        let (column, row) = (pixel.x as usize, pixel.y as usize);
        let (fx, fy) = ((pixel.x - column as f64) as f32, (pixel.y - row as f64) as f32);
        let corner = row * self.size.width + column;
        let (a, b) = (self.texels[corner], self.texels[corner + 1]);
        let (c, d) = (self.texels[corner + self.size.width], self.texels[corner + self.size.width + 1]);
        let mix = |i: usize| {
            let (top, bottom) = (a[i] + fx * (b[i] - a[i]), c[i] + fx * (d[i] - c[i]));
            f64::from(top + fy * (bottom - top))
        };
        Some(Sample { value: mix(0), gradient: Vector2::new(mix(1), mix(2)) })
    }
}

/// All levels of one picture, finest first.
#[derive(Clone, Debug)]
pub struct Pyramid {
    levels: Vec<Level>,
    usable: Option<Arc<Mask>>,
}

impl Pyramid {
    /// Makes as many levels as there are cameras.
    pub fn new(image: &Image, usable: Option<Arc<Mask>>, lenses: &Lenses) -> Self {
        let mut luma = image.luma();
        let mut levels = vec![Level::new(&luma)];
        while levels.len() < lenses.count() {
            luma = halved(&luma);
            levels.push(Level::new(&luma));
        }
        Self { levels, usable }
    }

    /// A level, 0 being the full picture.
    pub fn level(&self, level: usize) -> &Level {
        &self.levels[level]
    }

    /// Whether all pixels within `margin` of a pixel of the full picture may be used.
    pub fn is_usable(&self, x: usize, y: usize, margin: usize) -> bool {
        let size = self.levels[0].size();
        if x < margin || y < margin || x + margin >= size.width || y + margin >= size.height {
            return false;
        }
        let Some(mask) = &self.usable else { return true };
        let row = |row: usize| mask.row(row)[x - margin..=x + margin].iter().all(|usable| *usable);
        (y - margin..=y + margin).all(row)
    }
}

fn halved(luma: &Grid<f32>) -> Grid<f32> {
    Grid::from_fn(half(luma.size()), |x, y| {
        let (top, bottom) = (luma.row(2 * y), luma.row(2 * y + 1));
        0.25 * (top[2 * x] + top[2 * x + 1] + bottom[2 * x] + bottom[2 * x + 1])
    })
}

/// Where a pixel of the full picture lies at a level: edges map to edges.
pub fn at_level(pixel: &Vector2<f64>, level: usize) -> Vector2<f64> {
    let scale = 0.5_f64.powi(level as i32);
    pixel.map(|p| (p + 0.5) * scale - 0.5)
}
