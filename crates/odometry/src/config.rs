//! Every choice of [`LearnedOdometry`](crate::LearnedOdometry), with its origin.

use crate::OdometryError;
use endoscape_core::Size;
use endoscape_nets::TrainedInput;
use serde::Serialize;

/// Size of the pictures of SfMLearner's published weights, for checkpoints that do not say theirs.
const PUBLISHED_SIZE: Size = Size::new(416, 128);

/// How the networks are used.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OdometryConfig {
    /// Size at which the networks see the pictures; that of the training unless told otherwise.
    pub size: Size,
    /// Frames between neighbours of a window; 0 waits until the picture has moved.
    pub fixed_gap: usize,
    /// Median displacement from one frame of a window to the next from which on motion is measured, as a share of the
    /// picture's width: that of the training.
    pub least_displacement: f64,
    /// Share of its deviation from the networks' own unit that the scale keeps from keyframe to keyframe. 1 trusts the
    /// chain of depth ratios alone, whose errors add up; 0 trusts every depth map alone. Default 0.98: a deviation is
    /// halved within 34 keyframes.
    pub scale_memory: f64,
    /// Whether the motion network's answer is sharpened by aligning brightness, where the camera is known. Default on.
    pub refine: bool,
    /// Poses below this confidence count as lost. Default 0.1.
    pub lost_below: f64,
}

impl OdometryConfig {
    /// The configuration a model was trained for; `size` overrides the size of its pictures.
    pub fn for_model(input: Option<&TrainedInput>, size: Option<Size>) -> Self {
        let trained_size = input.map_or(PUBLISHED_SIZE, |input| Size::new(input.width, input.height));
        Self {
            size: size.unwrap_or(trained_size),
            // SfMLearner's published weights were trained on neighbouring frames.
            fixed_gap: input.map_or(1, |input| input.fixed_gap),
            least_displacement: input.map_or(0.0, |input| input.least_displacement),
            scale_memory: 0.98,
            refine: true,
            lost_below: 0.1,
        }
    }

    /// # Errors
    /// [`OdometryError::Setting`] naming what is out of range.
    pub fn validate(&self) -> Result<(), OdometryError> {
        let share = |setting, value: f64| {
            let inside = (0.0..=1.0).contains(&value);
            inside.then_some(()).ok_or(OdometryError::Setting { setting, value, range: "from 0 to 1" })
        };
        for (setting, value) in [("width", self.size.width), ("height", self.size.height)] {
            // Below 32 pixels nothing is left of a picture after the networks' seven halvings.
            if !(32..=4096).contains(&value) {
                return Err(OdometryError::Setting { setting, value: value as f64, range: "from 32 to 4096" });
            }
        }
        share("least_displacement", self.least_displacement)?;
        share("scale_memory", self.scale_memory)?;
        share("lost_below", self.lost_below)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_brings_its_own_configuration() {
        let input = TrainedInput { width: 160, height: 128, fixed_gap: 0, least_displacement: 0.02 };
        let config = OdometryConfig::for_model(Some(&input), None);
        assert_eq!((config.size, config.fixed_gap, config.least_displacement), (Size::new(160, 128), 0, 0.02));
        let published = OdometryConfig::for_model(None, None);
        assert_eq!((published.size, published.fixed_gap), (Size::new(416, 128), 1));
        config.validate().unwrap();
    }

    #[test]
    fn impossible_settings_are_named() {
        let config = OdometryConfig::for_model(None, Some(Size::new(8, 128)));
        let sentence = config.validate().unwrap_err().to_string();
        assert_eq!(sentence, "the setting `width` is 8 but must be from 32 to 4096");
        let config = OdometryConfig { scale_memory: f64::NAN, ..OdometryConfig::for_model(None, None) };
        assert!(config.validate().unwrap_err().to_string().contains("scale_memory"));
    }
}
