//! Whether one method is better than another or was only luckier: tests on pairs of errors of the same thing.

use serde::Serialize;

/// Up to this many pairs the distribution is counted out; above it the normal approximation is good to four digits.
const MOST_EXACT: usize = 50;

/// The signed-rank test of F. Wilcoxon, "Individual comparisons by ranking methods" (1945), two-sided.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SignedRank {
    /// Pairs that differ; equal ones say nothing and are left out.
    pub pairs: usize,
    /// Sum of the ranks of the positive differences.
    pub positive_ranks: f64,
    /// Probability of a sum as far from the middle, or further, if neither method were better.
    pub p_value: f64,
    /// The smallest `p_value` this many pairs can give.
    pub smallest_p_value: f64,
}

/// Tests differences of paired errors; `None` if no pair differs or a difference is not finite.
///
/// Equal sizes share their mean rank, and the distribution is that of the ranks at hand, so ties need no correction.
pub fn signed_rank(differences: &[f64]) -> Option<SignedRank> {
    if differences.iter().any(|difference| !difference.is_finite()) {
        return None;
    }
    let mut differences: Vec<f64> = differences.iter().copied().filter(|difference| *difference != 0.0).collect();
    differences.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    let doubled_ranks = doubled_ranks(&differences);
    let signed = || differences.iter().zip(&doubled_ranks);
    let positive: usize = signed().filter(|(difference, _)| **difference > 0.0).map(|(_, rank)| rank).sum();
    let pairs = differences.len();
    (pairs > 0).then(|| SignedRank {
        pairs,
        positive_ranks: positive as f64 / 2.0,
        p_value: if pairs <= MOST_EXACT { exact(&doubled_ranks, positive) } else { normal(&doubled_ranks, positive) },
        smallest_p_value: 2.0 * 0.5_f64.powi(pairs as i32).max(f64::MIN_POSITIVE),
    })
}

/// Twice the rank of each of the values sorted by size, so that shared ranks are whole numbers too.
fn doubled_ranks(sorted: &[f64]) -> Vec<usize> {
    let mut ranks = Vec::with_capacity(sorted.len());
    for group in sorted.chunk_by(|a, b| a.abs() == b.abs()) {
        let before = ranks.len();
        ranks.extend(std::iter::repeat_n(2 * before + group.len() + 1, group.len()));
    }
    ranks
}

/// Counts how many of the 2^n choices of signs are as far from the middle.
fn exact(doubled_ranks: &[usize], positive: usize) -> f64 {
    let total: usize = doubled_ranks.iter().sum();
    let mut ways = vec![0.0; total + 1];
    ways[0] = 1.0;
    for rank in doubled_ranks {
        for sum in (*rank..=total).rev() {
            ways[sum] += ways[sum - rank];
        }
    }
    let tail: f64 = ways[..=positive.min(total - positive)].iter().sum();
    (2.0 * tail / 2_f64.powi(doubled_ranks.len() as i32)).min(1.0)
}

/// The sum of many independent signs is nearly normal, with the sum of squared ranks over four as its variance.
fn normal(doubled_ranks: &[usize], positive: usize) -> f64 {
    let total: usize = doubled_ranks.iter().sum();
    let variance: f64 = doubled_ranks.iter().map(|rank| (*rank as f64 / 2.0).powi(2)).sum::<f64>() / 4.0;
    let distance = (positive as f64 - total as f64 / 2.0).abs() / 2.0;
    (2.0 * upper_tail(distance / variance.sqrt())).min(1.0)
}

/// Probability that a standard normal number exceeds `z >= 0`, to 7.5e-8 (M. Abramowitz, I. Stegun, 1964, 26.2.17).
fn upper_tail(z: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.231_641_9 * z);
    let polynomial =
        t * (0.319_381_530 + t * (-0.356_563_782 + t * (1.781_477_937 + t * (-1.821_255_978 + t * 1.330_274_429))));
    (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt() * polynomial
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn all_wins_give_the_smallest_probability() {
        let test = signed_rank(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]).unwrap();
        assert_eq!((test.pairs, test.positive_ranks, test.p_value), (6, 21.0, 2.0 / 64.0));
        assert_eq!(test.p_value, test.smallest_p_value);
    }

    /// `scipy.stats.wilcoxon(d, method="exact")` and, for the 60 values, `method="approx", correction=False`.
    #[test]
    fn agrees_with_scipy() {
        let test = signed_rank(&[1.83, 0.50, 1.62, -0.48, -1.68, 1.88, 1.55, 3.06, 1.30]).unwrap();
        assert!((test.p_value - 0.074_218_75).abs() < 1e-12, "{}", test.p_value);
        let many: Vec<f64> = (1..=60).map(|i| f64::from(i) * if i % 3 == 0 { -1.0 } else { 1.0 }).collect();
        assert!((signed_rank(&many).unwrap().p_value - 0.035_900_1).abs() < 1e-6, "{:?}", signed_rank(&many));
    }

    #[test]
    fn nothing_to_compare_is_no_test() {
        assert_eq!(signed_rank(&[]), None);
        assert_eq!(signed_rank(&[0.0, 0.0]), None);
        assert_eq!(signed_rank(&[1.0, f64::NAN]), None);
    }

    proptest! {
        /// Which method comes first does not matter, and neither does the unit.
        #[test]
        fn symmetric_and_free_of_units(differences in prop::collection::vec(-3_i32..=3, 1..70)) {
            let differences: Vec<f64> = differences.into_iter().map(f64::from).collect();
            let swapped: Vec<f64> = differences.iter().map(|difference| -4.0 * difference).collect();
            match (signed_rank(&differences), signed_rank(&swapped)) {
                (Some(a), Some(b)) => {
                    prop_assert!((a.p_value - b.p_value).abs() < 1e-9);
                    prop_assert!(a.p_value > 0.0 && a.p_value <= 1.0);
                }
                (a, b) => prop_assert_eq!(a, b),
            }
        }
    }
}
