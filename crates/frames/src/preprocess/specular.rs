//! Highlights: mirror images of the lamp, which sit still on the lens side while the tissue moves.

use super::windows::box_sums;
use endoscape_core::{Grid, Image, Mask, Size};

/// When a pixel counts as highlight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SpecularConfig {
    /// A pixel whose weakest colour reaches this is white. Tissue is red: its blue and green stay low even when it is
    /// bright, while a highlight has the lamp's colour.
    pub white: u8,
    /// A pixel whose weakest colour reaches this and stands out by [`SpecularConfig::contrast`] is white too: small
    /// glints that the lens has blurred.
    pub pale: u8,
    /// By how much a pale pixel must exceed the mean of its neighbourhood.
    pub contrast: u8,
    /// How far around a highlight its glow reaches, pixels.
    pub dilation_px: usize,
}

impl Default for SpecularConfig {
    /// First guesses, checked by eye on one overlay each of colonoscope, bronchoscope and laparoscope video between 320
    /// and 1350 pixels wide and not tuned: 225 spares well-lit pale mucosa, 130 with a contrast of 45 is meant for
    /// glints in the dark lumen. Bright rims and steel are marked as well.
    fn default() -> Self {
        Self { white: 225, pale: 130, contrast: 45, dilation_px: 3 }
    }
}

/// Pixels that show the surface and not the lamp: `false` on highlights and within `dilation_px` of them.
pub fn mask(image: &Image, config: &SpecularConfig) -> Mask {
    let size = image.size();
    let weakest = image.rgb().chunks_exact(3).map(|rgb| rgb[0].min(rgb[1]).min(rgb[2])).collect::<Vec<_>>();
    // A neighbourhood of a sixteenth of the picture is far larger than a glint and far smaller than the lighting.
    let mean = box_mean(&weakest, size, (size.width.max(size.height) / 32).max(1));
    let highlight = |(&value, &mean): (&u8, &f32)| {
        value >= config.white || (value >= config.pale && f32::from(value) - mean >= f32::from(config.contrast))
    };
    let highlights = weakest.iter().zip(&mean).map(highlight).collect::<Vec<_>>();
    let counts = box_sums(&highlights, size, config.dilation_px, |hit| u32::from(*hit));
    Grid::from_fn(size, |x, y| counts[y * size.width + x].0 == 0)
}

fn box_mean(values: &[u8], size: Size, radius: usize) -> Vec<f32> {
    let sums = box_sums(values, size, radius, |value| u32::from(*value));
    sums.iter().map(|(sum, count)| *sum as f32 / *count as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_glint(tissue: [u8; 3], glint: [u8; 3]) -> Image {
        Image::from_fn(Size::new(64, 48), |x, y| if (x, y) == (30, 20) { glint } else { tissue })
    }

    #[test]
    fn a_glint_is_cut_out_with_its_glow() {
        let config = SpecularConfig { dilation_px: 2, ..SpecularConfig::default() };
        for glint in [[255, 250, 240], [160, 150, 140]] {
            let mask = mask(&with_glint([90, 40, 30], glint), &config);
            let unusable = mask.values().iter().filter(|usable| !**usable).count();
            assert_eq!(unusable, 25, "a square of 5 around {glint:?}");
            assert_eq!(mask.get(28, 18), Some(&false));
        }
    }

    #[test]
    fn bright_red_tissue_is_no_highlight() {
        let mask = mask(&with_glint([255, 120, 110], [255, 130, 120]), &SpecularConfig::default());
        assert!(mask.values().iter().all(|usable| *usable));
    }

    #[test]
    fn more_dilation_never_gives_pixels_back() {
        let image = with_glint([90, 40, 30], [255, 250, 240]);
        let dilated = |dilation_px| mask(&image, &SpecularConfig { dilation_px, ..SpecularConfig::default() });
        for (small, large) in [(0, 1), (1, 5), (5, 100)] {
            let (small, large) = (dilated(small), dilated(large));
            assert!(small.values().iter().zip(large.values()).all(|(small, large)| *small || !*large));
        }
        assert!(mask(&Image::from_fn(Size::new(0, 0), |_, _| [0; 3]), &SpecularConfig::default()).values().is_empty());
    }
}
