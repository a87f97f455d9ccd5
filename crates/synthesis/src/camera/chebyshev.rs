//! Chebyshev interpolation of a smooth function of one variable.

use std::f64::consts::PI;

/// Highest degree tried.
const HIGHEST_DEGREE: usize = 20;

/// Coefficients `c_k` with `f(x) = sum_k c_k T_k(x)` on `-1 ..= 1`, of the lowest degree whose largest error between the
/// nodes is below `tolerance`; the best degree tried where none is.
pub fn fit(tolerance: f64, f: impl Fn(f64) -> f64) -> Vec<f64> {
    let mut best = (Vec::new(), f64::INFINITY);
    for degree in 2..=HIGHEST_DEGREE {
        let coefficients = interpolate(degree, &f);
        let error = largest_error(&coefficients, &f);
        if error < best.1 {
            best = (coefficients, error);
        }
        if best.1 < tolerance {
            break;
        }
    }
    best.0
}

/// Interpolation at the `degree + 1` roots of the next Chebyshev polynomial.
fn interpolate(degree: usize, f: impl Fn(f64) -> f64) -> Vec<f64> {
    let count = degree + 1;
    let angle = |node: usize| PI * (node as f64 + 0.5) / count as f64;
    let values: Vec<f64> = (0..count).map(|node| f(angle(node).cos())).collect();
    (0..count)
        .map(|k| {
            let sum: f64 = values.iter().enumerate().map(|(node, value)| value * (k as f64 * angle(node)).cos()).sum();
            sum * if k == 0 { 1.0 } else { 2.0 } / count as f64
        })
        .collect()
}

/// Largest difference on a grid finer than the nodes, ends included.
fn largest_error(coefficients: &[f64], f: impl Fn(f64) -> f64) -> f64 {
    const POINTS: usize = 200;
    let grid = (0..=POINTS).map(|point| 2.0 * point as f64 / POINTS as f64 - 1.0);
    grid.map(|x| (evaluate(coefficients, x) - f(x)).abs()).fold(0.0, f64::max)
}

/// Clenshaw's recurrence.
fn evaluate(coefficients: &[f64], x: f64) -> f64 {
    let (mut next, mut after) = (0.0, 0.0);
    for c in coefficients.iter().skip(1).rev() {
        (next, after) = (c + 2.0 * x * next - after, next);
    }
    coefficients.first().copied().unwrap_or(0.0) + x * next - after
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smooth_functions_are_met() {
        let coefficients = fit(1e-10, f64::exp);
        assert!(coefficients.len() < 14, "{} terms", coefficients.len());
        assert!((evaluate(&coefficients, 0.3) - 0.3_f64.exp()).abs() < 1e-10);
    }

    #[test]
    fn polynomials_need_no_more_than_their_degree() {
        assert_eq!(fit(1e-13, |x| 1.0 - 2.0 * x + 0.5 * x * x).len(), 3);
    }

    #[test]
    fn rough_functions_get_the_best_degree_tried() {
        assert!(!fit(1e-10, f64::abs).is_empty());
    }
}
