//! Brightness against its surroundings: what stays the same when a lamp moves with the lens.

use super::windows::box_sums;
use endoscape_core::{Image, Size};

/// Half the side of the surroundings, as a share of the picture's longer side: larger than most texture, smaller than
/// the gradients of the lighting.
const RADIUS_SHARE: f64 = 1.0 / 24.0;

/// Grey levels that one standard deviation of the surroundings becomes.
const SPREAD: f32 = 40.0;

/// Standard deviation that is added, grey levels: noise of flat regions is not to be blown up to texture.
const NOISE: f32 = 3.0;

/// A grey picture of local contrast: `128 + 40 (I - mean) / (sd + 3)` with mean and standard deviation of luma over a
/// square around each pixel, cut at the edges.
pub fn local(image: &Image) -> Image {
    let Size { width, height } = image.size();
    let radius = (RADIUS_SHARE * width.max(height) as f64).round().max(1.0) as usize;
    let luma: Vec<u8> = image.luma().values().iter().map(|luma| luma.round().clamp(0.0, 255.0) as u8).collect();
    let sums = box_sums(&luma, image.size(), radius, |value| u32::from(*value));
    let squares = box_sums(&luma, image.size(), radius, |value| u32::from(*value).pow(2));
    Image::from_fn(image.size(), |x, y| {
        let index = y * width + x;
        let ((sum, count), (square, _)) = (sums[index], squares[index]);
        let mean = sum as f32 / count as f32;
        let deviation = (square as f32 / count as f32 - mean * mean).max(0.0).sqrt();
        let contrast = 128.0 + SPREAD * (f32::from(luma[index]) - mean) / (deviation + NOISE);
        [contrast.round().clamp(0.0, 255.0) as u8; 3]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stripes under a light of some strength that falls off to the right.
    fn striped(strength: f64) -> Image {
        Image::from_fn(Size::new(96, 64), |x, y| {
            let stripe = if (x / 3 + y / 3) % 2 == 0 { 0.8 } else { 1.0 };
            [(strength * stripe * (1.0 - x as f64 / 192.0)).round() as u8; 3]
        })
    }

    #[test]
    fn light_hardly_changes_it() {
        let (bright, dim) = (local(&striped(220.0)), local(&striped(150.0)));
        let difference = |(a, b): (&u8, &u8)| f64::from(a.abs_diff(*b));
        let differences: f64 = bright.rgb().iter().zip(dim.rgb()).map(difference).sum();
        let mean = differences / bright.rgb().len() as f64;
        assert!(mean < 6.0, "{mean} grey levels, of 40 per standard deviation");
    }

    #[test]
    fn one_colour_stays_flat() {
        for value in [0, 77, 255] {
            let flat = local(&Image::from_fn(Size::new(40, 30), |_, _| [value; 3]));
            assert!(flat.rgb().iter().all(|value| *value == 128));
        }
        assert!(local(&Image::from_fn(Size::new(0, 0), |_, _| [0; 3])).rgb().is_empty());
    }
}
