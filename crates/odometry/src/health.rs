//! Frames in which nothing can be measured.
//!
//! The checks look at the brightness of the picture at the networks' size. Thresholds are in grey levels of 0 to 255.

use endoscape_core::Grid;
use std::fmt;

/// A pixel below is black: cheap cameras have blacks of about 16.
const BLACK_BELOW: f32 = 20.0;
/// A picture is black if fewer of its pixels are brighter: one in a hundred may be a hot pixel or a caption.
const LEAST_LIT: f64 = 0.01;
/// A pixel from here on is saturated.
const SATURATED_FROM: f32 = 250.0;
/// A picture is over-exposed if more of it is saturated; highlights of wet tissue stay below a tenth.
const MOST_SATURATED: f64 = 0.6;
/// A picture whose brightness varies less shows nothing.
const LEAST_DEVIATION: f64 = 1.5;
/// A picture that differs less from the one before repeats it; noise alone is larger, even after shrinking.
const LEAST_CHANGE: f64 = 0.05;

/// Why a frame says nothing about motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flaw {
    /// No light.
    Black,
    /// Too much light.
    Overexposed,
    /// One colour all over.
    Featureless,
    /// The same picture as before.
    Frozen,
}

impl fmt::Display for Flaw {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Black => "the picture is black, so the pose is a prediction",
            Self::Overexposed => "the picture is over-exposed, so the pose is a prediction",
            Self::Featureless => "the picture shows nothing, so the pose is a prediction",
            Self::Frozen => "the picture repeats the one before, so the pose is repeated",
        })
    }
}

/// The flaw of a picture, given its brightness and that of the picture before it, of the same size.
pub fn flaw_of(luma: &Grid<f32>, previous: Option<&Grid<f32>>) -> Option<Flaw> {
    let values = luma.values();
    let count = values.len().max(1) as f64;
    let share = |holds: fn(f32) -> bool| values.iter().filter(|value| holds(**value)).count() as f64 / count;
    if share(|value| value >= BLACK_BELOW) < LEAST_LIT {
        return Some(Flaw::Black);
    }
    if share(|value| value >= SATURATED_FROM) > MOST_SATURATED {
        return Some(Flaw::Overexposed);
    }
    if deviation(values) < LEAST_DEVIATION {
        return Some(Flaw::Featureless);
    }
    let previous = previous.filter(|previous| previous.size() == luma.size())?;
    let change = values.iter().zip(previous.values()).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>() / count;
    (change < LEAST_CHANGE).then_some(Flaw::Frozen)
}

/// Standard deviation.
fn deviation(values: &[f32]) -> f64 {
    let count = values.len().max(1) as f64;
    let mean = values.iter().copied().map(f64::from).sum::<f64>() / count;
    (values.iter().map(|value| (f64::from(*value) - mean).powi(2)).sum::<f64>() / count).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use endoscape_core::Size;

    const SIZE: Size = Size::new(64, 48);

    fn textured(shift: usize) -> Grid<f32> {
        Grid::from_fn(SIZE, |x, y| 40.0 + ((7 * (x + shift) + 13 * y) % 90) as f32)
    }

    #[test]
    fn each_flaw_is_told_apart() {
        let flat = |value: f32| Grid::filled(SIZE, value);
        assert_eq!(flaw_of(&flat(9.0), None), Some(Flaw::Black));
        assert_eq!(flaw_of(&flat(255.0), None), Some(Flaw::Overexposed));
        assert_eq!(flaw_of(&flat(120.0), None), Some(Flaw::Featureless));
        assert_eq!(flaw_of(&textured(0), Some(&textured(0))), Some(Flaw::Frozen));
        assert_eq!(flaw_of(&textured(0), Some(&textured(1))), None);
        assert_eq!(flaw_of(&textured(0), None), None);
    }

    #[test]
    fn highlights_captions_and_noise_are_no_flaws() {
        let highlights = Grid::from_fn(SIZE, |x, y| if x < 12 { 255.0 } else { *textured(0).get(x, y).unwrap() });
        assert_eq!(flaw_of(&highlights, None), None);
        let caption = Grid::from_fn(SIZE, |x, y| if x == 0 && y < 10 { 255.0 } else { 3.0 });
        assert_eq!(flaw_of(&caption, None), Some(Flaw::Black));
        let noisy = textured(0).map(|value| value + if value.to_bits() % 2 == 0 { 0.2 } else { -0.2 });
        assert_eq!(flaw_of(&noisy, Some(&textured(0))), None);
    }

    #[test]
    fn an_empty_picture_is_black() {
        assert_eq!(flaw_of(&Grid::filled(Size::new(0, 0), 0.0), None), Some(Flaw::Black));
    }
}
