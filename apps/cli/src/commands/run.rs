//! `endoscape run`: a pose and a depth map for every frame of a video.

use crate::device::DeviceArgs;
use crate::input::{InputArgs, parse_field_of_view, parse_range, parse_size};
use crate::memory::peak_memory_mb;
use crate::model;
use crate::progress::Progress;
use crate::record::{RecordArgs, Recorder};
use anyhow::{Context as _, bail};
use endoscape_baselines::fused::{Fused, FusedConfig, Recorded};
use endoscape_baselines::{Direct, DirectConfig, Magnetic, MagneticConfig};
#[cfg(feature = "orb")]
use endoscape_baselines::{Orb, OrbConfig};
use endoscape_core::{Camera, Event, EventSink as _, MagneticReading, MagneticRig, Odometry, Size};
use endoscape_frames::{Sequence, magnet};
use endoscape_nets::RecurrentCheckpoint;
use endoscape_odometry::pipeline::{self, Job};
use endoscape_odometry::{
    Account, DepthFormat, LearnedOdometry, OdometryConfig, Percentiles, RecurrentOdometry, RunWriter,
};
use endoscape_train::model_folder;
use serde::Serialize;
use signal_hook::consts::SIGINT;
use std::collections::BTreeMap;
use std::io::Write as _;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Confidence below which a pose counts as lost, where the method does not say.
const LOST_BELOW: f64 = 0.1;

/// Unit of methods with a reference outside the body.
const METRES: &str = "metres";

/// Estimate the camera's path and the depth of every frame.
///
/// INPUT is a video, a folder of images, a data-set sequence, a sequence folder or a live address; Ctrl-C ends a live
/// run and keeps its results. The folder of --out gets trajectory.tum, trajectory.kitti, frames.csv, depth/,
/// reliability/, run.json and report.html. Lengths are in the unit of the training, which a single camera cannot tie to metres.
#[derive(clap::Args)]
#[command(after_help = "Example:
  endoscape run patient.mp4 --camera scope.yaml --model runs/phantom --out patient-run
  endoscape eval trajectory patient-run recordings/patient --align sim3")]
pub struct Args {
    #[command(flatten)]
    input: InputArgs,
    /// How motion is estimated: learned, recurrent (trained with true poses, in metres), direct (from brightness, without
    /// a model), orb (from corners, in builds with the feature orb), magnetic (from the readings of a sequence folder's magnet.csv) or fused (those readings with the
    /// learned method where --model is given, else with the direct one).
    #[arg(long, value_name = "NAME", default_value = "learned")]
    method: Method,
    /// Settings of the orb method: endo for pictures from inside the body, ordinary for streets and rooms.
    #[arg(long, value_name = "NAME", default_value = "endo")]
    preset: Preset,
    /// Training run or checkpoint with the networks.
    #[arg(long, value_name = "CKPT")]
    model: Option<PathBuf>,
    /// Chain the motions of the networks as they are, not sharpened by aligning pictures.
    #[arg(long)]
    networks_only: bool,
    /// Horizontal field of view to assume for an input without calibration.
    #[arg(long, value_name = "DEGREES", value_parser = parse_field_of_view)]
    hfov: Option<f64>,
    /// Size at which the networks see the pictures, and that of the depth maps [default: that of the training].
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    size: Option<Size>,
    /// Frames A to B - 1 only.
    #[arg(long, value_name = "A..B", value_parser = parse_range)]
    range: Option<Range<usize>>,
    /// How depth maps are stored: png (16 bits), npy (exact) or none.
    #[arg(long, value_name = "FORM", default_value = "png")]
    depth: DepthFormat,
    /// Folder for the results; it must not exist or be empty [default: NAME-METHOD here].
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    record: RecordArgs,
    #[command(flatten)]
    device: DeviceArgs,
    /// Print the summary as JSON.
    #[arg(long)]
    json: bool,
}

/// The methods of this build.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Method {
    Learned,
    Recurrent,
    Direct,
    Orb,
    Magnetic,
    Fused,
}

/// What the pictures of the orb method are like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Preset {
    Endo,
    Ordinary,
}

impl FromStr for Preset {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "endo" => Ok(Self::Endo),
            "ordinary" => Ok(Self::Ordinary),
            _ => Err(format!("`{text}` is no preset; choose endo or ordinary")),
        }
    }
}

impl Method {
    const fn name(self) -> &'static str {
        match self {
            Self::Learned => "learned",
            Self::Recurrent => "recurrent",
            Self::Direct => "direct",
            Self::Orb => "orb",
            Self::Magnetic => "magnetic",
            Self::Fused => "fused",
        }
    }
}

