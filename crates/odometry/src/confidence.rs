//! How far to trust a pose, from 0 to 1.
//!
//! ```text
//! confidence = match * overlap * agreement
//! match      correlation of the brightness of a keyframe's pixels with that at their places in the frame, at least 0
//! overlap    share of those pixels that the frame shows, full marks from one half on
//! agreement  of the forward and the backward estimate of the motion to the keyframe (chain::agreement)
//! ```
//!
//! Correlation does not mind exposure and gain, which follow the distance of a light that moves with the camera. Pixels
//! too dark or too bright to carry texture are left out. Without a camera, which the comparison of pictures needs,
//! agreement alone is left. A frame in which nothing can be seen has confidence 0.

use crate::reproject::{Moved, bilinear};
use endoscape_core::Grid;

/// Fewer pixels than this compare by luck.
const LEAST_PIXELS: usize = 50;
/// A frame that shows this share of the keyframe's pixels shows enough.
const ENOUGH_OVERLAP: f64 = 0.5;

/// How well a frame shows what a keyframe shows, given where the keyframe's pixels should be; 0 to 1.
///
/// `counts` says which pixels of the keyframe may be compared and `compared` how many there are.
pub fn likeness(
    moved: &[Moved],
    keyframe: &Grid<f32>,
    frame: &Grid<f32>,
    counts: impl Fn(usize) -> bool,
    compared: usize,
) -> f64 {
    let pair = |pixel: &Moved| {
        let before = keyframe.values().get(pixel.from).copied().map(f64::from)?;
        Some((before, bilinear(frame, &pixel.to)?))
    };
    let pairs: Vec<(f64, f64)> = moved.iter().filter(|pixel| counts(pixel.from)).filter_map(pair).collect();
    if pairs.len() < LEAST_PIXELS {
        return 0.0;
    }
    let overlap = (pairs.len() as f64 / (ENOUGH_OVERLAP * compared.max(1) as f64)).min(1.0);
    correlation(&pairs).max(0.0) * overlap
}

/// Pearson's correlation; 0 where either side does not vary.
fn correlation(pairs: &[(f64, f64)]) -> f64 {
    let count = pairs.len().max(1) as f64;
    let (mean_a, mean_b) = pairs.iter().fold((0.0, 0.0), |(a, b), pair| (a + pair.0 / count, b + pair.1 / count));
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (a, b) in pairs {
        let (a, b) = (a - mean_a, b - mean_b);
        (ab, aa, bb) = (ab + a * b, aa + a * a, bb + b * b);
    }
    let norm = (aa * bb).sqrt();
    if norm > 0.0 && norm.is_finite() { (ab / norm).clamp(-1.0, 1.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reproject::{LATTICE, Reprojector};
    use endoscape_core::{Camera, Pose, Size};

    const SIZE: Size = Size::new(80, 64);

    fn scene(shift: f64) -> Grid<f32> {
        Grid::from_fn(SIZE, |x, y| {
            let (x, y) = (x as f64 + shift, y as f64);
            (120.0 + 50.0 * (0.4 * x).sin() + 30.0 * (0.3 * y + 0.1 * x).cos()) as f32
        })
    }

    fn likeness_after(shift_m: f64, frame: &Grid<f32>) -> f64 {
        let camera = Camera::from_field_of_view(SIZE, 1.0).unwrap();
        let lattice = Reprojector::new(&camera, SIZE, LATTICE).unwrap();
        let moved = lattice.reproject(&Grid::filled(SIZE, 1.0), &Pose::translation(shift_m, 0.0, 0.0));
        likeness(&moved, &scene(0.0), frame, |_| true, lattice.len())
    }

    #[test]
    fn the_right_motion_is_trusted_and_the_wrong_one_is_not() {
        // A pinhole of one radian over 80 pixels has a focal length of 73.2 pixels.
        let three_pixels_m = 3.0 / 73.2;
        let moved = scene(-3.0);
        assert!(likeness_after(three_pixels_m, &moved) > 0.99);
        assert!(likeness_after(-three_pixels_m, &moved) < 0.5);
        let brighter = moved.map(|value| 1.4 * value + 20.0);
        assert!(likeness_after(three_pixels_m, &brighter) > 0.99);
    }

    #[test]
    fn nothing_in_common_is_no_trust() {
        assert_eq!(likeness_after(5.0, &scene(0.0)), 0.0);
        assert_eq!(likeness_after(0.0, &Grid::filled(SIZE, 90.0)), 0.0);
        assert_eq!(likeness_after(0.0, &Grid::filled(SIZE, f32::NAN)), 0.0);
        let half_out = likeness_after(0.8 * 80.0 / 73.2, &scene(-64.0));
        assert!(half_out > 0.1 && half_out < 0.6, "{half_out}");
    }
}
