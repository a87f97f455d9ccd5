//! Other sizes for pictures, depth and masks, in step with [`endoscape_core::Camera::scaled_to`].
//!
//! Edges map to edges: pixel `x` of the new raster covers `x * s ..= (x + 1) * s` of the old one, counted from its left
//! edge, with `s` the ratio of the widths.

use crate::FramesError;
use endoscape_core::{DepthMap, Grid, Image, Mask, Size};
use fast_image_resize::images::{TypedImage, TypedImageRef};
use fast_image_resize::pixels::U8x3;
use fast_image_resize::{FilterType, ResizeAlg, ResizeOptions, Resizer};
use rayon::prelude::*;
use std::ops::Range;

/// The picture at another size: bilinear when it grows, the mean under a tent as wide as two new pixels when it
/// shrinks.
///
/// The tent, not the plain box, because a box over a ratio that is no whole number takes neighbours in or leaves them
/// out as a whole, and the edges it so displaces a pose estimate would take for motion.
///
/// # Errors
/// [`FramesError::Request`] if either size has no pixels.
pub fn image(image: &Image, size: Size) -> Result<Image, FramesError> {
    if image.size() == size {
        return Ok(image.clone());
    }
    let refused = |reason: String| FramesError::Request {
        what: format!("a picture of {} cannot be resized to {size} ({reason})", image.size()),
        remedy: "choose a size with at least one and at most 2^31 pixels per side".to_owned(),
    };
    if size.area() == 0 || image.size().area() == 0 {
        return Err(refused("no pixels".to_owned()));
    }
    let side = |extent: usize| u32::try_from(extent).map_err(|error| refused(error.to_string()));
    let (old_width, old_height) = (side(image.size().width)?, side(image.size().height)?);
    let source = TypedImageRef::<U8x3>::from_buffer(old_width, old_height, image.rgb());
    let source = source.map_err(|error| refused(error.to_string()))?;
    let (new_width, new_height) = (side(size.width)?, side(size.height)?);
    let mut rgb = vec![0; 3 * size.area()];
    let mut target =
        TypedImage::<U8x3>::from_buffer(new_width, new_height, &mut rgb).map_err(|error| refused(error.to_string()))?;
    let options = ResizeOptions::new().resize_alg(ResizeAlg::Convolution(FilterType::Bilinear));
    Resizer::new().resize_typed(&source, &mut target, &options).map_err(|error| refused(error.to_string()))?;
    drop(target);
    Image::new(size, rgb).map_err(|error| refused(error.to_string()))
}

/// The depth at another size: the middle known value under each new pixel, never a mean, so edges stay edges.
///
/// A new pixel is known if at least half of the old ones under it are. When the map grows, the nearest value.
pub fn depth(depth: &DepthMap, size: Size) -> DepthMap {
    let old = depth.grid();
    let (columns, rows) = (Axis::new(old.size().width, size.width), Axis::new(old.size().height, size.height));
    let mut values = vec![DepthMap::UNKNOWN; size.area()];
    values.par_chunks_mut(size.width.max(1)).enumerate().for_each(|(y, out)| {
        let mut under = Vec::new();
        for (x, out) in out.iter_mut().enumerate() {
            let (columns, rows) = (columns.centres(x), rows.centres(y));
            let footprint = columns.len() * rows.len();
            under.clear();
            under.extend(rows.flat_map(|y| old.row(y).get(columns.clone()).unwrap_or_default()).filter(|d| **d > 0.0));
            if !under.is_empty() && 2 * under.len() >= footprint {
                let middle = (under.len() - 1) / 2;
                *out = *under.select_nth_unstable_by(middle, f32::total_cmp).1;
            }
        }
    });
    DepthMap::new(Grid::from_fn(size, |x, y| values[y * size.width + x]))
}

/// The mask at another size: usable where every old pixel that the new one touches is usable.
pub fn mask(mask: &Mask, size: Size) -> Mask {
    let (columns, rows) = (Axis::new(mask.size().width, size.width), Axis::new(mask.size().height, size.height));
    Grid::from_fn(size, |x, y| {
        let columns = columns.touched(x);
        let (mut rows, any) = (rows.touched(y), !columns.is_empty());
        any && !rows.is_empty()
            && rows.all(|y| mask.row(y).get(columns.clone()).is_some_and(|row| row.iter().all(|u| *u)))
    })
}

/// Which old pixels lie under a new one, along one axis.
#[derive(Clone, Copy)]
struct Axis {
    old: usize,
    ratio: f64,
}

impl Axis {
    fn new(old: usize, new: usize) -> Self {
        Self { old, ratio: old as f64 / new.max(1) as f64 }
    }

    fn edges(&self, pixel: usize) -> (f64, f64) {
        (pixel as f64 * self.ratio, (pixel + 1) as f64 * self.ratio)
    }

    /// Old pixels whose centre lies under the new one; the one under its centre if there is none.
    fn centres(&self, pixel: usize) -> Range<usize> {
        let (left, right) = self.edges(pixel);
        let range = (left - 0.5).ceil() as usize..((right - 0.5).ceil() as usize).min(self.old);
        if !range.is_empty() {
            return range;
        }
        let nearest = (0.5 * (left + right)) as usize;
        nearest.min(self.old)..(nearest + 1).min(self.old)
    }

    /// Old pixels any part of which lies under the new one; a billionth of a pixel is rounding.
    fn touched(&self, pixel: usize) -> Range<usize> {
        let (left, right) = self.edges(pixel);
        (left + 1e-9) as usize..((right - 1e-9).ceil() as usize).min(self.old)
    }
}

#[cfg(test)]
mod tests;
