//! The recipe of supervised training: as that of the joint training, with another model and another loss.
//!
//! A subsequence is shown in pieces of `truncation` pairs; the memory is handed from piece to piece, gradients are not.

use super::clip::{PosedClip, mean_step_m};
use super::config::SupervisedConfig;
use super::draw::Passage;
use super::loss::MotionLoss;
use super::validation::{MotionScores, measure};
use crate::error::TrainError;
use crate::model::numbered;
use crate::optimizer::{adam, limit_gradient};
use crate::run_folder::{RunFolder, RunManifest, Table};
use crate::schedule::warmup_factor;
use crate::state::{Progress, read_beside, write_beside};
use crate::tensorboard::EventFile;
use burn::module::Module;
use burn::optim::{GradientsParams, ModuleOptimizer};
use burn::tensor::{Device, Tensor};
use endoscape_core::{Event, EventSink};
use endoscape_nets::{DataSource, Manifest, Memory, NetsError, RecurrentCheckpoint, RecurrentVo, RecurrentVoConfig};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::time::Instant;

/// What to train, on what, and where to put it.
pub struct SupervisedJob {
    /// The complete configuration.
    pub config: SupervisedConfig,
    /// Training data.
    pub data: Vec<PosedClip>,
    /// Validation data; that of the training if there is no other.
    pub validation: Option<Vec<PosedClip>>,
    /// Recurrent checkpoint to take the weights and the unit of length from.
    pub init: Option<PathBuf>,
    /// Where to compute; a device without gradients, the trainer adds them.
    pub device: Device,
    /// Name of the device as the run manifest says it.
    pub device_name: String,
}

/// How a training ended.
#[derive(Clone, Debug, PartialEq)]
pub struct SupervisedSummary {
    /// Steps taken in all.
    pub steps: u64,
    /// Seconds they took in all sessions.
    pub elapsed_s: f64,
    /// The last validation.
    pub scores: MotionScores,
    /// The checkpoint with the best validation.
    pub best: PathBuf,
}

/// A line of `metrics.csv`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Metrics {
    step: u64,
    elapsed_s: f64,
    steps_per_s: f64,
    learning_rate: f64,
    total: f32,
    /// Mean squared translation error, square steps.
    translation: f32,
    /// Mean squared rotation error, square radians, before its weight.
    rotation: f32,
}

/// A line of `validation.csv`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct ScoreLine {
    step: u64,
    elapsed_s: f64,
    loss: f64,
    translation: f64,
    rotation: f64,
}

/// Starts a run in an empty folder and trains until its budget is spent.
///
/// # Errors
/// [`TrainError`]: an impossible configuration, data without motion, a folder in use, weights that do not load, a loss
/// that diverged.
pub fn train(
    job: &SupervisedJob,
    run: &RunFolder,
    events: &mut dyn EventSink,
) -> Result<SupervisedSummary, TrainError> {
    job.config.validate()?;
    let device = job.device.clone().autodiff();
    let SupervisedConfig { net, seed, .. } = &job.config;
    let checkpoint = match &job.init {
        None => {
            let net = RecurrentVoConfig { unit_m: mean_step_m(&job.data)?, ..net.clone() };
            RecurrentCheckpoint::init(net, *seed, &device)?
        }
        Some(path) => RecurrentCheckpoint::load(path, &device)?,
    };
    // The architecture and the unit of a checkpoint stay its own.
    let config = SupervisedConfig { net: checkpoint.config, ..job.config.clone() };
    run.describe_as(&config.to_toml()?, &manifest_of(job))?;
    let state = State { net: numbered(checkpoint.net), optimizer: adam(), progress: Progress::default() };
    let mut session = Session::new(job, config, run, state)?;
    // From here on the run can be resumed, whatever happens.
    session.save_latest()?;
    session.train(events)
}

/// Goes on with a run where its last checkpoint left it. On the CPU the result is the same to the last bit as that of a
/// run that was never interrupted, unless its budget is in minutes.
///
/// # Errors
/// [`TrainError`]: a folder without a supervised run, other data than the run's, or as [`train`].
pub fn resume(
    job: &SupervisedJob,
    run: &RunFolder,
    events: &mut dyn EventSink,
) -> Result<SupervisedSummary, TrainError> {
    job.config.validate()?;
    let recorded = run.manifest()?;
    if sources_of(&job.data) != recorded.data {
        let remedy = "give the same --data as before, or start a new run from its weights with --init";
        return Err(TrainError::run(run.root(), "the run was trained on other data", remedy));
    }
    let checkpoint = RecurrentCheckpoint::load(&run.latest(), &job.device.clone().autodiff())?;
    let (optimizer, progress) = read_beside(run)?;
    let state = State { net: numbered(checkpoint.net), optimizer, progress };
    run.describe_as(&job.config.to_toml()?, &RunManifest { device: job.device_name.clone(), ..recorded })?;
    Session::new(job, job.config.clone(), run, state)?.train(events)
}

