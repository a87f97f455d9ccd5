//! Adapting as a user does it: to a video, to a folder of videos, killed, and refused.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "test helpers fail by panicking and say what they skip"
)]

mod common;
use common::{Folder, fail, json, model, succeed, tube};
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

fn weights(checkpoint: &str) -> Vec<u8> {
    fs::read(Path::new(checkpoint).join("weights.safetensors")).unwrap()
}

/// The arguments that adapt the small model of the tests to its own sequence, which it has seen.
fn words<'a>(model: &'a str, input: &'a str, out: &'a str, steps: &'a str) -> Vec<&'a str> {
    vec!["adapt", input, "--model", model, "--out", out, "--steps", steps, "--again", "--json"]
}

#[test]
fn a_model_is_adapted_and_runs_and_remembers() {
    let folder = Folder::new();
    let (model, tube, first, second) = (model(), tube(), folder.path("first"), folder.path("second"));
    let summary = json(&words(&model, &tube, &first, "8"));
    let record = &summary["record"];
    assert_eq!(record["videos"][0]["frames"], 12, "{summary}");
    assert!(record["held_back_snippets"].as_u64() > Some(0) && record["steps"] == 8, "{summary}");
    let error = |when: &str| record[when]["error"].as_f64().unwrap();
    assert!(error("after") <= error("before"));
    assert_eq!(summary["improved"], error("after") < error("before"));
    let run = json(&["run", &tube, "--model", &first, "--out", &folder.path("run"), "--depth", "none", "--json"]);
    assert_eq!(run["frames"], 12);

    let known = json(&["adapt", &tube, "--model", &first, "--out", &second, "--json"]);
    assert!(known["known"].as_array().unwrap().len() == 1 && known["record"].is_null(), "{known}");
    assert!(weights(&first) == weights(&second), "the weights changed");
    let again = json(&words(&second, &tube, &folder.path("third"), "2"));
    assert_eq!(again["adaptations"], 2);
    assert!(Path::new(&folder.path("third")).join("training.toml").is_file());
}

#[test]
fn a_folder_of_sequences_is_taken_apart() {
    let folder = Folder::new();
    for name in ["day/one", "day/two"] {
        common::copy(tube(), folder.path(name));
    }
    folder.file("day/notes.txt", "nothing to see");
    let (model, tube, day, out) = (model(), tube(), folder.path("day"), folder.path("out"));
    let arguments = [words(&model, &day, &out, "2"), vec!["--mix", &tube]].concat();
    let summary = json(&arguments);
    assert_eq!(summary["record"]["videos"].as_array().unwrap().len(), 2, "{summary}");
}

#[test]
fn a_killed_adaptation_leaves_the_model_alone_and_goes_on() {
    let folder = Folder::new();
    let (model, tube, out) = (model(), tube(), folder.path("out"));
    let given = format!("{model}/best");
    let before = weights(&given);
    let arguments = [words(&model, &tube, &out, "100000"), vec!["--config"]].concat();
    let config = folder.file("often.toml", "patience = 0\ncheckpoint_seconds = 0.0");
    let mut command = Command::new(env!("CARGO_BIN_EXE_endoscape"));
    let mut child = command.args(arguments).arg(config).stderr(Stdio::null()).stdout(Stdio::null()).spawn().unwrap();
    let (metrics, begun) = (folder.path(".out.adapting/metrics.csv"), Instant::now());
    while fs::read_to_string(&metrics).unwrap_or_default().lines().count() < 4 {
        assert!(begun.elapsed() < Duration::from_secs(300), "no step was taken");
        assert!(child.try_wait().unwrap().is_none(), "the adaptation ended by itself");
        std::thread::sleep(Duration::from_millis(5));
    }
    // SIGKILL on Unix: no handler runs.
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(before == weights(&given) && !Path::new(&out).exists());
    succeed(&words(&model, &tube, &out, "3"));
    assert!(Path::new(&out).is_dir() && !Path::new(&folder.path(".out.adapting")).exists());
}

#[test]
fn slips_are_told_in_one_sentence() {
    let folder = Folder::new();
    let (model, tube, out) = (model(), tube(), folder.path("out"));
    let told = |arguments: &[&str], word: &str| {
        let sentence = fail(arguments);
        assert!(sentence.contains(word), "{sentence}");
        assert!(!Path::new(&out).exists(), "something was left behind");
    };
    told(&words(&model, &folder.path("none"), &out, "1"), "no such file");
    told(&words(&folder.path("none"), &tube, &out, "1"), "no such checkpoint");
    told(&words(&model, &tube, &format!("{model}/best"), "1"), "is the given model");
    fs::create_dir_all(folder.path("mine/of")).unwrap();
    told(&words(&model, &tube, &folder.path("mine"), "1"), "is not a checkpoint");
    told(&words(&model, &folder.path("mine"), &out, "1"), "no known data set");
    let short = folder.path("short");
    succeed(&["convert", &tube, &short, "--range", "0..4"]);
    told(&words(&model, &short, &out, "1"), "longer");
}
