//! The joint training of both networks, from snippets to checkpoints.
//!
//! [`train`] is the whole recipe. A step reads nothing back from the device; losses are read every `log_every` steps,
//! together and once.

use crate::adapt::Judge;
use crate::alignment::alignment_loss;
use crate::batch::SnippetBatch;
use crate::collapse::{CollapseWatch, Signs, VitalSigns};
use crate::config::{Criterion, TrainConfig};
use crate::dataset::{DrawPlan, SnippetDataset};
use crate::error::TrainError;
use crate::lesson::LessonLoss;
use crate::loader::{Loader, LoaderPlan};
use crate::model::{DepthMotionModel, Output, standing_motion};
use crate::optimizer::limit_gradient;
use crate::run_folder::{RunFolder, RunManifest, Table};
use crate::schedule::warmup_factor;
use crate::state::{Progress, TrainState};
use crate::tensorboard::EventFile;
use crate::transfer::initial_weights;
use crate::validation::{Scores, Validator};
use burn::module::Module;
use burn::optim::GradientsParams;
use burn::tensor::{Device, Tensor};
use endoscape_core::{Event, EventSink};
use endoscape_kernels::awake;
use endoscape_nets::{Checkpoint, DataSource, Manifest, recycle};
use endoscape_synthesis::{LossTerms, objective};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

/// What to train, on what, and where to put it.
pub struct TrainJob {
    /// The complete configuration.
    pub config: TrainConfig,
    /// Training snippets.
    pub data: Arc<SnippetDataset>,
    /// Validation snippets; those of the training if there are no others.
    pub validation: Option<Arc<SnippetDataset>>,
    /// Weights to start from.
    pub init: Option<PathBuf>,
    /// Where to compute; a device without gradients, the trainer adds them.
    pub device: Device,
    /// Name of the device as the run manifest says it.
    pub device_name: String,
}

/// How a training ended.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Steps taken in all.
    pub steps: u64,
    /// Seconds they took in all sessions.
    pub elapsed_s: f64,
    /// The last validation.
    pub scores: Scores,
    /// The checkpoint with the best validation.
    pub best: PathBuf,
}

/// A line of `metrics.csv`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// Steps taken.
    pub step: u64,
    /// Seconds of training.
    pub elapsed_s: f64,
    /// Steps per second since the line before.
    pub steps_per_s: f64,
    /// Learning rate of the step.
    pub learning_rate: f64,
    /// The weighted sum that is minimised.
    pub total: f32,
    /// View synthesis error.
    pub photometric: f32,
    /// Smoothness before its weight.
    pub smoothness: f32,
    /// Price of unreliable pixels before its weight.
    pub mask: f32,
    /// Depth disagreement before its weight.
    pub geometry: f32,
    /// Disagreement of depth and brightness before its weight.
    pub light: f32,
    /// Distance from the depth of the labels before its weight; 0 without labels.
    pub label_depth: f32,
    /// Distance from the motions of the labels before its weight; 0 without labels.
    pub label_motion: f32,
    /// See [`alignment_loss`]; 0 without labels.
    pub label_alignment: f32,
    /// Share of pixels that count.
    pub coverage: f32,
    /// See [`VitalSigns::depth_spread`].
    pub depth_spread: f32,
    /// See [`VitalSigns::mask`].
    pub reliability: f32,
    /// See [`VitalSigns::translation`].
    pub translation: f32,
    /// See [`VitalSigns::rotation`].
    pub rotation_rad: f32,
}

impl Metrics {
    /// The figures by the names of their curves.
    fn curves(&self) -> Vec<(String, f64)> {
        let curves = [
            ("loss/total", f64::from(self.total)),
            ("loss/photometric", f64::from(self.photometric)),
            ("loss/smoothness", f64::from(self.smoothness)),
            ("loss/mask", f64::from(self.mask)),
            ("loss/geometry", f64::from(self.geometry)),
            ("loss/label_depth", f64::from(self.label_depth)),
            ("loss/label_motion", f64::from(self.label_motion)),
            ("loss/label_alignment", f64::from(self.label_alignment)),
            ("networks/coverage", f64::from(self.coverage)),
            ("networks/depth_spread", f64::from(self.depth_spread)),
            ("networks/reliability", f64::from(self.reliability)),
            ("networks/translation", f64::from(self.translation)),
            ("networks/rotation_rad", f64::from(self.rotation_rad)),
            ("training/learning_rate", self.learning_rate),
            ("training/steps_per_s", self.steps_per_s),
        ];
        curves.map(|(name, value)| (name.to_owned(), value)).into()
    }
}

