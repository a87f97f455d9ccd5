//! How the learning rate changes over a training.

use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// What happens to the learning rate after the warm-up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Decay {
    /// Nothing (SfMLearner).
    #[default]
    Constant,
    /// Down to a tenth along half a cosine over the whole budget.
    Cosine,
    /// To a tenth for the last quarter of the budget (Godard et al. 2019: 15 of 20 epochs).
    Step,
}

/// Share of the learning rate that is left at the end.
const LEAST: f64 = 0.1;

impl Decay {
    /// Factor on the learning rate when the share `progress` (0 to 1) of the budget is spent.
    pub fn factor(self, progress: f64) -> f64 {
        let progress = progress.clamp(0.0, 1.0);
        match self {
            Self::Constant => 1.0,
            Self::Cosine => LEAST + (1.0 - LEAST) * 0.5 * (1.0 + (PI * progress).cos()),
            Self::Step => {
                if progress < 0.75 {
                    1.0
                } else {
                    LEAST
                }
            }
        }
    }
}

/// Factor on the learning rate in the first `warmup` steps, growing linearly: Adam's second moments start unknown.
pub fn warmup_factor(step: u64, warmup: u64) -> f64 {
    if step < warmup { (step + 1) as f64 / (warmup + 1) as f64 } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schedules_start_full_and_never_grow() {
        for decay in [Decay::Constant, Decay::Cosine, Decay::Step] {
            let factors: Vec<f64> = (0..=20).map(|step| decay.factor(f64::from(step) / 20.0)).collect();
            assert_eq!(factors[0], 1.0);
            assert!(factors.windows(2).all(|pair| pair[1] <= pair[0]), "{decay:?}");
            assert!(decay == Decay::Constant || (factors[20] - LEAST).abs() < 1e-12);
        }
    }

    #[test]
    fn warm_up_grows_to_one() {
        let factors: Vec<f64> = (0..6).map(|step| warmup_factor(step, 4)).collect();
        assert_eq!(factors, [0.2, 0.4, 0.6, 0.8, 1.0, 1.0]);
        assert_eq!(warmup_factor(0, 0), 1.0);
    }
}