/// Whether a run is a supervised one.
pub fn is_supervised(run: &RunFolder) -> bool {
    RecurrentCheckpoint::is_at(&run.latest())
}

/// The complete configuration of a supervised run.
///
/// # Errors
/// [`TrainError::Run`] if it cannot be read.
pub fn config_of(run: &RunFolder) -> Result<SupervisedConfig, TrainError> {
    SupervisedConfig::default().overlaid(&run.config_file())
}

fn sources_of(clips: &[PosedClip]) -> Vec<DataSource> {
    clips.iter().map(PosedClip::source).collect()
}

fn manifest_of(job: &SupervisedJob) -> RunManifest {
    let pairs = job.data.iter().flat_map(|clip| &clip.stretches).map(|stretch| stretch.len() - 1);
    RunManifest {
        endoscape_version: env!("CARGO_PKG_VERSION").to_owned(),
        device: job.device_name.clone(),
        seed: job.config.seed,
        snippets: pairs.sum(),
        labelled_frames: 0,
        data: sources_of(&job.data),
        validation: sources_of(job.validation.as_ref().unwrap_or(&job.data)),
        init: job.init.as_ref().map(|path| path.display().to_string()),
    }
}

/// A run in memory.
struct State {
    /// On a device that records gradients.
    net: RecurrentVo,
    optimizer: ModuleOptimizer,
    progress: Progress,
}

/// What a step leaves on the device.
struct StepTaken {
    loss: MotionLoss,
    learning_rate: f64,
}

/// One sitting of a run.
struct Session<'a> {
    job: &'a SupervisedJob,
    config: SupervisedConfig,
    run: &'a RunFolder,
    state: State,
    metrics: Table<Metrics>,
    scores: Table<ScoreLine>,
    curves: EventFile,
    /// Begin of the sitting, and seconds of training before it.
    begun: (Instant, f64),
    /// Step and seconds of the last line of `metrics.csv`.
    logged: (u64, f64),
    /// Step and seconds of the last checkpoint.
    saved: (u64, f64),
}

impl<'a> Session<'a> {
    fn new(
        job: &'a SupervisedJob,
        config: SupervisedConfig,
        run: &'a RunFolder,
        state: State,
    ) -> Result<Self, TrainError> {
        let Progress { step, elapsed_s, .. } = state.progress;
        Ok(Self {
            metrics: Table::open(run, "metrics.csv", |row: &Metrics| row.step <= step)?,
            scores: Table::open(run, "validation.csv", |row: &ScoreLine| row.step <= step)?,
            curves: EventFile::create(run, step)?,
            begun: (Instant::now(), elapsed_s),
            logged: (step, elapsed_s),
            saved: (step, elapsed_s),
            job,
            config,
            run,
            state,
        })
    }

    fn train(mut self, events: &mut dyn EventSink) -> Result<SupervisedSummary, TrainError> {
        let total = (self.config.minutes == 0.0).then_some(self.config.steps);
        events.event(Event::Started { stage: "training".into(), total });
        while self.share_spent() < 1.0 {
            let taken = self.step();
            events.event(Event::Advanced { done: self.state.progress.step });
            if self.is_due(self.config.log_every) {
                self.log(&taken, events)?;
                if self.elapsed_s() - self.saved.1 >= self.config.checkpoint_seconds {
                    self.save_latest()?;
                }
            }
            if self.is_due(self.config.validate_every) {
                self.validate(events)?;
            }
        }
        let scores = self.validate(events)?;
        self.save_latest()?;
        events.event(Event::Finished);
        let Progress { step, elapsed_s, .. } = self.state.progress;
        Ok(SupervisedSummary { steps: step, elapsed_s, scores, best: self.run.best() })
    }

    /// One step of the optimiser.
    fn step(&mut self) -> StepTaken {
        let learning_rate = self.learning_rate();
        let (config, net) = (&self.config, self.state.net.clone());
        let device = self.job.device.clone().autodiff();
        let passage = Passage::draw(&self.job.data, config, config.net.unit_m, self.state.progress.step, &device);
        let motion = truncated(&net, &passage.pairs, config.truncation);
        let loss = MotionLoss::new(motion, passage.truth, config.rotation_weight);
        let mut gradients = GradientsParams::from_grads(loss.total.backward(), &net);
        if config.gradient_norm > 0.0 {
            gradients = limit_gradient(gradients, &net, config.gradient_norm);
        }
        self.state.net = self.state.optimizer.step(learning_rate, net, gradients);
        self.state.progress.step += 1;
        StepTaken { loss, learning_rate }
    }

    fn learning_rate(&self) -> f64 {
        let decayed = self.config.learning_rate * self.config.decay.factor(self.share_spent());
        decayed * warmup_factor(self.state.progress.step, self.config.warmup)
    }

    fn share_spent(&self) -> f64 {
        self.config.progress(self.state.progress.step, self.elapsed_s())
    }

    fn elapsed_s(&self) -> f64 {
        self.begun.0.elapsed().as_secs_f64() + self.begun.1
    }

    fn is_due(&self, every: u64) -> bool {
        self.state.progress.step.is_multiple_of(every)
    }

