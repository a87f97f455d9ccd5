//! `endoscape compare` and `endoscape report`, driven as a user drives them.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "helpers of tests fail and speak as tests do"
)]

mod common;

use common::{Folder, endoscape, fail, json, succeed, tube};
use std::path::Path;

/// A winding path in the TUM format; each position is off by up to `error`.
fn tum(error: f64, frames: std::ops::Range<u32>) -> String {
    let line = |frame: u32| {
        let angle = 0.1 * f64::from(frame);
        let off = error * (3.1 * angle).sin();
        let (x, y, z) = (angle.sin() + off, 0.3 * (1.7 * angle).cos() - off, 0.4 * angle);
        let (sin, cos) = (0.5 * angle.sin()).sin_cos();
        format!("{} {x} {y} {z} 0 {sin} 0 {cos}\n", f64::from(frame) * 0.04)
    };
    frames.map(line).collect()
}

#[test]
fn three_trajectories_of_other_programs_compare_without_ceremony() {
    let folder = Folder::new();
    let truth = folder.file("truth.txt", tum(0.0, 0..200));
    let good = folder.file("good.txt", tum(0.001, 0..200));
    let bad = folder.file("bad.txt", tum(0.1, 0..200));
    let lossy = folder.file("lossy.txt", tum(0.01, 0..120));
    let out = folder.path("out");
    let text = succeed(&["compare", "--truth", &truth, &good, &bad, &format!("partial={lossy}"), "--out", &out]);
    for word in ["good", "bad", "partial", "constant motion", "report.html", "60.00"] {
        assert!(text.contains(word), "{word}: {text}");
    }
    for file in ["report.html", "compare.json", "figures/paths.svg", "figures/paths.png", "figures/drift-by-length.csv"]
    {
        assert!(Path::new(&out).join(file).is_file(), "{file}");
    }
    let html = std::fs::read_to_string(Path::new(&out).join("report.html")).unwrap();
    assert!(html.contains("good, bad, partial on truth") && html.len() < 5_000_000);
    assert!(!html.contains("depth is shown"));
}

#[test]
fn several_sequences_give_wins_and_a_test() {
    let folder = Folder::new();
    let mut arguments = vec!["compare".to_owned()];
    for sequence in 0..6 {
        let range = 10 * sequence..200 + 10 * sequence;
        let file = |name: &str, error: f64| folder.file(&format!("{sequence}/{name}.txt"), tum(error, range.clone()));
        arguments.extend(["--truth".to_owned(), format!("s{sequence}={}", file("truth", 0.0))]);
        arguments.extend([file("ours", 0.001), file("theirs", 0.02)]);
    }
    arguments.extend(["--out".to_owned(), folder.path("out"), "--json".to_owned()]);
    let result = json(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
    let names: Vec<&str> =
        result["sequences"].as_array().unwrap().iter().map(|sequence| sequence["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["s0", "s1", "s2", "s3", "s4", "s5"]);
    assert_eq!((result["wins"]["best"].as_u64(), result["wins"]["wins"][0].as_u64()), (Some(0), Some(6)));
    assert_eq!(result["wins"]["tests"][1]["p_value"].as_f64(), Some(2.0 / 64.0));
    let html = std::fs::read_to_string(folder.path("out/report.html")).unwrap();
    assert!(html.contains("ours is better than theirs beyond chance") && html.contains("id=\"paths-6\""));
}

#[test]
fn json_is_that_of_the_file_and_agrees_with_eval() {
    let folder = Folder::new();
    let (truth, estimate) = (folder.file("t.txt", tum(0.0, 0..200)), folder.file("e.txt", tum(0.02, 0..200)));
    let result = json(&["compare", "--truth", &truth, &estimate, "--out", &folder.path("out"), "--json"]);
    let file = std::fs::read_to_string(folder.path("out/compare.json")).unwrap();
    assert_eq!(serde_json::from_str::<serde_json::Value>(&file).unwrap(), result);
    let alone = json(&["eval", "trajectory", &estimate, &truth, "--json"]);
    assert_eq!(result["sequences"][0]["methods"][0]["trajectory"], alone);
}

#[test]
fn a_sequence_folder_is_a_truth_with_pictures() {
    let folder = Folder::new();
    let poses = std::fs::read_to_string(Path::new(&tube()).join("poses.tum")).unwrap();
    let estimate = folder.file("estimate.txt", poses);
    let text = succeed(&["compare", "--truth", &tube(), &estimate, "--out", &folder.path("out"), "--align", "se3"]);
    assert!(text.contains("estimate beats every trivial answer"), "{text}");
}

#[test]
fn a_run_folder_is_reported_in_place() {
    let folder = Folder::new();
    let poses = std::fs::read_to_string(Path::new(&tube()).join("poses.tum")).unwrap();
    folder.file("run/trajectory.tum", poses);
    let printed = succeed(&["report", &folder.path("run"), "--truth", &tube()]);
    assert_eq!(printed.trim_end(), folder.path("run/report.html"));
    assert!(std::fs::read_to_string(folder.path("run/report.html")).unwrap().contains("run on tube"));
}

#[test]
fn bad_input_is_one_sentence() {
    let folder = Folder::new();
    let (truth, out) = (folder.file("t.txt", tum(0.0, 0..200)), folder.path("out"));
    let compare = |estimate: &str| fail(&["compare", "--truth", &truth, estimate, "--out", &out]);
    assert!(compare(&folder.file("prose.txt", "once upon a time\n")).contains("prose.txt"));
    assert!(compare(&folder.file("nan.txt", "0 NaN 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n")).contains("nan.txt"));
    let late = folder.file("late.txt", tum(0.0, 2000..2100));
    assert!(compare(&late).contains("late: no pose of the estimate"));
    std::fs::create_dir(folder.path("empty")).unwrap();
    assert!(compare(&folder.path("empty")).contains("empty"));
    assert!(compare(&folder.path("absent.txt")).contains("absent.txt"));
    let shares = fail(&["compare", "--truth", &truth, "--truth", &truth, &truth, "--out", &out]);
    assert!(shares.contains("1 runs cannot be shared out to 2 sequences"), "{shares}");
    assert!(fail(&["report", &folder.path("empty")]).contains("is no run folder"));
    assert!(!Path::new(&out).exists(), "nothing is written for bad input");
    assert_eq!(endoscape(&["compare", &truth, "--out", &out]).status.code(), Some(2));
}

#[test]
fn depth_of_another_shape_is_one_sentence() {
    let folder = Folder::new();
    let poses = std::fs::read_to_string(Path::new(&tube()).join("poses.tum")).unwrap();
    folder.file("run/trajectory.tum", poses);
    std::fs::create_dir_all(folder.path("run/depth")).unwrap();
    image::GrayImage::new(64, 64).save(folder.path("run/depth/000000.png")).unwrap();
    let sentence = fail(&["report", &folder.path("run"), "--truth", &tube()]);
    assert!(sentence.contains("000000.png") && sentence.contains("64x64"), "{sentence}");
}
