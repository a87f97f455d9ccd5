//! 95 % intervals by resampling.
//!
//! Errors of neighbouring windows share poses, so drawing single values would make intervals too narrow; whole blocks
//! of neighbours are drawn instead (circular block bootstrap, D. Politis and J. Romano, 1992; percentile interval,
//! B. Efron, 1981). The generator is seeded, so the same input gives the same interval.

/// Number of resamples.
const RESAMPLES: usize = 1000;

/// Most blocks per resample, so that a million errors take no longer than a thousand; larger blocks stay valid.
const MOST_BLOCKS: usize = 1000;

/// Seed of the generator. Any number would do; a fixed one makes reports repeatable.
const SEED: u64 = 0x00e5_ca9e;

/// The 2.5 % and 97.5 % quantiles of the mean of `values`, drawn in blocks of at least `block` neighbours.
///
/// `None` for no values.
pub fn mean_interval(values: &[f64], block: usize) -> Option<[f64; 2]> {
    let count = values.len();
    if count == 0 {
        return None;
    }
    let block = block.max(count / MOST_BLOCKS).clamp(1, count);
    let blocks = count.div_ceil(block);
    let sums = circular_block_sums(values, block);
    let mut generator = fastrand::Rng::with_seed(SEED);
    let mut resample = || (0..blocks).map(|_| sums[generator.usize(..count)]).sum::<f64>() / (blocks * block) as f64;
    let mut means: Vec<f64> = (0..RESAMPLES).map(|_| resample()).collect();
    means.sort_by(f64::total_cmp);
    let quantile = |share: f64| means[(share * (RESAMPLES - 1) as f64).round() as usize];
    Some([quantile(0.025), quantile(0.975)])
}

/// Sum of the `block` values from each position on, going round at the end.
fn circular_block_sums(values: &[f64], block: usize) -> Vec<f64> {
    let mut prefix = Vec::with_capacity(values.len() + block + 1);
    prefix.push(0.0);
    let mut sum = 0.0;
    for value in values.iter().chain(&values[..block]) {
        sum += value;
        prefix.push(sum);
    }
    (0..values.len()).map(|start| prefix[start + block] - prefix[start]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_values_leave_no_doubt() {
        assert_eq!(mean_interval(&[2.0; 50], 5), Some([2.0, 2.0]));
        assert_eq!(mean_interval(&[3.0], 10), Some([3.0, 3.0]));
        assert_eq!(mean_interval(&[], 1), None);
    }

    #[test]
    fn independent_values_get_the_width_theory_predicts() {
        let mut generator = fastrand::Rng::with_seed(1);
        let values: Vec<f64> = (0..4000).map(|_| generator.f64()).collect();
        let [low, high] = mean_interval(&values, 1).unwrap();
        // Standard error of the mean of uniform numbers: sqrt(1/12/4000); 95 % lie within 1.96 of them.
        let width = 2.0 * 1.96 * (1.0_f64 / 12.0 / 4000.0).sqrt();
        assert!(((high - low) / width - 1.0).abs() < 0.15);
        assert_eq!(mean_interval(&values, 1), Some([low, high]));
    }

    #[test]
    fn blocks_widen_the_interval_of_values_that_hang_together() {
        let values: Vec<f64> = (0..400).map(|i| (f64::from(i) * 0.05).sin()).collect();
        let single = mean_interval(&values, 1).unwrap();
        let blocks = mean_interval(&values, 40).unwrap();
        assert!(blocks[1] - blocks[0] > 2.0 * (single[1] - single[0]));
    }
}
