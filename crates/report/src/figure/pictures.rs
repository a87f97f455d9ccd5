//! Pictures and maps side by side, with perceptually uniform colour maps and their bars.

use super::canvas::{anchored, text};
use super::{Ink, Svg};
use crate::ReportError;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use colorous::Gradient;
use endoscape_core::{Grid, Image, Mask, Size};
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use std::fmt::Write as _;

/// Width of a picture in a figure, pixels.
const CELL: f64 = 190.0;

/// Pictures are stored with at most this many columns; more would hardly be seen at [`CELL`].
const MOST_COLUMNS: usize = 256;

/// Quality of photographs; maps are stored without loss.
const JPEG_QUALITY: u8 = 88;

/// Space between pictures, for heads above and labels at the left, pixels.
const GAP: f64 = 8.0;
const HEAD: f64 = 24.0;
const SIDE: f64 = 84.0;

/// Height of a bar of colours with its labels, pixels.
const BAR: f64 = 46.0;

/// Steps of a bar of colours.
const STEPS: usize = 32;

/// Grey of pixels without a value: no colour of the maps.
const UNKNOWN: [u8; 3] = [128, 128, 128];

/// Sizes of letters, pixels.
const HEAD_SIZE: f64 = 13.0;
const LABEL_SIZE: f64 = 11.5;

/// What a colour means.
#[derive(Clone)]
pub struct Bar {
    /// Name of the quantity.
    pub title: String,
    /// What the first and the last colour stand for.
    pub ends: [String; 2],
    /// The colours.
    pub gradient: Gradient,
}

/// Rows of pictures under common heads.
#[derive(Clone)]
pub struct PictureGrid {
    /// What it shows, for those who cannot see it.
    pub label: String,
    /// One per column.
    pub heads: Vec<String>,
    /// A label and one picture per column, `None` where there is none. The first column is a photograph.
    pub rows: Vec<(String, Vec<Option<Image>>)>,
    /// Below the pictures.
    pub bars: Vec<Bar>,
}

/// Colours values from 0 to 1; what is `None` becomes grey.
pub fn coloured(values: &Grid<Option<f32>>, gradient: Gradient) -> Image {
    let size = values.size();
    Image::from_fn(size, |x, y| match values.get(x, y).copied().flatten() {
        Some(value) => {
            let colour = gradient.eval_continuous(f64::from(value.clamp(0.0, 1.0)));
            [colour.r, colour.g, colour.b]
        }
        None => UNKNOWN,
    })
}

/// A mask in black and white.
pub fn black_and_white(mask: &Mask) -> Image {
    Image::from_fn(mask.size(), |x, y| if mask.get(x, y) == Some(&true) { [255; 3] } else { [0; 3] })
}

impl PictureGrid {
    /// Draws it.
    ///
    /// # Errors
    /// [`ReportError`] if a picture cannot be encoded.
    pub fn svg(&self) -> Result<Svg, ReportError> {
        let first = self.rows.iter().flat_map(|(_, row)| row.iter().flatten()).next();
        let aspect = first.map_or(0.75, |image| image.size().height as f64 / image.size().width.max(1) as f64);
        let height = CELL * aspect;
        let column = |index: usize| SIDE + index as f64 * (CELL + GAP);
        let mut body = String::new();
        for (index, head) in self.heads.iter().enumerate() {
            body.push_str(&anchored((column(index) + 0.5 * CELL, HEAD - 9.0), head, HEAD_SIZE, Ink::Text, "middle"));
        }
        for (row, (label, images)) in self.rows.iter().enumerate() {
            let y = HEAD + row as f64 * (height + GAP);
            body.push_str(&anchored((SIDE - GAP, y + 0.5 * height + 4.0), label, LABEL_SIZE, Ink::Muted, "end"));
            for (index, image) in images.iter().enumerate() {
                match image {
                    Some(image) => {
                        let data = if index == 0 { jpeg(&shrunk(image))? } else { png(&shrunk(image))? };
                        body.push_str(&embedded((column(index), y), (CELL, height), &data));
                    }
                    None => {
                        let at = (column(index) + 0.5 * CELL, y + 0.5 * height);
                        body.push_str(&anchored(at, "none", LABEL_SIZE, Ink::Muted, "middle"));
                    }
                }
            }
        }
        let top = HEAD + self.rows.len() as f64 * (height + GAP);
        for (index, bar) in self.bars.iter().enumerate() {
            body.push_str(&bar_of_colours(bar, (SIDE + index as f64 * 2.0 * (CELL + GAP), top + 8.0)));
        }
        let needed = SIDE + 2.0 * self.bars.len() as f64 * (CELL + GAP);
        let width = column(self.heads.len()).max(needed);
        let bottom = if self.bars.is_empty() { 0.0 } else { BAR };
        Ok(Svg { width, height: top + bottom, label: self.label.clone(), body })
    }
}

/// A picture as an address that holds its data.
fn embedded((x, y): (f64, f64), (width, height): (f64, f64), (kind, data): &(&str, Vec<u8>)) -> String {
    format!(
        "<image x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" \
         preserveAspectRatio=\"none\" href=\"data:image/{kind};base64,{}\"/>",
        STANDARD.encode(data)
    )
}

/// Every n-th pixel, so that the longer rows have at most [`MOST_COLUMNS`].
fn shrunk(image: &Image) -> Image {
    let size = image.size();
    let step = size.width.div_ceil(MOST_COLUMNS).max(1);
    let small = Size::new(size.width.div_ceil(step), size.height.div_ceil(step));
    Image::from_fn(small, |x, y| image.get(x * step, y * step).unwrap_or(UNKNOWN))
}

fn png(image: &Image) -> Result<(&'static str, Vec<u8>), ReportError> {
    let mut bytes = Vec::new();
    encode(image, PngEncoder::new_with_quality(&mut bytes, CompressionType::Best, FilterType::Adaptive))?;
    Ok(("png", bytes))
}

fn jpeg(image: &Image) -> Result<(&'static str, Vec<u8>), ReportError> {
    let mut bytes = Vec::new();
    encode(image, JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY))?;
    Ok(("jpeg", bytes))
}

fn encode(image: &Image, encoder: impl ImageEncoder) -> Result<(), ReportError> {
    let (width, height) = (image.size().width as u32, image.size().height as u32);
    encoder
        .write_image(image.rgb(), width, height, ExtendedColorType::Rgb8)
        .map_err(|error| ReportError::Drawing { figure: "a picture".to_owned(), reason: error.to_string() })
}

fn bar_of_colours(bar: &Bar, (x, y): (f64, f64)) -> String {
    let width = 1.6 * CELL;
    let mut body = text((x, y + 8.0), &bar.title, LABEL_SIZE, Ink::Text);
    let step = width / STEPS as f64;
    for index in 0..STEPS {
        let colour = bar.gradient.eval_continuous((index as f64 + 0.5) / STEPS as f64);
        // A little wider than the step, so that no seam shows; writing to a String cannot fail.
        write!(
            body,
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"10\" fill=\"#{colour:x}\"/>",
            x + index as f64 * step,
            y + 13.0,
            step + if index + 1 < STEPS { 0.5 } else { 0.0 }
        )
        .ok();
    }
    body.push_str(&text((x, y + 35.0), &bar.ends[0], LABEL_SIZE, Ink::Muted));
    body + &anchored((x + width, y + 35.0), &bar.ends[1], LABEL_SIZE, Ink::Muted, "end")
}
