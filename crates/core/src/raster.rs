//! Pictures and per-pixel maps: plain row-major memory with a size that is checked once.

use serde::{Deserialize, Serialize};
use std::fmt;
use thiserror::Error;

/// Width and height in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Size {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Size {
    /// A size of `width` columns and `height` rows.
    pub const fn new(width: usize, height: usize) -> Self {
        Self { width, height }
    }

    /// Number of pixels.
    pub const fn area(self) -> usize {
        self.width * self.height
    }
}

impl fmt::Display for Size {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}x{}", self.width, self.height)
    }
}

/// An axis-aligned block of whole pixels inside a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Rect {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Extent of the block.
    pub size: Size,
}

impl Rect {
    /// Whether the block lies wholly inside a picture of `size`.
    pub const fn fits(&self, size: Size) -> bool {
        self.x + self.size.width <= size.width && self.y + self.size.height <= size.height
    }
}

/// Why a raster could not be made.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum RasterError {
    /// The memory handed over does not have one value per pixel and channel.
    #[error("a {size} raster needs {expected} values but {got} were given")]
    Length {
        /// The size asked for.
        size: Size,
        /// Values that size needs.
        expected: usize,
        /// Values handed over.
        got: usize,
    },
    /// A crop that reaches outside the picture.
    #[error("the block at ({}, {}) of size {} does not fit into {size}", rect.x, rect.y, rect.size)]
    Outside {
        /// The block asked for.
        rect: Rect,
        /// The size of the picture.
        size: Size,
    },
}

/// One value per pixel, row after row.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid<T> {
    size: Size,
    values: Vec<T>,
}

impl<T> Grid<T> {
    /// Takes row-major `values` of a raster of `size`.
    ///
    /// # Errors
    /// [`RasterError::Length`] unless there is exactly one value per pixel.
    pub fn new(size: Size, values: Vec<T>) -> Result<Self, RasterError> {
        if values.len() != size.area() {
            return Err(RasterError::Length { size, expected: size.area(), got: values.len() });
        }
        Ok(Self { size, values })
    }

    /// Computes every pixel from its column and row.
    pub fn from_fn(size: Size, mut value: impl FnMut(usize, usize) -> T) -> Self {
        let mut values = Vec::with_capacity(size.area());
        for y in 0..size.height {
            values.extend((0..size.width).map(|x| value(x, y)));
        }
        Self { size, values }
    }

    /// Extent in pixels.
    pub const fn size(&self) -> Size {
        self.size
    }

    /// All values, row after row.
    pub fn values(&self) -> &[T] {
        &self.values
    }

    /// All values, row after row, to be changed in place.
    pub fn values_mut(&mut self) -> &mut [T] {
        &mut self.values
    }

    /// Gives the row-major memory away.
    pub fn into_values(self) -> Vec<T> {
        self.values
    }

    /// One row.
    ///
    /// # Panics
    /// If `y` is not a row of the raster.
    pub fn row(&self, y: usize) -> &[T] {
        &self.values[y * self.size.width..(y + 1) * self.size.width]
    }

    /// The value at column `x`, row `y`, if that pixel exists.
    pub fn get(&self, x: usize, y: usize) -> Option<&T> {
        (x < self.size.width && y < self.size.height).then(|| &self.values[y * self.size.width + x])
    }

    /// A raster of the same size with every value mapped.
    pub fn map<U>(&self, function: impl FnMut(&T) -> U) -> Grid<U> {
        Grid { size: self.size, values: self.values.iter().map(function).collect() }
    }
}

impl<T: Clone> Grid<T> {
    /// A raster filled with one value.
    pub fn filled(size: Size, value: T) -> Self {
        Self { size, values: vec![value; size.area()] }
    }

