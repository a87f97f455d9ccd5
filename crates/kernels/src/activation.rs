//! What follows a product, on the way back.

use rayon::prelude::*;

/// Numbers that are a sensible piece of work.
const PIECE: usize = 1 << 15;

/// The gradient before a ReLU: `gradient` where the ReLU let something through, else 0.
pub fn relu_gradient(gradient: &[f32], output: &[f32]) -> Vec<f32> {
    let mut before = vec![0.0; gradient.len()];
    let pieces = before.par_chunks_mut(PIECE).zip(gradient.par_chunks(PIECE)).zip(output.par_chunks(PIECE));
    pieces.for_each(|((before, gradient), output)| {
        for ((before, gradient), output) in before.iter_mut().zip(gradient).zip(output) {
            *before = if *output > 0.0 { *gradient } else { 0.0 };
        }
    });
    before
}