/// Networks that explain a smaller share of the pixels are never the best, however well they explain those.
pub(crate) const LEAST_COVERAGE: f64 = 0.2;

/// A line of `validation.csv`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct ScoreLine {
    step: u64,
    elapsed_s: f64,
    photometric: f64,
    light: Option<f64>,
    coverage: f64,
    depth_abs_rel: Option<f64>,
    depth_d1: Option<f64>,
    ate_m: Option<f64>,
    alignment: Option<f64>,
}

/// Starts a run in an empty folder and trains until its budget is spent.
///
/// # Errors
/// [`TrainError`]: an impossible configuration, a folder in use, weights that do not load, a loss that diverged.
pub fn train(job: &TrainJob, run: &RunFolder, events: &mut dyn EventSink) -> Result<Summary, TrainError> {
    begin(job, None, run, events)
}

/// As [`train`]; with a judge, only networks it admits are ever the best.
pub(crate) fn begin(
    job: &TrainJob,
    judge: Option<&Judge>,
    run: &RunFolder,
    events: &mut dyn EventSink,
) -> Result<Summary, TrainError> {
    job.config.validate()?;
    if job.config.lesson.alignment && job.data.labelled().is_none() {
        return Err(TrainError::config(
            "lesson.alignment",
            "is on, but no snippet has labels throughout; give runs that kept track of the training videos with --labels",
        ));
    }
    let device = job.device.clone().autodiff();
    let nets = &job.config.nets;
    let mut checkpoint = match &job.init {
        None => Checkpoint::init(nets.clone(), job.config.seed, &device)?,
        Some(path) => {
            let (checkpoint, message) = initial_weights(path, nets, job.config.seed, &device)?;
            message.into_iter().for_each(|message| events.event(Event::Warned(message)));
            checkpoint
        }
    };
    if job.config.lesson.alignment && checkpoint.align.is_none() {
        checkpoint.config.align = nets.align.clone();
        checkpoint.align = Some(nets.align.init(job.config.seed, &device)?);
    }
    // The architecture of a checkpoint stays its own.
    let config = TrainConfig { nets: checkpoint.config.clone(), ..job.config.clone() };
    run.describe(&config, &manifest_of(job))?;
    let mut session = Session::new(job, judge, config, run, TrainState::fresh(checkpoint)?)?;
    // From here on the run can be resumed, whatever happens.
    session.save_latest()?;
    session.train(events)
}

/// Goes on with a run where its last checkpoint left it. On the CPU the result is the same to the last bit as that of a
/// run that was never interrupted, unless its budget is in minutes.
///
/// # Errors
/// [`TrainError`]: a folder without a run, other data than the run's, or as [`train`].
pub fn resume(job: &TrainJob, run: &RunFolder, events: &mut dyn EventSink) -> Result<Summary, TrainError> {
    go_on(job, None, run, events)
}

/// As [`resume`], for a run that [`begin`] began with a judge.
pub(crate) fn go_on(
    job: &TrainJob,
    judge: Option<&Judge>,
    run: &RunFolder,
    events: &mut dyn EventSink,
) -> Result<Summary, TrainError> {
    job.config.validate()?;
    let recorded = run.manifest()?;
    if sources_of(&job.data) != recorded.data {
        let remedy = "give the same --data as before, or start a new run from its weights with --init";
        return Err(TrainError::run(run.root(), "the run was trained on other data", remedy));
    }
    if job.data.labelled_frames() != recorded.labelled_frames {
        let reason = format!("the run learned from labels of {} frames", recorded.labelled_frames);
        return Err(TrainError::run(run.root(), reason, "give the same --labels as before"));
    }
    let state = TrainState::load(run, &job.device.clone().autodiff())?;
    run.describe(&job.config, &RunManifest { device: job.device_name.clone(), ..recorded })?;
    Session::new(job, judge, job.config.clone(), run, state)?.train(events)
}

/// Names and fingerprints of the clips of a data set.
pub(crate) fn sources_of(dataset: &SnippetDataset) -> Vec<DataSource> {
    let source =
        |clip: &crate::clip::Clip| DataSource { name: clip.name.clone(), fingerprint: clip.fingerprint.clone() };
    dataset.clips().map(|(clip, _)| source(clip)).collect()
}

