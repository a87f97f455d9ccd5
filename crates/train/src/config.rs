//! Everything that can be chosen about a training: preset, then file, then flags.
//!
//! ```text
//! preset (paper | fast | endo)  <  --config FILE.toml  <  flags
//! ```
//! A file names only what differs from the preset. The result is written beside the weights, complete, so that every
//! run says what it was.

use crate::augment::AugmentConfig;
use crate::error::TrainError;
use crate::gap::GapConfig;
use crate::lesson::LessonConfig;
use crate::schedule::Decay;
use endoscape_core::Size;
use endoscape_nets::{NetsConfig, TrainedInput};
use endoscape_synthesis::ObjectiveConfig;
use endoscape_synthesis::config::Scales;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::str::FromStr;

/// The configuration of a training. `default()` is [`TrainConfig::fast`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// Width of the pictures the networks see. Default 160; paper 416; endo 320.
    pub width: usize,
    /// Their height. Default 128; paper 128; endo 256.
    pub height: usize,
    /// Snippets per step. Default 4; paper 8.
    pub batch: usize,
    /// Seed of the weights, the order of the snippets and every augmentation. Default 0.
    pub seed: u64,
    /// Steps to take, 0 for no limit; training ends at whichever budget is spent first. Default 20000; paper and endo
    /// 150000.
    pub steps: u64,
    /// Minutes to train, 0 for no limit. Default 0.
    pub minutes: f64,
    /// Adam's learning rate. Default 6e-4; endo 2e-4 (SfMLearner); paper 3e-4, from a comment in its LaTeX source: the 0.1 of its
    /// text diverges with Adam.
    pub learning_rate: f64,
    /// Steps over which the learning rate grows to its full value. Default 100; paper 0.
    pub warmup: u64,
    /// How it falls later. Default cosine; paper constant; endo in steps.
    pub decay: Decay,
    /// Price of a motion that is seen where the camera stands still (`gap.still`). Default 0; 10 in `adapt`: one pixel's
    /// worth, about 0.005, then costs a tenth of a usual loss.
    pub standing_weight: f64,
    /// Longest gradient over all weights; longer ones are shortened, 0 for no limit. Default 10: far above what a
    /// healthy training shows, so it only catches outliers.
    pub gradient_norm: f64,
    /// Steps between two lines of `metrics.csv`. Default 10.
    pub log_every: u64,
    /// Steps between two validations. Default 250.
    pub validate_every: u64,
    /// Validations in a row without a better one after which training ends, 0 for never. Default 0.
    pub patience: u64,
    /// Snippets of a validation, spread evenly over its clips. Default 64.
    pub validation_snippets: usize,
    /// What makes a checkpoint the best. Default photometric.
    pub best_by: Criterion,
    /// Seconds between two checkpoints of the state to resume from. Default 120.
    pub checkpoint_seconds: f64,
    /// Threads that prepare batches. Default 1: augmenting takes a few milliseconds, a step a few hundred.
    pub loader_threads: usize,
    /// Most memory in MiB for the decoded frames of all clips, 4 bytes a pixel. Default 4096: 50,000 frames of 160x128.
    pub memory_mib: usize,
    /// How far apart the frames of a snippet are.
    pub gap: GapConfig,
    /// What is varied.
    pub augment: AugmentConfig,
    /// What is minimised.
    pub objective: ObjectiveConfig,
    /// How much labels count, where there are any.
    pub lesson: LessonConfig,
    /// What learns. The number of frames in a snippet is `nets.pose.snippet_length`.
    pub nets: NetsConfig,
}

/// Which validation figure decides.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Criterion {
    /// The photometric loss, and the light term by its weight: needs no truth.
    #[default]
    Photometric,
    /// AbsRel of the depth, where the validation data has depth.
    Depth,
}

/// A named starting point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Preset {
    /// As the paper has it.
    Paper,
    /// Slim networks for two processor cores.
    Fast,
    /// The best known for endoscopes.
    Endo,
}

impl FromStr for Preset {
    type Err = TrainError;

