//! Training as a user runs it: killed, resumed, and refused.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "test helpers fail by panicking and say what they skip"
)]

mod common;
use common::{TINY, fail, succeed, tube};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

struct Place {
    folder: tempfile::TempDir,
}

impl Place {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("tiny.toml"), TINY).unwrap();
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The arguments of a new run into `out`.
    fn begin(&self, out: &str, steps: &str) -> Vec<String> {
        let (out, config) = (self.path(out), self.path("tiny.toml"));
        let text = |path: &Path| path.display().to_string();
        let words = ["train", "--data", &tube(), "--out", &text(&out), "--config", &text(&config), "--steps", steps];
        words.map(str::to_owned).to_vec()
    }

    fn resume(&self, out: &str, steps: &str) -> Vec<String> {
        let out = self.path(out).display().to_string();
        ["train", "--data", &tube(), "--out", &out, "--resume", "--steps", steps].map(str::to_owned).to_vec()
    }
}

fn strs(words: &[String]) -> Vec<&str> {
    words.iter().map(String::as_str).collect()
}

/// Waits until the run has logged some steps.
fn wait_for_steps(child: &mut Child, metrics: &Path, lines: usize) {
    let begun = Instant::now();
    while fs::read_to_string(metrics).unwrap_or_default().lines().count() < lines {
        assert!(begun.elapsed() < Duration::from_secs(300), "no step was taken");
        assert!(child.try_wait().unwrap().is_none(), "the training ended by itself");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn a_killed_training_goes_on_as_if_nothing_had_happened() {
    let place = Place::new();
    succeed(&strs(&place.begin("whole", "12")));

    let binary = env!("CARGO_BIN_EXE_endoscape");
    let mut child = Command::new(binary).args(place.begin("killed", "100000")).stderr(Stdio::null()).spawn().unwrap();
    wait_for_steps(&mut child, &place.path("killed/metrics.csv"), 4);
    // SIGKILL on Unix: no handler runs.
    child.kill().unwrap();
    child.wait().unwrap();
    succeed(&strs(&place.resume("killed", "12")));

    let weights = |run: &str| fs::read(place.path(run).join("latest/weights.safetensors")).unwrap();
    assert!(weights("whole") == weights("killed"), "the weights differ");
}

#[test]
fn slips_are_told_before_anything_is_written() {
    let place = Place::new();
    let with = |change: &dyn Fn(&mut Vec<String>)| {
        let mut words = place.begin("run", "1");
        change(&mut words);
        fail(&strs(&words))
    };
    let sentence = with(&|words| words[2] = place.path("nothing").display().to_string());
    assert!(sentence.contains("no such file"), "{sentence}");
    let sentence = with(&|words| words.extend(["--size".into(), "8x8".into()]));
    assert!(sentence.contains("`width` is 8"), "{sentence}");
    let sentence = with(&|words| words[2] = format!("{}@900..901", tube()));
    assert!(sentence.contains("the range is empty"), "{sentence}");
    let sentence = with(&|words| words.extend(["--init".into(), place.path("none").display().to_string()]));
    assert!(sentence.contains("no such checkpoint"), "{sentence}");
    let sentence = fail(&strs(&place.resume("run", "2")));
    assert!(sentence.contains("no training run to resume"), "{sentence}");
    assert!(!place.path("run").exists(), "something was left behind");
}