impl FromStr for Method {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "learned" => Ok(Self::Learned),
            "recurrent" => Ok(Self::Recurrent),
            "direct" => Ok(Self::Direct),
            "orb" if cfg!(feature = "orb") => Ok(Self::Orb),
            "orb" => Err("ORB SLAM is not in this build of endoscape; build it with --features orb".into()),
            "magnetic" => Ok(Self::Magnetic),
            "fused" => Ok(Self::Fused),
            _ => Err(format!(
                "`{text}` is no method of this build of endoscape; it has: learned, recurrent, direct, magnetic, fused{}",
                if cfg!(feature = "orb") { ", orb" } else { "" }
            )),
        }
    }
}

/// A method ready to run, with what `run.json` says about it.
struct Prepared {
    odometry: Box<dyn Odometry>,
    /// What the method looks at, where that is not the frames.
    readings: Option<Vec<MagneticReading>>,
    /// Unit of its lengths.
    unit: &'static str,
    model: Option<String>,
    lost_below: f64,
    settings: serde_json::Value,
}

/// What `--json` prints and `run.json` holds.
#[derive(Serialize)]
struct Summary {
    method: &'static str,
    model: Option<String>,
    frames: usize,
    tracked: usize,
    lost_frames: Vec<usize>,
    fps: f64,
    /// From a decoded frame to its pose and depth.
    latency_ms: Percentiles,
    stages_ms: BTreeMap<&'static str, Percentiles>,
    peak_memory_mb: Option<f64>,
    device: String,
    version: &'static str,
    interrupted: bool,
    warnings: Vec<String>,
    depth: DepthSummary,
    /// `null` where lengths are not metres, so that nobody takes them for such.
    depth_metres_per_unit: Option<f64>,
    config: Config,
    out: String,
}

/// What the depth maps are.
#[derive(Serialize)]
struct DepthSummary {
    format: DepthFormat,
    /// Length of a step of 16-bit maps in the unit of the trajectory.
    unit_per_step: Option<f64>,
    /// Unit of depth and translation alike.
    unit: &'static str,
    size: Option<Size>,
    /// The camera at that size.
    camera: Option<Camera>,
}

/// The call as it was resolved.
#[derive(Serialize)]
struct Config {
    input: String,
    format: String,
    range: Option<Range<usize>>,
    camera: Option<Camera>,
    settings: serde_json::Value,
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let mut progress = Progress::new();
    let recorder = args.record.open()?;
    let sequence = args.input.open_assuming(args.hfov)?;
    args.warn(&sequence, &mut progress);
    let mut prepared = args.prepare(&sequence)?;
    let out = args.out.clone().unwrap_or_else(|| PathBuf::from(format!("{}-{}", sequence.name, args.method.name())));
    let mut writer = RunWriter::create(&out, args.depth)?;
    let stop = stop_on_interrupt()?;
    let range = args.range.clone().unwrap_or(0..usize::MAX);
    let job = Job { sequence: &sequence, range, lost_below: prepared.lost_below, stop: &stop };
    let odometry = prepared.odometry.as_mut();
    let account = match &prepared.readings {
        None => pipeline::run(&job, odometry, &mut writer, &mut progress)?,
        Some(readings) => pipeline::run_readings(readings, prepared.lost_below, odometry, &mut writer, &mut progress)?,
    };
    let summary = args.summary(&sequence, prepared, account, (&writer, &out))?;
    writer.finish(&summary)?;
    let pages = write_report(&sequence, &out, recorder, &mut progress)?;
    report(args.json, &summary, &pages)
}

/// What was written about the run, by name.
type Pages = Vec<(&'static str, PathBuf)>;

/// The page about the run, and the recording if one is asked for. The results are safe by now, so that a page that cannot
/// be made is a warning.
fn write_report(sequence: &Sequence, out: &Path, recorder: Recorder, progress: &mut Progress) -> anyhow::Result<Pages> {
    let recorded = Some(sequence).filter(|sequence| !sequence.is_live());
    let mut pages = Pages::new();
    let mut unwritten = |error| progress.event(Event::Warned(format!("no report was written: {error}")));
    match endoscape_report::judge_run(out, recorded) {
        Ok(study) => {
            match endoscape_report::write_run(&study, out) {
                Ok(page) => pages.push(("report", page)),
                Err(error) => unwritten(error),
            }
            let recording = recorder.write(&study, &[recorded])?;
            pages.extend(recording.map(|file| ("recording", file)));
        }
        Err(error) if recorder.is_wanted() => return Err(error.into()),
        Err(error) => unwritten(error),
    }
    Ok(pages)
}

/// Lets Ctrl-C end the run in an orderly way.
fn stop_on_interrupt() -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    signal_hook::flag::register(SIGINT, stop.clone()).context("Ctrl-C cannot be handled")?;
    Ok(stop)
}