    /// Copies a block out.
    ///
    /// # Errors
    /// [`RasterError::Outside`] if the block does not lie inside.
    pub fn cropped(&self, rect: Rect) -> Result<Self, RasterError> {
        if !rect.fits(self.size) {
            return Err(RasterError::Outside { rect, size: self.size });
        }
        let rows = rect.y..rect.y + rect.size.height;
        let values = rows.flat_map(|y| self.row(y)[rect.x..rect.x + rect.size.width].iter().cloned()).collect();
        Ok(Self { size: rect.size, values })
    }
}

/// A per-pixel yes or no; `true` means the pixel may be used.
pub type Mask = Grid<bool>;

/// An 8-bit RGB picture, interleaved, row after row.
///
/// Endoscopes deliver 8-bit video; deeper stills are reduced when they are read, so everything downstream has one
/// picture type.
#[derive(Clone, PartialEq, Eq)]
pub struct Image {
    size: Size,
    rgb: Vec<u8>,
}

impl fmt::Debug for Image {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "Image({})", self.size)
    }
}

impl Image {
    /// Takes interleaved RGB bytes.
    ///
    /// # Errors
    /// [`RasterError::Length`] unless there are exactly three bytes per pixel.
    pub fn new(size: Size, rgb: Vec<u8>) -> Result<Self, RasterError> {
        if rgb.len() != 3 * size.area() {
            return Err(RasterError::Length { size, expected: 3 * size.area(), got: rgb.len() });
        }
        Ok(Self { size, rgb })
    }

    /// Computes every pixel from its column and row.
    pub fn from_fn(size: Size, mut rgb: impl FnMut(usize, usize) -> [u8; 3]) -> Self {
        let mut bytes = Vec::with_capacity(3 * size.area());
        for y in 0..size.height {
            for x in 0..size.width {
                bytes.extend_from_slice(&rgb(x, y));
            }
        }
        Self { size, rgb: bytes }
    }

    /// Extent in pixels.
    pub const fn size(&self) -> Size {
        self.size
    }

    /// Interleaved RGB bytes, row after row.
    pub fn rgb(&self) -> &[u8] {
        &self.rgb
    }

    /// Gives the interleaved RGB bytes away.
    pub fn into_rgb(self) -> Vec<u8> {
        self.rgb
    }

    /// The colour at column `x`, row `y`, if that pixel exists.
    pub fn get(&self, x: usize, y: usize) -> Option<[u8; 3]> {
        (x < self.size.width && y < self.size.height).then(|| {
            let start = 3 * (y * self.size.width + x);
            [self.rgb[start], self.rgb[start + 1], self.rgb[start + 2]]
        })
    }

    /// Brightness in `0.0 ..= 255.0` by the weights of ITU-R BT.601 (0.299, 0.587, 0.114).
    pub fn luma(&self) -> Grid<f32> {
        let luma = |c: &[u8]| 0.299 * f32::from(c[0]) + 0.587 * f32::from(c[1]) + 0.114 * f32::from(c[2]);
        Grid { size: self.size, values: self.rgb.chunks_exact(3).map(luma).collect() }
    }

    /// Copies a block out.
    ///
    /// # Errors
    /// [`RasterError::Outside`] if the block does not lie inside.
    pub fn cropped(&self, rect: Rect) -> Result<Self, RasterError> {
        if !rect.fits(self.size) {
            return Err(RasterError::Outside { rect, size: self.size });
        }
        let mut rgb = Vec::with_capacity(3 * rect.size.area());
        for y in rect.y..rect.y + rect.size.height {
            let start = 3 * (y * self.size.width + rect.x);
            rgb.extend_from_slice(&self.rgb[start..start + 3 * rect.size.width]);
        }
        Ok(Self { size: rect.size, rgb })
    }
}

/// Depth along the optical axis (the z coordinate in the camera frame), in metres, per pixel.
///
/// A pixel without a measurement holds [`DepthMap::UNKNOWN`] (0.0). Values are finite and never negative: whatever
/// else comes in becomes unknown, so no NaN travels further.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMap(Grid<f32>);

impl DepthMap {
    /// The value of a pixel whose depth is not known.
    pub const UNKNOWN: f32 = 0.0;

