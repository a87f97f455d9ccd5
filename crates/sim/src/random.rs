//! Randomness that does not depend on the order of work.
//!
//! Every number is a hash of what it is for: seed, purpose, frame, pixel. So the same seed gives the same bytes however
//! many threads share the pixels, and a frame does not depend on the frames before it.

use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Finaliser of SplitMix64 (G. Steele, D. Lea, C. Flood, "Fast splittable pseudorandom number generators", 2014).
const fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

/// Distance between successive states of SplitMix64: the golden ratio in 64 bits.
const GAMMA: u64 = 0x9E37_79B9_7F4A_7C15;

/// A source of independent numbers, addressed rather than advanced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Key(u64);

impl Key {
    /// The key of a patient.
    pub const fn new(seed: u64) -> Self {
        Self(mix(seed.wrapping_add(GAMMA)))
    }

    /// An independent key for another purpose.
    pub fn of(self, purpose: &str) -> Self {
        purpose.bytes().fold(self, |key, byte| key.at(u64::from(byte)))
    }

    /// An independent key for one member of a series: a frame, a pixel, a lesion.
    pub const fn at(self, index: u64) -> Self {
        Self(mix(self.0.wrapping_add(GAMMA).wrapping_add(index.wrapping_mul(GAMMA))))
    }

    /// A number from 0 to below 1.
    pub fn uniform(self) -> f64 {
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// A number from `low` to below `high`.
    pub fn range(self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// A normal number of mean 0 and deviation 1 (G. Box, M. Muller, 1958).
    pub fn normal(self) -> f64 {
        let radius = (-2.0 * (1.0 - self.at(0).uniform()).ln()).sqrt();
        radius * (TAU * self.at(1).uniform()).cos()
    }

    /// The numbers of a series one after another.
    pub fn series(self) -> Series {
        Series { key: self, next: 0 }
    }
}

/// Successive numbers of one key.
#[derive(Clone, Copy, Debug)]
pub struct Series {
    key: Key,
    next: u64,
}

impl Series {
    /// The next key.
    pub const fn key(&mut self) -> Key {
        self.next += 1;
        self.key.at(self.next)
    }

    /// A number from `low` to below `high`.
    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        self.key().range(low, high)
    }

    /// A whole number from `low` to below `high`.
    pub fn index(&mut self, low: usize, high: usize) -> usize {
        low + (self.key().uniform() * (high - low) as f64) as usize
    }
}

/// A smooth function of time between -1 and 1 that never repeats: a few sines of unrelated periods and random phases.
#[derive(Clone, Debug)]
pub struct Wander {
    waves: [(f64, f64, f64); 4],
}

impl Wander {
    /// A wander whose slowest period is about `period_s`.
    pub fn new(key: Key, period_s: f64) -> Self {
        let wave = |i: usize| {
            let mut series = key.at(i as u64).series();
            // Higher harmonics are weaker, so that speed stays bounded by few slow terms.
            let order = 1.0 + 0.83 * i as f64;
            let weight = 0.5 / (order * order) * 1.2;
            (weight, TAU * order * series.range(0.85, 1.15) / period_s, series.range(0.0, TAU))
        };
        Self { waves: std::array::from_fn(wave) }
    }

    /// Its value at a time.
    pub fn at(&self, time_s: f64) -> f64 {
        self.waves.iter().map(|(weight, rate, phase)| weight * (rate * time_s + phase).sin()).sum()
    }
}

/// Value noise in space: random values at integer points, joined by a smooth step; between -1 and 1.
pub fn noise(key: Key, point: &Vector3<f64>) -> f64 {
    let floor = point.map(f64::floor);
    let share = (point - floor).map(|x| x * x * (3.0 - 2.0 * x));
    let cell = floor.map(|x| x as i64);
    let corner = |dx: i64, dy: i64, dz: i64| {
        let word = (cell.x + dx).wrapping_mul(0x1F_1F1F_1F1F)
            ^ (cell.y + dy).wrapping_mul(0x2B_2B2B_2B2B)
            ^ (cell.z + dz).wrapping_mul(0x47_4747_4747);
        2.0 * key.at(word as u64).uniform() - 1.0
    };
    let lerp = |a: f64, b: f64, t: f64| a + t * (b - a);
    let row = |dy: i64, dz: i64| lerp(corner(0, dy, dz), corner(1, dy, dz), share.x);
    lerp(lerp(row(0, 0), row(1, 0), share.y), lerp(row(0, 1), row(1, 1), share.y), share.z)
}

/// Two octaves of [`noise`], about -1 to 1.
pub fn turbulence(key: Key, point: &Vector3<f64>) -> f64 {
    0.68 * noise(key, point) + 0.32 * noise(key.at(7), &(point * 2.17))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_depend_on_all_of_their_address() {
        let key = Key::new(1);
        assert_eq!(key.of("noise").at(3), Key::new(1).of("noise").at(3));
        assert_ne!(key.of("noise"), key.of("path"));
        assert_ne!(key.at(3), key.at(4));
        assert_ne!(Key::new(1), Key::new(2));
    }

    #[test]
    fn moments_are_those_of_the_distributions() {
        let keys: Vec<Key> = (0..20_000).map(|i| Key::new(9).at(i)).collect();
        let mean = |values: Vec<f64>| values.iter().sum::<f64>() / values.len() as f64;
        assert!((mean(keys.iter().map(|key| key.uniform()).collect()) - 0.5).abs() < 0.01);
        assert!(mean(keys.iter().map(|key| key.normal()).collect()).abs() < 0.03);
        assert!((mean(keys.iter().map(|key| key.normal().powi(2)).collect()) - 1.0).abs() < 0.05);
    }

    #[test]
    fn wander_and_noise_stay_bounded_and_smooth() {
        let wander = Wander::new(Key::new(3), 10.0);
        for i in 0..2000 {
            let time_s = 0.05 * f64::from(i);
            assert!(wander.at(time_s).abs() <= 1.0);
            let point = Vector3::new(0.01 * f64::from(i), 0.3, -0.7);
            let step = noise(Key::new(4), &point) - noise(Key::new(4), &(point + Vector3::x() * 1e-6));
            assert!(step.abs() < 1e-5);
        }
    }
}
