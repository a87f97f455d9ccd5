//! Blur: of the lens by distance, of the exposure by motion.

use super::Light;
use crate::render::{Optics, Sample};
use endoscape_core::Size;
use rayon::prelude::*;

/// Distance in focus, metres; a fixed-focus capsule lens.
const FOCUS_M: f64 = 0.022;
/// Diameter of the entrance pupil, metres.
const PUPIL_M: f64 = 0.00055;
/// Blur of the lens at its best, as the deviation of a Gaussian in pixels.
const SHARPEST_PX: f32 = 0.45;
/// Widest blur worked out, pixels.
const WIDEST_PX: f32 = 6.0;
/// Share of the interval between frames during which the sensor takes light.
const SHUTTER: f64 = 0.3;
/// Longest smear worked out, pixels.
const LONGEST_PX: f64 = 40.0;

/// Radius of the circle of confusion of every pixel: pupil times the difference of reciprocal distances, as an angle,
/// in pixels.
pub fn circles_px(optics: &Optics, samples: &[Sample]) -> Vec<f32> {
    let per_rad = 1.0 / optics.pixel_rad();
    let radius = |sample: &Sample| {
        if sample.distance_m <= 0.0 {
            return 0.0;
        }
        (0.5 * PUPIL_M * (1.0 / sample.distance_m - 1.0 / FOCUS_M).abs() * per_rad) as f32
    };
    samples.iter().map(|sample| radius(sample).min(WIDEST_PX)).collect()
}

/// The picture through a lens whose blur differs from pixel to pixel: each gathers from its own circle.
pub fn defocused(light: &Light, radii: &[f32], size: Size) -> Light {
    let gather = |i: usize| {
        let (x, y) = ((i % size.width) as i64, (i / size.width) as i64);
        // Half the radius of a disc is the deviation of the Gaussian that looks like it.
        let deviation = SHARPEST_PX.hypot(0.5 * radii[i]);
        let reach = (2.0 * deviation).ceil() as i64;
        let (mut sum, mut total) = ([0.0_f32; 3], 0.0_f32);
        for (dx, dy) in (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy))) {
            let (column, row) = (x + dx, y + dy);
            if column < 0 || row < 0 || column >= size.width as i64 || row >= size.height as i64 {
                continue;
            }
            let weight = (-0.5 * (dx * dx + dy * dy) as f32 / (deviation * deviation)).exp();
            let value = light[row as usize * size.width + column as usize];
            (0..3).for_each(|c| sum[c] += weight * value[c]);
            total += weight;
        }
        sum.map(|value| value / total)
    };
    (0..size.area()).into_par_iter().map(gather).collect()
}

/// The picture smeared along the flow of its surface for the time the shutter is open.
pub fn smeared(light: &Light, samples: &[Sample], size: Size) -> Light {
    let smear = |i: usize| {
        let Some([dx, dy]) = samples[i].flow else { return light[i] };
        let length = (SHUTTER * dx.hypot(dy)).min(LONGEST_PX);
        let taps = length.ceil() as i64;
        if length < 0.5 {
            return light[i];
        }
        let scale = length / dx.hypot(dy);
        let (x, y) = ((i % size.width) as f64, (i / size.width) as f64);
        let mut sum = [0.0_f32; 3];
        for tap in 0..=taps {
            // The frame's time is the middle of the exposure.
            let share = scale * (tap as f64 / taps as f64 - 0.5);
            let column = (x + share * dx).round().clamp(0.0, (size.width - 1) as f64) as usize;
            let row = (y + share * dy).round().clamp(0.0, (size.height - 1) as f64) as usize;
            let value = light[row * size.width + column];
            (0..3).for_each(|c| sum[c] += value[c]);
        }
        sum.map(|value| value / (taps + 1) as f32)
    };
    (0..size.area()).into_par_iter().map(smear).collect()
}