impl Args {
    fn warn(&self, sequence: &Sequence, progress: &mut Progress) {
        let mut warn = |warning: String| progress.event(Event::Warned(warning));
        sequence.warnings.iter().cloned().for_each(&mut warn);
        if sequence.camera.is_none() && self.method == Method::Learned {
            warn(
                "the camera is not known: drift of the scale is not corrected and confidence rests on the motions \
                 alone; give a calibration with --camera FILE or the field of view with --hfov DEGREES"
                    .into(),
            );
        }
    }

    /// Makes the method. Others plug in here.
    fn prepare(&self, sequence: &Sequence) -> anyhow::Result<Prepared> {
        match self.method {
            Method::Learned => self.prepare_learned(),
            Method::Recurrent => self.prepare_recurrent(),
            Method::Direct => prepare_direct(sequence),
            Method::Orb => prepare_orb(sequence, self.preset),
            Method::Magnetic => prepare_magnetic(sequence, self.range.clone()),
            Method::Fused => self.prepare_fused(sequence),
        }
    }

    /// The magnet's readings with the camera's motion by another method.
    fn prepare_fused(&self, sequence: &Sequence) -> anyhow::Result<Prepared> {
        let (rig, readings) = read_magnet(sequence, Method::Fused)?;
        let visual = if self.model.is_some() { self.prepare_learned()? } else { prepare_direct(sequence)? };
        let config = FusedConfig { visual_confidence: visual.lost_below, ..FusedConfig::default() };
        let fused = Fused::new(config, visual.odometry, rig)?;
        Ok(Prepared {
            odometry: Box::new(Recorded::new(fused, readings)),
            readings: None,
            unit: METRES,
            model: visual.model,
            lost_below: LOST_BELOW,
            settings: serde_json::json!({ "fused": config, "visual": visual.settings }),
        })
    }

    fn prepare_learned(&self) -> anyhow::Result<Prepared> {
        let model = self.needed_model(Method::Learned)?;
        let device = self.device.device.open()?;
        let (checkpoint, config) = model::load(model, self.size, &device)?;
        let config = OdometryConfig { refine: !self.networks_only, ..config };
        Ok(Prepared {
            model: Some(model.display().to_string()),
            lost_below: config.lost_below,
            settings: serde_json::to_value(&config)?,
            odometry: Box::new(LearnedOdometry::new(checkpoint, config, &device)?),
            readings: None,
            unit: "of the training, not metres",
        })
    }

    /// Motions in metres by the network that was trained with true poses.
    fn prepare_recurrent(&self) -> anyhow::Result<Prepared> {
        let model = self.needed_model(Method::Recurrent)?;
        let device = self.device.device.open()?;
        let checkpoint = RecurrentCheckpoint::load(&model_folder(model), &device)?;
        let odometry = RecurrentOdometry::new(checkpoint, self.size, &device)?;
        Ok(Prepared {
            model: Some(model.display().to_string()),
            lost_below: LOST_BELOW,
            settings: serde_json::json!({ "size": odometry.size(), "unit_m": odometry.unit_m() }),
            odometry: Box::new(odometry),
            readings: None,
            unit: METRES,
        })
    }

    fn needed_model(&self, method: Method) -> anyhow::Result<&Path> {
        self.model.as_deref().with_context(|| {
            format!("the {} method needs a model; name a training run or checkpoint with --model", method.name())
        })
    }

    fn summary(
        &self,
        sequence: &Sequence,
        prepared: Prepared,
        account: Account,
        (writer, out): (&RunWriter, &Path),
    ) -> anyhow::Result<Summary> {
        let size = writer.depth().size();
        let camera = sequence.camera.zip(size).map(|(camera, size)| camera.scaled_to(size)).transpose()?;
        let Account { frames, lost_frames, latency, elapsed_s, is_interrupted, warnings } = account;
        let mut stages_ms = latency.stages_ms();
        let latency_ms = stages_ms.remove(pipeline::FRAME).unwrap_or_default();
        Ok(Summary {
            method: self.method.name(),
            model: prepared.model,
            frames,
            tracked: frames - lost_frames.len(),
            lost_frames,
            fps: frames as f64 / elapsed_s.max(1e-9),
            latency_ms,
            stages_ms,
            peak_memory_mb: peak_memory_mb(),
            device: self.device.device.to_string(),
            version: env!("CARGO_PKG_VERSION"),
            interrupted: is_interrupted,
            warnings,
            depth: DepthSummary {
                format: self.depth,
                unit_per_step: writer.depth().unit(),
                unit: prepared.unit,
                size,
                camera,
            },
            depth_metres_per_unit: (prepared.unit == METRES).then_some(1.0),
            config: Config {
                input: sequence.root.display().to_string(),
                format: sequence.format.to_string(),
                range: self.range.clone(),
                camera: sequence.camera,
                settings: prepared.settings,
            },
            out: out.display().to_string(),
        })
    }
}

