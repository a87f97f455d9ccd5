//! Pictures, depth and masks of one lens as another lens at the same place would have seen them.
//!
//! Both cameras share centre and axes, so a pixel moves along its ray only: depth along the optical axis keeps its
//! value and poses stay as they are. Where each pixel comes from is computed once per pair of cameras.

use crate::FramesError;
use endoscape_core::{Camera, CameraError, DepthMap, Grid, Image, Mask, Size};
use nalgebra::{Point2, Point3};
use rayon::prelude::*;
use thiserror::Error;

/// Largest relative difference between neighbouring depths of one surface; beyond it lies an edge.
///
/// A plane tilted by 80 degrees changes by less over one pixel of a 640 pixel wide picture with 83 degrees
/// (tan 80 degrees / f = 5.7 / 360 = 1.6 %).
const SAME_SURFACE: f32 = 0.05;

/// Steps per pixel in which positions are kept, as many as 8-bit weights resolve.
const STEPS: u16 = 256;

/// Pixels computed together: few enough to stay in the first cache, enough to fill wide registers.
const BLOCK: usize = 16;

/// Why something cannot be rectified.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum RectifyError {
    /// The raster does not belong to the camera.
    #[error(
        "the {what} is {got} but the camera to rectify from has {expected}; give the camera of these frames or resize first"
    )]
    Size {
        /// `picture`, `depth map` or `mask`.
        what: &'static str,
        /// Size of the camera to rectify from.
        expected: Size,
        /// Size of the raster.
        got: Size,
    },
    /// Not even the narrowest picture around the optical axis is covered.
    #[error("the optical axis leaves the {0} picture of the camera; check its principal point")]
    AxisOutside(Size),
    /// No such pinhole.
    #[error(transparent)]
    Camera(#[from] CameraError),
}

impl From<RectifyError> for FramesError {
    fn from(error: RectifyError) -> Self {
        let sentence = error.to_string();
        let (what, remedy) = sentence.split_once("; ").unwrap_or((&sentence, "check the camera file"));
        Self::Request { what: what.to_owned(), remedy: remedy.to_owned() }
    }
}

/// Where one pixel comes from: the top left of four neighbours and how far the position lies to its right and below it.
#[derive(Clone, Copy)]
struct Tap {
    index: u32,
    /// 256ths of a pixel, below 256.
    right: u16,
    /// 256ths of a pixel, below 256.
    below: u16,
}

impl Tap {
    /// Nothing is seen. The index lies behind the end of every picture, where all bytes read as 0.
    const NOWHERE: Self = Self { index: u32::MAX, right: 0, below: 0 };

    /// The tap for a position, `None` off the picture. The half pixel between the outer centres and the edge repeats
    /// the edge.
    fn at(position: &Point2<f64>, size: Size) -> Option<Self> {
        let (x, right) = Self::split(position.x, size.width)?;
        let (y, below) = Self::split(position.y, size.height)?;
        let index = u32::try_from(y * size.width + x).ok()?;
        Some(Self { index, right, below })
    }

    /// Whole pixel and 256ths on one axis.
    fn split(position: f64, extent: usize) -> Option<(usize, u16)> {
        let last = extent as f64 - 1.0;
        let on_picture = position >= -0.5 && position <= last + 0.5;
        on_picture.then(|| {
            let steps = (position.clamp(0.0, last) * f64::from(STEPS)).round() as usize;
            (steps / usize::from(STEPS), (steps % usize::from(STEPS)) as u16)
        })
    }

    const fn inside(self) -> bool {
        self.index != Self::NOWHERE.index
    }

    /// Weights of the neighbours at (0, 0), (1, 0), (0, 1) and (1, 1), in all 256 x 256 (0 where nothing is seen).
    fn weights(self) -> [u32; 4] {
        if !self.inside() {
            return [0; 4];
        }
        let [left, right] = [STEPS - self.right, self.right].map(u32::from);
        let [above, below] = [STEPS - self.below, self.below].map(u32::from);
        [left * above, right * above, left * below, right * below]
    }

    /// Indices and weights of the neighbours that take part, in a raster `width` wide.
    fn parts(self, width: usize) -> impl Iterator<Item = (usize, u32)> {
        let corner = self.index as usize;
        let indices = [corner, corner + 1, corner + width, corner + width + 1];
        indices.into_iter().zip(self.weights()).filter(|(_, weight)| *weight > 0)
    }
}

/// The way from the pictures of one camera to those of another, computed once.
pub struct Rectifier {
    from: Size,
    to: Size,
    taps: Vec<Tap>,
    valid: Mask,
}

