//! Bytes: colour subsampling, JPEG and the PNG files of the truth.

use crate::SimError;
use endoscape_core::{Image, Mask, Size};
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder as _, ImageFormat};

/// Flow is stored in this fraction of a pixel, as KITTI does (M. Menze, A. Geiger, CVPR 2015).
const FLOW_UNIT_PX: f64 = 1.0 / 64.0;
/// Stored value of no flow.
const FLOW_ZERO: f64 = 32_768.0;

fn refused(error: &dyn std::fmt::Display, size: Size) -> SimError {
    SimError::parameter(format!("a frame of {size} cannot be encoded ({error})"), "choose a smaller --size")
}

/// A picture from its bytes.
pub fn image(size: Size, rgb: Vec<u8>) -> Result<Image, SimError> {
    Image::new(size, rgb).map_err(|error| refused(&error, size))
}

/// The picture as it comes back from a recorder: colour at half the resolution, then JPEG.
pub fn compressed(picture: Image, subsampled: bool, quality: Option<u8>) -> Result<Image, SimError> {
    let picture = if subsampled { subsample(&picture) } else { picture };
    let Some(quality) = quality else { return Ok(picture) };
    let size = picture.size();
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality)
        .write_image(picture.rgb(), size.width as u32, size.height as u32, ExtendedColorType::Rgb8)
        .map_err(|error| refused(&error, size))?;
    let decoded =
        image::load_from_memory_with_format(&bytes, ImageFormat::Jpeg).map_err(|error| refused(&error, size))?;
    self::image(size, decoded.into_rgb8().into_raw())
}

/// Colour averaged over squares of two by two pixels, brightness kept (4:2:0 with the matrix of ITU-R BT.601).
fn subsample(picture: &Image) -> Image {
    let size = picture.size();
    let split = |rgb: [u8; 3]| {
        let [r, g, b] = rgb.map(f32::from);
        let luma = 0.299 * r + 0.587 * g + 0.114 * b;
        [luma, 0.564 * (b - luma), 0.713 * (r - luma)]
    };
    let at = |x: usize, y: usize| split(picture.get(x.min(size.width - 1), y.min(size.height - 1)).unwrap_or_default());
    Image::from_fn(size, |x, y| {
        let (left, top) = (x & !1, y & !1);
        let four = [at(left, top), at(left + 1, top), at(left, top + 1), at(left + 1, top + 1)];
        let mean = |c: usize| four.iter().map(|part| part[c]).sum::<f32>() / 4.0;
        let (luma, blue, red) = (at(x, y)[0], mean(1), mean(2));
        let byte = |value: f32| value.round().clamp(0.0, 255.0) as u8;
        [byte(luma + 1.403 * red), byte(luma - 0.344 * blue - 0.714 * red), byte(luma + 1.773 * blue)]
    })
}

/// A PNG of 8-bit grey values.
///
/// # Errors
/// [`SimError`] for a size no PNG has.
pub fn gray_png(size: Size, values: &[u8]) -> Result<Vec<u8>, SimError> {
    png(size, values, ExtendedColorType::L8)
}

/// A PNG of a mask, white where it is true.
///
/// # Errors
/// As [`gray_png`].
pub fn mask_png(mask: &Mask) -> Result<Vec<u8>, SimError> {
    let values: Vec<u8> = mask.values().iter().map(|white| if *white { 255 } else { 0 }).collect();
    gray_png(mask.size(), &values)
}

/// A 16-bit RGB PNG of flow in pixels as KITTI stores it: red and green are `64 * displacement + 32768`, blue is 1
/// where the flow is known.
///
/// # Errors
/// As [`gray_png`].
pub fn flow_png(size: Size, flow: impl Iterator<Item = Option<[f64; 2]>>) -> Result<Vec<u8>, SimError> {
    let unit = |displacement: f64| displacement / FLOW_UNIT_PX + FLOW_ZERO;
    let fits = |value: f64| (0.0..=f64::from(u16::MAX)).contains(&value.round());
    let words = flow.flat_map(|flow| match flow.map(|[x, y]| [unit(x), unit(y)]) {
        Some([x, y]) if fits(x) && fits(y) => [x.round() as u16, y.round() as u16, 1],
        _ => [0; 3],
    });
    let bytes: Vec<u8> = words.flat_map(u16::to_ne_bytes).collect();
    png(size, &bytes, ExtendedColorType::Rgb16)
}

fn png(size: Size, bytes: &[u8], colour: ExtendedColorType) -> Result<Vec<u8>, SimError> {
    let mut encoded = Vec::new();
    PngEncoder::new_with_quality(&mut encoded, CompressionType::Fast, FilterType::Adaptive)
        .write_image(bytes, size.width as u32, size.height as u32, colour)
        .map_err(|error| refused(&error, size))?;
    Ok(encoded)
}
