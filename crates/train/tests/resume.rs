//! A run that is interrupted and resumed ends in the same bits as one that is not.

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
use endoscape_nets::NetsConfig;
use endoscape_train::augment::AugmentConfig;
use endoscape_train::gap::GapConfig;
use endoscape_train::{RunFolder, SnippetDataset, TrainConfig, TrainJob, resume, train};
use std::path::{Path, PathBuf};
use std::sync::Arc;

fn tiny() -> TrainConfig {
    let mut nets = NetsConfig::paper();
    nets.disp = nets.disp.with_width(0.1);
    nets.pose = nets.pose.with_width(0.2);
    TrainConfig {
        width: SIZE.width,
        height: SIZE.height,
        batch: 2,
        steps: 6,
        log_every: 1,
        validate_every: 3,
        validation_snippets: 4,
        checkpoint_seconds: 0.0,
        loader_threads: 2,
        gap: GapConfig { fixed: 1, ..GapConfig::default() },
        augment: AugmentConfig::endo(),
        nets,
        ..TrainConfig::endo()
    }
}

fn job(config: TrainConfig, frames: usize) -> TrainJob {
    let clips = vec![Arc::new(room_clip(frames))];
    let data = SnippetDataset::new(clips, config.snippet_length(), &config.gap, &mut NullSink).unwrap();
    let device_name = "cpu".to_owned();
    TrainJob { config, data: Arc::new(data), validation: None, init: None, device: Device::flex(), device_name }
}

fn bytes(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap()
}

fn lines(run: &RunFolder, table: &str) -> Vec<String> {
    std::fs::read_to_string(run.root().join(table)).unwrap().lines().map(str::to_owned).collect()
}

/// Columns that do not depend on the clock.
fn losses(run: &RunFolder) -> Vec<Vec<String>> {
    let fields = |line: &String| {
        line.split(',').enumerate().filter(|(at, _)| *at != 1 && *at != 2).map(|(_, f)| f.to_owned()).collect()
    };
    lines(run, "metrics.csv").iter().map(fields).collect()
}

#[test]
fn a_resumed_run_equals_one_that_never_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| -> PathBuf { folder.path().join(name) };
    let whole = RunFolder::fresh(&path("whole")).unwrap();
    let summary = train(&job(tiny(), 8), &whole, &mut NullSink).unwrap();
    assert_eq!(summary.steps, 6);

    let parts = RunFolder::fresh(&path("parts")).unwrap();
    train(&job(TrainConfig { steps: 3, ..tiny() }, 8), &parts, &mut NullSink).unwrap();
    // A process that dies while it writes leaves a draft behind and a line cut short.
    std::fs::create_dir(path("parts").join(".latest.incomplete")).unwrap();
    let metrics = path("parts").join("metrics.csv");
    std::fs::write(&metrics, [bytes(&metrics), b"4,1.5,0.".to_vec()].concat()).unwrap();
    let parts = RunFolder::open(&path("parts")).unwrap();
    let mut events = Vec::new();
    let again = resume(&job(TrainConfig { steps: 6, ..parts.config().unwrap() }, 8), &parts, &mut events).unwrap();

    assert_eq!((again.steps, again.scores), (summary.steps, summary.scores));
    for checkpoint in ["latest", "best"] {
        let weights = |run: &RunFolder| bytes(&run.root().join(checkpoint).join("weights.safetensors"));
        assert!(weights(&whole) == weights(&parts), "the weights of {checkpoint} differ");
    }
    assert_eq!(losses(&whole), losses(&parts));
    assert_eq!(lines(&parts, "validation.csv").len(), 3);
    assert!(events.iter().any(|event| matches!(event, Event::Measured { name, step: 6, .. } if name == "remaining_s")));
}

#[test]
fn other_data_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let run = RunFolder::fresh(&folder.path().join("run")).unwrap();
    train(&job(TrainConfig { steps: 1, ..tiny() }, 6), &run, &mut NullSink).unwrap();
    let mut other = room_clip(6);
    other.fingerprint = "another".into();
    let mut job = job(TrainConfig { steps: 2, ..tiny() }, 6);
    job.data = Arc::new(SnippetDataset::new(vec![Arc::new(other)], 3, &job.config.gap, &mut NullSink).unwrap());
    let message = resume(&job, &run, &mut NullSink).unwrap_err().to_string();
    assert!(message.contains("other data") && message.contains("--init"), "{message}");
}

#[test]
fn a_second_stage_may_change_the_snippet_length() {
    let folder = tempfile::tempdir().unwrap();
    let first = RunFolder::fresh(&folder.path().join("first")).unwrap();
    train(&job(TrainConfig { steps: 1, ..tiny() }, 6), &first, &mut NullSink).unwrap();
    let mut config = TrainConfig { steps: 1, ..tiny() };
    config.nets.pose.snippet_length = 5;
    let second = RunFolder::fresh(&folder.path().join("second")).unwrap();
    let mut events = Vec::new();
    let job = TrainJob { init: Some(first.latest()), ..job(config, 8) };
    train(&job, &second, &mut events).unwrap();
    assert!(events.iter().any(|event| matches!(event, Event::Warned(text) if text.contains("start fresh"))));
    assert_eq!(second.config().unwrap().snippet_length(), 5);
    assert!(second.manifest().unwrap().init.is_some());
}
