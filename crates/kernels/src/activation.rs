//! What follows a product, on the way back.

use crate::pieces::sum;
use rayon::prelude::*;

/// Numbers that are a sensible piece of work.
const PIECE: usize = 1 << 14;

/// The gradient of the bias: the sum of each channel over the batch and all pixels.
///
/// # Shapes
/// - `gradient`: `[batch, channels, area]`
/// - `bias`: `[channels]`, all of it is written
pub fn bias_gradient(gradient: &[f32], area: usize, bias: &mut [f32]) {
    let planes = gradient.par_chunks(area.max(1)).with_min_len(PIECE / area.max(1) + 1);
    collect(&planes.map(sum).collect::<Vec<_>>(), bias);
}

/// Makes the gradient after a ReLU that before it, zero where the ReLU let nothing through, and sums it as
/// [`bias_gradient`] does.
///
/// # Shapes
/// - `gradient`, `output`: `[batch, channels, area]`
/// - `bias`: `[channels]`, all of it is written
pub fn relu_bias_gradient(gradient: &mut [f32], output: &[f32], area: usize, bias: &mut [f32]) {
    let planes = gradient.par_chunks_mut(area.max(1)).zip(output.par_chunks(area.max(1)));
    let sums = planes.with_min_len(PIECE / area.max(1) + 1).map(|(gradient, output)| {
        for (gradient, output) in gradient.iter_mut().zip(output) {
            *gradient = if *output > 0.0 { *gradient } else { 0.0 };
        }
        sum(gradient)
    });
    collect(&sums.collect::<Vec<_>>(), bias);
}

/// Adds up the sums of planes, channel by channel in the order of the batch.
fn collect(sums: &[f32], bias: &mut [f32]) {
    bias.fill(0.0);
    for sums in sums.chunks_exact(bias.len().max(1)) {
        bias.iter_mut().zip(sums).for_each(|(bias, sum)| *bias += sum);
    }
}
