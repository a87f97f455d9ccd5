//! Going on learning from new, unlabelled videos: a better model or the same one, never a worse one.
//!
//! ```text
//! videos -> known? -> held back | learned from -> gentle training -> candidates -> Judge -> better one, or the given one
//!                         \________________________ scored on ________________/            + history.toml
//! ```
//! | module | what |
//! |---|---|
//! | [`model`] | the given model: weights, how it was trained, what it has seen |
//! | [`held_back`] | which frames are kept apart to judge by |
//! | [`judge`] | when a candidate may take the given model's place |
//! | [`history`] | the record that travels in the checkpoint |
//!
//! The training itself is that of [`trainer`](crate::trainer), in a hidden run folder beside the result, so that a killed
//! adaptation goes on when the same one is started again. Poses and depth of a video, if it has any, are not looked at.

pub mod held_back;
pub mod history;
pub mod judge;
pub mod model;

use crate::clip::Clip;
use crate::config::TrainConfig;
use crate::dataset::SnippetDataset;
use crate::error::TrainError;
use crate::model::DepthMotionModel;
use crate::run_folder::{RunFolder, write_whole};
use crate::trainer::{TrainJob, begin, go_on, sources_of};
use crate::validation::{Scores, Validator};
use burn::tensor::Device;
use endoscape_core::{Event, EventSink};
use endoscape_nets::{Checkpoint, DataSource, Manifest};
use held_back::Parts;
use history::{Adaptation, HISTORY, Video};
pub use judge::Judge;
pub use model::GivenModel;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The file with the settings of the training, beside the weights.
pub const TRAINING: &str = "training.toml";

/// A new video at the training size.
pub struct NewVideo {
    /// Its frames.
    pub clip: Clip,
    /// How long it lasts, where that is known.
    pub seconds: Option<f64>,
}

/// What to adapt to what.
pub struct AdaptJob {
    /// The model to begin with.
    pub given: GivenModel,
    /// How to learn; [`GivenModel::gentle`] is where to start.
    pub config: TrainConfig,
    /// What to learn from.
    pub videos: Vec<NewVideo>,
    /// Earlier videos to learn from beside the new ones, so that they are not forgotten.
    pub mix: Vec<Arc<Clip>>,
    /// Learn from videos that the model has seen before, too.
    pub again: bool,
    /// Where to compute; a device without gradients.
    pub device: Device,
    /// Its name.
    pub device_name: String,
    /// The date for the record.
    pub date: String,
}

/// How an adaptation ended.
#[derive(Clone, Debug, PartialEq)]
pub struct Adapted {
    /// Whether the result is another model than the given one.
    pub improved: bool,
    /// What happened, as one sentence.
    pub sentence: String,
    /// Names of videos that the model had seen before and that were left out.
    pub known: Vec<String>,
    /// What was added to the history; `None` if there was nothing new.
    pub record: Option<Adaptation>,
    /// Adaptations in the history of the result.
    pub adaptations: usize,
}

/// Adapts a model and writes the result to `out`.
///
/// # Errors
/// [`TrainError`]: an `out` that is the given model or that may not be replaced, videos too short to hold a part back,
/// or as [`train`](crate::train).
pub fn adapt(mut job: AdaptJob, out: &Path, events: &mut dyn EventSink) -> Result<Adapted, TrainError> {
    job.config.validate()?;
    check_place(&job.given.folder, out)?;
    let known = job.leave_out_known();
    if job.videos.is_empty() {
        let sentence = "every video has been learned from before, so the given model is kept unchanged".to_owned();
        let mut adapted = Adapted { improved: false, sentence, known, record: None, adaptations: 0 };
        adapted.adaptations = job.keep_given(out, None)?;
        return Ok(adapted);
    }
    let round = Round::prepare(job, out, events)?;
    let (record, best) = round.learn(events)?;
    round.conclude(out, known, record, best)
}

/// Refuses a place for the result before anything is read or learned.
///
/// # Errors
/// [`TrainError::Run`] if it is the given model, or holds something that is no checkpoint.
pub fn check_place(given: &Path, out: &Path) -> Result<(), TrainError> {
    let same = fs::canonicalize(given).ok().zip(fs::canonicalize(out).ok()).is_some_and(|(given, out)| given == out);
    if same {
        let reason = "is the given model, which an adaptation never touches";
        return Err(TrainError::run(out, reason, "choose another folder with --out"));
    }
    let occupied = out.is_file() || fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_some());
    if occupied && !out.join("manifest.json").is_file() {
        return Err(TrainError::run(out, "exists and is not a checkpoint", "choose another folder or empty this one"));
    }
    Ok(())
}

