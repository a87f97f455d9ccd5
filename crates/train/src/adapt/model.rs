//! The model an adaptation begins with: its weights, how it was trained, what it has seen.

use super::TRAINING;
use super::history::History;
use crate::config::{Preset, TrainConfig};
use crate::error::TrainError;
use crate::run_folder::{RunFolder, model_folder};
use crate::schedule::Decay;
use burn::tensor::Device;
use endoscape_core::{Event, EventSink};
use endoscape_nets::{Checkpoint, NetsConfig};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Share of the training's learning rate.
const GENTLE: f64 = 1.0 / 3.0;
/// Steps, unless told otherwise.
const STEPS: u64 = 600;
/// Steps from one candidate to the next.
const CANDIDATE_EVERY: u64 = 50;
/// Candidates in a row without a better one after which it is over.
const PATIENCE: u64 = 6;
/// Seconds between two states to go on from.
const CHECKPOINT_SECONDS: f64 = 10.0;
/// See [`TrainConfig::standing_weight`].
const STANDING_WEIGHT: f64 = 10.0;

/// A checkpoint and what is known about it.
pub struct GivenModel {
    /// Where the checkpoint is.
    pub folder: PathBuf,
    /// The checkpoint.
    pub checkpoint: Checkpoint,
    /// How it was trained: the settings beside it, else those of the nearest preset.
    pub training: TrainConfig,
    /// What it was adapted to before.
    pub history: History,
}

impl GivenModel {
    /// Reads a checkpoint or the best one of a run. Settings that are nowhere written are assumed, with a warning.
    ///
    /// # Errors
    /// [`TrainError`] if the checkpoint, its settings or its history cannot be read, or one of its networks is missing.
    pub fn open(path: &Path, device: &Device, events: &mut dyn EventSink) -> Result<Self, TrainError> {
        let folder = Checkpoint::folder(&model_folder(path));
        let checkpoint = Checkpoint::load(&folder, device)?;
        if checkpoint.disp.is_none() || checkpoint.pose.is_none() {
            let remedy = "name a model with a depth and a motion network";
            return Err(TrainError::run(&folder, "holds only one of the two networks", remedy));
        }
        let training = match settings_beside(&folder)? {
            Some(training) => training,
            None => assumed(&folder, &checkpoint, events),
        };
        let training = TrainConfig { nets: checkpoint.config.clone(), ..training };
        Ok(Self { history: History::read(&folder)?, folder, checkpoint, training })
    }

    /// How to go on learning: as in the training, more gently, and with still pictures, which the training leaves out.
    ///
    /// Pixels that stillness explains best are no longer dropped (auto-mask), or a camera that stands could not be
    /// learned from.
    pub fn gentle(&self) -> TrainConfig {
        let mut config = self.training.clone();
        config.learning_rate *= GENTLE;
        (config.steps, config.minutes) = (STEPS, 0.0);
        (config.warmup, config.decay) = (CANDIDATE_EVERY, Decay::Cosine);
        (config.validate_every, config.patience) = (CANDIDATE_EVERY, PATIENCE);
        config.checkpoint_seconds = CHECKPOINT_SECONDS;
        (config.gap.still, config.standing_weight) = (true, STANDING_WEIGHT);
        config.objective.auto_mask = false;
        config
    }

    /// Fingerprints of all that it has learned from.
    pub fn fingerprints(&self) -> BTreeSet<String> {
        let trained = self.checkpoint.manifest.data.iter().map(|source| source.fingerprint.clone());
        let adapted = self.history.adaptation.iter().flat_map(|adaptation| &adaptation.videos);
        trained.chain(adapted.map(|video| video.fingerprint.clone())).collect()
    }
}

/// The settings of the training: in the checkpoint itself, or those of the run it lies in.
fn settings_beside(folder: &Path) -> Result<Option<TrainConfig>, TrainError> {
    let own = folder.join(TRAINING);
    if own.is_file() {
        return Ok(Some(TrainConfig::default().overlaid(&own)?));
    }
    let run = folder.parent().and_then(|parent| RunFolder::open(parent).ok());
    run.map(|run| run.config()).transpose()
}

/// The preset whose networks are nearest in size, at the size and gap that the checkpoint says.
fn assumed(folder: &Path, checkpoint: &Checkpoint, events: &mut dyn EventSink) -> TrainConfig {
    let numbers = |nets: &NetsConfig| nets.disp.parameter_count() + nets.pose.parameter_count();
    let presets = [("paper", Preset::Paper), ("fast", Preset::Fast), ("endo", Preset::Endo)];
    let presets = presets.map(|(name, preset)| (name, TrainConfig::preset(preset)));
    let distance = |preset: &TrainConfig| numbers(&preset.nets).abs_diff(numbers(&checkpoint.config));
    let [first, others @ ..] = presets;
    let nearer = |best: (_, TrainConfig), other: (_, TrainConfig)| {
        if distance(&other.1) < distance(&best.1) { other } else { best }
    };
    let (name, mut config) = others.into_iter().fold(first, nearer);
    if let Some(input) = checkpoint.manifest.input {
        (config.width, config.height) = (input.width, input.height);
        (config.gap.fixed, config.gap.least) = (input.fixed_gap, input.least_displacement);
    }
    events.event(Event::Warned(format!(
        "{} does not say how it was trained, so the settings of the preset {name}, whose networks are nearest, are \
         assumed; --config FILE changes them",
        folder.display()
    )));
    config
}
