//! Everything that can be chosen about the objective, with named presets.

use crate::camera::CameraScaling;
use crate::error::SynthesisError;
use crate::photometric::Average;
use crate::smoothness::Smoothness;
use crate::warp::OutOfView;
use serde::{Deserialize, Serialize};

/// How the errors of several sources become one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AcrossSources {
    /// Every source is averaged over its own pixels, and the averages add up (the paper).
    Sum,
    /// Each pixel takes its best source (Godard et al., ICCV 2019).
    #[default]
    Minimum,
}

/// How brightness differs between the frames of a snippet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Brightness {
    /// Not at all (the paper).
    Constant,
    /// By one gain and one offset per picture, taken out before comparing.
    #[default]
    Affine,
}

/// At which size the coarser disparities are judged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Scales {
    /// Each at its own, against shrunk pictures (the paper).
    Native,
    /// All at full size, enlarged bilinearly: no holes in textureless regions (Godard et al., ICCV 2019).
    #[default]
    Full,
}

/// The objective. `default()` is [`ObjectiveConfig::endo`].
///
/// "Paper" is Turan et al. 2018, "TensorFlow" and "port" are the public SfMLearner code and its PyTorch port.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ObjectiveConfig {
    /// Share of `(1 - SSIM) / 2` in the photometric error, 0 to 1; the rest is `|a - b|` of pictures in [-1, 1].
    /// Default 0.85 (Godard et al. 2017); the paper has 0.
    pub ssim_weight: f64,
    /// Pixels that leave the source picture. Default masked; paper grey (its TensorFlow base).
    pub out_of_view: OutOfView,
    /// Divisor of the photometric sum. Default the pixels that count; port all pixels.
    pub average: Average,
    /// Sum or per-pixel minimum over sources. Default minimum; paper sum.
    pub across_sources: AcrossSources,
    /// Drop pixels that match better without warping. Default on; paper off.
    pub auto_mask: bool,
    /// Brightness change between frames. Default affine: an endoscope carries its light; paper constant.
    pub brightness: Brightness,
    /// Scales judged at their own or at full size. Default full; paper native.
    pub scales: Scales,
    /// How cameras shrink with their pictures. Default exact; port divided intrinsics.
    pub camera_scaling: CameraScaling,
    /// Which smoothness. Default edge-aware; paper second-order disparity.
    pub smoothness: Smoothness,
    /// lambda_s. Default 0.01, in the middle of the published range; paper 0.4 (a comment in its LaTeX source),
    /// TensorFlow 0.5, port 0.1.
    pub smoothness_weight: f64,
    /// The smoothness weight is divided by this from each scale to the next coarser. Default 2; port 2.3.
    pub smoothness_decay: f64,
    /// lambda_e, the price of unreliable pixels; without mask outputs it has no effect. Default and port 0.2; paper
    /// 0.15 (a comment in its LaTeX source).
    pub mask_weight: f64,
    /// Weight of depth disagreement between views; above 0 it also weighs pixels by their agreement. Default 0.5
    /// (Bian et al. 2019); paper 0.
    pub geometry_weight: f64,
    /// Weight of the disagreement between depth and brightness under a lamp beside the lens, see
    /// [`light`](crate::light). Default 1; paper 0. Set it to 0 for scenes with other light, such as streets.
    pub light_weight: f64,
}

impl Default for ObjectiveConfig {
    fn default() -> Self {
        Self::endo()
    }
}

impl ObjectiveConfig {
    /// The paper's objective: L1, mid-grey outside, smooth disparity, reliability mask.
    pub const fn paper() -> Self {
        Self {
            ssim_weight: 0.0,
            out_of_view: OutOfView::Grey,
            average: Average::ValidPixels,
            across_sources: AcrossSources::Sum,
            auto_mask: false,
            brightness: Brightness::Constant,
            scales: Scales::Native,
            camera_scaling: CameraScaling::Exact,
            smoothness: Smoothness::SecondOrderDisparity,
            smoothness_weight: 0.4,
            smoothness_decay: 2.0,
            mask_weight: 0.15,
            geometry_weight: 0.0,
            light_weight: 0.0,
        }
    }

    /// SfMLearner's PyTorch port, number for number: what imported checkpoints were trained with.
    pub const fn port() -> Self {
        Self {
            out_of_view: OutOfView::Masked,
            average: Average::AllPixels,
            camera_scaling: CameraScaling::Divided,
            smoothness: Smoothness::SecondOrderDepth,
            smoothness_weight: 0.1,
            smoothness_decay: 2.3,
            mask_weight: 0.2,
            ..Self::paper()
        }
    }

    /// The paper's objective with the terms that later work and endoscopes call for.
    pub const fn endo() -> Self {
        Self {
            ssim_weight: 0.85,
            out_of_view: OutOfView::Masked,
            across_sources: AcrossSources::Minimum,
            auto_mask: true,
            brightness: Brightness::Affine,
            scales: Scales::Full,
            smoothness: Smoothness::EdgeAware,
            smoothness_weight: 0.01,
            mask_weight: 0.2,
            geometry_weight: 0.5,
            light_weight: 1.0,
            ..Self::paper()
        }
    }

    /// Refuses numbers the formulae have no meaning for.
    ///
    /// # Errors
    /// [`SynthesisError::Config`] for the first field outside its range.
    pub fn validate(&self) -> Result<(), SynthesisError> {
        let weight = |value: f64| value.is_finite() && value >= 0.0;
        let rules = [
            ("ssim_weight", self.ssim_weight, (0.0..=1.0).contains(&self.ssim_weight), "between 0 and 1"),
            ("smoothness_weight", self.smoothness_weight, weight(self.smoothness_weight), "0 or above"),
            (
                "smoothness_decay",
                self.smoothness_decay,
                self.smoothness_decay.is_finite() && self.smoothness_decay >= 1.0,
                "1 or above",
            ),
            ("mask_weight", self.mask_weight, weight(self.mask_weight), "0 or above"),
            ("geometry_weight", self.geometry_weight, weight(self.geometry_weight), "0 or above"),
            ("light_weight", self.light_weight, weight(self.light_weight), "0 or above"),
        ];
        match rules.into_iter().find(|(_, _, holds, _)| !holds) {
            Some((field, value, _, allowed)) => Err(SynthesisError::Config { field, value, allowed }),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_valid_and_survive_a_file() {
        for preset in [ObjectiveConfig::paper(), ObjectiveConfig::port(), ObjectiveConfig::endo()] {
            preset.validate().unwrap();
            let text = serde_json::to_string(&preset).unwrap();
            assert_eq!(serde_json::from_str::<ObjectiveConfig>(&text).unwrap(), preset);
        }
        assert_eq!(serde_json::from_str::<ObjectiveConfig>("{}").unwrap(), ObjectiveConfig::endo());
    }

    #[test]
    fn nonsense_is_refused_in_one_sentence() {
        let config = ObjectiveConfig { ssim_weight: 1.5, ..ObjectiveConfig::endo() };
        let message = config.validate().unwrap_err().to_string();
        assert_eq!(
            message,
            "objective.ssim_weight is 1.5, but it must be between 0 and 1; correct it in the configuration"
        );
        assert!(ObjectiveConfig { mask_weight: f64::NAN, ..ObjectiveConfig::endo() }.validate().is_err());
        assert!(ObjectiveConfig { smoothness_decay: 0.0, ..ObjectiveConfig::endo() }.validate().is_err());
    }
}
