//! Filtering in one dimension beside the plain sum.

use super::*;
use proptest::prelude::*;
use pulp::Scalar;

/// A line whose first numbers are given.
fn line(values: &[f32]) -> [f32; MAX_POINTS] {
    std::array::from_fn(|index| values.get(index).copied().unwrap_or(0.0))
}

/// Largest difference between filtered outputs and plain sums, and between the two gradients of the kernel.
fn errors<const PAIRS: usize>(pixels: &[f32], kernel: &[f32], gradient: &[f32]) -> [f32; 2] {
    let (points, taps) = (Points::<PAIRS>::COUNT, kernel.len());
    let outputs = points + 1 - taps;
    let analysed = Points::<PAIRS>::analyse(Scalar::new(), &line(&pixels[..points]));
    let scaled = |mut values: [f32; MAX_POINTS]| {
        values.iter_mut().zip(Points::<PAIRS>::SCALES).for_each(|(value, scale)| *value *= scale);
        values
    };
    let times = |other: [f32; MAX_POINTS]| std::array::from_fn(|point| analysed[point] * other[point]);
    let weights = scaled(Points::<PAIRS>::evaluate(Scalar::new(), &line(kernel), taps));
    let filtered = Points::<PAIRS>::collect(Scalar::new(), &times(weights), outputs);
    let values = Points::<PAIRS>::evaluate(Scalar::new(), &line(&gradient[..outputs]), outputs);
    let of_kernel = Points::<PAIRS>::collect(Scalar::new(), &scaled(times(values)), taps);
    let product = |at: usize, factors: &[f32]| factors.iter().zip(&pixels[at..]).map(|(a, b)| a * b).sum::<f32>();
    let error = |actual: &[f32], factors: &[f32]| {
        let differences = actual.iter().enumerate().map(|(at, actual)| (actual - product(at, factors)).abs());
        differences.fold(0.0, f32::max)
    };
    [error(&filtered[..outputs], kernel), error(&of_kernel[..taps], &gradient[..outputs])]
}

proptest! {
    #[test]
    fn filtering_gives_the_plain_sums_and_their_gradients(
        pixels in prop::collection::vec(-1.0_f32..1.0, MAX_POINTS),
        gradient in prop::collection::vec(-1.0_f32..1.0, MAX_POINTS),
        kernel in prop::collection::vec(-1.0_f32..1.0, 2..=7),
    ) {
        if kernel.len() <= 5 {
            prop_assert!(errors::<2>(&pixels, &kernel, &gradient).iter().all(|error| *error < 2e-5));
        }
        prop_assert!(errors::<3>(&pixels, &kernel, &gradient).iter().all(|error| *error < 2e-4));
    }
}