fn manifest_of(job: &TrainJob) -> RunManifest {
    RunManifest {
        endoscape_version: env!("CARGO_PKG_VERSION").to_owned(),
        device: job.device_name.clone(),
        seed: job.config.seed,
        snippets: job.data.len(),
        labelled_frames: job.data.labelled_frames(),
        data: sources_of(&job.data),
        validation: sources_of(job.validation.as_ref().unwrap_or(&job.data)),
        init: job.init.as_ref().map(|path| path.display().to_string()),
    }
}

/// What a step leaves on the device.
struct StepTaken {
    terms: LossTerms,
    taught: Taught,
    output: Output,
    learning_rate: f64,
}

/// How far a step was from what labels say.
#[derive(Default)]
struct Taught {
    lesson: Option<LessonLoss>,
    alignment: Option<Tensor<1>>,
}

/// One sitting of a run.
struct Session<'a> {
    job: &'a TrainJob,
    judge: Option<&'a Judge>,
    config: TrainConfig,
    run: &'a RunFolder,
    state: TrainState,
    /// Snippets that something can be learned from.
    data: Arc<SnippetDataset>,
    validator: Validator,
    metrics: Table<Metrics>,
    scores: Table<ScoreLine>,
    curves: EventFile,
    watch: CollapseWatch,
    /// Begin of the sitting, and seconds of training before it.
    begun: (Instant, f64),
    /// Step and seconds of the last line of `metrics.csv`.
    logged: (u64, f64),
    /// Step and seconds of the last checkpoint.
    saved: (u64, f64),
}

impl<'a> Session<'a> {
    fn new(
        job: &'a TrainJob,
        judge: Option<&'a Judge>,
        config: TrainConfig,
        run: &'a RunFolder,
        state: TrainState,
    ) -> Result<Self, TrainError> {
        let Progress { step, elapsed_s, .. } = state.progress;
        let judged = job.validation.as_ref().unwrap_or(&job.data);
        let labelled = config.lesson.alignment.then(|| job.data.labelled()).flatten();
        Ok(Self {
            data: labelled.map_or_else(|| job.data.clone(), Arc::new),
            validator: Validator::new(judged.clone(), &config, &job.device),
            metrics: Table::open(run, "metrics.csv", |row: &Metrics| row.step <= step)?,
            scores: Table::open(run, "validation.csv", |row: &ScoreLine| row.step <= step)?,
            curves: EventFile::create(run, step)?,
            watch: CollapseWatch::default(),
            begun: (Instant::now(), elapsed_s),
            logged: (step, elapsed_s),
            saved: (step, elapsed_s),
            job,
            judge,
            config,
            run,
            state,
        })
    }