impl AdaptJob {
    /// Takes the videos that the model has seen before out of the job and names them.
    fn leave_out_known(&mut self) -> Vec<String> {
        let seen = self.given.fingerprints();
        let is_known = |video: &NewVideo| !self.again && seen.contains(&video.clip.fingerprint);
        let (known, new) = std::mem::take(&mut self.videos).into_iter().partition(is_known);
        self.videos = new;
        known.into_iter().map(|video| video.clip.name).collect()
    }

    /// Writes the given weights to `out`, with one more record.
    fn keep_given(&self, out: &Path, record: Option<Adaptation>) -> Result<usize, TrainError> {
        self.write(out, &self.given.checkpoint, record)
    }

    /// Writes a model, the settings of its first training and its history; returns the number of records.
    fn write(&self, out: &Path, checkpoint: &Checkpoint, record: Option<Adaptation>) -> Result<usize, TrainError> {
        let mut history = self.given.history.clone();
        history.adaptation.extend(record);
        checkpoint.save_with(out, |folder| {
            write_whole(&folder.join(TRAINING), self.given.training.to_toml()?.as_bytes())?;
            write_whole(&folder.join(HISTORY), history.to_toml()?.as_bytes())
        })?;
        Ok(history.adaptation.len())
    }
}

/// An adaptation under way.
struct Round {
    job: AdaptJob,
    videos: Vec<Video>,
    training: TrainJob,
    validator: Validator,
    judge: Judge,
    run: RunFolder,
    goes_on: bool,
}

impl Round {
    /// Holds a part back, scores the given model on it and finds out whether an earlier sitting left something.
    fn prepare(mut job: AdaptJob, out: &Path, events: &mut dyn EventSink) -> Result<Self, TrainError> {
        let videos = job.videos.iter().map(Video::of).collect();
        let clips = std::mem::take(&mut job.videos).into_iter().map(|video| Arc::new(unlabelled(video.clip)));
        let mut parts = Parts::of(clips.collect(), &job.config, events)?;
        if !job.mix.is_empty() {
            let mix =
                std::mem::take(&mut job.mix).into_iter().map(|clip| Arc::new(unlabelled(Arc::unwrap_or_clone(clip))));
            parts = parts.mixed_with(&Parts::of(mix.collect(), &job.config, events)?);
        }
        let (learned, held) = (Arc::new(parts.learned), Arc::new(parts.held));
        let validator = Validator::new(held.clone(), &job.config, &job.device);
        let given = DepthMotionModel::from_checkpoint(job.given.checkpoint.clone())?;
        let judge = Judge::new(validator.measure(&given)?, &job.config, held.standing_share());
        let training = job.training(learned, held);
        let (run, goes_on) = sitting(&training, &work_folder(out)?)?;
        Ok(Self { videos, training, validator, judge, run, goes_on, job })
    }

    /// Trains; returns what the history is to say and the best candidate, if any was better than the given model.
    fn learn(&self, events: &mut dyn EventSink) -> Result<(Adaptation, Option<Checkpoint>), TrainError> {
        let start = if self.goes_on { go_on } else { begin };
        let (steps, elapsed_s) = match start(&self.training, Some(&self.judge), &self.run, events) {
            Ok(summary) => (summary.steps, summary.elapsed_s),
            // What was better before the loss ran away is still better.
            Err(TrainError::Diverged { step, loss, .. }) => {
                events.event(Event::Warned(format!("the loss became {loss} before step {step}, so learning stopped")));
                (step, 0.0)
            }
            Err(error) => return Err(error),
        };
        let best = self.run.best();
        let best = best.is_dir().then(|| Checkpoint::load(&best, &self.job.device)).transpose()?;
        let after = best.as_ref().map(|best| self.score(best)).transpose()?;
        let record = Adaptation {
            date: self.job.date.clone(),
            endoscape_version: env!("CARGO_PKG_VERSION").to_owned(),
            improved: best.is_some(),
            seed: self.job.config.seed,
            steps,
            elapsed_s,
            learning_rate: self.job.config.learning_rate,
            learned_snippets: self.training.data.len(),
            held_back_snippets: self.training.validation.as_ref().map_or(0, |held| held.len()),
            before: self.judge.figures(self.judge.given()),
            after: self.judge.figures(after.as_ref().unwrap_or(self.judge.given())),
            videos: self.videos.clone(),
        };
        Ok((record, best))
    }

