//! `endoscape train`: depth and motion from unlabelled video, or motion alone from true poses.

use crate::device::DeviceArgs;
use crate::input::{InputArgs, SimcolMatrix, parse_field_of_view, parse_range, parse_size};
use crate::progress::Progress;
use anyhow::bail;
use endoscape_core::{Event, EventSink as _, Size};
use endoscape_frames::labels;
use endoscape_train::supervised::{self, PosedClip, SupervisedConfig, SupervisedJob, load_posed};
use endoscape_train::{
    Preset, RunFolder, SnippetDataset, Source, Summary, TrainConfig, TrainJob, load_clips, model_folder, resume, train,
};
use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Learn depth and motion together from video without labels; with --supervised, motion from true poses.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  endoscape train --data recordings/c3vd/cecum_t1_a@0..120 phantom.mp4 --hfov 90 --out run --minutes 20
  endoscape train --data recordings/patient --init run --preset endo --out second
  endoscape train --data recordings/patient --out second --resume
  endoscape run recordings/patient --model second --out found
  endoscape train --data recordings/patient --labels found --init second --out third
  endoscape train --supervised --data patients/* --validation patient --out recurrent --minutes 15")]
pub struct Args {
    /// Videos, folders or sequences to learn from; PATH@A..B takes frames A to B - 1 only.
    #[arg(long, value_name = "PATH", num_args = 1.., required = true)]
    data: Vec<String>,
    /// Result folders of `endoscape run` over the same inputs, one for each --data: their poses and depth are learned too.
    #[arg(long, value_name = "RUN", num_args = 1..)]
    labels: Vec<PathBuf>,
    /// Train the recurrent network on sequences with true poses, for endoscape run --method recurrent.
    #[arg(long, conflicts_with_all = ["preset", "gap", "camera", "hfov", "labels"])]
    supervised: bool,
    /// Folder of the run; it must not exist or be empty, unless resumed.
    #[arg(long, value_name = "RUN")]
    out: PathBuf,
    /// Where the configuration starts: paper, fast or endo.
    #[arg(long, value_name = "NAME", default_value = "fast", conflicts_with = "resume")]
    preset: Preset,
    /// TOML file with the settings that differ from the preset.
    #[arg(long, value_name = "FILE", conflicts_with = "resume")]
    config: Option<PathBuf>,
    /// Checkpoint or run to take the weights from; size, camera and snippet length may change.
    #[arg(long, value_name = "CKPT", conflicts_with = "resume")]
    init: Option<PathBuf>,
    /// What to validate on, as --data; the training data as it is if left out.
    #[arg(long, value_name = "PATH", num_args = 1..)]
    validation: Vec<String>,
    /// Stop after so many steps.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    steps: Option<u64>,
    /// Stop after so many minutes of training.
    #[arg(long, value_name = "M", conflicts_with = "steps")]
    minutes: Option<f64>,
    /// Size of the pictures the networks see.
    #[arg(long, value_name = "WxH", value_parser = parse_size, conflicts_with = "resume")]
    size: Option<Size>,
    /// Snippets per step.
    #[arg(long, value_name = "N", conflicts_with = "resume")]
    batch: Option<usize>,
    /// Seed of everything random.
    #[arg(long, value_name = "S", conflicts_with = "resume")]
    seed: Option<u64>,
    /// Frames from one frame of a snippet to the next, instead of choosing by how far the picture moves.
    #[arg(long, value_name = "FRAMES", conflicts_with = "resume")]
    gap: Option<usize>,
    /// Calibration file for inputs that have none.
    #[arg(long, value_name = "FILE")]
    camera: Option<PathBuf>,
    /// Horizontal field of view to assume for inputs without calibration.
    #[arg(long, value_name = "DEGREES", value_parser = parse_field_of_view)]
    hfov: Option<f64>,
    /// Go on with the run in --out where it stopped.
    #[arg(long)]
    resume: bool,
    #[command(flatten)]
    device: DeviceArgs,
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let device = args.device.device.open()?;
    let mut progress = Progress::new();
    // A slip in the name of the folder must not cost the time of reading all frames.
    let run = if args.resume { RunFolder::open(&args.out)? } else { RunFolder::fresh(&args.out)? };
    if args.is_supervised(&run)? {
        return args.train_supervised(&run, &mut progress);
    }
    let config = args.configuration(&run)?;
    config.validate()?;
    let judged_apart = !args.validation.is_empty();
    let data = args.dataset(&args.labelled(&mut progress)?, &config, !judged_apart, &mut progress)?;
    let validation = match judged_apart {
        true => Some(args.dataset(&args.sources(&args.validation, &mut progress)?, &config, true, &mut progress)?),
        false => None,
    };
    let init = args.init.as_deref().map(model_folder);
    let device_name = args.device.device.to_string();
    let job = TrainJob { config, data, validation, init, device, device_name };
    let begin = if args.resume { resume } else { train };
    let Summary { steps, elapsed_s, scores, best } = begin(&job, &run, &mut progress)?;
    report(&args.out, (steps, elapsed_s), &scores.named(), &best)
}

impl Args {
    /// Preset, then file, then flags; of a resumed run all but the budget stays.
    fn configuration(&self, run: &RunFolder) -> anyhow::Result<TrainConfig> {
        let mut config = match (self.resume, &self.config) {
            (true, _) => run.config()?,
            (false, None) => TrainConfig::preset(self.preset),
            (false, Some(file)) => TrainConfig::preset(self.preset).overlaid(file)?,
        };
        (config.steps, config.minutes) = self.budget((config.steps, config.minutes));
        if let Some(size) = self.size {
            (config.width, config.height) = (size.width, size.height);
        }
        config.batch = self.batch.unwrap_or(config.batch);
        config.seed = self.seed.unwrap_or(config.seed);
        config.gap.fixed = self.gap.unwrap_or(config.gap.fixed);
        Ok(config)
    }

    /// Whether the run is to be, or was, a supervised one.
    fn is_supervised(&self, run: &RunFolder) -> anyhow::Result<bool> {
        let was = self.resume && supervised::is_supervised(run);
        if self.resume && self.supervised && !was {
            bail!("{}: holds no supervised training run to resume; leave out --supervised", self.out.display());
        }
        Ok(was || self.supervised)
    }

    fn train_supervised(&self, run: &RunFolder, progress: &mut Progress) -> anyhow::Result<()> {
        let device = self.device.device.open()?;
        let config = self.supervised_configuration(run)?;
        config.validate()?;
        let data = self.posed(&self.data, &config, progress)?;
        let judged_apart = !self.validation.is_empty();
        let validation = judged_apart.then(|| self.posed(&self.validation, &config, progress)).transpose()?;
        let init = self.init.as_deref().map(model_folder);
        let device_name = self.device.device.to_string();
        let job = SupervisedJob { config, data, validation, init, device, device_name };
        let begin = if self.resume { supervised::resume } else { supervised::train };
        let summary = begin(&job, run, progress)?;
        report(&self.out, (summary.steps, summary.elapsed_s), &summary.scores.named(), &summary.best)
    }

    /// As [`Self::configuration`].
    fn supervised_configuration(&self, run: &RunFolder) -> anyhow::Result<SupervisedConfig> {
        let mut config = match (self.resume, &self.config) {
            (true, _) => supervised::config_of(run)?,
            (false, None) => SupervisedConfig::default(),
            (false, Some(file)) => SupervisedConfig::default().overlaid(file)?,
        };
        (config.steps, config.minutes) = self.budget((config.steps, config.minutes));
        if let Some(size) = self.size {
            (config.width, config.height) = (size.width, size.height);
        }
        config.batch = self.batch.unwrap_or(config.batch);
        config.seed = self.seed.unwrap_or(config.seed);
        Ok(config)
    }

    /// Steps and minutes to train, where flags say so.
    fn budget(&self, configured: (u64, f64)) -> (u64, f64) {
        match (self.steps, self.minutes) {
            (Some(steps), _) => (steps, 0.0),
            (None, Some(minutes)) => (0, minutes),
            (None, None) => configured,
        }
    }

    fn posed(
        &self,
        inputs: &[String],
        config: &SupervisedConfig,
        progress: &mut Progress,
    ) -> anyhow::Result<Vec<PosedClip>> {
        Ok(load_posed(&self.sources(inputs, progress)?, config.size(), config.memory_mib, progress)?)
    }

    /// Opens all inputs and tells what they warn of.
    fn sources(&self, inputs: &[String], progress: &mut Progress) -> anyhow::Result<Vec<Source>> {
        let sources = inputs.iter().map(|input| self.source(input)).collect::<anyhow::Result<Vec<_>>>()?;
        let warnings = sources.iter().flat_map(|source| &source.sequence.warnings);
        warnings.for_each(|warning| progress.event(Event::Warned(warning.clone())));
        Ok(sources)
    }

    /// The training data, with what runs have found out about it.
    fn labelled(&self, progress: &mut Progress) -> anyhow::Result<Vec<Source>> {
        let mut sources = self.sources(&self.data, progress)?;
        let (runs, inputs) = (self.labels.len(), sources.len());
        if runs > 0 && runs != inputs {
            bail!(
                "--labels names {runs} runs but --data {inputs} inputs; give the run over each input, in their order"
            );
        }
        for (source, run) in sources.iter_mut().zip(&self.labels) {
            source.labels = Some(labels::of_run(&source.sequence, run)?);
        }
        Ok(sources)
    }

    fn dataset(
        &self,
        sources: &[Source],
        config: &TrainConfig,
        with_depth: bool,
        progress: &mut Progress,
    ) -> anyhow::Result<Arc<SnippetDataset>> {
        let clips = load_clips(sources, config.size(), with_depth, config.memory_mib, progress)?;
        Ok(Arc::new(SnippetDataset::new(clips, config.snippet_length(), &config.gap, progress)?))
    }

    fn source(&self, text: &str) -> anyhow::Result<Source> {
        // A path may hold an @ of its own; only one that a range follows counts.
        let ranged = text.rsplit_once('@').and_then(|(path, range)| Some((path, parse_range(range).ok()?)));
        let (path, range) = ranged.unwrap_or((text, 0..usize::MAX));
        let input = |camera| InputArgs { input: path.into(), format: None, camera, simcol_k: SimcolMatrix::Fixed };
        let mut sequence = input(None).open()?;
        if sequence.camera.is_none() {
            sequence = input(self.camera.clone()).open_assuming(self.hfov)?;
        }
        Ok(Source { sequence, range, labels: None })
    }
}

fn report(
    out: &Path,
    (steps, elapsed_s): (u64, f64),
    scores: &BTreeMap<String, f64>,
    best: &Path,
) -> anyhow::Result<()> {
    let rate = steps as f64 / elapsed_s.max(1e-9);
    let mut text =
        format!("{}: {steps} steps in {:.1} minutes, {rate:.2} per second\n", out.display(), elapsed_s / 60.0);
    for (name, value) in scores {
        text += &format!("  {name:<15}{value:.5}\n");
    }
    writeln!(std::io::stdout(), "{text}  best checkpoint {}", best.display())?;
    Ok(())
}