    fn train(mut self, events: &mut dyn EventSink) -> Result<Summary, TrainError> {
        events.event(Event::Started { stage: "training".into(), total: self.expected_steps() });
        let mut loader = Loader::start(&self.loader_plan(), self.state.progress.step, self.config.loader_threads);
        while self.share_spent() < 1.0 && !self.is_stale() {
            let batch = loader.next_batch()?;
            let taken = self.step(&batch);
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
        self.finish(events)
    }

    /// A last validation and checkpoint, unless the loop has just done both.
    fn finish(mut self, events: &mut dyn EventSink) -> Result<Summary, TrainError> {
        let scores = self.validate(events)?;
        self.save_latest()?;
        events.event(Event::Finished);
        let Progress { step, elapsed_s, .. } = self.state.progress;
        Ok(Summary { steps: step, elapsed_s, scores, best: self.run.best() })
    }

    /// One step of the optimiser: the method in five lines.
    fn step(&mut self, batch: &SnippetBatch) -> StepTaken {
        // Many small parallel parts on the processor.
        awake(|| self.take_step(batch))
    }

    fn take_step(&mut self, batch: &SnippetBatch) -> StepTaken {
        let learning_rate = self.learning_rate();
        let model = self.state.model.clone();
        let (output, mut terms) = self.look(&model, batch);
        let taught = self.taught(&model, batch, &output);
        if let Some(loss) = &taught.lesson {
            terms.total = terms.total + loss.weighted(&self.config.lesson);
        }
        if let Some(loss) = &taught.alignment {
            terms.total = terms.total + loss.clone();
        }
        if self.config.standing_weight > 0.0 {
            let price = standing_motion(output.motion.clone(), batch.stands.clone());
            terms.total = terms.total + price * self.config.standing_weight;
        }
        let mut gradients = GradientsParams::from_grads(terms.total.backward(), &model);
        if self.config.gradient_norm > 0.0 {
            gradients = limit_gradient(gradients, &model, self.config.gradient_norm);
        }
        let updated = self.state.optimizer.step(learning_rate, model, gradients);
        // Batch normalisation keeps its news apart by thread until it is looked at, and the next step may be on another.
        drop(updated.valid());
        recycle(std::mem::replace(&mut self.state.model, updated));
        self.state.progress.step += 1;
        StepTaken { terms, taught, output, learning_rate }
    }

    /// How far it is from what labels say, where there are any.
    fn taught(&self, model: &DepthMotionModel, batch: &SnippetBatch, output: &Output) -> Taught {
        let Some(lessons) = &batch.lessons else { return Taught::default() };
        if !self.config.lesson.alignment {
            return Taught { lesson: Some(lessons.loss(&output.prediction)), alignment: None };
        }
        let seen = model.align.as_ref().zip(output.depth());
        Taught { lesson: None, alignment: seen.map(|(net, depth)| alignment_loss(net, batch, lessons, depth)) }
    }

    /// What the networks say, and how well it explains the pictures; where the alignment network learns, the depth that
    /// it sees.
    fn look(&self, model: &DepthMotionModel, batch: &SnippetBatch) -> (Output, LossTerms) {
        if self.config.lesson.alignment {
            let output = model.predict_depth(batch);
            let none = LossTerms::none(&output.motion);
            return (output, none);
        }
        let output = model.predict(batch, self.config.with_source_depth());
        let terms = objective(&batch.views, &output.prediction, &self.config.objective);
        (output, terms)
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

    /// Whether the last validations have all brought nothing better.
    fn is_stale(&self) -> bool {
        self.config.patience > 0 && self.state.progress.stale >= self.config.patience
    }

    /// Steps in all, where the budget says.
    fn expected_steps(&self) -> Option<u64> {
        (self.config.minutes == 0.0).then_some(self.config.steps)
    }

    fn loader_plan(&self) -> LoaderPlan {
        let TrainConfig { seed, batch, augment, objective, .. } = &self.config;
        LoaderPlan {
            dataset: self.data.clone(),
            draw: DrawPlan { seed: *seed, batch: *batch, augment: augment.clone() },
            objective: objective.clone(),
            device: self.job.device.clone().autodiff(),
        }
    }

    /// Reads the losses back, writes them down and looks for a collapse.
    fn log(&mut self, taken: &StepTaken, events: &mut dyn EventSink) -> Result<(), TrainError> {
        let row = self.metrics_of(taken);
        if !row.total.is_finite() {
            return Err(TrainError::Diverged { step: row.step, kept: self.saved.0, loss: row.total });
        }
        self.metrics.add(&row)?;
        self.curves.add_scalars(row.step, &row.curves())?;
        self.logged = (row.step, row.elapsed_s);
        let left_s = row.elapsed_s * (1.0 / self.share_spent() - 1.0).max(0.0);
        let figures = [
            ("loss", f64::from(row.total)),
            ("photometric", f64::from(row.photometric)),
            ("smoothness", f64::from(row.smoothness)),
            ("mask", f64::from(row.mask)),
            ("geometry", f64::from(row.geometry)),
            ("light", f64::from(row.light)),
            ("steps_per_s", row.steps_per_s),
            ("remaining_s", left_s),
        ];
        for (name, value) in figures {
            events.event(Event::Measured { name: name.into(), step: row.step, value });
        }
        // What says nothing does not collapse.
        if self.config.lesson.alignment {
            return Ok(());
        }
        let Metrics { coverage, depth_spread, reliability: mask, translation, rotation_rad: rotation, .. } = row;
        let sentences = self.watch.look(&Signs { coverage, depth_spread, mask, translation, rotation });
        sentences.into_iter().for_each(|sentence| events.event(Event::Warned(sentence.to_owned())));
        Ok(())
    }

    fn metrics_of(&self, taken: &StepTaken) -> Metrics {
        let LossTerms { photometric, smoothness, mask, geometry, light, total, coverage } = &taken.terms;
        let signs = VitalSigns::new(&taken.output.prediction, taken.output.motion.clone());
        let losses =
            [total, photometric, smoothness, mask, geometry, light, coverage].map(|term| term.clone().detach().inner());
        let signs = [signs.depth_spread, signs.mask, signs.translation, signs.rotation].map(Tensor::inner);
        let zero = || taken.terms.total.zeros_like().detach();
        let lesson = taken
            .taught
            .lesson
            .as_ref()
            .map_or_else(|| [zero(), zero()], |loss| [loss.depth.clone(), loss.motion.clone()]);
        let alignment = taken.taught.alignment.clone().unwrap_or_else(zero);
        let lesson = lesson.into_iter().chain([alignment]).map(Tensor::inner);
        // One read-back for all.
        let figures: Vec<f32> =
            Tensor::cat(losses.into_iter().chain(signs).chain(lesson).collect(), 0).into_data().iter().collect();
        let figure = |index: usize| figures.get(index).copied().unwrap_or(f32::NAN);
        let (step, elapsed_s) = (self.state.progress.step, self.elapsed_s());
        Metrics {
            step,
            elapsed_s,
            steps_per_s: (step - self.logged.0) as f64 / (elapsed_s - self.logged.1).max(1e-9),
            learning_rate: taken.learning_rate,
            total: figure(0),
            photometric: figure(1),
            smoothness: figure(2),
            mask: figure(3),
            geometry: figure(4),
            light: figure(5),
            coverage: figure(6),
            depth_spread: figure(7),
            reliability: figure(8),
            translation: figure(9),
            rotation_rad: figure(10),
            label_depth: figure(11),
            label_motion: figure(12),
            label_alignment: figure(13),
        }
    }

    /// Measures the networks, and keeps them if they are the best so far.
    fn validate(&mut self, events: &mut dyn EventSink) -> Result<Scores, TrainError> {
        let scores = self.validator.measure(&self.state.model.valid())?;
        let (step, elapsed_s) = (self.state.progress.step, self.elapsed_s());
        let Scores { photometric, light, coverage, depth_abs_rel, depth_d1, ate_m, alignment, .. } = scores;
        if self.state.progress.validated_at != Some(step) {
            let line =
                ScoreLine { step, elapsed_s, photometric, light, coverage, depth_abs_rel, depth_d1, ate_m, alignment };
            self.scores.add(&line)?;
            let curves: Vec<_> =
                scores.named().into_iter().map(|(name, value)| (format!("validation/{name}"), value)).collect();
            self.curves.add_scalars(step, &curves)?;
            for (name, value) in scores.named() {
                events.event(Event::Measured { name: format!("validation_{name}"), step, value });
            }
        }
        self.state.progress.validated_at = Some(step);
        self.state.progress.stale += 1;
        let deciding = self.deciding(&scores).filter(|value| self.state.progress.best.is_none_or(|best| *value < best));
        if let Some(value) = deciding {
            (self.state.progress.best, self.state.progress.stale) = (Some(value), 0);
            let checkpoint =
                self.state.model.valid().to_checkpoint(self.config.nets.clone(), self.manifest(Some(&scores)));
            checkpoint.save(&self.run.best())?;
        }
        Ok(scores)
    }

    /// The figure by which the best checkpoint is chosen; `None` for networks that must not be it.
    fn deciding(&self, scores: &Scores) -> Option<f64> {
        if let Some(judge) = self.judge {
            return judge.admits(scores);
        }
        let unsupervised = scores.photometric + self.config.objective.light_weight * scores.light.unwrap_or(0.0);
        let unsupervised = unsupervised + scores.alignment.unwrap_or(0.0);
        let value = match self.config.best_by {
            Criterion::Photometric => unsupervised,
            Criterion::Depth => scores.depth_abs_rel.unwrap_or(unsupervised),
        };
        (scores.coverage >= LEAST_COVERAGE && value.is_finite()).then_some(value)
    }

    fn save_latest(&mut self) -> Result<(), TrainError> {
        self.state.progress.elapsed_s = self.elapsed_s();
        self.state.save(self.run, &self.config.nets, self.manifest(None))?;
        self.saved = (self.state.progress.step, self.elapsed_s());
        Ok(())
    }

    fn manifest(&self, scores: Option<&Scores>) -> Manifest {
        Manifest {
            steps: self.state.progress.step,
            seed: Some(self.config.seed),
            data: sources_of(&self.job.data),
            input: Some(self.config.trained_input()),
            validation: scores.map(Scores::named).unwrap_or_default(),
            origin: self.job.init.as_ref().map(|path| path.display().to_string()),
            ..Manifest::default()
        }
    }
}
