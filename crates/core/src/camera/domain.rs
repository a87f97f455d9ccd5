//! How far off the axis a model stays one to one, found without derivatives.

/// Steps of the first scan; a turning point between two steps is then closed in on.
const STEPS: usize = 512;

/// Largest angle up to which `radius` keeps growing from 0, at most `widest`.
///
/// A scan finds the first step that does not grow, then a golden-section search pins the maximum down.
pub fn monotone_limit(widest: f64, radius: impl Fn(f64) -> f64) -> f64 {
    let angle = |step: usize| widest * step as f64 / STEPS as f64;
    let grows = |step: &usize| radius(angle(*step)) > radius(angle(step - 1));
    match (1..=STEPS).find(|step| !grows(step)) {
        None => widest,
        // Just inside the maximum, where the slope is still positive.
        Some(step) => maximum(angle(step.saturating_sub(2)), angle(step), radius) * (1.0 - 1e-6),
    }
}

/// Place of the only maximum of `value` between `low` and `high`.
fn maximum(mut low: f64, mut high: f64, value: impl Fn(f64) -> f64) -> f64 {
    let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
    for _ in 0..60 {
        let (left, right) = (high - golden * (high - low), low + golden * (high - low));
        if value(left) < value(right) { low = left } else { high = right }
    }
    0.5 * (low + high)
}

/// Solves `value(x) = target` for a `value` that grows between `low` and `high`.
///
/// Illinois variant of the false-position rule with bisection whenever it stalls: no derivative, no way out of the
/// bracket. `None` if the target is not bracketed.
pub fn invert_monotone(target: f64, mut low: f64, mut high: f64, value: impl Fn(f64) -> f64) -> Option<f64> {
    let (mut at_low, mut at_high) = (value(low) - target, value(high) - target);
    if at_low > 0.0 || at_high < 0.0 || !(at_low.is_finite() && at_high.is_finite()) {
        return None;
    }
    for iteration in 0..100 {
        let secant = (low * at_high - high * at_low) / (at_high - at_low);
        let x = if iteration % 4 == 3 || !secant.is_finite() { 0.5 * (low + high) } else { secant };
        let at_x = value(x) - target;
        if at_x == 0.0 || high - low <= 4.0 * f64::EPSILON * high.abs() {
            return Some(x);
        }
        if at_x < 0.0 {
            (low, at_low, at_high) = (x, at_x, 0.5 * at_high);
        } else {
            (high, at_high, at_low) = (x, at_x, 0.5 * at_low);
        }
    }
    Some(0.5 * (low + high))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_is_the_first_turning_point() {
        assert!((monotone_limit(3.0, f64::sin) - std::f64::consts::FRAC_PI_2).abs() < 1e-4);
        assert_eq!(monotone_limit(1.0, |x| x), 1.0);
    }

    #[test]
    fn inversion_brackets_or_refuses() {
        let root = invert_monotone(2.0, 0.0, 2.0, |x| x * x).unwrap();
        assert!((root - 2.0_f64.sqrt()).abs() < 1e-14);
        assert_eq!(invert_monotone(5.0, 0.0, 2.0, |x| x * x), None);
        assert_eq!(invert_monotone(0.0, 0.0, 2.0, |x| x * x), Some(0.0));
    }
}
