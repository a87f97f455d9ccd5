//! `endoscape adapt`: a model goes on learning from new videos, and never gets worse.

use crate::device::DeviceArgs;
use crate::input::{InputArgs, SimcolMatrix, parse_field_of_view};
use crate::progress::Progress;
use endoscape_core::{Event, EventSink as _, Size};
use endoscape_frames::{Sequence, natural};
use endoscape_train::adapt::check_place;
use endoscape_train::{AdaptJob, Adapted, Clip, GivenModel, NewVideo, Source, TrainConfig, adapt, load_clips};
use serde_json::json;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Go on learning from unlabelled videos: a better model or the same one.
///
/// A part of every video (the last sixth, in blocks) is held back and never learned from. The given model and every
/// candidate are scored on it; --out gets the best candidate, or the given weights if none is better. A killed adaptation
/// goes on when the same command is run again.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  endoscape adapt monday.mp4 --hfov 140 --model models/capsule --out monday
  endoscape adapt new-videos --hfov 140 --model monday --out tuesday --mix recordings/patient --minutes 10
  endoscape run monday.mp4 --hfov 140 --model tuesday")]
pub struct Args {
    /// Videos, folders of pictures, sequences, or folders of those.
    #[arg(value_name = "INPUT", required = true)]
    inputs: Vec<PathBuf>,
    /// Training run or checkpoint to begin with; it is not touched.
    #[arg(long, value_name = "CKPT")]
    model: PathBuf,
    /// Folder for the result, a checkpoint.
    #[arg(long, value_name = "CKPT")]
    out: PathBuf,
    /// Stop after so many minutes of learning.
    #[arg(long, value_name = "M", conflicts_with = "steps")]
    minutes: Option<f64>,
    /// Stop after so many steps [default: 600; sooner where nothing better has come for 300].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    steps: Option<u64>,
    /// Earlier videos or sequences to learn from beside the new ones, at most as much of them, so that they are not
    /// forgotten.
    #[arg(long, value_name = "SEQ", num_args = 1..)]
    mix: Vec<PathBuf>,
    /// TOML file with training settings that differ from the model's own.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Learn again from videos that the model has seen before.
    #[arg(long)]
    again: bool,
    /// Seed of everything random.
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// Calibration file for inputs that have none.
    #[arg(long, value_name = "FILE")]
    camera: Option<PathBuf>,
    /// Horizontal field of view to assume for inputs without calibration.
    #[arg(long, value_name = "DEGREES", value_parser = parse_field_of_view)]
    hfov: Option<f64>,
    #[command(flatten)]
    device: DeviceArgs,
    /// Print the summary as JSON.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let device = args.device.device.open()?;
    let mut progress = Progress::new();
    let given = GivenModel::open(&args.model, &device, &mut progress)?;
    check_place(&given.folder, &args.out)?;
    let config = args.configuration(&given)?;
    config.validate()?;
    let videos = args.videos(&config, &mut progress)?;
    let mix = args.clips(&args.sequences(&args.mix, &mut progress)?, &config, &mut progress)?;
    let date = jiff::Timestamp::now().strftime("%Y-%m-%dT%H:%M:%SZ").to_string();
    let (again, device_name) = (args.again, args.device.device.to_string());
    let job = AdaptJob { given, config, videos, mix, again, device, device_name, date };
    let adapted = adapt(job, &args.out, &mut progress)?;
    args.report(&adapted)
}

impl Args {
    /// The model's own settings made gentle, then the file, then flags.
    fn configuration(&self, given: &GivenModel) -> anyhow::Result<TrainConfig> {
        let mut config = match &self.config {
            None => given.gentle(),
            Some(file) => given.gentle().overlaid(file)?,
        };
        if let Some(steps) = self.steps {
            (config.steps, config.minutes) = (steps, 0.0);
        }
        if let Some(minutes) = self.minutes {
            (config.steps, config.minutes) = (0, minutes);
        }
        config.seed = self.seed.unwrap_or(config.seed);
        // Networks cannot change on the way.
        config.nets = given.checkpoint.config.clone();
        Ok(config)
    }

