//! `history.toml`: what a model has been adapted to, one table per adaptation, oldest first. It travels in the
//! checkpoint, so that every later adaptation adds to it.

use super::NewVideo;
use crate::error::TrainError;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// Its name in a checkpoint folder.
pub const HISTORY: &str = "history.toml";

/// All adaptations of a model.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct History {
    /// Oldest first.
    #[serde(default)]
    pub adaptation: Vec<Adaptation>,
}

/// One adaptation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Adaptation {
    /// When it ended.
    pub date: String,
    /// Version of the program.
    pub endoscape_version: String,
    /// Whether a better model came of it; if not, the weights stayed as they were.
    pub improved: bool,
    /// Seed of everything random.
    pub seed: u64,
    /// Steps taken, those after the best candidate included.
    pub steps: u64,
    /// Seconds they took.
    pub elapsed_s: f64,
    /// The highest learning rate.
    pub learning_rate: f64,
    /// Snippets that were learned from, of mixed-in videos too.
    pub learned_snippets: usize,
    /// Snippets that were judged by.
    pub held_back_snippets: usize,
    /// Figures of the model before, on the part held back; `error` decides.
    pub before: BTreeMap<String, f64>,
    /// Figures of the model that came of it.
    pub after: BTreeMap<String, f64>,
    /// The new videos.
    pub videos: Vec<Video>,
}

/// A video a model has seen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Video {
    /// Its name and the frames of it.
    pub name: String,
    /// SHA-256 over the decoded pictures.
    pub fingerprint: String,
    /// Number of frames.
    pub frames: usize,
    /// How long it lasts, where that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
}

impl Video {
    /// What the record says about a video.
    pub fn of(video: &NewVideo) -> Self {
        let NewVideo { clip, seconds } = video;
        let (name, fingerprint) = (clip.name.clone(), clip.fingerprint.clone());
        Self { name, fingerprint, frames: clip.frames.len(), seconds: *seconds }
    }
}

impl Adaptation {
    /// What came of it.
    pub fn sentence(&self) -> String {
        let error = |figures: &BTreeMap<String, f64>| figures.get("error").copied().unwrap_or(f64::NAN);
        let (before, after) = (error(&self.before), error(&self.after));
        if self.improved {
            let fell = 100.0 * (1.0 - after / before);
            format!("the error on the frames held back fell by {fell:.1} %, from {before:.4} to {after:.4}")
        } else {
            format!(
                "nothing that was learned is better on the frames held back (error {before:.4}), so the given model is \
                 kept unchanged"
            )
        }
    }
}

impl History {
    /// Reads the history of a checkpoint; empty if it has none.
    ///
    /// # Errors
    /// [`TrainError::Run`] if it cannot be read.
    pub fn read(checkpoint: &Path) -> Result<Self, TrainError> {
        let path = checkpoint.join(HISTORY);
        if !path.exists() {
            return Ok(Self::default());
        }
        let text = fs::read_to_string(&path).map_err(|error| TrainError::io(&path, "be read", &error))?;
        toml::from_str(&text).map_err(|error: toml::de::Error| {
            let reason = format!("is no history ({})", error.message().replace('\n', " "));
            TrainError::run(&path, reason, "restore the file, or remove it to begin a new history")
        })
    }

    /// The history as text.
    ///
    /// # Errors
    /// [`TrainError::Config`] when a number has no TOML form.
    pub fn to_toml(&self) -> Result<String, TrainError> {
        toml::to_string(self).map_err(|error| TrainError::config("history", format!("cannot be written: {error}")))
    }
}
