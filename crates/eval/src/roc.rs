//! How well a score separates two classes: reliability masks against true masks.
//!
//! T. Fawcett, "An introduction to ROC analysis" (2006), algorithms 1 and 2.

use crate::EvalError;
use serde::Serialize;

/// One threshold of a score.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RocPoint {
    /// Scores of at least this count as positive.
    pub threshold: f64,
    /// Share of the negatives that do.
    pub false_positive_rate: f64,
    /// Share of the positives that do.
    pub true_positive_rate: f64,
}

/// The curve from (0, 0) to (1, 1) with the area under it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Roc {
    /// One point per distinct score, the highest threshold first; the point (0, 0) is left out.
    pub points: Vec<RocPoint>,
    /// Area under the curve: 1 is perfect, 0.5 is chance.
    pub auc: f64,
}

/// The curve of `scores` for true classes `positive`.
///
/// # Errors
/// [`EvalError::Setting`] if the lengths differ, a score is not finite or one class is empty.
pub fn roc(scores: &[f64], positive: &[bool]) -> Result<Roc, EvalError> {
    let refused = |what: &str| EvalError::Setting { what: what.into(), remedy: "give a score and a class per pixel" };
    if scores.len() != positive.len() || scores.iter().any(|score| !score.is_finite()) {
        return Err(refused("the scores do not fit the classes"));
    }
    let positives = positive.iter().filter(|class| **class).count() as f64;
    let negatives = positive.len() as f64 - positives;
    if positives == 0.0 || negatives == 0.0 {
        return Err(refused("only one class occurs, so nothing can be separated"));
    }
    let mut order: Vec<(f64, bool)> = scores.iter().copied().zip(positive.iter().copied()).collect();
    order.sort_by(|a, b| b.0.total_cmp(&a.0));
    let (mut hits, mut alarms, mut auc, mut last) = (0.0, 0.0, 0.0, (0.0, 0.0));
    let mut points = Vec::new();
    // Equal scores change sides together, so they make one point and a slanted line.
    for group in order.chunk_by(|a, b| a.0 == b.0) {
        let inside = group.iter().filter(|(_, class)| *class).count() as f64;
        hits += inside;
        alarms += group.len() as f64 - inside;
        let now = (alarms / negatives, hits / positives);
        auc += 0.5 * (now.0 - last.0) * (now.1 + last.1);
        last = now;
        points.push(RocPoint { threshold: group[0].0, false_positive_rate: now.0, true_positive_rate: now.1 });
    }
    Ok(Roc { points, auc })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn perfect_chance_and_wrong() {
        let classes = [true, true, false, false];
        assert_eq!(roc(&[0.9, 0.8, 0.2, 0.1], &classes).unwrap().auc, 1.0);
        assert_eq!(roc(&[0.5; 4], &classes).unwrap().auc, 0.5);
        assert_eq!(roc(&[0.1, 0.2, 0.8, 0.9], &classes).unwrap().auc, 0.0);
        assert!(roc(&[1.0, 2.0], &[true, true]).is_err());
        assert!(roc(&[f64::NAN, 2.0], &[true, false]).is_err());
    }

    proptest! {
        /// The area is the probability that a positive scores higher than a negative, ties counting half.
        #[test]
        fn the_area_is_a_probability(data in prop::collection::vec((0_u8..6, any::<bool>()), 2..60)) {
            let scores: Vec<f64> = data.iter().map(|(score, _)| f64::from(*score)).collect();
            let classes: Vec<bool> = data.iter().map(|(_, class)| *class).collect();
            let (mut wins, mut games) = (0.0, 0.0);
            for (a, _) in data.iter().filter(|(_, class)| *class) {
                for (b, _) in data.iter().filter(|(_, class)| !*class) {
                    games += 1.0;
                    wins += if a > b { 1.0 } else if a == b { 0.5 } else { 0.0 };
                }
            }
            match roc(&scores, &classes) {
                Ok(roc) => prop_assert!((roc.auc - wins / games).abs() < 1e-12),
                Err(_) => prop_assert_eq!(games, 0.0),
            }
        }
    }
}
