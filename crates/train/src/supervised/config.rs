//! Everything that can be chosen about a supervised training.

use crate::config::overlaid;
use crate::error::TrainError;
use crate::schedule::Decay;
use endoscape_core::Size;
use endoscape_nets::{RecurrentVoConfig, TrainedInput};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The configuration of a supervised training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SupervisedConfig {
    /// Width of the pictures the network sees. Default 128.
    pub width: usize,
    /// Their height. Default 128.
    pub height: usize,
    /// Subsequences per step. Default 2.
    pub batch: usize,
    /// Pairs of frames in a subsequence. Default 16: by then the memory is filled as in a long stream.
    pub subsequence: usize,
    /// Pairs that gradients flow back through at most. Default 8.
    pub truncation: usize,
    /// Seed of the weights and of everything drawn. Default 0.
    pub seed: u64,
    /// Steps to take, 0 for no limit; training ends at whichever budget is spent first. Default 6000.
    pub steps: u64,
    /// Minutes to train, 0 for no limit. Default 0.
    pub minutes: f64,
    /// Adam's learning rate. Default 5e-4.
    pub learning_rate: f64,
    /// Steps over which the learning rate grows to its full value. Default 100.
    pub warmup: u64,
    /// How it falls later. Default cosine.
    pub decay: Decay,
    /// Longest gradient over all weights; longer ones are shortened, 0 for no limit. Default 10.
    pub gradient_norm: f64,
    /// Weight of the squared rotation error in square radians beside the squared translation error in square steps.
    /// Default 100, the weight of DeepVO (Wang et al. 2017), of which Deep EndoVO is the endoscopic sibling.
    pub rotation_weight: f64,
    /// Most frames from one frame of a pair to the next: streams lose frames. Default 2.
    pub longest_gap: usize,
    /// Whether subsequences are mirrored and turned as a whole, their motions with them. Default on.
    pub symmetries: bool,
    /// Largest share by which brightness and each colour of a subsequence are changed. Default 0.1.
    pub colour_change: f64,
    /// Steps between two lines of `metrics.csv`. Default 10.
    pub log_every: u64,
    /// Steps between two validations. Default 250.
    pub validate_every: u64,
    /// Frames of a validation at most, in equal parts from the begin of each stretch. Default 400.
    pub validation_frames: usize,
    /// Seconds between two checkpoints of the state to resume from. Default 120.
    pub checkpoint_seconds: f64,
    /// Most memory in MiB for the decoded frames, 3 bytes a pixel. Default 4096.
    pub memory_mib: usize,
    /// What learns. Its unit of length is set by the data.
    pub net: RecurrentVoConfig,
}

impl Default for SupervisedConfig {
    fn default() -> Self {
        Self {
            width: 128,
            height: 128,
            batch: 2,
            subsequence: 16,
            truncation: 8,
            seed: 0,
            steps: 6000,
            minutes: 0.0,
            learning_rate: 5e-4,
            warmup: 100,
            decay: Decay::Cosine,
            gradient_norm: 10.0,
            rotation_weight: 100.0,
            longest_gap: 2,
            symmetries: true,
            colour_change: 0.1,
            log_every: 10,
            validate_every: 250,
            validation_frames: 400,
            checkpoint_seconds: 120.0,
            memory_mib: 4096,
            net: RecurrentVoConfig::default(),
        }
    }
}

impl SupervisedConfig {
    /// Lays the settings of a TOML file over these.
    ///
    /// # Errors
    /// [`TrainError::Run`] if the file cannot be read, is no TOML, or names a setting that does not exist.
    pub fn overlaid(&self, file: &Path) -> Result<Self, TrainError> {
        overlaid(self, file)
    }

    /// The complete configuration as text.
    ///
    /// # Errors
    /// [`TrainError::Config`] when a number has no TOML form.
    pub fn to_toml(&self) -> Result<String, TrainError> {
        toml::to_string(self).map_err(|error| TrainError::config("config", format!("cannot be written: {error}")))
    }

