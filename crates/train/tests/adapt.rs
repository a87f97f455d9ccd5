//! Adapting: never worse, better where there is something to learn, and a record of it.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "test helpers fail by panicking and say what they skip"
)]

mod common;

use burn::tensor::Device;
use common::{SIZE, room_clip};
use endoscape_core::event::NullSink;
use endoscape_core::{Event, EventSink};
use endoscape_nets::{Checkpoint, NetsConfig};
use endoscape_synthesis::ObjectiveConfig;
use endoscape_train::adapt::TRAINING;
use endoscape_train::adapt::history::History;
use endoscape_train::clip::Clip;
use endoscape_train::gap::GapConfig;
use endoscape_train::{AdaptJob, GivenModel, NewVideo, TrainConfig, adapt};
use std::fs;
use std::path::{Path, PathBuf};

/// Small networks that learn something of the room within a few steps.
fn config() -> TrainConfig {
    let mut nets = NetsConfig::fast();
    nets.disp = nets.disp.with_width(0.1);
    nets.pose = nets.pose.with_width(0.2);
    let (width, height, gap) = (SIZE.width, SIZE.height, GapConfig { fixed: 1, ..GapConfig::default() });
    // The walls of the room shine by themselves.
    let objective = ObjectiveConfig { light_weight: 0.0, ..TrainConfig::fast().objective };
    TrainConfig { width, height, batch: 2, validation_snippets: 4, gap, objective, nets, ..TrainConfig::fast() }
}

/// An untrained model in a folder.
fn model(folder: &Path) -> PathBuf {
    let path = folder.join("given");
    let mut checkpoint = Checkpoint::init(config().nets, 0, &Device::flex()).unwrap();
    checkpoint.manifest.input = Some(config().trained_input());
    checkpoint.save(&path).unwrap();
    fs::write(path.join(TRAINING), config().to_toml().unwrap()).unwrap();
    path
}

fn video(name: &str, frames: usize) -> NewVideo {
    let clip = Clip { name: name.into(), fingerprint: format!("sha256:{name}"), ..room_clip(frames) };
    NewVideo { clip, seconds: Some(1.5) }
}

fn job(given: &Path, videos: Vec<NewVideo>) -> AdaptJob {
    let given = GivenModel::open(given, &Device::flex(), &mut NullSink).unwrap();
    let steps = TrainConfig { steps: 30, validate_every: 10, warmup: 5, ..given.gentle() };
    AdaptJob {
        config: TrainConfig { learning_rate: 1e-3, ..steps },
        given,
        videos,
        mix: Vec::new(),
        again: false,
        device: Device::flex(),
        device_name: "cpu".into(),
        date: "2026-01-02T03:04:05Z".into(),
    }
}

fn weights(folder: &Path) -> Vec<u8> {
    fs::read(folder.join("weights.safetensors")).unwrap()
}

#[test]
fn a_result_is_better_or_the_given_model_and_the_record_says_which() {
    let folder = tempfile::tempdir().unwrap();
    let (given, out) = (model(folder.path()), folder.path().join("out"));
    let mut job = job(&given, vec![video("monday", 40)]);
    (job.config.steps, job.config.learning_rate, job.config.validate_every) = (150, 3e-3, 25);
    let adapted = adapt(job, &out, &mut NullSink).unwrap();
    let record = adapted.record.clone().unwrap();
    let is_better = record.after["error"] < record.before["error"];
    assert_eq!((adapted.improved, record.improved), (is_better, is_better), "{adapted:?}");
    assert_eq!(weights(&given) != weights(&out), is_better);
    assert_eq!(History::read(&out).unwrap().adaptation, std::slice::from_ref(&record));
    assert_eq!((record.videos[0].frames, record.videos[0].seconds), (40, Some(1.5)));
    let manifest = Checkpoint::load(&out, &Device::flex()).unwrap().manifest;
    assert_eq!(manifest.data.len(), usize::from(is_better), "only what it has learned from is named");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2, "the work folder was left behind");
}

/// Frames that repeat one picture of the room, as a camera that stands shows them.
fn static_video() -> NewVideo {
    let mut video = video("static", 24);
    let picture = video.clip.frames[0].image.clone();
    video.clip.frames.iter_mut().for_each(|frame| frame.image = picture.clone());
    video
}

#[test]
fn a_camera_that_stands_teaches_to_stand_and_flattens_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (given, out) = (model(folder.path()), folder.path().join("out"));
    let adapted = adapt(job(&given, vec![static_video()]), &out, &mut NullSink).unwrap();
    let record = adapted.record.unwrap();
    assert!(record.after["error"] <= record.before["error"]);
    assert!(record.after["depth_spread"] >= 0.5 * record.before["depth_spread"], "{record:?}");
}