impl Rectifier {
    /// Follows the ray of every pixel of `to` into the picture of `from`.
    ///
    /// Pixels of `to` without a ray, or whose ray misses the picture of `from`, are not valid.
    pub fn new(from: &Camera, to: &Camera) -> Self {
        let (size, from_size) = (to.size(), from.size());
        let tap = |x: usize, y: usize| {
            let ray = to.unproject(&Point2::new(x as f64, y as f64))?;
            Tap::at(&from.project(&Point3::from(ray))?, from_size)
        };
        let mut taps = vec![Tap::NOWHERE; size.area()];
        taps.par_chunks_mut(size.width).enumerate().for_each(|(y, row)| {
            for (x, out) in row.iter_mut().enumerate() {
                *out = tap(x, y).unwrap_or(Tap::NOWHERE);
            }
        });
        let valid = Grid::from_fn(size, |x, y| taps[y * size.width + x].inside());
        Self { from: from_size, to: size, taps, valid }
    }

    /// Pixels of the new picture that see something of the old one.
    pub const fn valid(&self) -> &Mask {
        &self.valid
    }

    /// The picture through the new lens, bilinear; black where nothing is seen.
    ///
    /// # Errors
    /// [`RectifyError::Size`] unless the picture has the size of the camera rectified from.
    pub fn image(&self, image: &Image) -> Result<Image, RectifyError> {
        self.check("picture", image.size())?;
        let mut rgb = vec![0; 3 * self.to.area()];
        let (source, stride) = (image.rgb(), 3 * self.from.width);
        let width = self.to.width;
        if rayon::current_num_threads() == 1 {
            // Handing a millisecond of work to the only worker and waiting for it costs more than it brings.
            let rows = rgb.chunks_mut(3 * width).zip(self.taps.chunks(width));
            rows.for_each(|(out, taps)| remap_row(out, taps, source, stride));
        } else {
            let rows = rgb.par_chunks_mut(3 * width).zip(self.taps.par_chunks(width));
            rows.for_each(|(out, taps)| remap_row(out, taps, source, stride));
        }
        // The memory was made for this size, so it cannot be refused.
        Image::new(self.to, rgb).map_err(|_| self.mismatch("picture", image.size()))
    }

    /// The depth along the optical axis through the new lens, in metres.
    ///
    /// Bilinear where all neighbours that take part are known and within 5 % of each other; elsewhere the known
    /// neighbour with the most weight, so no depth between two surfaces is made up.
    ///
    /// # Errors
    /// [`RectifyError::Size`] unless the map has the size of the camera rectified from.
    pub fn depth(&self, depth: &DepthMap) -> Result<DepthMap, RectifyError> {
        self.check("depth map", depth.size())?;
        let source = depth.grid().values();
        let values = self.taps.par_iter().map(|tap| blend_depth(*tap, source, self.from.width)).collect();
        let grid = Grid::new(self.to, values).map_err(|_| self.mismatch("depth map", depth.size()))?;
        Ok(DepthMap::new(grid))
    }

    /// The mask through the new lens: usable where every pixel that takes part is usable.
    ///
    /// # Errors
    /// [`RectifyError::Size`] unless the mask has the size of the camera rectified from.
    pub fn mask(&self, mask: &Mask) -> Result<Mask, RectifyError> {
        self.check("mask", mask.size())?;
        let (source, width) = (mask.values(), self.from.width);
        let usable = |tap: &Tap| tap.inside() && tap.parts(width).all(|(index, _)| source[index]);
        let values = self.taps.par_iter().map(usable).collect();
        Grid::new(self.to, values).map_err(|_| self.mismatch("mask", mask.size()))
    }

    fn check(&self, what: &'static str, got: Size) -> Result<(), RectifyError> {
        if got == self.from { Ok(()) } else { Err(self.mismatch(what, got)) }
    }

    fn mismatch(&self, what: &'static str, got: Size) -> RectifyError {
        RectifyError::Size { what, expected: self.from, got }
    }
}

/// Fills one row of RGB bytes from the RGB bytes of the whole source picture.
///
/// Per block it first gathers the neighbours, eight bytes from each of two rows, then blends all of them with plain
/// loops over bytes, which compilers turn into vector instructions. Blending rounds twice, below the columns and along
/// the row, which costs at most one grey level.
fn remap_row(out: &mut [u8], taps: &[Tap], source: &[u8], stride: usize) {
    let (mut top, mut bottom) = ([0; 8 * BLOCK], [0; 8 * BLOCK]);
    let (mut right, mut below) = ([0; 8 * BLOCK], [0; 8 * BLOCK]);
    // Three more values than pixels need: the last pixel has a right neighbour to be blended with, of no consequence.
    let (mut columns, mut blended) = ([0; 8 * BLOCK + 3], [0; 8 * BLOCK]);
    for (out, taps) in out.chunks_mut(3 * BLOCK).zip(taps.chunks(BLOCK)) {
        for (i, tap) in taps.iter().enumerate() {
            let start = 3 * tap.index as usize;
            top[8 * i..8 * i + 8].copy_from_slice(&eight_bytes(source, start));
            bottom[8 * i..8 * i + 8].copy_from_slice(&eight_bytes(source, start + stride));
            right[8 * i..8 * i + 8].fill(tap.right);
            below[8 * i..8 * i + 8].fill(tap.below);
        }
        for i in 0..8 * BLOCK {
            columns[i] = blend(top[i].into(), bottom[i].into(), below[i]);
        }
        for i in 0..8 * BLOCK {
            blended[i] = blend(columns[i], columns[i + 3], right[i]) as u8;
        }
        for (out, pixel) in out.chunks_exact_mut(3).zip(blended.chunks_exact(8)) {
            out.copy_from_slice(&pixel[..3]);
        }
    }
}

