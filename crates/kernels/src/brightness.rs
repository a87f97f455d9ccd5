//! One gain and one offset per picture that give a view the brightness of its target, forward and backward.

use rayon::prelude::*;

/// Views, what they are to look like, and which pixels say so.
#[derive(Clone, Copy, Debug)]
pub struct Alignment<'a> {
    /// `[batch, channels, rows, columns]`.
    pub view: &'a [f32],
    /// Shaped like `view`.
    pub target: &'a [f32],
    /// `[batch, 1, rows, columns]`, 0 or 1.
    pub valid: &'a [f32],
    /// Channels.
    pub channels: usize,
    /// Rows times columns.
    pub area: usize,
    /// Added to variances, so that flat pictures keep their contrast.
    pub flat: f32,
}

/// Mean and standard deviation over the valid pixels of all channels.
#[derive(Clone, Copy)]
struct Moments {
    mean: f32,
    deviation: f32,
}

impl Alignment<'_> {
    /// `(view - mean) * (target's deviation / view's deviation) + target's mean`, shaped like `view`.
    ///
    /// # Panics
    /// If lengths do not fit together.
    pub fn aligned(&self) -> Vec<f32> {
        let mut aligned = vec![0.0; self.view.len()];
        aligned.par_chunks_mut(self.channels * self.area).enumerate().for_each(|(picture, aligned)| {
            let (view, of_view, of_target) = self.moments(picture);
            let gain = of_target.deviation / of_view.deviation;
            let values = aligned.iter_mut().zip(view);
            values.for_each(|(aligned, view)| *aligned = (view - of_view.mean) * gain + of_target.mean);
        });
        aligned
    }

    /// The gradient of the view, shaped like it, from that of the result; through the statistics as well.
    ///
    /// # Panics
    /// If lengths do not fit together.
    pub fn view_gradient(&self, of_aligned: &[f32]) -> Vec<f32> {
        let mut of_view = vec![0.0; self.view.len()];
        let count = self.channels * self.area;
        of_view.par_chunks_mut(count).enumerate().for_each(|(picture, gradient)| {
            let of_aligned = &of_aligned[picture * count..][..count];
            let (view, of_view, of_target) = self.moments(picture);
            let gain = of_target.deviation / of_view.deviation;
            let (mut sum, mut along) = (0.0_f64, 0.0_f64);
            for (of_aligned, view) in of_aligned.iter().zip(view) {
                sum += f64::from(*of_aligned);
                along += f64::from(*of_aligned * (view - of_view.mean));
            }
            let valid = &self.valid[picture * self.area..][..self.area];
            let number = (self.channels as f64 * f64::from(sum_of(valid))).max(1.0);
            let of_mean = (-f64::from(gain) * sum / number) as f32;
            let deviation = f64::from(of_view.deviation);
            let of_deviation = (-f64::from(gain) * along / (number * deviation * deviation)) as f32;
            for (channel, gradient) in gradient.chunks_exact_mut(self.area).enumerate() {
                let start = channel * self.area;
                let inputs = of_aligned[start..].iter().zip(&view[start..]).zip(valid);
                for (gradient, ((of_aligned, view), valid)) in gradient.iter_mut().zip(inputs) {
                    *gradient = gain * of_aligned + valid * (of_mean + of_deviation * (view - of_view.mean));
                }
            }
        });
        of_view
    }

    /// A view and the moments of it and of its target.
    fn moments(&self, picture: usize) -> (&[f32], Moments, Moments) {
        let count = self.channels * self.area;
        let [view, target] = [self.view, self.target].map(|pictures| &pictures[picture * count..][..count]);
        let valid = &self.valid[picture * self.area..][..self.area];
        (view, self.moments_of(view, valid), self.moments_of(target, valid))
    }

    fn moments_of(&self, picture: &[f32], valid: &[f32]) -> Moments {
        let number = (self.channels as f32 * sum_of(valid)).max(1.0);
        let over = |value: &dyn Fn(f32) -> f32| {
            let lines = picture.chunks_exact(self.area);
            let sums = lines.map(|plane| weighted_sum(plane, valid, value));
            sums.sum::<f32>() / number
        };
        let mean = over(&|value| value);
        let variance = over(&|value| (value - mean) * (value - mean));
        Moments { mean, deviation: (variance + self.flat).sqrt() }
    }
}

fn sum_of(values: &[f32]) -> f32 {
    values.chunks(1024).map(|values| values.iter().sum::<f32>()).sum()
}

/// Sums of pieces, which lose fewer digits than one long sum.
fn weighted_sum(values: &[f32], weights: &[f32], of: &dyn Fn(f32) -> f32) -> f32 {
    let pieces = values.chunks(1024).zip(weights.chunks(1024));
    pieces.map(|(values, weights)| values.iter().zip(weights).map(|(value, weight)| weight * of(*value)).sum::<f32>()).sum()
}
