//! Figures as PNG, drawn from their SVG with a font of our own, so that they look the same everywhere.

use crate::ReportError;
use resvg::{tiny_skia, usvg};
use std::sync::Arc;

/// DejaVu Sans, Latin, Greek and a few signs.
const FONT: &[u8] = include_bytes!("../../assets/DejaVuSans-subset.ttf");

/// Pixels of the PNG per pixel of the figure: sharp in print at column width.
const SCALE: f32 = 2.0;

/// Draws an SVG document.
///
/// # Errors
/// [`ReportError::Drawing`] for a document that is none or has no size.
pub fn png(figure: &str, svg: &str) -> Result<Vec<u8>, ReportError> {
    let failed = |reason: String| ReportError::Drawing { figure: figure.to_owned(), reason };
    let mut fonts = usvg::fontdb::Database::new();
    fonts.load_font_data(FONT.to_vec());
    fonts.set_sans_serif_family("DejaVu Sans");
    let options =
        usvg::Options { fontdb: Arc::new(fonts), font_family: "DejaVu Sans".to_owned(), ..usvg::Options::default() };
    let tree = usvg::Tree::from_str(svg, &options).map_err(|error| failed(error.to_string()))?;
    let size = tree.size();
    let (width, height) = ((size.width() * SCALE).ceil() as u32, (size.height() * SCALE).ceil() as u32);
    let mut pixmap = tiny_skia::Pixmap::new(width, height).ok_or_else(|| failed("it has no size".to_owned()))?;
    resvg::render(&tree, tiny_skia::Transform::from_scale(SCALE, SCALE), &mut pixmap.as_mut());
    pixmap.encode_png().map_err(|error| failed(error.to_string()))
}
