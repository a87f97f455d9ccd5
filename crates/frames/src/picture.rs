//! Still pictures of any bit depth.
//!
//! Everything downstream works on 8-bit RGB, so [`read`] is the one place where other depths are reduced. A picture
//! that ends early is an error here, also where the decoder would fill the missing part with grey: a half picture
//! looks real to a network.

use crate::FramesError;
use endoscape_core::{Grid, Image, Mask, Size};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{DynamicImage, ExtendedColorType, ImageEncoder as _, ImageFormat, ImageReader};
use std::io::{Cursor, Read as _};
use std::path::Path;

/// File name endings of the pictures [`read`] understands, in lower case.
pub const EXTENSIONS: &[&str] = &["png", "jpg", "jpeg", "tif", "tiff", "bmp", "webp"];

/// Largest width and height accepted; no endoscope comes near.
const LARGEST_EXTENT: u32 = 16_384;
/// Most memory one decoded picture may take, in bytes.
const LARGEST_DECODED: u64 = 512 << 20;
/// Largest picture file, in bytes.
const LARGEST_FILE: u64 = 1 << 30;
/// Mask values from here on are usable pixels.
const USABLE_FROM: u8 = 128;

/// Reads a picture and reduces it to 8-bit RGB: 16-bit values keep their upper byte, grey is repeated, alpha dropped.
///
/// Pixels stay as stored: a rotation noted in EXIF is not applied, because calibrations refer to the stored picture.
///
/// # Errors
/// [`FramesError`] if the file is missing, unreadable, truncated or no picture.
pub fn read(path: &Path) -> Result<Image, FramesError> {
    let decoded = decode(path)?;
    let size = Size::new(decoded.width() as usize, decoded.height() as usize);
    let rgb = match decoded {
        // Rounding would shift values; the upper byte is what 8-bit recordings of the same data hold.
        DynamicImage::ImageLuma16(grey) => grey.into_raw().iter().flat_map(|v| [upper(v); 3]).collect(),
        DynamicImage::ImageLumaA16(grey) => grey.into_raw().chunks_exact(2).flat_map(|v| [upper(&v[0]); 3]).collect(),
        DynamicImage::ImageRgb16(colour) => colour.into_raw().iter().map(upper).collect(),
        DynamicImage::ImageRgba16(colour) => {
            colour.into_raw().chunks_exact(4).flat_map(|v| [upper(&v[0]), upper(&v[1]), upper(&v[2])]).collect()
        }
        float @ (DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_)) => {
            check_numbers(path, &float.to_rgb32f())?;
            float.into_rgb8().into_raw()
        }
        other => other.into_rgb8().into_raw(),
    };
    Image::new(size, rgb).map_err(|error| FramesError::file(path, error.to_string(), "fetch the file again"))
}

/// # Errors
/// [`FramesError`] naming the first pixel of a floating-point picture that is not a finite number.
fn check_numbers(path: &Path, picture: &image::Rgb32FImage) -> Result<(), FramesError> {
    let wrong = picture.enumerate_pixels().find(|(.., pixel)| pixel.0.iter().any(|value| !value.is_finite()));
    wrong.map_or(Ok(()), |(x, y, _)| {
        let reason = format!("holds a value that is not a number at column {x}, row {y}");
        Err(FramesError::file(path, reason, "write the picture again without such values"))
    })
}

const fn upper(value: &u16) -> u8 {
    (*value >> 8) as u8
}

/// Size of a picture from its header alone.
///
/// # Errors
/// As [`read`].
pub fn size(path: &Path) -> Result<Size, FramesError> {
    let reader = ImageReader::open(path).map_err(|error| FramesError::io(path, "read", error))?;
    let reader = reader.with_guessed_format().map_err(|error| FramesError::io(path, "read", error))?;
    let (width, height) = reader.into_dimensions().map_err(|error| unreadable(path, &error))?;
    Ok(Size::new(width as usize, height as usize))
}

/// Whether the file begins like one of the pictures [`read`] understands, whatever its name.
pub fn is_picture(path: &Path) -> bool {
    let mut head = [0; 16];
    let length = std::fs::File::open(path).and_then(|mut file| file.read(&mut head)).unwrap_or(0);
    image::guess_format(&head[..length]).is_ok_and(|format| format.reading_enabled())
}

