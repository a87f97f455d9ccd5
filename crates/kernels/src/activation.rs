//! What follows a product, on the way back.

use rayon::prelude::*;

/// Numbers that are a sensible piece of work.
const PIECE: usize = 1 << 15;

/// Makes the gradient after a ReLU that before it: zero where the ReLU let nothing through.
pub fn relu_gradient(gradient: &mut [f32], output: &[f32]) {
    let pieces = gradient.par_chunks_mut(PIECE).zip(output.par_chunks(PIECE));
    pieces.for_each(|(gradient, output)| {
        for (gradient, output) in gradient.iter_mut().zip(output) {
            *gradient = if *output > 0.0 { *gradient } else { 0.0 };
        }
    });
}
