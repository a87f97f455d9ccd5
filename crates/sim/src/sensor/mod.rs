//! From light to the bytes of a frame: lens, sensor, processor.
//!
//! The chain follows that of a real camera: blur of the lens, smear of the exposure, drops on the window, vignetting,
//! gain, noise, tone curve, quantisation, colour subsampling, compression. Each step is one [`Effect`] and is left out
//! without a trace when that is off: the value of a pixel is then its light times the gain.

mod blur;
mod droplets;
pub mod encode;

use crate::random::Key;
use crate::render::{Optics, Sample};
use crate::{Effect, Effects, SimError};
use endoscape_core::{Grid, Image, Mask, Size};
use rayon::prelude::*;

/// Linear red, green and blue of every pixel.
pub(crate) type Light = Vec<[f32; 3]>;

/// Share of full scale at which the brightest tenth of the picture is kept.
const EXPOSED_TO: f64 = 0.62;
/// Time constant of the automatic gain, seconds.
const EXPOSURE_DELAY_S: f64 = 0.3;
/// The gain stays within this factor of the fixed one.
const GAIN_RANGE: f64 = 24.0;
/// Electrons at full scale and unit gain, and electrons of read-out noise; a small CMOS sensor as in capsules.
const FULL_WELL: f64 = 6000.0;
const READ_NOISE: f64 = 7.0;
/// Light lost in the corners.
const VIGNETTE: f64 = 0.55;
/// Quality of the compression.
const JPEG_QUALITY: u8 = 88;
/// Wall nearer than this lies against the window and hides what is behind, metres.
const TOUCHING_M: f64 = 0.0025;
/// A highlight or an occluder counts from this share of the pixel's light.
const COUNTS_FROM: f32 = 0.35;

/// The camera's electronics; keeps the gain from frame to frame.
#[derive(Clone, Debug)]
pub struct Sensor {
    effects: Effects,
    key: Key,
    fixed_gain: f64,
    gain: Option<f64>,
}

/// A finished frame.
#[derive(Clone, Debug)]
pub struct Developed {
    /// The picture.
    pub image: Image,
    /// Pixels that show the wall: inside the field of view, no highlight, no occluder, in focus.
    pub usable: Mask,
    /// White where a highlight covers the wall.
    pub specular: Mask,
    /// White where something between lens and wall covers it.
    pub occluder: Mask,
    /// White where the lens blurs by more than a pixel.
    pub defocus: Mask,
    /// Value of a pixel per unit of light.
    pub gain: f64,
}

/// What lies between the wall and the lens: colour and cover of every pixel.
#[derive(Clone, Debug)]
pub struct Veil {
    /// Share of the wall's light that is replaced, 0 to 1.
    pub cover: Vec<f32>,
    /// Light added.
    pub light: Light,
}

impl Sensor {
    /// Electronics with a gain at which a wall of albedo 1 at `usual_distance_m` is white.
    pub fn new(effects: Effects, seed: u64, usual_distance_m: f64) -> Self {
        let fixed_gain = usual_distance_m * usual_distance_m;
        Self { effects, key: Key::new(seed).of("sensor"), fixed_gain, gain: None }
    }

    /// Takes a frame: the light of every pixel, what veils it, and the time since the frame before.
    ///
    /// # Errors
    /// [`SimError`] if the compression fails, which it does for pictures no JPEG can hold.
    pub fn develop(
        &mut self,
        number: u64,
        interval_s: f64,
        optics: &Optics,
        samples: &[Sample],
        veil: Option<&Veil>,
    ) -> Result<Developed, SimError> {
        let size = optics.size();
        let mut light: Light = samples.par_iter().map(|s| s.diffuse.map(|c| (c + s.specular) as f32)).collect();
        let mut cover = vec![0.0_f32; samples.len()];
        if let Some(veil) = veil {
            light.par_iter_mut().enumerate().for_each(|(i, rgb)| {
                *rgb = std::array::from_fn(|c| rgb[c] * (1.0 - veil.cover[i]) + veil.light[i][c]);
            });
            cover.clone_from(&veil.cover);
        }
        let mut defocus = Grid::filled(size, false);
        if self.effects.has(Effect::Defocus) {
            let radii = blur::circles_px(optics, samples);
            light = blur::defocused(&light, &radii, size);
            defocus = Grid::from_fn(size, |x, y| radii[y * size.width + x] > 1.0);
        }
        if self.effects.has(Effect::MotionBlur) {
            light = blur::smeared(&light, samples, size);
        }
        if self.effects.has(Effect::Droplets) {
            droplets::cling(&mut light, &mut cover, size, self.key.of("droplets"), number as f64 * interval_s);
        }
        if self.effects.has(Effect::Vignette) {
            vignette(&mut light, size);
        }
        let gain = self.exposed(&light, samples, interval_s);
        let image = self.digitised(&light, size, gain, number)?;
        let white = |i: usize| samples[i].specular as f32 >= COUNTS_FROM * light_of(&samples[i]);
        let at = |x: usize, y: usize| y * size.width + x;
        let bright = |i: usize| samples[i].specular * gain > 0.12;
        let specular = Grid::from_fn(size, |x, y| white(at(x, y)) && bright(at(x, y)));
        let pressed = |i: usize| samples[i].is_wall() && samples[i].distance_m < TOUCHING_M;
        let occluder = Grid::from_fn(size, |x, y| cover[at(x, y)] > COUNTS_FROM || pressed(at(x, y)));
        let usable = Grid::from_fn(size, |x, y| {
            let marked = |mask: &Mask| mask.get(x, y) == Some(&true);
            samples[at(x, y)].is_wall() && !(marked(&specular) || marked(&occluder) || marked(&defocus))
        });
        Ok(Developed { image, usable, specular, occluder, defocus, gain })
    }

