//! The recurrent rival as a user meets it: trained with true poses, run, and refused.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "test helpers fail by panicking and say what they skip"
)]

mod common;

use common::{Folder, SLIM, endoscape, fail, json, model, recurrent_model, succeed, tube};
use endoscape_core::{Image, Size};
use std::path::Path;

#[test]
fn a_network_is_trained_with_true_poses_and_runs_in_metres() {
    let folder = Folder::new();
    let model = recurrent_model(&folder, "model", "20");
    for file in
        ["config.toml", "run.json", "metrics.csv", "validation.csv", "best/manifest.json", "latest/progress.json"]
    {
        assert!(Path::new(&model).join(file).is_file(), "{file}");
    }
    let out = folder.path("out");
    let summary = json(&["run", &tube(), "--method", "recurrent", "--model", &model, "--out", &out, "--json"]);
    assert_eq!((summary["method"].as_str(), summary["depth"]["unit"].as_str()), (Some("recurrent"), Some("metres")));
    assert_eq!((summary["frames"].as_u64(), summary["tracked"].as_u64()), (Some(12), Some(12)));
    let unit_m = summary["config"]["settings"]["unit_m"].as_f64().unwrap();
    assert!((5e-4..5e-3).contains(&unit_m), "the mean step of the tube is some 1.5 mm, not {unit_m}");
    let trajectory = json(&["eval", "trajectory", &out, &tube(), "--align", "se3", "--json"]);
    assert_eq!(trajectory["completeness"].as_f64(), Some(1.0));
    assert!(trajectory["ate_m"]["rmse"].as_f64().unwrap() < 0.05, "{trajectory}");
    assert!(std::fs::read_to_string(format!("{out}/report.html")).unwrap().contains("</html>"));
}

#[test]
fn a_supervised_run_is_resumed_without_being_told_its_kind() {
    let folder = Folder::new();
    let (whole, parts) = (recurrent_model(&folder, "whole", "4"), recurrent_model(&folder, "parts", "2"));
    succeed(&["train", "--data", &tube(), "--out", &parts, "--resume", "--steps", "4"]);
    let weights = |run: &str| std::fs::read(Path::new(run).join("latest/weights.safetensors")).unwrap();
    assert!(weights(&whole) == weights(&parts), "the weights differ");
    let sentence = fail(&["train", "--supervised", "--data", &tube(), "--out", &model(), "--resume", "--steps", "9"]);
    assert!(sentence.contains("no supervised training run to resume"), "{sentence}");
}

#[test]
fn a_model_of_the_wrong_kind_is_one_sentence() {
    let folder = Folder::new();
    let (recurrent, joint, out) = (recurrent_model(&folder, "model", "1"), model(), folder.path("out"));
    let run = |method: &str, model: &str| fail(&["run", &tube(), "--method", method, "--model", model, "--out", &out]);
    let sentence = run("learned", &recurrent);
    assert!(sentence.contains("holds a recurrent network") && sentence.contains("--method recurrent"), "{sentence}");
    let sentence = run("recurrent", &joint);
    assert!(sentence.contains("not a recurrent one") && sentence.contains("--method learned"), "{sentence}");
    let sentence = fail(&["run", &tube(), "--method", "recurrent", "--out", &out]);
    assert!(sentence.contains("the recurrent method needs a model"), "{sentence}");
    assert!(!Path::new(&out).exists());
}

#[test]
fn data_without_truth_and_other_slips_are_named() {
    let folder = Folder::new();
    let (pictures, out) = (Path::new(&tube()).join("frames").display().to_string(), folder.path("out"));
    let train = |data: &str, more: &[&str]| {
        [&["train", "--supervised", "--data", data, "--out", &out, "--steps", "1"], more].concat().join(" ")
    };
    let refused = |line: String| fail(&line.split(' ').collect::<Vec<_>>());
    let sentence = refused(train(&pictures, &[]));
    assert!(sentence.contains("frames@0..12: it has no true poses"), "{sentence}");
    let sentence = refused(train(&format!("{}@3..4", tube()), &[]));
    assert!(sentence.contains("no two neighbouring frames"), "{sentence}");
    let sentence = refused(train(&tube(), &["--size", "8x8"]));
    assert!(sentence.contains("`width` is 8"), "{sentence}");
    let wrong = folder.file("wrong.toml", "gap.fixed = 2");
    let sentence = refused(train(&tube(), &["--config", &wrong]));
    assert!(sentence.contains("wrong.toml") && sentence.contains("gap"), "{sentence}");
    let sentence = refused(train(&tube(), &["--init", &model()]));
    assert!(sentence.contains("not a recurrent one"), "{sentence}");
    let call = endoscape(&train(&tube(), &["--preset", "fast"]).split(' ').collect::<Vec<_>>());
    assert_eq!(call.status.code(), Some(2));
    assert!(!Path::new(&out).exists(), "something was left behind");
}

#[test]
fn sequences_of_two_sizes_train_together_and_spoilt_frames_are_answered() {
    let folder = Folder::new();
    let small = folder.path("small");
    succeed(&["convert", &tube(), &small, "--size", "80x64"]);
    let (config, model) = (folder.file("slim.toml", SLIM), folder.path("model"));
    let data = ["train", "--supervised", "--data", &tube(), &small, "--out", &model, "--config", &config];
    succeed(&[&data[..], &["--steps", "1"]].concat());

    common::copy(Path::new(&tube()).join("frames"), folder.path("spoilt"));
    let spoilt = |index: usize| Path::new(&folder.path("spoilt")).join(format!("{index:06}.png"));
    let black = Image::from_fn(Size::new(160, 128), |_, _| [0; 3]);
    endoscape_frames::picture::write_png(&spoilt(3), &black).unwrap();
    std::fs::copy(spoilt(5), spoilt(6)).unwrap();
    let bytes = std::fs::read(spoilt(9)).unwrap();
    std::fs::write(spoilt(9), &bytes[..bytes.len() / 2]).unwrap();
    let (input, out) = (folder.path("spoilt"), folder.path("out"));
    let summary = json(&["run", &input, "--method", "recurrent", "--model", &model, "--out", &out, "--json"]);
    assert_eq!(summary["lost_frames"], serde_json::json!([3, 6, 9]));
    let poses = std::fs::read_to_string(format!("{out}/trajectory.tum")).unwrap();
    assert!(poses.lines().count() == 12 && !poses.contains("NaN"));
}
