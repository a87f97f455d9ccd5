//! Labels of poses and depth are learned, through mirrored and enlarged pictures too.

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
use endoscape_train::clip::{Clip, Label};
use endoscape_train::gap::GapConfig;
use endoscape_train::trainer::Metrics;
use endoscape_train::{RunFolder, SnippetDataset, TrainConfig, TrainJob, train};
use std::path::{Path, PathBuf};
use std::sync::Arc;

const STEPS: u64 = 150;

fn config() -> TrainConfig {
    let mut nets = NetsConfig::fast();
    nets.disp = nets.disp.with_width(0.5);
    TrainConfig {
        width: SIZE.width,
        height: SIZE.height,
        steps: STEPS,
        learning_rate: 2e-3,
        warmup: 0,
        log_every: 1,
        validate_every: 1_000_000,
        checkpoint_seconds: 1e9,
        gap: GapConfig { fixed: 1, ..GapConfig::default() },
        augment: AugmentConfig { mirror: 0.5, enlarge: 1.05, ..AugmentConfig::none() },
        nets,
        ..TrainConfig::fast()
    }
}

/// A clip whose truth is its label.
fn labelled(frames: usize) -> Clip {
    let mut clip = room_clip(frames);
    for frame in &mut clip.frames {
        let known = frame.world_from_camera.take().zip(frame.depth.take());
        frame.label = known.map(|(world_from_camera, depth)| Label { world_from_camera, depth });
    }
    clip
}

/// Trains on labelled pictures of the room into a folder; returns what was logged and what was warned of.
fn trained(config: TrainConfig, init: Option<PathBuf>, out: &Path) -> (Vec<Metrics>, Vec<String>) {
    let data = SnippetDataset::new(vec![Arc::new(labelled(6))], 3, &config.gap, &mut NullSink).unwrap();
    assert_eq!(data.labelled_frames(), 6);
    let run = RunFolder::fresh(out).unwrap();
    let (device, device_name) = (Device::flex(), "cpu".to_owned());
    let job = TrainJob { config, data: Arc::new(data), validation: None, init, device, device_name };
    let mut events = Vec::new();
    train(&job, &run, &mut events).unwrap();
    let mut table = csv::Reader::from_path(run.root().join("metrics.csv")).unwrap();
    let rows = table.deserialize().map(Result::unwrap).collect();
    let warning = |event: Event| if let Event::Warned(sentence) = event { Some(sentence) } else { None };
    (rows, events.into_iter().filter_map(warning).collect())
}

fn mean(rows: &[Metrics], figure: fn(&Metrics) -> f32) -> f64 {
    rows.iter().map(|row| f64::from(figure(row))).sum::<f64>() / rows.len() as f64
}

#[test]
fn what_labels_say_is_learned() {
    let folder = tempfile::tempdir().unwrap();
    let (rows, _) = trained(config(), None, &folder.path().join("run"));
    for (name, figure) in
        [("depth", (|row| row.label_depth) as fn(&Metrics) -> f32), ("motion", |row| row.label_motion)]
    {
        let (begin, end) = (mean(&rows[..5], figure), mean(&rows[rows.len() - 20..], figure));
        eprintln!("{name}: {begin:.4} to {end:.4}");
        assert!(end < 0.5 * begin, "{name}: {begin} to {end}");
    }
}

#[test]
fn the_alignment_network_learns_what_is_left_of_a_motion() {
    let folder = tempfile::tempdir().unwrap();
    // Depth first: through a wrong one no motion explains the pictures.
    let first = folder.path().join("first");
    trained(config(), None, &first);
    let mut config = TrainConfig { steps: 400, ..config() };
    config.lesson.alignment = true;
    let (rows, warnings) = trained(config, Some(first.join("latest")), &folder.path().join("second"));
    let (begin, end) =
        (mean(&rows[..20], |row| row.label_alignment), mean(&rows[rows.len() - 20..], |row| row.label_alignment));
    eprintln!("alignment: {begin:.4} to {end:.4}");
    assert!(end < 0.8 * begin, "{begin} to {end}");
    assert!(rows.iter().all(|row| row.label_depth == 0.0 && row.label_motion == 0.0 && row.photometric == 0.0));
    assert!(warnings.is_empty(), "{warnings:?}");
}
