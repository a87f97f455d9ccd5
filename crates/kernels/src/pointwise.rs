//! Functions of single numbers, by all threads.

use crate::level::Level;
use rayon::prelude::*;

/// Numbers that are a sensible piece of work.
const PIECE: usize = 1 << 13;

/// A function of single numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pointwise {
    /// `scale / (1 + exp(-x)) + offset`.
    Logistic {
        /// Distance of the largest from the smallest value.
        scale: f32,
        /// The smallest value.
        offset: f32,
    },
    /// The number where it lies between two others, else the lower one; NaN does not lie between.
    Within([f32; 2]),
    /// One over [`Pointwise::Within`].
    InverseWithin([f32; 2]),
}

impl Pointwise {
    /// The values at `inputs`.
    pub fn values(self, inputs: &[f32]) -> Vec<f32> {
        match self {
            Self::Logistic { scale, offset } => map(inputs, |x| scale * logistic(x) + offset),
            Self::Within(range) => map(inputs, |x| within(x, range)),
            Self::InverseWithin(range) => map(inputs, |x| 1.0 / within(x, range)),
        }
    }

    /// The gradient of the inputs from that of the values.
    ///
    /// # Panics
    /// If lengths differ.
    pub fn gradient(self, inputs: &[f32], of_values: &[f32]) -> Vec<f32> {
        assert_eq!(inputs.len(), of_values.len());
        match self {
            Self::Logistic { scale, .. } => map_two(inputs, of_values, |x, gradient| {
                let share = logistic(x);
                gradient * scale * share * (1.0 - share)
            }),
            Self::Within(range) => {
                map_two(inputs, of_values, |x, gradient| if is_within(x, range) { gradient } else { 0.0 })
            }
            Self::InverseWithin(range) => {
                map_two(inputs, of_values, |x, gradient| if is_within(x, range) { -gradient / (x * x) } else { 0.0 })
            }
        }
    }
}

#[inline(always)]
fn logistic(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

#[inline(always)]
fn is_within(x: f32, [low, high]: [f32; 2]) -> bool {
    (x > low) & (x < high)
}

#[inline(always)]
fn within(x: f32, range: [f32; 2]) -> f32 {
    if is_within(x, range) { x } else { range[0] }
}

fn map(inputs: &[f32], function: impl Fn(f32) -> f32 + Sync) -> Vec<f32> {
    map_two(inputs, inputs, |x, _| function(x))
}

fn map_two(first: &[f32], second: &[f32], function: impl Fn(f32, f32) -> f32 + Sync) -> Vec<f32> {
    let mut outputs = vec![0.0; first.len()];
    let pieces = outputs.par_chunks_mut(PIECE).zip(first.par_chunks(PIECE).zip(second.par_chunks(PIECE)));
    pieces.for_each(|(outputs, (first, second))| {
        Level::default().run(
            #[inline(always)]
            || outputs.iter_mut().zip(first.iter().zip(second)).for_each(|(y, (a, b))| *y = function(*a, *b)),
        );
    });
    outputs
}