    fn from_str(name: &str) -> Result<Self, TrainError> {
        match name {
            "paper" => Ok(Self::Paper),
            "fast" => Ok(Self::Fast),
            "endo" => Ok(Self::Endo),
            _ => Err(TrainError::config("preset", format!("is `{name}` but must be paper, fast or endo"))),
        }
    }
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self::fast()
    }
}

impl TrainConfig {
    /// The configuration of a preset.
    pub fn preset(preset: Preset) -> Self {
        match preset {
            Preset::Paper => Self::paper(),
            Preset::Fast => Self::fast(),
            Preset::Endo => Self::endo(),
        }
    }

    /// The paper (Turan et al. 2018): 416x128, batch 8, its networks and its objective, no warm-up.
    pub fn paper() -> Self {
        Self {
            width: 416,
            height: 128,
            batch: 8,
            steps: 150_000,
            learning_rate: 3e-4,
            warmup: 0,
            decay: Decay::Constant,
            augment: AugmentConfig::paper(),
            objective: ObjectiveConfig::paper(),
            nets: NetsConfig::paper(),
            ..Self::fast()
        }
    }

    /// Slim networks at 160x128 with the objective of `endo` but for what costs more time than it brings: the depth of
    /// the sources, which would triple the work, and coarse scales judged at full size, which halve the steps a second.
    pub fn fast() -> Self {
        Self {
            width: 160,
            height: 128,
            batch: 4,
            seed: 0,
            steps: 20_000,
            minutes: 0.0,
            learning_rate: 6e-4,
            warmup: 100,
            decay: Decay::Cosine,
            standing_weight: 0.0,
            gradient_norm: 10.0,
            log_every: 10,
            validate_every: 250,
            patience: 0,
            validation_snippets: 64,
            best_by: Criterion::Photometric,
            checkpoint_seconds: 120.0,
            loader_threads: 1,
            memory_mib: 4096,
            gap: GapConfig::default(),
            augment: AugmentConfig::endo(),
            objective: ObjectiveConfig { geometry_weight: 0.0, scales: Scales::Native, ..ObjectiveConfig::endo() },
            lesson: LessonConfig::default(),
            nets: NetsConfig::fast(),
        }
    }

    /// Full networks at 320x256 with every term and augmentation for endoscopes.
    pub fn endo() -> Self {
        Self {
            width: 320,
            height: 256,
            steps: 150_000,
            learning_rate: 2e-4,
            decay: Decay::Step,
            objective: ObjectiveConfig::endo(),
            nets: NetsConfig::endo(),
            ..Self::fast()
        }
    }

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

    /// Size of the pictures the networks see.
    pub const fn size(&self) -> Size {
        Size::new(self.width, self.height)
    }

    /// What the checkpoint says about its pictures.
    pub const fn trained_input(&self) -> TrainedInput {
        let Self { width, height, gap, .. } = self;
        let (fixed_gap, least_displacement) = (gap.fixed, gap.least);
        TrainedInput { width: *width, height: *height, fixed_gap, least_displacement }
    }

    /// Frames per snippet.
    pub const fn snippet_length(&self) -> usize {
        self.nets.pose.snippet_length
    }

    /// Whether the depth of the sources is needed.
    pub fn with_source_depth(&self) -> bool {
        self.objective.geometry_weight > 0.0
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
        // The deepest stage halves seven times; below 32 pixels nothing is left of a picture long before.
        for (name, value) in [("width", self.width), ("height", self.height)] {
            if !(32..=4096).contains(&value) {
                return wrong(name, value as f64, "from 32 to 4096");
            }
        }
        let counts = [
            ("batch", self.batch, 256),
            ("loader_threads", self.loader_threads, 64),
            ("validation_snippets", self.validation_snippets, 100_000),
            ("log_every", self.log_every as usize, 1_000_000),
            ("validate_every", self.validate_every as usize, 1_000_000_000),
        ];
        if let Some((name, value, most)) = counts.into_iter().find(|(_, value, most)| !(1..=*most).contains(value)) {
            return wrong(name, value as f64, &format!("from 1 to {most}"));
        }
        if !(self.learning_rate > 0.0 && self.learning_rate <= 1.0) {
            return wrong("learning_rate", self.learning_rate, "above 0 and at most 1");
        }
        let numbers = [
            ("minutes", self.minutes),
            ("standing_weight", self.standing_weight),
            ("gradient_norm", self.gradient_norm),
            ("checkpoint_seconds", self.checkpoint_seconds),
        ];
        if let Some((name, value)) = numbers.into_iter().find(|(_, value)| !(value.is_finite() && *value >= 0.0)) {
            return wrong(name, value, "0 or above");
        }
        if self.steps == 0 && self.minutes == 0.0 {
            return Err(TrainError::config("steps", "and `minutes` are both 0, so training would never end; set one"));
        }
        self.gap.validate()?;
        self.lesson.validate()?;
        self.augment.validate()?;
        self.objective.validate()?;
        Ok(self.nets.validate()?)
    }
}