#[test]
fn a_learning_that_runs_away_gives_the_given_weights_back() {
    let folder = tempfile::tempdir().unwrap();
    let (given, out) = (model(folder.path()), folder.path().join("out"));
    let mut wild = job(&given, vec![video("monday", 40)]);
    (wild.config.learning_rate, wild.config.gradient_norm, wild.config.warmup) = (1.0, 0.0, 0);
    let adapted = adapt(wild, &out, &mut NullSink).unwrap();
    assert!(!adapted.improved && adapted.sentence.contains("kept unchanged"), "{adapted:?}");
    assert!(weights(&given) == weights(&out), "the weights changed");
    let record = adapted.record.unwrap();
    assert_eq!(record.before, record.after);
    assert_eq!(History::read(&out).unwrap().adaptation.len(), 1);
}

#[test]
fn the_record_accumulates_and_known_videos_are_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let (given, first, second) = (model(folder.path()), folder.path().join("first"), folder.path().join("second"));
    let short = |given: &Path, names: &[&str]| {
        let mut job = job(given, names.iter().map(|name| video(name, 30)).collect());
        job.config.steps = 4;
        job
    };
    adapt(short(&given, &["monday"]), &first, &mut NullSink).unwrap();
    let adapted = adapt(short(&first, &["monday", "tuesday"]), &second, &mut NullSink).unwrap();
    assert_eq!((adapted.known, adapted.adaptations), (vec!["monday".to_owned()], 2));
    let names: Vec<String> =
        History::read(&second).unwrap().adaptation.iter().map(|adaptation| adaptation.videos[0].name.clone()).collect();
    assert_eq!(names, ["monday", "tuesday"]);

    let third = folder.path().join("third");
    let adapted = adapt(short(&second, &["tuesday"]), &third, &mut NullSink).unwrap();
    assert!(adapted.record.is_none() && adapted.sentence.contains("learned from before"), "{adapted:?}");
    assert!(weights(&second) == weights(&third));
    let again = AdaptJob { again: true, ..short(&second, &["tuesday"]) };
    assert_eq!(adapt(again, &third, &mut NullSink).unwrap().adaptations, 3);
}

/// Stops listening, as a user does who closes the lid, once a number of candidates has been scored.
struct Impatient(u32);

impl EventSink for Impatient {
    fn event(&mut self, event: Event) {
        if matches!(event, Event::Measured { name, .. } if name == "validation_photometric") {
            self.0 -= 1;
            assert!(self.0 > 0, "closed");
        }
    }
}

#[test]
fn an_interrupted_adaptation_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let (given, whole, parts) = (model(folder.path()), folder.path().join("whole"), folder.path().join("parts"));
    let job = || {
        let mut job = job(&given, vec![video("monday", 40)]);
        (job.config.checkpoint_seconds, job.config.log_every) = (0.0, 1);
        job
    };
    adapt(job(), &whole, &mut NullSink).unwrap();
    let sitting = || adapt(job(), &parts, &mut Impatient(2));
    assert!(std::panic::catch_unwind(sitting).is_err(), "it was not interrupted");
    assert!(!parts.exists(), "half a result");
    let mut events = Vec::new();
    adapt(job(), &parts, &mut events).unwrap();
    let first = events.iter().find_map(|event| if let Event::Advanced { done } = event { Some(*done) } else { None });
    assert!(first > Some(10), "it began anew: {first:?}");
    assert!(weights(&whole) == weights(&parts), "the weights differ");
}

#[test]
fn places_that_would_cost_somebody_something_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let given = model(folder.path());
    let before = weights(&given);
    let refused =
        |out: &Path| adapt(job(&given, vec![video("monday", 30)]), out, &mut NullSink).unwrap_err().to_string();
    assert!(refused(&given).contains("is the given model"));
    fs::write(folder.path().join("mine.txt"), "mine").unwrap();
    assert!(refused(folder.path()).contains("is not a checkpoint"));
    assert!(weights(&given) == before);
}

#[test]
fn a_model_without_settings_gets_those_of_the_nearest_preset() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bare");
    Checkpoint::init(NetsConfig::fast(), 0, &Device::flex()).unwrap().save(&path).unwrap();
    let mut events = Vec::new();
    let given = GivenModel::open(&path, &Device::flex(), &mut events).unwrap();
    assert_eq!(given.training, TrainConfig::fast());
    assert!(matches!(&events[0], Event::Warned(text) if text.contains("preset fast")), "{events:?}");
}
