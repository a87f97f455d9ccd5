//! How good the networks are now: photometric always, depth and trajectory where the truth is known.

pub mod depth;
pub mod trajectory;

use crate::alignment::alignment_error;
use crate::augment::{AugmentConfig, augment};
use crate::batch::SnippetBatch;
use crate::clip::ClipFrame;
use crate::collapse::VitalSigns;
use crate::config::TrainConfig;
use crate::dataset::{Drawn, Item, SnippetDataset, spread};
use crate::error::TrainError;
use crate::model::{DepthMotionModel, standing_motion};
use burn::tensor::{Device, Tensor};
use depth::{DepthScore, score_depth};
use endoscape_synthesis::{ObjectiveConfig, Prediction, objective, source_from_target};
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;
use trajectory::score_trajectory;

/// Figures of one validation; lower is better but for `coverage` and `depth_d1`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scores {
    /// Photometric loss on snippets as they are, without reliability and auto-masking, which are no way to be better.
    pub photometric: f64,
    /// Disagreement of depth and brightness; `None` where the objective leaves it out.
    pub light: Option<f64>,
    /// Share of the pixels it was measured on: those a source shows.
    pub coverage: f64,
    /// What `photometric` is when the camera is taken to stand still.
    pub still_photometric: f64,
    /// Share of the pixels that was measured on: all that are usable.
    pub still_coverage: f64,
    /// See [`VitalSigns::depth_spread`].
    pub depth_spread: f64,
    /// See [`standing_motion`].
    pub standing_motion: f64,
    /// Mean absolute relative depth error after median scaling per picture.
    pub depth_abs_rel: Option<f64>,
    /// Share of pixels whose depth is within 25 %, after median scaling.
    pub depth_d1: Option<f64>,
    /// RMSE of the camera positions after alignment by a similarity, metres; the mean over clips.
    pub ate_m: Option<f64>,
    /// See [`alignment_error`]; `None` unless the alignment network learns.
    pub alignment: Option<f64>,
}

impl Scores {
    /// Photometric loss over all usable pixels: one that no source shows is charged what it costs when nothing moves, so
    /// that looking away is no way to be better.
    pub fn synthesis_error(&self) -> f64 {
        let unseen = (self.still_coverage - self.coverage).max(0.0);
        (self.coverage * self.photometric + unseen * self.still_photometric) / (self.coverage + unseen)
    }

    /// The figures that exist, by name.
    pub fn named(&self) -> BTreeMap<String, f64> {
        let all = [
            ("photometric", Some(self.photometric)),
            ("light", self.light),
            ("coverage", Some(self.coverage)),
            ("still_photometric", Some(self.still_photometric)),
            ("depth_spread", Some(self.depth_spread)),
            ("standing_motion", Some(self.standing_motion)),
            ("depth_abs_rel", self.depth_abs_rel),
            ("depth_d1", self.depth_d1),
            ("ate_m", self.ate_m),
            ("alignment", self.alignment),
        ];
        all.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?))).collect()
    }
}

/// Measures networks on fixed data.
pub struct Validator {
    dataset: Arc<SnippetDataset>,
    objective: ObjectiveConfig,
    batch: usize,
    snippets: usize,
    /// Whether the alignment network is measured.
    alignment: bool,
    device: Device,
}

impl Validator {
    /// Measures on `dataset`, on a device without gradients.
    pub fn new(dataset: Arc<SnippetDataset>, config: &TrainConfig, device: &Device) -> Self {
        // Both change with the networks which pixels count, so values before and after would not compare.
        let objective = ObjectiveConfig { auto_mask: false, geometry_weight: 0.0, ..config.objective.clone() };
        let (batch, snippets) = (config.batch, config.validation_snippets);
        Self { dataset, objective, batch, snippets, alignment: config.lesson.alignment, device: device.clone() }
    }

    /// Measures `model`, which must live on the same device.
    ///
    /// # Errors
    /// [`TrainError`] if a batch cannot be made.
    pub fn measure(&self, model: &DepthMotionModel) -> Result<Scores, TrainError> {
        let depth = self.depth(model)?;
        let trajectories: Vec<f64> =
            self.dataset.clips().filter_map(|(clip, gap)| score_trajectory(model, clip, gap, &self.device)).collect();
        let (terms, alignment) = self.snippet_terms(model)?;
        let [photometric, light, coverage, still_photometric, still_coverage, depth_spread, standing_motion] = terms;
        Ok(Scores {
            photometric,
            light: (self.objective.light_weight > 0.0).then_some(light),
            coverage,
            still_photometric,
            still_coverage,
            depth_spread,
            standing_motion,
            depth_abs_rel: depth.map(|score| score.abs_rel),
            depth_d1: depth.map(|score| score.d1),
            ate_m: mean(&trajectories),
            alignment,
        })
    }