    /// Takes depths in metres; NaN, infinite and non-positive values become [`DepthMap::UNKNOWN`].
    pub fn new(mut depth_m: Grid<f32>) -> Self {
        for value in depth_m.values_mut() {
            if !(value.is_finite() && *value > 0.0) {
                *value = Self::UNKNOWN;
            }
        }
        Self(depth_m)
    }

    /// Extent in pixels.
    pub const fn size(&self) -> Size {
        self.0.size()
    }

    /// The depths in metres, unknown pixels as 0.
    pub const fn grid(&self) -> &Grid<f32> {
        &self.0
    }

    /// Gives the depths in metres away, unknown pixels as 0.
    pub fn into_grid(self) -> Grid<f32> {
        self.0
    }

    /// The depth in metres at column `x`, row `y`; `None` outside or where it is unknown.
    pub fn get(&self, x: usize, y: usize) -> Option<f32> {
        self.0.get(x, y).copied().filter(|depth| *depth > Self::UNKNOWN)
    }

    /// Pixels with a known depth.
    pub fn known(&self) -> Mask {
        self.0.map(|depth| *depth > Self::UNKNOWN)
    }

    /// Share of pixels with a known depth, 0 to 1; 0 for an empty map.
    pub fn coverage(&self) -> f64 {
        let known = self.0.values().iter().filter(|depth| **depth > Self::UNKNOWN).count();
        known as f64 / self.size().area().max(1) as f64
    }

    /// Middle known depth in metres, if any is known.
    pub fn median_m(&self) -> Option<f32> {
        let mut known: Vec<f32> = self.0.values().iter().copied().filter(|depth| *depth > Self::UNKNOWN).collect();
        let middle = known.len() / 2;
        (!known.is_empty()).then(|| *known.select_nth_unstable_by(middle, f32::total_cmp).1)
    }

    /// The same map with every known depth multiplied by `factor`.
    pub fn scaled(&self, factor: f32) -> Self {
        Self::new(self.0.map(|depth| depth * factor))
    }

    /// Copies a block out.
    ///
    /// # Errors
    /// [`RasterError::Outside`] if the block does not lie inside.
    pub fn cropped(&self, rect: Rect) -> Result<Self, RasterError> {
        self.0.cropped(rect).map(Self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_needs_one_value_per_pixel() {
        let error = Grid::new(Size::new(3, 2), vec![0; 5]).unwrap_err();
        assert_eq!(error, RasterError::Length { size: Size::new(3, 2), expected: 6, got: 5 });
    }

    #[test]
    fn crops_copy_the_named_block() {
        let rect = Rect { x: 1, y: 1, size: Size::new(2, 1) };
        let grid = Grid::from_fn(Size::new(3, 2), |x, y| 10 * y + x);
        assert_eq!(grid.cropped(rect).unwrap().values(), [11, 12]);
        let image = Image::from_fn(Size::new(3, 2), |x, y| [x as u8, y as u8, 7]);
        assert_eq!(image.cropped(rect).unwrap().rgb(), [1, 1, 7, 2, 1, 7]);
        assert!(grid.cropped(Rect { x: 2, ..rect }).is_err());
    }

    #[test]
    fn poison_depths_become_unknown() {
        let poison = vec![f32::NAN, f32::INFINITY, -1.0, 0.0, 2.0, 4.0];
        let depth = DepthMap::new(Grid::new(Size::new(3, 2), poison).unwrap());
        assert_eq!(depth.grid().values(), [0.0, 0.0, 0.0, 0.0, 2.0, 4.0]);
        assert_eq!(depth.median_m(), Some(4.0));
        assert_eq!(depth.get(0, 0), None);
        assert_eq!(depth.scaled(f32::NAN).coverage(), 0.0);
    }

    #[test]
    fn an_empty_map_has_no_median() {
        assert_eq!(DepthMap::new(Grid::filled(Size::new(0, 0), 0.0)).median_m(), None);
    }
}
