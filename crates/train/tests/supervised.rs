//! Supervised training: motion is learned, and an interruption changes nothing.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "test helpers fail by panicking and say what they skip"
)]

mod common;

use burn::tensor::Device;
use common::{SIZE, room_clip};
use endoscape_core::Event;
use endoscape_core::event::NullSink;
use endoscape_nets::RecurrentVoConfig;
use endoscape_train::schedule::Decay;
use endoscape_train::supervised::clip::PosedFrame;
use endoscape_train::supervised::{
    PosedClip, SupervisedConfig, SupervisedJob, config_of, is_supervised, resume, train,
};
use endoscape_train::{RunFolder, TrainError};
use std::path::Path;

/// The painted room with its true poses.
fn room(frames: usize) -> PosedClip {
    let clip = room_clip(frames);
    let posed = |frame: endoscape_train::clip::ClipFrame| PosedFrame {
        image: frame.image,
        world_from_camera: frame.world_from_camera.unwrap(),
    };
    let stretch = clip.frames.into_iter().map(posed).collect();
    PosedClip { name: clip.name, stretches: vec![stretch], fingerprint: clip.fingerprint }
}

fn config() -> SupervisedConfig {
    SupervisedConfig {
        width: SIZE.width,
        height: SIZE.height,
        batch: 1,
        subsequence: 6,
        truncation: 3,
        warmup: 5,
        // Does not ask how long the run will be, so that one that stops early can be compared.
        decay: Decay::Constant,
        log_every: 1,
        validate_every: 3,
        checkpoint_seconds: 0.0,
        net: RecurrentVoConfig {
            stem: [8, 12],
            blocks: [[4, 6, 4, 2], [4, 6, 4, 2], [6, 8, 6, 4]],
            grid: 3,
            hidden: 24,
            unit_m: 1.0,
        },
        ..SupervisedConfig::default()
    }
}

fn job(config: SupervisedConfig, frames: usize) -> SupervisedJob {
    let (data, device_name) = (vec![room(frames)], "cpu".to_owned());
    SupervisedJob { config, data, validation: None, init: None, device: Device::flex(), device_name }
}

fn bytes(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap()
}

#[test]
fn a_resumed_run_equals_one_that_never_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let whole = RunFolder::fresh(&folder.path().join("whole")).unwrap();
    let steps = |steps| SupervisedConfig { steps, ..config() };
    let summary = train(&job(steps(6), 8), &whole, &mut NullSink).unwrap();

    let parts = RunFolder::fresh(&folder.path().join("parts")).unwrap();
    train(&job(steps(3), 8), &parts, &mut NullSink).unwrap();
    let parts = RunFolder::open(parts.root()).unwrap();
    assert!(is_supervised(&parts));
    let mut events = Vec::new();
    let recorded = config_of(&parts).unwrap();
    assert!(recorded.net.unit_m != 1.0, "the unit is that of the data");
    let again = resume(&job(SupervisedConfig { steps: 6, ..recorded }, 8), &parts, &mut events).unwrap();

    assert_eq!((again.steps, again.scores), (6, summary.scores));
    for checkpoint in ["latest", "best"] {
        let weights = |run: &RunFolder| bytes(&run.root().join(checkpoint).join("weights.safetensors"));
        assert!(weights(&whole) == weights(&parts), "the weights of {checkpoint} differ");
    }
    assert_eq!(std::fs::read_to_string(parts.root().join("metrics.csv")).unwrap().lines().count(), 7);
    assert!(events.iter().any(|event| matches!(event, Event::Measured { name, step: 6, .. } if name == "loss")));
}

#[test]
fn what_cannot_be_resumed_or_begun_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let run = RunFolder::fresh(&folder.path().join("run")).unwrap();
    train(&job(SupervisedConfig { steps: 1, ..config() }, 6), &run, &mut NullSink).unwrap();
    let mut other = job(SupervisedConfig { steps: 2, ..config() }, 6);
    other.data[0].fingerprint = "another".into();
    let sentence = resume(&other, &run, &mut NullSink).unwrap_err().to_string();
    assert!(sentence.contains("other data") && sentence.contains("--init"), "{sentence}");

    let mut still = job(config(), 6);
    still.data[0].stretches[0].iter_mut().for_each(|frame| frame.world_from_camera = endoscape_core::Pose::identity());
    let run = RunFolder::fresh(&folder.path().join("still")).unwrap();
    let error = train(&still, &run, &mut NullSink).unwrap_err();
    assert!(matches!(&error, TrainError::Data { .. }) && error.to_string().contains("never moves"), "{error}");
    assert!(!run.root().exists());
}

#[test]
fn weights_and_unit_of_another_run_are_a_start() {
    let folder = tempfile::tempdir().unwrap();
    let (first, second) = (folder.path().join("first"), folder.path().join("second"));
    let first = RunFolder::fresh(&first).unwrap();
    train(&job(SupervisedConfig { steps: 1, ..config() }, 6), &first, &mut NullSink).unwrap();
    let second = RunFolder::fresh(&second).unwrap();
    let fresh = SupervisedConfig { steps: 1, net: RecurrentVoConfig::default(), ..config() };
    let job = SupervisedJob { init: Some(first.latest()), ..job(fresh, 9) };
    train(&job, &second, &mut NullSink).unwrap();
    assert_eq!(config_of(&second).unwrap().net, config_of(&first).unwrap().net);
}

/// Summed translation and rotation errors over the true motions after so many steps on eight frames.
fn recovered(steps: u64) -> (f64, f64) {
    let folder = tempfile::tempdir().unwrap();
    let run = RunFolder::fresh(&folder.path().join("run")).unwrap();
    let config = SupervisedConfig {
        steps,
        learning_rate: 2e-3,
        decay: Decay::Cosine,
        symmetries: false,
        longest_gap: 1,
        colour_change: 0.0,
        validate_every: 1_000_000,
        checkpoint_seconds: 1e9,
        ..config()
    };
    let scores = train(&job(config, 8), &run, &mut NullSink).unwrap().scores;
    (scores.translation, scores.rotation)
}

#[test]
fn the_motions_of_a_short_clip_are_learned() {
    let (start, later) = (recovered(1), recovered(700));
    eprintln!("{start:?} {later:?}");
    assert!(later.0 < 0.25 && later.1 < 0.25, "{start:?} {later:?}");
    assert!(start.0 > 0.8, "nothing was to be learned: {start:?}");
}
