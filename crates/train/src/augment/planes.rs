//! Pictures as the networks take them: three planes of numbers.

use endoscape_core::{Image, Size};

/// Red, green and blue plane one after the other, row after row, each value 0 to 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Planes {
    size: Size,
    values: Vec<f32>,
}

impl Planes {
    /// The picture, unchanged.
    pub fn new(image: &Image) -> Self {
        let plane = |channel: usize| image.rgb().iter().skip(channel).step_by(3).map(|value| f32::from(*value) / 255.0);
        Self { size: image.size(), values: (0..3).flat_map(plane).collect() }
    }

    /// Computes each pixel from its column and row.
    pub fn from_fn(size: Size, mut rgb: impl FnMut(usize, usize) -> [f32; 3]) -> Self {
        let area = size.area();
        let mut values = vec![0.0; 3 * area];
        for pixel in 0..area {
            let colour = rgb(pixel % size.width, pixel / size.width);
            for (channel, value) in colour.into_iter().enumerate() {
                values[channel * area + pixel] = value;
            }
        }
        Self { size, values }
    }

    /// Extent in pixels.
    pub const fn size(&self) -> Size {
        self.size
    }

    /// All values, plane after plane.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// Mean of all values.
    pub fn mean(&self) -> f32 {
        self.values.iter().sum::<f32>() / self.values.len().max(1) as f32
    }

    /// Changes each pixel, given its column and row; what leaves 0 to 1 is cut off.
    pub fn map_pixels(&mut self, change: impl Fn(usize, usize, [f32; 3]) -> [f32; 3]) {
        let area = self.size.area();
        for pixel in 0..area {
            let old = [0, 1, 2].map(|channel| self.values[channel * area + pixel]);
            let new = change(pixel % self.size.width, pixel / self.size.width, old);
            for (channel, value) in new.into_iter().enumerate() {
                self.values[channel * area + pixel] = value.clamp(0.0, 1.0);
            }
        }
    }

    /// Colour at a place between pixel centres, bilinear; the rim is continued outwards.
    pub fn sample(&self, x: f32, y: f32) -> [f32; 3] {
        let Size { width, height } = self.size;
        let (x, y) = (x.clamp(0.0, (width - 1) as f32), y.clamp(0.0, (height - 1) as f32));
        let (left, top) = (x as usize, y as usize);
        let (right, bottom) = ((left + 1).min(width - 1), (top + 1).min(height - 1));
        let (u, v) = (x - left as f32, y - top as f32);
        let area = self.size.area();
        [0, 1, 2].map(|channel| {
            let at = |x: usize, y: usize| self.values[channel * area + y * width + x];
            let above = at(left, top) * (1.0 - u) + at(right, top) * u;
            let below = at(left, bottom) * (1.0 - u) + at(right, bottom) * u;
            above * (1.0 - v) + below * v
        })
    }
}
