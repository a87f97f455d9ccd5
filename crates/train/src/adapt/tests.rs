use super::*;
use crate::config::Preset;
use crate::testing::sliding_clip;
use endoscape_core::event::NullSink;
use endoscape_nets::NetsConfig;

/// Networks for pictures of 96x64 that learn something within a few steps.
fn config() -> TrainConfig {
    let mut nets = NetsConfig::fast();
    nets.disp = nets.disp.with_width(0.25);
    nets.pose = nets.pose.with_width(0.25);
    TrainConfig { width: 96, height: 64, batch: 2, learning_rate: 2e-3, nets, ..TrainConfig::preset(Preset::Fast) }
}

/// An untrained model in a folder.
fn model(folder: &Path) -> PathBuf {
    let path = folder.join("given");
    let mut checkpoint = Checkpoint::init(config().nets, 0, &Device::flex()).unwrap();
    checkpoint.manifest.input = Some(config().trained_input());
    let settings = |folder: &Path| write_whole(&folder.join(TRAINING), config().to_toml().unwrap().as_bytes());
    checkpoint.save_with(&path, settings).unwrap();
    path
}

fn video(name: &str, frames: usize, pixels_per_frame: f64) -> NewVideo {
    let clip = sliding_clip(frames, pixels_per_frame);
    let clip = Clip { name: name.into(), fingerprint: format!("sha256:{name}"), ..clip };
    NewVideo { clip, seconds: Some(1.5) }
}

fn job(given: &Path, videos: Vec<NewVideo>) -> AdaptJob {
    let given = GivenModel::open(given, &Device::flex(), &mut NullSink).unwrap();
    let steps = TrainConfig { steps: 40, validate_every: 10, warmup: 5, ..given.gentle() };
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
fn a_lively_video_makes_a_better_model_and_the_record_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let (given, out) = (model(folder.path()), folder.path().join("out"));
    let adapted = adapt(job(&given, vec![video("monday", 40, 2.5)]), &out, &mut NullSink).unwrap();
    let record = adapted.record.clone().unwrap();
    assert!(adapted.improved && record.improved, "{adapted:?}");
    assert!(record.after["error"] < record.before["error"]);
    assert!(record.after["photometric"] < record.after["still_photometric"]);
    assert_ne!(weights(&given), weights(&out));
    assert_eq!(History::read(&out).unwrap().adaptation, [record.clone()]);
    assert_eq!((record.videos[0].frames, record.videos[0].seconds), (40, Some(1.5)));
    let manifest = Checkpoint::load(&out, &Device::flex()).unwrap().manifest;
    assert_eq!(manifest.data[0].name, "monday");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2, "the work folder was left behind");
}

#[test]
fn a_learning_that_runs_away_gives_the_given_weights_back() {
    let folder = tempfile::tempdir().unwrap();
    let (given, out) = (model(folder.path()), folder.path().join("out"));
    let mut wild = job(&given, vec![video("monday", 40, 2.5)]);
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
        let mut job = job(given, names.iter().map(|name| video(name, 30, 2.5)).collect());
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

#[test]
fn an_interrupted_adaptation_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let (given, whole, parts) = (model(folder.path()), folder.path().join("whole"), folder.path().join("parts"));
    let job = || {
        let mut job = job(&given, vec![video("monday", 40, 2.5)]);
        job.config.decay = crate::schedule::Decay::Constant;
        job
    };
    adapt(job(), &whole, &mut NullSink).unwrap();
    // A first sitting that never comes to its conclusion.
    let mut early = job();
    early.config.steps = 20;
    let round = Round::prepare(early, &parts, &mut NullSink).unwrap();
    round.learn(&mut NullSink).unwrap();
    let run = RunFolder::open(round.run.root()).unwrap();
    run.describe(&job().config, &run.manifest().unwrap()).unwrap();
    let round = Round::prepare(job(), &parts, &mut NullSink).unwrap();
    assert!(round.goes_on);
    adapt(job(), &parts, &mut NullSink).unwrap();
    assert!(weights(&whole) == weights(&parts), "the weights differ");
}

#[test]
fn places_that_would_cost_somebody_something_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let given = model(folder.path());
    let before = weights(&given);
    let refused =
        |out: &Path| adapt(job(&given, vec![video("monday", 30, 2.5)]), out, &mut NullSink).unwrap_err().to_string();
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
