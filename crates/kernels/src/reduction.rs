//! Maps that become one number, with derivatives, in one pass over memory.
//!
//! Sums are taken piece by piece and then over the pieces in their order.

use crate::level::Level;
use crate::pieces::{dot, sum};
use rayon::prelude::*;

/// Numbers that are a sensible piece of work.
const PIECE: usize = 1 << 13;

/// What a weighted sum is divided by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Divisor {
    /// The sum of the weights, or 1 if that is less.
    Weights,
    /// The number of values.
    Count,
}

/// Values and their weights; values of weight 0 do not count whatever they are, NaN included.
#[derive(Clone, Copy, Debug)]
pub struct WeightedMean<'a> {
    /// What is averaged.
    pub values: &'a [f32],
    /// As many weights.
    pub weights: &'a [f32],
    /// What the sum is divided by.
    pub divisor: Divisor,
}

impl WeightedMean<'_> {
    /// The mean.
    ///
    /// # Panics
    /// If lengths differ.
    pub fn value(&self) -> f32 {
        assert_eq!(self.values.len(), self.weights.len());
        let pieces = self.values.par_chunks(PIECE).zip(self.weights.par_chunks(PIECE));
        let sums = pieces.map(|(values, weights)| {
            Level::default().run(
                #[inline(always)]
                || weighted_sum(values, weights),
            )
        });
        total(sums) / self.divided_by()
    }

    /// The gradient of the values from that of the mean.
    pub fn gradient(&self, of_mean: f32) -> Vec<f32> {
        let factor = of_mean / self.divided_by();
        let mut gradient = vec![0.0; self.weights.len()];
        let pieces = gradient.par_chunks_mut(PIECE).zip(self.weights.par_chunks(PIECE));
        pieces.for_each(|(gradient, weights)| {
            gradient.iter_mut().zip(weights).for_each(|(gradient, weight)| *gradient = factor * weight);
        });
        gradient
    }

    fn divided_by(&self) -> f32 {
        match self.divisor {
            Divisor::Weights => total(self.weights.par_chunks(PIECE).map(sum)).max(1.0),
            Divisor::Count => self.values.len() as f32,
        }
    }
}

/// The sum over pieces, in their order.
fn total(sums: impl IndexedParallelIterator<Item = f32>) -> f32 {
    sums.collect::<Vec<f32>>().into_iter().map(f64::from).sum::<f64>() as f32
}

#[inline(always)]
fn weighted_sum(values: &[f32], weights: &[f32]) -> f32 {
    let mut counted = [0.0; PIECE];
    let counted = &mut counted[..values.len()];
    for (counted, (value, weight)) in counted.iter_mut().zip(values.iter().zip(weights)) {
        // Not a product alone: 0 * NaN would spread from a value that does not count.
        *counted = if *weight == 0.0 { 0.0 } else { *value };
    }
    dot(counted, weights)
}

/// `mean(-ln(max(x, smallest)))`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CrossEntropy {
    /// Keeps the logarithm finite; the gradient ends there too.
    pub smallest: f32,
}

impl CrossEntropy {
    /// The mean over `values`.
    pub fn value(self, values: &[f32]) -> f32 {
        // Their product stays in the range of double precision while each is between 1e-9 and 1e9.
        const TOGETHER: usize = 32;
        let logarithms = values.par_chunks(PIECE).map(|values| {
            // One logarithm of a product instead of many.
            let product = |values: &[f32]| values.iter().map(|x| f64::from(x.max(self.smallest))).product::<f64>();
            values.chunks(TOGETHER).map(|values| product(values).ln()).sum::<f64>() as f32
        });
        -total(logarithms) / values.len() as f32
    }

    /// The gradient of the values from that of the mean.
    pub fn gradient(self, values: &[f32], of_mean: f32) -> Vec<f32> {
        let factor = -of_mean / values.len() as f32;
        let mut gradient = vec![0.0; values.len()];
        gradient.par_chunks_mut(PIECE).zip(values.par_chunks(PIECE)).for_each(|(gradient, values)| {
            for (gradient, x) in gradient.iter_mut().zip(values) {
                *gradient = if *x < self.smallest { 0.0 } else { factor / x };
            }
        });
        gradient
    }
}
