//! What a run needs to go on exactly where it stopped.
//!
//! Weights, the optimiser's moments and the step are all there is: what is drawn for a step follows from the seed and
//! the step's number alone.

use crate::error::TrainError;
use crate::model::DepthMotionModel;
use crate::optimizer::adam;
use crate::run_folder::{RunFolder, to_json, write_whole};
use burn::optim::ModuleOptimizer;
use burn::tensor::Device;
use endoscape_nets::{Checkpoint, Manifest, NetsConfig};
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::Path;

const OPTIMIZER: &str = "optimizer.bpk";
const PROGRESS: &str = "progress.json";
const REMEDY: &str = "start a new run from its weights with --init";

/// How far a run has come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Steps taken.
    pub step: u64,
    /// Seconds of training in all sessions together.
    pub elapsed_s: f64,
    /// Best value of the deciding validation figure so far.
    pub best: Option<f64>,
    /// Step of the last validation, which a resumed run need not repeat.
    pub validated_at: Option<u64>,
    /// Validations in a row that brought nothing better.
    #[serde(default)]
    pub stale: u64,
}

/// A run in memory.
pub struct TrainState {
    /// The networks, on a device that records gradients.
    pub model: DepthMotionModel,
    /// Adam's moments.
    pub optimizer: ModuleOptimizer,
    /// How far it has come.
    pub progress: Progress,
}

impl TrainState {
    /// The state of a run that has not begun.
    ///
    /// # Errors
    /// As [`DepthMotionModel::from_checkpoint`].
    pub fn fresh(checkpoint: Checkpoint) -> Result<Self, TrainError> {
        let model = DepthMotionModel::from_checkpoint(checkpoint)?;
        Ok(Self { model, optimizer: adam(), progress: Progress::default() })
    }

    /// Reads the last complete state of a run.
    ///
    /// # Errors
    /// [`TrainError`] if there is none, or it is damaged.
    pub fn load(run: &RunFolder, device: &Device) -> Result<Self, TrainError> {
        let model = DepthMotionModel::from_checkpoint(Checkpoint::load(&run.latest(), device)?)?;
        let (optimizer, progress) = read_beside(run)?;
        Ok(Self { model, optimizer, progress })
    }

    /// Writes the state in place of the one before, in one piece.
    ///
    /// # Errors
    /// [`TrainError`] if it cannot be written; the one before is untouched then.
    pub fn save(&self, run: &RunFolder, nets: &NetsConfig, manifest: Manifest) -> Result<(), TrainError> {
        let checkpoint = self.model.to_checkpoint(nets.clone(), manifest);
        checkpoint.save_with(&run.latest(), |folder| write_beside(folder, &self.optimizer, &self.progress))
    }
}

/// What lies beside the weights in the last complete checkpoint of a run.
///
/// # Errors
/// [`TrainError`] if it is missing or damaged.
pub(crate) fn read_beside(run: &RunFolder) -> Result<(ModuleOptimizer, Progress), TrainError> {
    let folder = Checkpoint::folder(&run.latest());
    let path = folder.join(PROGRESS);
    let text = fs::read(&path).map_err(|error| TrainError::io(&path, "be read", &error))?;
    let progress = serde_json::from_slice(&text)
        .map_err(|error| TrainError::run(&path, format!("is no training progress ({error})"), REMEDY))?;
    let path = folder.join(OPTIMIZER);
    let optimizer = adam().load(&path).map_err(|error| TrainError::run(&path, error.to_string(), REMEDY))?;
    Ok((optimizer, progress))
}

/// Writes what a run needs beside its weights.
///
/// # Errors
/// [`TrainError`] if it cannot be written.
pub(crate) fn write_beside(folder: &Path, optimizer: &ModuleOptimizer, progress: &Progress) -> Result<(), TrainError> {
    write_whole(&folder.join(PROGRESS), &to_json(progress)?)?;
    let path = folder.join(OPTIMIZER);
    optimizer.save(&path).map_err(|error| {
        TrainError::run(&path, format!("cannot be written: {error}"), "free some space or choose another folder")
    })
}