    /// The gain for this frame: fixed, or following the brightest tenth with a delay.
    fn exposed(&mut self, light: &Light, samples: &[Sample], interval_s: f64) -> f64 {
        if !self.effects.has(Effect::Exposure) {
            return self.fixed_gain;
        }
        let seen = light.iter().zip(samples).step_by(7).filter(|(_, sample)| sample.is_wall());
        let mut luma: Vec<f32> = seen.map(|(c, _)| 0.299 * c[0] + 0.587 * c[1] + 0.114 * c[2]).collect();
        if luma.is_empty() {
            return self.gain.unwrap_or(self.fixed_gain);
        }
        let at = luma.len() * 9 / 10;
        let bright = f64::from(*luma.select_nth_unstable_by(at, f32::total_cmp).1).max(1e-12);
        let range = (self.fixed_gain / GAIN_RANGE, self.fixed_gain * GAIN_RANGE);
        let wanted = (EXPOSED_TO / bright).clamp(range.0, range.1);
        let step = 1.0 - (-interval_s / EXPOSURE_DELAY_S).exp();
        let gain = self.gain.map_or(wanted, |gain| gain * (wanted / gain).powf(step));
        self.gain = Some(gain);
        gain
    }

    fn digitised(&self, light: &Light, size: Size, gain: f64, number: u64) -> Result<Image, SimError> {
        let key = self.key.of("noise").at(number);
        let (noisy, curved) = (self.effects.has(Effect::Noise), self.effects.has(Effect::Gamma));
        let amplified = (gain / self.fixed_gain).max(0.2);
        let byte = |i: usize, c: usize| {
            let mut value = f64::from(light[i][c]) * gain;
            // Outside the field of view recorders write black.
            if noisy && value > 0.0 {
                // Photons are counted before the gain, so a dark scene is noisy once it is made bright.
                let electrons = FULL_WELL / amplified;
                let deviation = (value.clamp(0.0, 1.5) / electrons + (READ_NOISE / electrons).powi(2)).sqrt();
                value += deviation * key.at((3 * i + c) as u64).normal();
            }
            let value = if curved { srgb(shoulder(value.max(0.0))) } else { value };
            (255.0 * value.clamp(0.0, 1.0)).round() as u8
        };
        let bytes: Vec<u8> = (0..3 * size.area()).into_par_iter().map(|i| byte(i / 3, i % 3)).collect();
        let image = encode::image(size, bytes)?;
        encode::compressed(
            image,
            self.effects.has(Effect::Chroma),
            self.effects.has(Effect::Jpeg).then_some(JPEG_QUALITY),
        )
    }
}

fn light_of(sample: &Sample) -> f32 {
    (sample.diffuse.iter().sum::<f64>() / 3.0 + sample.specular) as f32
}

fn vignette(light: &mut Light, size: Size) {
    let middle = [0.5 * (size.width as f64 - 1.0), 0.5 * (size.height as f64 - 1.0)];
    let reach = middle[0].max(middle[1]);
    light.par_iter_mut().enumerate().for_each(|(i, rgb)| {
        let (x, y) = ((i % size.width) as f64 - middle[0], (i / size.width) as f64 - middle[1]);
        let share = (x.hypot(y) / reach).min(1.4);
        let kept = (1.0 - VIGNETTE * share.powi(3)).max(0.0) as f32;
        *rgb = rgb.map(|value| value * kept);
    });
}

/// Rolls highlights off instead of clipping them hard, as camera processors do; identity below the knee.
fn shoulder(value: f64) -> f64 {
    const KNEE: f64 = 0.6;
    let rest = 1.0 - KNEE;
    if value <= KNEE { value } else { KNEE + rest * (1.0 - (-(value - KNEE) / rest).exp()) }
}

/// The sRGB curve (IEC 61966-2-1).
fn srgb(value: f64) -> f64 {
    if value <= 0.003_130_8 { 12.92 * value } else { 1.055 * value.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests;
