//! Arrows between crates go one way; ARCHITECTURE.md names them and this test holds them.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "test helpers fail by panicking and say what they skip"
)]

use std::process::Command;

/// Each crate of ours and those of ours it may use.
const ALLOWED: &[(&str, &[&str])] = &[
    ("endoscape-core", &[]),
    ("endoscape-baselines", &["endoscape-core", "endoscape-frames"]),
    ("endoscape-frames", &["endoscape-core"]),
    ("endoscape-eval", &["endoscape-core", "endoscape-frames"]),
    ("endoscape-kernels", &[]),
    ("endoscape-nets", &["endoscape-core", "endoscape-kernels"]),
    ("endoscape-synthesis", &["endoscape-core", "endoscape-kernels"]),
    (
        "endoscape-train",
        &["endoscape-core", "endoscape-frames", "endoscape-kernels", "endoscape-nets", "endoscape-synthesis"],
    ),
    (
        "endoscape-odometry",
        &["endoscape-baselines", "endoscape-core", "endoscape-frames", "endoscape-nets", "endoscape-synthesis"],
    ),
    ("endoscape-report", &["endoscape-core", "endoscape-frames", "endoscape-eval"]),
    ("endoscape-sim", &["endoscape-core", "endoscape-frames"]),
    ("endoscape", ROOMS),
    ("endoscape-cli", ROOMS),
];

/// What the facade stands in front of.
const ROOMS: &[&str] = &[
    "endoscape-baselines",
    "endoscape-core",
    "endoscape-eval",
    "endoscape-frames",
    "endoscape-nets",
    "endoscape-odometry",
    "endoscape-report",
    "endoscape-sim",
    "endoscape-synthesis",
    "endoscape-train",
];

/// Crates that may link Burn; all others stay light.
const WITH_BURN: &[&str] =
    &["endoscape", "endoscape-nets", "endoscape-odometry", "endoscape-synthesis", "endoscape-train", "endoscape-cli"];

fn packages() -> Vec<serde_json::Value> {
    let arguments = ["metadata", "--format-version", "1", "--no-deps", "--offline"];
    let output = Command::new(env!("CARGO")).args(arguments).current_dir(env!("CARGO_MANIFEST_DIR")).output().unwrap();
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    metadata["packages"].as_array().unwrap().clone()
}

fn normal_dependencies(package: &serde_json::Value) -> Vec<String> {
    let all = package["dependencies"].as_array().unwrap().iter();
    let normal = all.filter(|dependency| dependency["kind"].is_null());
    normal.map(|dependency| dependency["name"].as_str().unwrap().to_string()).collect()
}

#[test]
fn crates_use_only_what_the_architecture_allows() {
    for package in packages() {
        let name = package["name"].as_str().unwrap();
        let (_, allowed) = ALLOWED.iter().find(|(crate_name, _)| *crate_name == name).unwrap_or_else(|| {
            panic!("{name} is not in this table; add it here and to ARCHITECTURE.md");
        });
        for used in normal_dependencies(&package).iter().filter(|used| used.starts_with("endoscape-")) {
            assert!(allowed.contains(&used.as_str()), "{name} must not use {used}");
        }
    }
}

#[test]
fn only_the_learning_crates_link_burn() {
    for package in packages() {
        let name = package["name"].as_str().unwrap();
        let burn = normal_dependencies(&package).iter().any(|used| used == "burn" || used.starts_with("burn-"));
        assert!(!burn || WITH_BURN.contains(&name), "{name} must not link Burn");
    }
}
