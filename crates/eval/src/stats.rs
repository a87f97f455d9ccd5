//! The seven figures errors are summed up by.

use serde::Serialize;

/// Summary of a list of errors, in the unit of the errors (`sse` in its square).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Statistics {
    /// Root of the mean square.
    pub rmse: f64,
    /// Mean.
    pub mean: f64,
    /// Middle value; the mean of the two middle ones for an even count.
    pub median: f64,
    /// Standard deviation of the errors given (divided by their number).
    pub std: f64,
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
    /// Sum of squares.
    pub sse: f64,
}

impl Statistics {
    /// `None` for no errors at all.
    pub fn of(errors: &[f64]) -> Option<Self> {
        let count = errors.len() as f64;
        let mean = mean(errors)?;
        let sse: f64 = errors.iter().map(|error| error * error).sum();
        Some(Self {
            rmse: (sse / count).sqrt(),
            mean,
            median: median(errors)?,
            std: std(errors)?,
            min: errors.iter().copied().fold(f64::INFINITY, f64::min),
            max: errors.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            sse,
        })
    }

    /// The same errors in another unit.
    pub fn scaled(self, factor: f64) -> Self {
        Self {
            rmse: self.rmse * factor,
            mean: self.mean * factor,
            median: self.median * factor,
            std: self.std * factor,
            min: self.min * factor,
            max: self.max * factor,
            sse: self.sse * factor * factor,
        }
    }
}

/// Mean and standard deviation, with the 95 % interval of the mean.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Standard deviation (divided by the number of values).
    pub std: f64,
    /// Bootstrap interval of the mean, see [`crate::bootstrap`].
    pub ci95: [f64; 2],
}

impl Spread {
    /// Sums up `values` of which `overlap` neighbours at a time share data; `None` for no values.
    pub fn of(values: &[f64], overlap: usize) -> Option<Self> {
        let ci95 = crate::bootstrap::mean_interval(values, overlap)?;
        Some(Self { mean: mean(values)?, std: std(values)?, ci95 })
    }
}

/// Mean; `None` for no values.
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Standard deviation, divided by the number of values; `None` for no values.
pub fn std(values: &[f64]) -> Option<f64> {
    let mean = mean(values)?;
    let squares: f64 = values.iter().map(|value| (value - mean) * (value - mean)).sum();
    Some((squares / values.len() as f64).sqrt())
}

/// Middle value, the mean of the two middle ones for an even count; `None` for no values.
pub fn median(values: &[f64]) -> Option<f64> {
    let mut values = values.to_vec();
    let middle = values.len() / 2;
    if values.is_empty() {
        return None;
    }
    let odd = values.len() % 2 == 1;
    let (below, upper, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    let upper = *upper;
    let lower = if odd { upper } else { below.iter().copied().fold(f64::NEG_INFINITY, f64::max) };
    Some(0.5 * (lower + upper))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_figures() {
        let statistics = Statistics::of(&[4.0, 1.0, 3.0, 2.0]).unwrap();
        assert_eq!((statistics.mean, statistics.median, statistics.min, statistics.max), (2.5, 2.5, 1.0, 4.0));
        assert_eq!((statistics.sse, statistics.rmse, statistics.std), (30.0, 7.5_f64.sqrt(), 1.25_f64.sqrt()));
        assert_eq!(median(&[5.0, 1.0, 2.0]), Some(2.0));
        assert!(Statistics::of(&[]).is_none());
    }
}