    /// Reads the losses back and writes them down.
    fn log(&mut self, taken: &StepTaken, events: &mut dyn EventSink) -> Result<(), TrainError> {
        let row = self.metrics_of(taken);
        if !row.total.is_finite() {
            return Err(TrainError::Diverged { step: row.step, kept: self.saved.0, loss: row.total });
        }
        self.metrics.add(&row)?;
        self.logged = (row.step, row.elapsed_s);
        let left_s = row.elapsed_s * (1.0 / self.share_spent() - 1.0).max(0.0);
        let figures = [
            ("loss", f64::from(row.total)),
            ("translation", f64::from(row.translation)),
            ("rotation", f64::from(row.rotation)),
            ("steps_per_s", row.steps_per_s),
            ("remaining_s", left_s),
        ];
        for (name, value) in figures {
            events.event(Event::Measured { name: name.into(), step: row.step, value });
        }
        let curves = figures.map(|(name, value)| (format!("training/{name}"), value));
        self.curves.add_scalars(row.step, &curves)
    }

    fn metrics_of(&self, taken: &StepTaken) -> Metrics {
        let MotionLoss { translation, rotation, total } = &taken.loss;
        let terms = [total, translation, rotation].map(|term| term.clone().detach().inner());
        // One read-back for all.
        let figures: Vec<f32> = Tensor::cat(terms.into(), 0).into_data().iter().collect();
        let figure = |index: usize| figures.get(index).copied().unwrap_or(f32::NAN);
        let (step, elapsed_s) = (self.state.progress.step, self.elapsed_s());
        Metrics {
            step,
            elapsed_s,
            steps_per_s: (step - self.logged.0) as f64 / (elapsed_s - self.logged.1).max(1e-9),
            learning_rate: taken.learning_rate,
            total: figure(0),
            translation: figure(1),
            rotation: figure(2),
        }
    }

    /// Measures the network, and keeps it if it is the best so far.
    fn validate(&mut self, events: &mut dyn EventSink) -> Result<MotionScores, TrainError> {
        let SupervisedConfig { rotation_weight, validation_frames, net, .. } = &self.config;
        let judged = self.job.validation.as_ref().unwrap_or(&self.job.data);
        let network = self.state.net.valid();
        let scores = measure(&network, judged, (net.unit_m, *rotation_weight), *validation_frames, &self.job.device)?;
        let (step, elapsed_s) = (self.state.progress.step, self.elapsed_s());
        if self.state.progress.validated_at != Some(step) {
            let MotionScores { loss, translation, rotation } = scores;
            self.scores.add(&ScoreLine { step, elapsed_s, loss, translation, rotation })?;
            let named = scores.named();
            let curves: Vec<_> = named.iter().map(|(name, value)| (format!("validation/{name}"), *value)).collect();
            self.curves.add_scalars(step, &curves)?;
            for (name, value) in named {
                events.event(Event::Measured { name: format!("validation_{name}"), step, value });
            }
        }
        self.state.progress.validated_at = Some(step);
        if scores.loss.is_finite() && self.state.progress.best.is_none_or(|best| scores.loss < best) {
            self.state.progress.best = Some(scores.loss);
            let manifest = Manifest { validation: scores.named(), ..self.manifest() };
            let checkpoint = RecurrentCheckpoint { config: net.clone(), net: network, manifest };
            checkpoint.save_with(&self.run.best(), |_| Ok::<(), NetsError>(()))?;
        }
        Ok(scores)
    }

    fn save_latest(&mut self) -> Result<(), TrainError> {
        self.state.progress.elapsed_s = self.elapsed_s();
        let State { net, optimizer, progress } = &self.state;
        let (config, manifest) = (self.config.net.clone(), self.manifest());
        let checkpoint = RecurrentCheckpoint { config, net: net.clone(), manifest };
        checkpoint.save_with(&self.run.latest(), |folder| write_beside(folder, optimizer, progress))?;
        self.saved = (self.state.progress.step, self.elapsed_s());
        Ok(())
    }

    fn manifest(&self) -> Manifest {
        Manifest {
            steps: self.state.progress.step,
            seed: Some(self.config.seed),
            data: sources_of(&self.job.data),
            input: Some(self.config.trained_input()),
            origin: self.job.init.as_ref().map(|path| path.display().to_string()),
            ..Manifest::default()
        }
    }
}

/// Motions of all pairs, `[batch, time, 6]`, with gradients that reach back through at most `truncation` of them.
fn truncated(net: &RecurrentVo, pairs: &Tensor<5>, truncation: usize) -> Tensor<3> {
    let time = pairs.dims()[1];
    let (mut motions, mut memory): (Vec<_>, Option<Memory>) = (Vec::new(), None);
    for first in (0..time).step_by(truncation) {
        let piece = pairs.clone().narrow(1, first, truncation.min(time - first));
        let (motion, next) = net.forward(piece, memory);
        motions.push(motion);
        memory = Some(next.detached());
    }
    Tensor::cat(motions, 1)
}
