//! One step of Adam in one pass over memory.

use crate::level::Level;
use rayon::prelude::*;

/// Numbers that are a sensible piece of work.
const PIECE: usize = 1 << 15;

/// What is the same for all parameters of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamStep {
    /// Share of the old mean in the new one.
    pub beta_1: f32,
    /// Share of the old mean square in the new one.
    pub beta_2: f32,
    /// Keeps the quotient finite.
    pub epsilon: f32,
    /// Length of the step.
    pub learning_rate: f32,
    /// Number of this step, the first being 1.
    pub time: usize,
}

impl AdamStep {
    /// Updates both moments and puts the new parameters into the place of the gradient, whose memory nobody needs
    /// afterwards.
    ///
    /// Kingma and Ba, ICLR 2015, Algorithm 1, with the corrections for the start drawn into the step length (their
    /// section 2): `p - rate * c m / (sqrt(v) + epsilon sqrt(1 - beta_2^t))`, `c = sqrt(1 - beta_2^t) / (1 - beta_1^t)`.
    ///
    /// # Panics
    /// If lengths differ.
    pub fn apply(self, parameters: &[f32], gradient: &mut [f32], moments: [&mut [f32]; 2]) {
        let [means, squares] = moments;
        let lengths = [gradient.len(), means.len(), squares.len()];
        assert_eq!(lengths, [parameters.len(); 3], "one gradient and two moments per parameter");
        let moments = means.par_chunks_mut(PIECE).zip(squares.par_chunks_mut(PIECE));
        let pieces = gradient.par_chunks_mut(PIECE).zip(parameters.par_chunks(PIECE)).zip(moments);
        let level = Level::default();
        pieces.for_each(|((gradient, parameters), (means, squares))| {
            level.run(
                #[inline(always)]
                || self.apply_to_piece(parameters, gradient, means, squares),
            );
        });
    }

    #[inline(always)]
    fn apply_to_piece(self, old: &[f32], gradient: &mut [f32], means: &mut [f32], squares: &mut [f32]) {
        let Self { beta_1, beta_2, epsilon, learning_rate, time } = self;
        let correction = (1.0 - beta_2.powi(time as i32)).sqrt();
        let length = learning_rate * correction / (1.0 - beta_1.powi(time as i32));
        let epsilon = epsilon * correction;
        let moments = means.iter_mut().zip(squares.iter_mut());
        for ((old, gradient), (mean, square)) in old.iter().zip(gradient).zip(moments) {
            *mean = beta_1 * *mean + (1.0 - beta_1) * *gradient;
            *square = beta_2 * *square + (1.0 - beta_2) * *gradient * *gradient;
            *gradient = old - length * *mean / (square.sqrt() + epsilon);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_has_the_length_of_the_rate() {
        // With one gradient both moments are powers of it: the quotient is its sign.
        let step = AdamStep { beta_1: 0.9, beta_2: 0.999, epsilon: 1e-8, learning_rate: 0.1, time: 1 };
        let (mut means, mut squares) = ([0.0; 3], [0.0; 3]);
        let mut updated = [0.5, -4.0, 0.0];
        step.apply(&[1.0, 2.0, 3.0], &mut updated, [&mut means, &mut squares]);
        for (updated, expected) in updated.iter().zip([0.9, 2.1, 3.0]) {
            assert!((updated - expected).abs() < 1e-6, "{updated} instead of {expected}");
        }
        assert!((means[1] + 0.4).abs() < 1e-6 && (squares[1] - 0.016).abs() < 1e-6);
    }
}