    /// Photometric loss, light term and coverage; the first and the last of a camera that stands still; depth spread;
    /// standing motion. And what the alignment network leaves, where it can be measured.
    fn snippet_terms(&self, model: &DepthMotionModel) -> Result<([f64; 7], Option<f64>), TrainError> {
        let indices: Vec<usize> = spread(self.dataset.len(), self.snippets).collect();
        let (mut sum, mut count) = (None::<Tensor<1>>, 0.0);
        let mut alignment = Vec::new();
        for indices in indices.chunks(self.batch) {
            let items =
                indices.iter().map(|index| plain_item(&self.dataset.plain(*index))).collect::<Result<Vec<_>, _>>()?;
            let batch = SnippetBatch::new(&items, &self.objective, &self.device)?;
            let output = model.predict(&batch, false);
            let net = model.align.as_ref().filter(|_| self.alignment);
            let aligned = net.zip(batch.lessons.as_ref()).zip(output.depth());
            let error = aligned.map(|((net, lessons), depth)| alignment_error(net, &batch, lessons, depth));
            alignment.extend(error.map(|error| f64::from(error.into_scalar::<f32>())));
            let standing_motion = standing_motion(output.motion.clone(), batch.stands.clone());
            let signs = VitalSigns::new(&output.prediction, output.motion);
            let prediction = Prediction { masks: Vec::new(), ..output.prediction };
            let terms = objective(&batch.views, &prediction, &self.objective);
            let still = objective(&batch.views, &standing(prediction, model), &self.objective);
            let figures = vec![
                terms.photometric,
                terms.light,
                terms.coverage,
                still.photometric,
                still.coverage,
                signs.depth_spread,
                standing_motion,
            ];
            let weighted = Tensor::cat(figures, 0) * indices.len() as f64;
            sum = Some(sum.map_or(weighted.clone(), |sum| sum + weighted));
            count += indices.len() as f64;
        }
        let sums: Vec<f32> = sum.map_or_else(Vec::new, |sum| sum.into_data().iter().collect());
        let terms =
            [0, 1, 2, 3, 4, 5, 6].map(|figure| sums.get(figure).map_or(f64::NAN, |sum| f64::from(*sum) / count));
        Ok((terms, mean(&alignment)))
    }

    fn depth(&self, model: &DepthMotionModel) -> Result<Option<DepthScore>, TrainError> {
        let clips = self.dataset.clips();
        let frames: Vec<&ClipFrame> =
            clips.flat_map(|(clip, _)| &clip.frames).filter(|frame| frame.depth.is_some()).collect();
        let scores: Vec<DepthScore> =
            frames.into_iter().filter_map(|frame| score_depth(&model.disp, frame, &self.device)).collect();
        Ok(DepthScore::mean(&scores))
    }
}

/// The same depth seen by a camera that does not move.
fn standing(prediction: Prediction, model: &DepthMotionModel) -> Prediction {
    let still = |motion: &Tensor<3>| {
        let zero = Tensor::zeros([motion.dims()[0], 6], &motion.device());
        source_from_target(zero, model.pose.rotation())
    };
    let source_from_target = prediction.source_from_target.iter().map(still).collect();
    Prediction { source_from_target, ..prediction }
}

/// A snippet as it is.
fn plain_item(drawn: &Drawn<'_>) -> Result<Item, TrainError> {
    let unused = &mut ChaCha8Rng::seed_from_u64(0);
    let snippet = augment(&drawn.frames, drawn.camera, &AugmentConfig::none(), unused)?;
    Ok(Item { snippet, stands: drawn.stands })
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scores() -> Scores {
        Scores {
            photometric: 0.2,
            light: None,
            coverage: 0.9,
            still_photometric: 0.5,
            still_coverage: 0.95,
            depth_spread: 0.3,
            standing_motion: 0.0,
            depth_abs_rel: None,
            depth_d1: None,
            ate_m: Some(0.001),
            alignment: None,
        }
    }

    #[test]
    fn figures_that_do_not_exist_are_not_named() {
        let names: Vec<_> = scores().named().into_keys().collect();
        assert_eq!(names, ["ate_m", "coverage", "depth_spread", "photometric", "standing_motion", "still_photometric"]);
    }

    #[test]
    fn looking_away_is_no_way_to_be_better() {
        let honest = scores().synthesis_error();
        assert!((honest - (0.9 * 0.2 + 0.05 * 0.5) / 0.95).abs() < 1e-12);
        // The half that is hardest to explain is thrown out of view.
        let away = Scores { photometric: 0.15, coverage: 0.45, ..scores() };
        assert!(away.synthesis_error() > honest);
        let still = Scores { photometric: 0.5, coverage: 0.95, ..scores() };
        assert_eq!(still.synthesis_error(), still.still_photometric);
    }
}
