//! Depth against truth, up to the scale no single camera can know.

use crate::clip::ClipFrame;
use burn::tensor::Device;
use endoscape_nets::{DispNet, network_input};

/// Depth errors of one picture or their mean (Eigen et al. 2014).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthScore {
    /// Mean of `|d - d*| / d*`.
    pub abs_rel: f64,
    /// Share of pixels with `max(d / d*, d* / d) < 1.25`.
    pub d1: f64,
}

impl DepthScore {
    /// Errors over pixels given as (predicted, true) depth, after the prediction is scaled to the same median; `None`
    /// without pixels.
    pub fn of(pixels: &[(f32, f32)]) -> Option<Self> {
        let scale =
            median(pixels.iter().map(|(_, truth)| *truth))? / median(pixels.iter().map(|(predicted, _)| *predicted))?;
        let scaled = pixels.iter().map(|(predicted, truth)| (f64::from(predicted * scale), f64::from(*truth)));
        let (mut relative, mut near) = (0.0, 0.0);
        for (predicted, truth) in scaled {
            relative += (predicted - truth).abs() / truth;
            near += f64::from(u8::from((predicted / truth).max(truth / predicted) < 1.25));
        }
        let count = pixels.len() as f64;
        Some(Self { abs_rel: relative / count, d1: near / count })
    }

    /// Mean over pictures.
    pub fn mean(scores: &[Self]) -> Option<Self> {
        let mean = |figure: fn(&Self) -> f64| super::mean(&scores.iter().map(figure).collect::<Vec<_>>());
        Some(Self { abs_rel: mean(|score| score.abs_rel)?, d1: mean(|score| score.d1)? })
    }
}

/// Predicts the depth of a frame and compares it with its truth; `None` if it has none.
pub fn score_depth(disp: &DispNet, frame: &ClipFrame, device: &Device) -> Option<DepthScore> {
    let truth = frame.depth.as_ref()?;
    let depth = disp.forward(network_input(&frame.image, device)).depth(0);
    let predicted: Vec<f32> = depth.into_data().iter::<f32>().collect();
    let pixels = predicted.into_iter().zip(truth.grid().values().iter().copied());
    DepthScore::of(&pixels.filter(|(_, truth)| *truth > 0.0).collect::<Vec<_>>())
}

fn median(values: impl Iterator<Item = f32>) -> Option<f32> {
    let mut values: Vec<f32> = values.collect();
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f32::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scale_does_not_matter_and_shape_does() {
        let truth = [1.0, 2.0, 4.0, 5.0, 8.0_f32];
        let scaled: Vec<(f32, f32)> = truth.iter().map(|depth| (depth * 0.25, *depth)).collect();
        assert_eq!(DepthScore::of(&scaled), Some(DepthScore { abs_rel: 0.0, d1: 1.0 }));
        // A flat depth is scaled to the median, 4: errors 3, 1, 0, 1/5 and 1/2 of the truth.
        let flat: Vec<(f32, f32)> = truth.iter().map(|depth| (7.0, *depth)).collect();
        let score = DepthScore::of(&flat).unwrap();
        assert!((score.abs_rel - 4.7 / 5.0).abs() < 1e-6 && (score.d1 - 0.2).abs() < 1e-9, "{score:?}");
        assert_eq!(DepthScore::of(&[]), None);
    }
}