/// The camera, which a method needs.
fn known_camera(sequence: &Sequence, method: Method) -> anyhow::Result<&Camera> {
    sequence.camera.as_ref().with_context(|| {
        format!(
            "the {} method needs the camera; give a calibration with --camera FILE or the field of view with --hfov \
             DEGREES",
            method.name()
        )
    })
}

#[cfg(feature = "orb")]
fn prepare_orb(sequence: &Sequence, preset: Preset) -> anyhow::Result<Prepared> {
    let camera = known_camera(sequence, Method::Orb)?;
    let config = match preset {
        Preset::Endo => OrbConfig::endoscopic(),
        Preset::Ordinary => OrbConfig::ordinary(),
    };
    Ok(Prepared {
        model: None,
        lost_below: LOST_BELOW,
        settings: serde_json::to_value(config)?,
        odometry: Box::new(Orb::new(config, camera)?),
        readings: None,
        unit: "of the first map's depth, not metres",
    })
}

#[cfg(not(feature = "orb"))]
fn prepare_orb(_sequence: &Sequence, _preset: Preset) -> anyhow::Result<Prepared> {
    bail!("ORB SLAM is not in this build of endoscape; build it with --features orb")
}

fn prepare_direct(sequence: &Sequence) -> anyhow::Result<Prepared> {
    let camera = known_camera(sequence, Method::Direct)?;
    let config = DirectConfig::default();
    Ok(Prepared {
        model: None,
        lost_below: LOST_BELOW,
        settings: serde_json::to_value(config)?,
        odometry: Box::new(Direct::new(config, camera)?),
        readings: None,
        unit: "of the first keyframe's depth, not metres",
    })
}

fn prepare_magnetic(sequence: &Sequence, range: Option<Range<usize>>) -> anyhow::Result<Prepared> {
    let (rig, mut readings) = read_magnet(sequence, Method::Magnetic)?;
    if let Some(range) = range {
        readings.retain(|reading| range.contains(&reading.index));
        if readings.is_empty() {
            let root = sequence.root.display();
            bail!("{root}: no reading lies in {}..{}; choose another --range", range.start, range.end);
        }
    }
    let config = MagneticConfig::default();
    Ok(Prepared {
        model: None,
        lost_below: LOST_BELOW,
        settings: serde_json::to_value(config)?,
        odometry: Box::new(Magnetic::new(config, rig)?),
        readings: Some(readings),
        unit: METRES,
    })
}

/// The magnet, the array and their readings, which a method needs.
fn read_magnet(sequence: &Sequence, method: Method) -> anyhow::Result<(MagneticRig, Vec<MagneticReading>)> {
    let Some(found) = magnet::read(&sequence.root)? else {
        bail!(
            "{}: holds no magnet.toml and magnet.csv, which the {} method needs; give a sequence folder with the \
             readings of a magnetic array",
            sequence.root.display(),
            method.name()
        );
    };
    Ok(found)
}

fn report(json: bool, summary: &Summary, pages: &Pages) -> anyhow::Result<()> {
    for warning in &summary.warnings {
        // Nothing can be done about a standard error that is closed.
        writeln!(std::io::stderr(), "warning: {warning}").ok();
    }
    let mut stdout = std::io::stdout();
    if json {
        writeln!(stdout, "{}", serde_json::to_string_pretty(summary)?)?;
        return Ok(());
    }
    let Summary { frames, tracked, fps, latency_ms: Percentiles { p50, p95, p99, .. }, out, .. } = summary;
    writeln!(
        stdout,
        "{out}: {tracked} of {frames} frames tracked, {fps:.1} per second, a frame takes {p50:.1} ms (95 %: {p95:.1}, \
         99 %: {p99:.1})"
    )?;
    for (stage, Percentiles { p50, p95, p99, max }) in &summary.stages_ms {
        writeln!(stdout, "  {stage:<12}{p50:>8.2} ms   95 % {p95:>8.2}   99 % {p99:>8.2}   longest {max:>8.2}")?;
    }
    for (name, page) in pages {
        writeln!(stdout, "  {name:<12}{}", page.display())?;
    }
    Ok(())
}