    fn videos(&self, config: &TrainConfig, progress: &mut Progress) -> anyhow::Result<Vec<NewVideo>> {
        let sequences = self.sequences(&self.inputs, progress)?;
        let seconds: Vec<Option<f64>> = sequences.iter().map(duration_s).collect();
        let clips = self.clips(&sequences, config, progress)?;
        let video = |(clip, seconds)| NewVideo { clip: Arc::unwrap_or_clone(clip), seconds };
        Ok(clips.into_iter().zip(seconds).map(video).collect())
    }

    fn clips(
        &self,
        sequences: &[Sequence],
        config: &TrainConfig,
        progress: &mut Progress,
    ) -> anyhow::Result<Vec<Arc<Clip>>> {
        let sources: Vec<Source> = sequences
            .iter()
            .map(|sequence| Source { sequence: sequence.clone(), range: 0..usize::MAX, labels: None })
            .collect();
        let size = Size::new(config.width, config.height);
        Ok(load_clips(&sources, size, false, config.memory_mib, progress)?)
    }

    /// Every input, and what is inside those that are folders of inputs.
    fn sequences(&self, inputs: &[PathBuf], progress: &mut Progress) -> anyhow::Result<Vec<Sequence>> {
        let mut sequences = Vec::new();
        for input in inputs {
            match self.sequence(input) {
                Ok(sequence) => sequences.push(sequence),
                Err(error) => {
                    let inside = self.inside(input, progress);
                    anyhow::ensure!(!inside.is_empty(), error);
                    sequences.extend(inside);
                }
            }
        }
        let warnings = sequences.iter().flat_map(|sequence| &sequence.warnings);
        warnings.for_each(|warning| progress.event(Event::Warned(warning.clone())));
        Ok(sequences)
    }

    /// The inputs in a folder, in natural order; what is none is named and passed over.
    fn inside(&self, folder: &Path, progress: &mut Progress) -> Vec<Sequence> {
        let name = |path: &PathBuf| path.file_name().map(|name| name.to_string_lossy().into_owned());
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        let mut paths: Vec<(String, PathBuf)> =
            entries.map(|entry| entry.path()).filter_map(|path| Some((name(&path)?, path))).collect();
        paths.retain(|(name, _)| !name.starts_with('.'));
        paths.sort_by(|(a, _), (b, _)| natural::cmp(a, b));
        let opened: Vec<anyhow::Result<Sequence>> = paths.iter().map(|(_, path)| self.sequence(path)).collect();
        if opened.iter().any(Result::is_ok) {
            let passed_over = opened.iter().filter_map(|opened| opened.as_ref().err());
            passed_over.for_each(|error| progress.event(Event::Warned(format!("passed over: {error}"))));
        }
        opened.into_iter().flatten().collect()
    }

    fn sequence(&self, path: &Path) -> anyhow::Result<Sequence> {
        let input = |camera| InputArgs { input: path.into(), format: None, camera, simcol_k: SimcolMatrix::Fixed };
        let sequence = input(None).open()?;
        if sequence.camera.is_some() { Ok(sequence) } else { input(self.camera.clone()).open_assuming(self.hfov) }
    }

    fn report(&self, adapted: &Adapted) -> anyhow::Result<()> {
        let Adapted { improved, sentence, known, record, adaptations } = adapted;
        let mut stdout = std::io::stdout();
        let out = self.out.display().to_string();
        if self.json {
            let summary = json!({
                "improved": improved, "sentence": sentence, "model": self.model.display().to_string(), "out": out,
                "known": known, "record": record, "adaptations": adaptations,
            });
            writeln!(stdout, "{}", serde_json::to_string_pretty(&summary)?)?;
            return Ok(());
        }
        writeln!(stdout, "{out}: {sentence}")?;
        for name in known {
            writeln!(stdout, "  learned from before, left out: {name}")?;
        }
        let Some(record) = record else { return Ok(()) };
        for (name, before) in &record.before {
            let after = record.after.get(name).copied().unwrap_or(f64::NAN);
            writeln!(stdout, "  {name:<18}{before:>9.5} before {after:>9.5} after")?;
        }
        writeln!(stdout, "  {} steps in {:.1} minutes", record.steps, record.elapsed_s / 60.0)?;
        Ok(())
    }
}

/// How long a sequence lasts, where its frames have times of their own.
fn duration_s(sequence: &Sequence) -> Option<f64> {
    let fps = sequence.fps?;
    let [first, .., last] = sequence.frames.as_slice() else { return None };
    Some(last.time_s - first.time_s + 1.0 / fps)
}