    fn score(&self, candidate: &Checkpoint) -> Result<Scores, TrainError> {
        self.validator.measure(&DepthMotionModel::from_checkpoint(candidate.clone())?)
    }

    /// Writes the result and clears the work folder away.
    fn conclude(
        &self,
        out: &Path,
        known: Vec<String>,
        record: Adaptation,
        best: Option<Checkpoint>,
    ) -> Result<Adapted, TrainError> {
        let (improved, sentence) = (best.is_some(), record.sentence());
        let adaptations = match best {
            None => self.job.keep_given(out, Some(record.clone()))?,
            Some(best) => {
                let manifest = self.manifest(&best, &record);
                self.job.write(out, &Checkpoint { manifest, ..best }, Some(record.clone()))?
            }
        };
        fs::remove_dir_all(self.run.root()).map_err(|error| TrainError::io(self.run.root(), "be removed", &error))?;
        Ok(Adapted { improved, sentence, known, record: Some(record), adaptations })
    }

    /// The given model's manifest with what has come to it.
    fn manifest(&self, best: &Checkpoint, record: &Adaptation) -> Manifest {
        let given = &self.job.given;
        let mut data = given.checkpoint.manifest.data.clone();
        let new = record
            .videos
            .iter()
            .map(|video| DataSource { name: video.name.clone(), fingerprint: video.fingerprint.clone() });
        data.extend(new.filter(|new| !given.fingerprints().contains(&new.fingerprint)));
        Manifest {
            steps: given.checkpoint.manifest.steps + best.manifest.steps,
            data,
            origin: Some(given.folder.display().to_string()),
            validation: record.after.clone(),
            ..best.manifest.clone()
        }
    }
}

impl AdaptJob {
    fn training(&self, data: Arc<SnippetDataset>, held: Arc<SnippetDataset>) -> TrainJob {
        TrainJob {
            config: self.config.clone(),
            data,
            validation: Some(held),
            init: Some(self.given.folder.clone()),
            device: self.device.clone(),
            device_name: self.device_name.clone(),
        }
    }
}

/// A clip without its truth: what is adapted to has none, and no figure may depend on whether it does.
fn unlabelled(mut clip: Clip) -> Clip {
    for frame in &mut clip.frames {
        (frame.world_from_camera, frame.depth) = (None, None);
    }
    clip
}

/// The hidden folder beside the result in which learning happens.
fn work_folder(out: &Path) -> Result<PathBuf, TrainError> {
    let name = out.file_name().ok_or_else(|| TrainError::run(out, "has no name", "name a folder with --out"))?;
    Ok(out.with_file_name(format!(".{}.adapting", name.to_string_lossy())))
}

/// The run to go on with if the same adaptation was interrupted (`true`), else an empty one.
fn sitting(job: &TrainJob, root: &Path) -> Result<(RunFolder, bool), TrainError> {
    let is_same = |run: &RunFolder| {
        let manifest = run.manifest()?;
        let same_model = manifest.init == job.init.as_ref().map(|path| path.display().to_string());
        Ok::<_, TrainError>(same_model && manifest.data == sources_of(&job.data) && run.config()? == job.config)
    };
    if let Ok(run) = RunFolder::open(root)
        && run.latest().is_dir()
        && is_same(&run).unwrap_or(false)
        && !is_older(root, job.init.as_deref())
    {
        return Ok((run, true));
    }
    match fs::remove_dir_all(root) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            return Err(TrainError::io(root, "be removed", &error));
        }
        _ => {}
    }
    Ok((RunFolder::fresh(root)?, false))
}

/// Whether the model was written after a run began.
fn is_older(run: &Path, model: Option<&Path>) -> bool {
    let written = |path: PathBuf| fs::metadata(path).and_then(|data| data.modified()).ok();
    let model = model.and_then(|folder| written(folder.join("manifest.json")));
    written(run.join("run.json")).zip(model).is_none_or(|(run, model)| run < model)
}
