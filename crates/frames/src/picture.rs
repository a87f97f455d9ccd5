//! Still pictures of any bit depth.

use crate::FramesError;
use endoscape_core::{Image, Size};
use std::path::Path;

/// File name endings of the pictures [`read`] understands, in lower case.
pub const EXTENSIONS: &[&str] = &["png", "jpg", "jpeg", "tif", "tiff", "bmp", "webp"];

/// Reads a picture and reduces it to 8-bit RGB: 16-bit values keep their upper byte, grey is repeated, alpha dropped.
///
/// # Errors
/// [`FramesError`] if the file is missing, unreadable, truncated or no picture.
pub fn read(path: &Path) -> Result<Image, FramesError> {
    Err(FramesError::file(path, "not implemented", "wait"))
}

/// Size of a picture from its header alone.
///
/// # Errors
/// As [`read`].
pub fn size(path: &Path) -> Result<Size, FramesError> {
    let unreadable = |error: image::ImageError| {
        FramesError::file(path, format!("is no readable picture ({error})"), "fetch the file again")
    };
    let reader = image::ImageReader::open(path).map_err(|error| FramesError::io(path, "read", error))?;
    let reader = reader.with_guessed_format().map_err(|error| FramesError::io(path, "read", error))?;
    let (width, height) = reader.into_dimensions().map_err(unreadable)?;
    Ok(Size::new(width as usize, height as usize))
}