/// `config` with the settings of a TOML file laid over it.
///
/// # Errors
/// [`TrainError::Run`] if the file cannot be read, is no TOML, or names a setting that does not exist.
pub(crate) fn overlaid<T: Serialize + DeserializeOwned>(config: &T, file: &Path) -> Result<T, TrainError> {
    let text = std::fs::read_to_string(file).map_err(|error| TrainError::io(file, "be read", &error))?;
    overlaid_text(config, &text).map_err(|reason| TrainError::run(file, reason, "correct the file"))
}

fn overlaid_text<T: Serialize + DeserializeOwned>(config: &T, text: &str) -> Result<T, String> {
    let sentence = |error: &toml::de::Error| error.message().replace('\n', " ");
    let over: toml::Table = toml::from_str(text).map_err(|error| sentence(&error))?;
    let mut all = toml::Table::try_from(config).map_err(|error| error.to_string())?;
    overlay(&mut all, over);
    all.try_into().map_err(|error: toml::de::Error| sentence(&error))
}

/// Replaces what `over` names, table by table.
fn overlay(base: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (base.get_mut(&key), value) {
            (Some(toml::Value::Table(inner)), toml::Value::Table(over)) => overlay(inner, over),
            (_, value) => {
                base.insert(key, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_valid_and_survive_a_file() {
        for preset in [Preset::Paper, Preset::Fast, Preset::Endo] {
            let config = TrainConfig::preset(preset);
            config.validate().unwrap();
            assert_eq!(overlaid_text(&TrainConfig::paper(), &config.to_toml().unwrap()).unwrap(), config);
        }
    }

    #[test]
    fn a_file_changes_only_what_it_names() {
        let text = "learning_rate = 1e-3\n[nets.disp]\nbeta = 0.05\n[objective]\nsmoothness_weight = 0.2";
        let config = overlaid_text(&TrainConfig::paper(), text).unwrap();
        assert_eq!((config.learning_rate, config.nets.disp.beta), (1e-3, 0.05));
        assert_eq!(config.objective.smoothness_weight, 0.2);
        assert_eq!(config.nets.pose, NetsConfig::paper().pose);
        assert_eq!(config.objective.mask_weight, ObjectiveConfig::paper().mask_weight);
    }

    #[test]
    fn slips_are_named_in_one_sentence() {
        let error = overlaid_text(&TrainConfig::fast(), "learnig_rate = 1").unwrap_err();
        assert!(error.contains("learnig_rate") && !error.contains('\n'), "{error}");
        let error = overlaid_text(&TrainConfig::fast(), "batch = ").unwrap_err();
        assert!(!error.contains('\n'), "{error}");
        let config = TrainConfig { width: 8, ..TrainConfig::fast() };
        assert_eq!(config.validate().unwrap_err().to_string(), "the setting `width` is 8 but must be from 32 to 4096");
        assert!(TrainConfig { learning_rate: f64::NAN, ..TrainConfig::fast() }.validate().is_err());
    }

    #[test]
    fn the_budget_that_is_spent_first_counts() {
        let config = TrainConfig { steps: 100, minutes: 1.0, ..TrainConfig::fast() };
        assert_eq!(config.progress(50, 0.0), 0.5);
        assert_eq!(config.progress(50, 45.0), 0.75);
        assert_eq!(TrainConfig { minutes: 0.0, ..config }.progress(50, 45.0), 0.5);
    }
}