    /// Size of the pictures the network sees.
    pub const fn size(&self) -> Size {
        Size::new(self.width, self.height)
    }

    /// What the checkpoint says about its pictures: neighbouring frames at this size.
    pub const fn trained_input(&self) -> TrainedInput {
        TrainedInput { width: self.width, height: self.height, fixed_gap: 1, least_displacement: 0.0 }
    }

    /// Share of the budget that is spent, 0 to 1 and beyond.
    pub fn progress(&self, step: u64, elapsed_s: f64) -> f64 {
        let by_steps = if self.steps > 0 { step as f64 / self.steps as f64 } else { 0.0 };
        let by_time = if self.minutes > 0.0 { elapsed_s / (60.0 * self.minutes) } else { 0.0 };
        by_steps.max(by_time)
    }

    /// Refuses what cannot work, before any data is read.
    ///
    /// # Errors
    /// [`TrainError`] naming the first setting that is out of range.
    pub fn validate(&self) -> Result<(), TrainError> {
        let wrong = |name: &str, value: f64, range: &str| {
            Err(TrainError::config(name, format!("is {value} but must be {range}")))
        };
        let counts = [
            ("width", self.width, 32, 4096),
            ("height", self.height, 32, 4096),
            ("batch", self.batch, 1, 256),
            ("subsequence", self.subsequence, 1, 1000),
            ("truncation", self.truncation, 1, 1000),
            ("longest_gap", self.longest_gap, 1, 100),
            ("log_every", self.log_every as usize, 1, 1_000_000),
            ("validate_every", self.validate_every as usize, 1, 1_000_000_000),
            ("validation_frames", self.validation_frames, 2, 1_000_000),
        ];
        for (name, value, least, most) in counts {
            if !(least..=most).contains(&value) {
                return wrong(name, value as f64, &format!("from {least} to {most}"));
            }
        }
        if !(self.learning_rate > 0.0 && self.learning_rate <= 1.0) {
            return wrong("learning_rate", self.learning_rate, "above 0 and at most 1");
        }
        if !(0.0..1.0).contains(&self.colour_change) {
            return wrong("colour_change", self.colour_change, "from 0 to below 1");
        }
        let numbers = [
            ("minutes", self.minutes),
            ("gradient_norm", self.gradient_norm),
            ("rotation_weight", self.rotation_weight),
            ("checkpoint_seconds", self.checkpoint_seconds),
        ];
        if let Some((name, value)) = numbers.into_iter().find(|(_, value)| !(value.is_finite() && *value >= 0.0)) {
            return wrong(name, value, "0 or above");
        }
        if self.steps == 0 && self.minutes == 0.0 {
            return Err(TrainError::config("steps", "and `minutes` are both 0, so training would never end; set one"));
        }
        Ok(self.net.validate()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slips_are_named() {
        SupervisedConfig::default().validate().unwrap();
        let refused = |config: SupervisedConfig| config.validate().unwrap_err().to_string();
        let sentence = refused(SupervisedConfig { width: 8, ..SupervisedConfig::default() });
        assert_eq!(sentence, "the setting `width` is 8 but must be from 32 to 4096");
        let sentence = refused(SupervisedConfig { rotation_weight: f64::NAN, ..SupervisedConfig::default() });
        assert!(sentence.contains("rotation_weight"), "{sentence}");
        assert!(refused(SupervisedConfig { steps: 0, ..SupervisedConfig::default() }).contains("never end"));
    }

    #[test]
    fn the_written_configuration_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("config.toml");
        let config = SupervisedConfig { seed: 4, minutes: 2.5, ..SupervisedConfig::default() };
        std::fs::write(&file, config.to_toml().unwrap()).unwrap();
        assert_eq!(SupervisedConfig::default().overlaid(&file).unwrap(), config);
        std::fs::write(&file, "subsequences = 3").unwrap();
        let sentence = SupervisedConfig::default().overlaid(&file).unwrap_err().to_string();
        assert!(sentence.contains("subsequences") && !sentence.contains('\n'), "{sentence}");
    }
}
