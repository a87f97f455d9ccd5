//! Runs the built binary as a user would.

#![allow(dead_code, reason = "each test file uses its own part")]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The built binary.
pub fn endoscape(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_endoscape")).args(arguments).output().unwrap()
}

/// Runs it, expects success, and returns what it printed.
pub fn succeed(arguments: &[&str]) -> String {
    let output = endoscape(arguments);
    let (out, err) = (text(&output.stdout), text(&output.stderr));
    assert!(output.status.success(), "endoscape {arguments:?} failed: {err}");
    out
}

/// Runs it, expects exit code 1 and one sentence, and returns that sentence.
pub fn fail(arguments: &[&str]) -> String {
    sentence(&endoscape(arguments))
}

/// The one sentence of a failed run; panics if the run did not fail as the contract says.
pub fn sentence(output: &Output) -> String {
    let (out, err) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(output.status.code(), Some(1), "stdout: {out}\nstderr: {err}");
    assert_eq!(out, "", "nothing belongs on standard output");
    let errors: Vec<&str> = err.lines().filter(|line| !line.starts_with("warning: ")).collect();
    assert_eq!(errors.len(), 1, "one sentence was expected: {err}");
    assert!(errors[0].starts_with("error: "), "{err}");
    assert!(!err.contains("panicked"), "{err}");
    errors[0].to_string()
}

/// JSON printed by a successful run.
pub fn json(arguments: &[&str]) -> serde_json::Value {
    serde_json::from_str(&succeed(arguments)).unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// The root of the repository.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().unwrap()
}

/// The repository's own sequence.
pub fn tube() -> String {
    root().join("fixtures/tube").display().to_string()
}

/// Real data beside the repository, where a developer has it; says so when it is absent.
pub fn shared(path: &str) -> Option<String> {
    let full = root().join("../shared/data").join(path);
    if !full.exists() {
        eprintln!("skipped: {} is not here", full.display());
        return None;
    }
    Some(full.display().to_string())
}

/// Copies a folder.
pub fn copy(from: impl AsRef<Path>, to: impl AsRef<Path>) {
    std::fs::create_dir_all(&to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.as_ref().join(entry.file_name());
        if entry.path().is_dir() {
            copy(entry.path(), target);
        } else {
            std::fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// Networks small enough for a test.
pub const TINY: &str = "
width = 64
height = 48
batch = 2
log_every = 1
validate_every = 4
validation_snippets = 2
checkpoint_seconds = 0.0
gap.fixed = 1
# Does not ask how long the run will be, so that one that is stopped early can be compared.
decay = 'constant'
[nets.disp]
encoder = [4, 4, 8, 8, 8, 8, 8]
decoder = [8, 8, 8, 8, 4, 4, 4]
[nets.pose]
encoder = [4, 4, 8, 8, 8]
motion = [8, 8]
mask_decoder = [8, 8, 4, 4, 4]
";

/// A training run of a few steps on the repository's sequence, made once per test program.
pub fn model() -> String {
    static RUN: std::sync::OnceLock<tempfile::TempDir> = std::sync::OnceLock::new();
    let folder = RUN.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let (config, out) = (folder.path().join("tiny.toml"), folder.path().join("run"));
        std::fs::write(&config, TINY).unwrap();
        let (config, out) = (config.display().to_string(), out.display().to_string());
        succeed(&["train", "--data", &tube(), "--out", &out, "--config", &config, "--steps", "6"]);
        folder
    });
    folder.path().join("run").display().to_string()
}

/// A recurrent network small enough for a test.
pub const SLIM: &str = "
width = 64
height = 48
batch = 1
subsequence = 6
truncation = 3
log_every = 1
checkpoint_seconds = 0.0
decay = 'constant'
[net]
stem = [4, 6]
blocks = [[2, 3, 2, 1], [3, 4, 3, 2], [4, 5, 4, 3]]
grid = 2
hidden = 8
";

/// A training run of the recurrent network on the repository's sequence, in metres.
pub fn recurrent_model(folder: &Folder, name: &str, steps: &str) -> String {
    let (config, out) = (folder.file("slim.toml", SLIM), folder.path(name));
    succeed(&["train", "--supervised", "--data", &tube(), "--out", &out, "--config", &config, "--steps", steps]);
    out
}

/// A temporary folder that is filled by name.
pub struct Folder(tempfile::TempDir);

impl Folder {
    /// An empty one.
    pub fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    /// Writes a file, with the folders above it, and returns its path.
    pub fn file(&self, name: &str, contents: impl AsRef<[u8]>) -> String {
        let path = self.0.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, contents).unwrap();
        path.display().to_string()
    }

    /// The path of a name, whether or not it exists.
    pub fn path(&self, name: &str) -> String {
        self.0.path().join(name).display().to_string()
    }
}