/// Between `near` (at 0) and `far` (at 256), rounded; both up to 255, so nothing exceeds 16 bits.
const fn blend(near: u16, far: u16, at: u16) -> u16 {
    (near * (STEPS - at) + far * at + STEPS / 2) / STEPS
}

/// Eight bytes from `start`; zeros behind the last byte, where all weights are zero.
fn eight_bytes(bytes: &[u8], start: usize) -> [u8; 8] {
    match bytes.get(start..start + 8).and_then(|chunk| chunk.try_into().ok()) {
        Some(chunk) => chunk,
        None => last_bytes(bytes, start),
    }
}

#[cold]
fn last_bytes(bytes: &[u8], start: usize) -> [u8; 8] {
    let mut rest = [0; 8];
    rest.iter_mut().zip(bytes.get(start..).unwrap_or_default()).for_each(|(to, from)| *to = *from);
    rest
}

/// One depth from up to four; unknown if none of them is known.
fn blend_depth(tap: Tap, source: &[f32], width: usize) -> f32 {
    let known = || tap.parts(width).map(|(index, weight)| (source[index], weight)).filter(|(depth, _)| *depth > 0.0);
    let whole = u32::from(STEPS).pow(2);
    let (mut near, mut far, mut sum, mut weights) = (f32::INFINITY, 0.0_f32, 0.0, 0);
    for (depth, weight) in known() {
        (near, far) = (near.min(depth), far.max(depth));
        sum += depth * weight as f32;
        weights += weight;
    }
    if weights == whole && far <= near * (1.0 + SAME_SURFACE) {
        return sum / whole as f32;
    }
    known().max_by_key(|(_, weight)| *weight).map_or(DepthMap::UNKNOWN, |(depth, _)| depth)
}

/// A pinhole of `size` to rectify the pictures of `from` to.
///
/// Without a field of view (`hfov_rad`, left to right edge, radians) it takes the widest one that leaves no pixel
/// empty: every pixel on the border of the new picture still sees into the picture and the domain of `from`.
///
/// # Errors
/// [`RectifyError::Camera`] for a field of view or a size no pinhole has, [`RectifyError::AxisOutside`] if not even one
/// degree around the optical axis is covered.
pub fn pinhole_for(from: &Camera, size: Size, hfov_rad: Option<f64>) -> Result<Camera, RectifyError> {
    if let Some(hfov_rad) = hfov_rad {
        return Ok(Camera::from_field_of_view(size, hfov_rad)?);
    }
    let covered = |degrees: f64| -> Result<Option<Camera>, CameraError> {
        let pinhole = Camera::from_field_of_view(size, degrees.to_radians())?;
        Ok(border_is_seen(from, &pinhole).then_some(pinhole))
    };
    let (mut narrow, mut wide) = (1.0, 170.0);
    let mut best = covered(narrow)?.ok_or(RectifyError::AxisOutside(from.size()))?;
    // 30 halvings: finer than a micro-degree.
    for _ in 0..30 {
        let middle = 0.5 * (narrow + wide);
        match covered(middle)? {
            Some(pinhole) => (narrow, best) = (middle, pinhole),
            None => wide = middle,
        }
    }
    Ok(best)
}

/// Whether every pixel on the border of `pinhole` is seen by `from`.
fn border_is_seen(from: &Camera, pinhole: &Camera) -> bool {
    let Size { width, height } = pinhole.size();
    let seen = |x: usize, y: usize| {
        let pixel =
            pinhole.unproject(&Point2::new(x as f64, y as f64)).and_then(|ray| from.project(&Point3::from(ray)));
        pixel.is_some_and(|pixel| from.contains(&pixel))
    };
    (0..width).all(|x| seen(x, 0) && seen(x, height - 1)) && (0..height).all(|y| seen(0, y) && seen(width - 1, y))
}

#[cfg(test)]
mod tests;