/// Decodes a picture as it is stored, within the limits of this module.
///
/// # Errors
/// As [`read`].
pub(crate) fn decode(path: &Path) -> Result<DynamicImage, FramesError> {
    let bytes = crate::formats::common::read_bytes(path, LARGEST_FILE)?;
    let mut reader = ImageReader::new(Cursor::new(bytes.as_slice()));
    reader = reader.with_guessed_format().map_err(|error| FramesError::io(path, "read", error))?;
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(LARGEST_EXTENT);
    limits.max_image_height = Some(LARGEST_EXTENT);
    limits.max_alloc = Some(LARGEST_DECODED);
    reader.limits(limits);
    if reader.format() == Some(ImageFormat::Jpeg) && !jpeg_is_complete(&bytes) {
        return Err(FramesError::file(path, "ends in the middle of the picture", "fetch the file again"));
    }
    reader.decode().map_err(|error| unreadable(path, &error))
}

fn unreadable(path: &Path, error: &image::ImageError) -> FramesError {
    FramesError::file(path, format!("is no readable picture ({error})"), "fetch the file again")
}

/// Whether the scan of a JPEG is followed by its end marker (ITU-T T.81, B.2).
///
/// Segments before the scan are stepped over by their lengths, because an embedded thumbnail has an end marker too.
fn jpeg_is_complete(bytes: &[u8]) -> bool {
    const START_OF_SCAN: u8 = 0xDA;
    const END_OF_IMAGE: [u8; 2] = [0xFF, 0xD9];
    let mut at = 2;
    while let Some([0xFF, marker, high, low]) = bytes.get(at..at + 4) {
        at += if *marker == 0xFF { 1 } else { 2 + usize::from(u16::from_be_bytes([*high, *low])) };
        if *marker == START_OF_SCAN {
            return bytes.get(at..).is_some_and(|scan| scan.windows(2).any(|pair| pair == END_OF_IMAGE));
        }
    }
    false
}

/// Writes a picture as an 8-bit RGB PNG, quickly rather than small.
///
/// # Errors
/// [`FramesError`] if the file cannot be written; nothing is left of it then.
pub fn write_png(path: &Path, image: &Image) -> Result<(), FramesError> {
    write(path, image.rgb(), image.size(), ExtendedColorType::Rgb8)
}

/// Writes 16-bit values as a grey PNG.
///
/// # Errors
/// As [`write_png`].
pub fn write_gray16_png(path: &Path, values: &Grid<u16>) -> Result<(), FramesError> {
    // The encoder takes native byte order and swaps as PNG needs.
    let bytes: Vec<u8> = values.values().iter().flat_map(|value| value.to_ne_bytes()).collect();
    write(path, &bytes, values.size(), ExtendedColorType::L16)
}

/// Writes a mask as an 8-bit grey PNG: 255 for usable pixels, 0 for the others.
///
/// # Errors
/// As [`write_png`].
pub fn write_mask_png(path: &Path, mask: &Mask) -> Result<(), FramesError> {
    let bytes: Vec<u8> = mask.values().iter().map(|usable| if *usable { 255 } else { 0 }).collect();
    write(path, &bytes, mask.size(), ExtendedColorType::L8)
}

/// Reads a mask: pixels brighter than middle grey (of any bit depth) are usable.
///
/// # Errors
/// As [`read`].
pub fn read_mask(path: &Path) -> Result<Mask, FramesError> {
    let grey = read(path)?.luma();
    Ok(grey.map(|value| *value >= f32::from(USABLE_FROM)))
}

/// Encodes in memory first, so that the disk sees one write that either succeeds or is taken back.
fn write(path: &Path, bytes: &[u8], size: Size, color: ExtendedColorType) -> Result<(), FramesError> {
    let mut encoded = Vec::new();
    let extent = |value: usize| u32::try_from(value).unwrap_or(u32::MAX);
    PngEncoder::new_with_quality(&mut encoded, CompressionType::Fast, FilterType::Adaptive)
        .write_image(bytes, extent(size.width), extent(size.height), color)
        .map_err(|error| FramesError::file(path, format!("cannot be a PNG ({error})"), "write a smaller picture"))?;
    std::fs::write(path, encoded).map_err(|error| {
        std::fs::remove_file(path).ok();
        FramesError::io(path, "write", error)
    })
}

#[cfg(test)]
mod tests;
