//! When a candidate may take the place of the given model.
//!
//! Both are scored on the frames held back by what the training minimises: how well one picture is painted from another,
//! how well depth agrees with brightness, and how much motion is seen where the camera stands. Any could be had cheaply, so a
//! candidate must
//!
//! - be better in the sum, and worse neither in painting nor in light (before a camera that stands, painting may get worse:
//!   a motion that is none can explain tissue that moves);
//! - pay for pixels that its motion throws out of view what they cost when nothing moves ([`Scores::synthesis_error`]);
//! - where the picture moves, not paint it just as well as a camera that stands still, the mark of a motion that has
//!   vanished;
//! - keep at least half of the given model's relief, or its depth has become flat.
//!
//! Reliability and auto-mask take no part ([`Validator`](crate::validation::Validator)), so no pixel can be masked away.

use crate::config::TrainConfig;
use crate::trainer::LEAST_COVERAGE;
use crate::validation::Scores;
use std::collections::BTreeMap;

/// Where the camera stands in more than this share of the snippets, standing still is an explanation.
const MOSTLY: f64 = 0.5;
/// An error nearer than this share to that of standing still is that of a motion that has vanished.
const VANISHED: f64 = 0.02;
/// Share of the given model's relief that a candidate must keep.
const LEAST_RELIEF: f64 = 0.5;

/// Decides about candidates.
#[derive(Clone, Debug)]
pub struct Judge {
    given: Scores,
    light_weight: f64,
    standing_weight: f64,
    moves: bool,
}

impl Judge {
    /// For candidates that come from a model with the scores `given`, on frames of which a share shows a camera that
    /// stands still.
    pub fn new(given: Scores, config: &TrainConfig, standing_share: f64) -> Self {
        let (light_weight, standing_weight) = (config.objective.light_weight, config.standing_weight);
        Self { given, light_weight, standing_weight, moves: standing_share <= MOSTLY }
    }

    /// The scores of the given model.
    pub const fn given(&self) -> &Scores {
        &self.given
    }

    /// What decides, smaller is better: the error over all usable pixels, and light term and standing motion by their
    /// weights.
    pub fn error(&self, scores: &Scores) -> f64 {
        scores.synthesis_error()
            + self.light_weight * scores.light.unwrap_or(0.0)
            + self.standing_weight * scores.standing_motion
    }

    /// [`Judge::error`] of a candidate that may take the given model's place; `None` for any other.
    pub fn admits(&self, scores: &Scores) -> Option<f64> {
        let (error, synthesis, given) = (self.error(scores), scores.synthesis_error(), &self.given);
        let is_better = error.is_finite() && error < self.error(given);
        let paints_as_well = !self.moves || synthesis <= given.synthesis_error();
        let is_as_good = paints_as_well && scores.light <= given.light;
        let from_still = (synthesis - scores.still_photometric).abs();
        let sees_motion = !self.moves || from_still > VANISHED * scores.still_photometric;
        let has_relief = scores.depth_spread >= LEAST_RELIEF * self.given.depth_spread;
        let looks = scores.coverage >= LEAST_COVERAGE;
        (is_better && is_as_good && sees_motion && has_relief && looks).then_some(error)
    }

    /// The figures of a model as the record has them, with the deciding one as `error`.
    pub fn figures(&self, scores: &Scores) -> BTreeMap<String, f64> {
        let mut figures = scores.named();
        figures.insert("error".into(), self.error(scores));
        figures
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GIVEN: Scores = Scores {
        photometric: 0.3,
        light: Some(0.1),
        coverage: 0.9,
        still_photometric: 0.5,
        still_coverage: 0.95,
        depth_spread: 0.4,
        standing_motion: 0.0,
        depth_abs_rel: None,
        depth_d1: None,
        ate_m: None,
        alignment: None,
    };

    fn judge(standing_share: f64) -> Judge {
        Judge::new(GIVEN, &TrainConfig::endo(), standing_share)
    }

    #[test]
    fn only_what_is_better_is_admitted() {
        assert_eq!(judge(0.0).admits(&GIVEN), None, "the given model is not better than itself");
        let better = Scores { photometric: 0.29, ..GIVEN };
        assert!(judge(0.0).admits(&better).is_some_and(|error| error < judge(0.0).error(&GIVEN)));
        let lighter = Scores { light: Some(0.05), photometric: 0.301, ..GIVEN };
        assert_eq!(judge(0.0).admits(&lighter), None, "worse in one part");
        assert_eq!(judge(0.0).admits(&Scores { photometric: f64::NAN, ..GIVEN }), None);
    }

    #[test]
    fn no_cheap_way_is_admitted() {
        let better = Scores { photometric: 0.2, ..GIVEN };
        assert_eq!(judge(0.0).admits(&Scores { coverage: 0.3, ..better }), None, "looks away");
        assert_eq!(judge(0.0).admits(&Scores { depth_spread: 0.1, ..better }), None, "is flat");
    }

    #[test]
    fn standing_still_is_an_answer_only_where_the_camera_stands() {
        // The given model is worse than no motion at all.
        let given = Scores { photometric: 0.6, ..GIVEN };
        let still = Scores { photometric: 0.5, coverage: 0.95, ..GIVEN };
        assert_eq!(Judge::new(given, &TrainConfig::endo(), 0.1).admits(&still), None);
        assert!(Judge::new(given, &TrainConfig::endo(), 0.9).admits(&still).is_some());
    }
}
