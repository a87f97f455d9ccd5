//! `endoscape eval`, driven as a user drives it.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "helpers of tests fail and speak as tests do"
)]

mod common;

use common::Folder;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn endoscape(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_endoscape")).arg("eval").args(arguments).output().unwrap()
}

/// The JSON object on standard output, and nothing else there.
fn json(arguments: &[&str]) -> serde_json::Value {
    let output = endoscape(&[arguments, &["--json"]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Exit code 1 and one sentence that holds `part`.
fn fails(arguments: &[&str], part: &str) {
    let output = endoscape(arguments);
    let sentence = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {sentence}");
    assert!(output.stdout.is_empty() && sentence.trim_end().lines().count() == 1, "{sentence}");
    assert!(sentence.starts_with("error: ") && sentence.contains(part), "{sentence}");
}

/// A winding path in the TUM format, positions multiplied by `scale`.
fn tum(scale: f64, frames: std::ops::Range<u32>) -> String {
    let line = |frame: u32| {
        let angle = 0.1 * f64::from(frame);
        let (x, y, z) = (angle.sin(), 0.3 * (1.7 * angle).cos(), 0.4 * angle);
        let (sin, cos) = (0.5 * angle.sin()).sin_cos();
        format!("{} {} {} {} 0 {sin} 0 {cos}\n", f64::from(frame) * 0.04, scale * x, scale * y, scale * z)
    };
    frames.map(line).collect()
}

#[test]
fn a_scaled_estimate_is_perfect_after_sim3_and_all_keys_are_there() {
    let folder = Folder::new();
    let (estimate, truth) = (folder.file("e.txt", tum(0.25, 0..200)), folder.file("t.txt", tum(1.0, 0..200)));
    let result = json(&["trajectory", &estimate, &truth]);
    assert!(result["ate_m"]["rmse"].as_f64().unwrap() < 1e-9);
    assert!((result["scale"].as_f64().unwrap() - 4.0).abs() < 1e-9);
    assert_eq!((result["matched"].as_u64(), result["completeness"].as_f64()), (Some(200), Some(1.0)));
    for key in ["estimate_frames", "truth_frames", "align", "endpoint_drift_percent"] {
        assert!(!result[key].is_null(), "{key}");
    }
    for statistic in ["rmse", "mean", "median", "std", "min", "max", "sse"] {
        for part in
            [&result["ate_m"], &result["rotation_deg"], &result["rpe"]["translation_m"], &result["rpe"]["rotation_deg"]]
        {
            assert!(part[statistic].is_f64(), "{statistic}");
        }
    }
    assert_eq!((result["rpe"]["unit"].as_str(), result["rpe"]["delta"].as_f64()), (Some("f"), Some(1.0)));
    let segment = &result["segments"][0];
    for key in ["length_m", "count", "translation_m", "translation_percent", "rotation_deg", "rotation_deg_per_m"] {
        assert!(segment[key].is_number(), "{key}");
    }
    for baseline in ["zero", "constant", "previous"] {
        assert!(result["baselines"][baseline]["ate_m"]["rmse"].as_f64().unwrap() > 1e-3, "{baseline}");
    }
}

#[test]
fn lost_frames_are_counted_and_warned_of() {
    let folder = Folder::new();
    let lost = tum(1.0, 0..80) + &tum(1.0, 120..200);
    let (estimate, truth) = (folder.file("e.txt", lost), folder.file("t.txt", tum(1.0, 0..200)));
    let result = json(&["trajectory", &estimate, &truth, "--align", "se3"]);
    assert_eq!(result["completeness"].as_f64(), Some(0.8));
    assert!(result["warnings"][0].as_str().unwrap().contains("80.0 %"));
    let windows = json(&["snippets", &estimate, &truth]);
    assert_eq!((windows["windows"].as_u64(), windows["windows_possible"].as_u64()), (Some(152), Some(196)));
}

#[test]
fn snippets_have_both_definitions() {
    let folder = Folder::new();
    let (estimate, truth) = (folder.file("e.txt", tum(2.0, 0..100)), folder.file("t.txt", tum(1.0, 0..100)));
    let result = json(&["snippets", &estimate, &truth, "--length", "5"]);
    assert_eq!((result["length"].as_u64(), result["windows"].as_u64()), (Some(5), Some(96)));
    for key in ["ate_published", "ate_rmse", "rotation_rad"] {
        assert!(result[key]["mean"].as_f64().unwrap() < 1e-6 && result[key]["std"].is_f64(), "{key}");
        for baseline in ["zero", "constant", "previous"] {
            assert!(result["baselines"][baseline][key]["mean"].as_f64().unwrap() > 1e-6, "{baseline} {key}");
        }
    }
    let zero = &result["baselines"]["zero"];
    let ratio = zero["ate_rmse"]["mean"].as_f64().unwrap() / zero["ate_published"]["mean"].as_f64().unwrap();
    assert!((ratio - 5_f64.sqrt()).abs() < 1e-9);
}

#[test]
fn an_inverted_chain_is_named() {
    let folder = Folder::new();
    let truth = folder.file("t.txt", tum(1.0, 0..200));
    // A straight line with a turning camera, written as camera_from_world.
    let inverted: String = tum(1.0, 0..200)
        .lines()
        .map(|line| {
            let n: Vec<f64> = line.split(' ').map(|number| number.parse().unwrap()).collect();
            let (sin, cos) = (2.0 * n[5] * n[7], n[7] * n[7] - n[5] * n[5]);
            format!(
                "{} {} {} {} 0 {} 0 {}\n",
                n[0],
                -(cos * n[1] - sin * n[3]),
                -n[2],
                -(sin * n[1] + cos * n[3]),
                -n[5],
                n[7]
            )
        })
        .collect();
    let result = json(&["trajectory", &folder.file("e.txt", inverted), &truth]);
    assert!(result["warnings"].to_string().contains("camera_from_world"), "{}", result["warnings"]);
}

#[test]
fn run_folders_and_sequence_folders_are_read() {
    let folder = Folder::new();
    folder.file("run/trajectory.tum", tum(0.5, 0..100));
    folder.file("patient/poses.tum", tum(1.0, 0..100));
    let result = json(&["trajectory", &folder.path("run"), &folder.path("patient")]);
    assert!(result["ate_m"]["rmse"].as_f64().unwrap() < 1e-9);
}

#[test]
fn tables_for_people_spreadsheets_and_papers() {
    let folder = Folder::new();
    let (estimate, truth) = (folder.file("e.txt", tum(0.5, 0..200)), folder.file("t.txt", tum(1.0, 0..200)));
    let text = |flag: &[&str]| {
        let output = endoscape(&[&["trajectory", &estimate, &truth], flag].concat());
        String::from_utf8(output.stdout).unwrap()
    };
    let table = text(&[]);
    assert!(table.contains("ATE rmse [m]") && table.contains("constant motion") && table.contains('*'), "{table}");
    assert!(text(&["--csv"]).contains("\nestimate,"));
    assert!(text(&["--latex"]).contains("\\textbf{"));
    assert_eq!(endoscape(&["trajectory", &estimate, &truth, "--csv", "--json"]).status.code(), Some(2));
}

#[test]
fn bad_trajectories_end_in_one_sentence() {
    let folder = Folder::new();
    let truth = folder.file("t.txt", tum(1.0, 0..50));
    let bad = |name: &str, contents: &str, part: &str| {
        let file = folder.file(name, contents);
        fails(&["trajectory", &file, &truth], part);
        fails(&["snippets", &file, &truth], part);
    };
    bad("prose", "Dear reader,\nthis is a letter.\n", "no trajectory");
    bad("empty", "", "holds no pose");
    bad("binary", "\u{0}\u{1}\u{2}", "no trajectory");
    bad("unsorted", "1 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1\n", "not sorted");
    bad("twins", "1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "same stamp");
    bad("later", "9000 0 0 0 0 0 0 1\n9001 0 0 0 0 0 0 1\n", "check the clocks");
    bad("zero", "0 0 0 0 0 0 0 0\n", "norm");
    bad("nan", "0 nan 0 0 0 0 0 1\n", "not a finite number");
    bad("vast", "0 0 0 0 0 0 0 1\n1 0 -1e200 0 0 0 0 1\n", "too large to be squared");
    bad("short", "0 0 0 0 0 0 0 1\n1 0 0\n", "line 2");
    bad("counts", "1 0 0 0 0 1 0 0 0 0 1 0\n", "--by-index");
    bad("one", "0 0 0 0 0 0 0 1\n", "needs");
    fails(&["trajectory", &folder.path("nothing"), &truth], "nothing");
    std::fs::create_dir(folder.path("hollow")).unwrap();
    fails(&["trajectory", &folder.path("hollow"), &truth], "hollow");
    fails(&["trajectory", &truth, &truth, "--rpe-delta", "999"], "--rpe-delta");
    fails(&["trajectory", &truth, &truth, "--tolerance", "nan"], "tolerance");
    fails(&["trajectory", &truth, &truth, "--lengths=-1"], "--lengths");
    let line: String = (0..50).map(|i| format!("{} {i} 0 0 0 0 0 1\n", f64::from(i) * 0.04)).collect();
    fails(&["trajectory", &folder.file("line", line), &truth], "one line or in one point");
    assert_eq!(endoscape(&["trajectory", &truth, &truth, "--align", "best"]).status.code(), Some(2));
}

/// The published figure of evo's own test data, by way of the program; skipped where the data are not here.
#[test]
fn kitti_00_by_orb_slam() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/trajectories/evo");
    let file = |name: &str| -> Option<PathBuf> { Some(folder.join(name)).filter(|path| path.is_file()) };
    let (Some(estimate), Some(truth)) = (file("KITTI_00_ORB.txt"), file("KITTI_00_gt.txt")) else {
        eprintln!("skipped: {} is not here", folder.display());
        return;
    };
    let result = json(&["trajectory", estimate.to_str().unwrap(), truth.to_str().unwrap(), "--align", "se3"]);
    assert!((result["ate_m"]["rmse"].as_f64().unwrap() - 1.3034497145650266).abs() < 1e-9);
}

/// Depth of a bowl in units of 0.1 mm.
fn bowl(width: u32, height: u32, factor: u16) -> image::ImageBuffer<image::Luma<u16>, Vec<u16>> {
    image::ImageBuffer::from_fn(width, height, |x, y| {
        let (x, y) = (f64::from(x) / f64::from(width), f64::from(y) / f64::from(height));
        image::Luma([factor * (300.0 + 200.0 * x + 100.0 * y * y) as u16])
    })
}

/// A sequence folder of three frames with depth, and a run folder with maps that are twice as deep.
fn depth_folders(folder: &Folder) -> (String, String) {
    folder.file("patient/sequence.toml", "version = 1\nname = 'bowl'\nunits = 'm'\ndepth_metres_per_unit = 0.0001\n");
    let mut frames = "index,time_s,file,depth,mask\n".to_owned();
    for number in 0..3 {
        frames += &format!("{number},{},frames/{number:06}.png,depth/{number:06}.png,\n", f64::from(number) * 0.04);
        folder.file(&format!("patient/frames/{number:06}.png"), "");
        let frame = image::RgbImage::from_pixel(40, 32, image::Rgb([90, 60, 60]));
        frame.save(folder.path(&format!("patient/frames/{number:06}.png"))).unwrap();
        for (place, factor) in [("patient", 1), ("run", 2)] {
            let file = folder.file(&format!("{place}/depth/{number:06}.png"), "");
            bowl(40, 32, factor).save(file).unwrap();
        }
    }
    folder.file("patient/frames.csv", frames);
    folder.file("run/run.json", "{\"depth_metres_per_unit\": 0.0001}");
    (folder.path("run"), folder.path("patient"))
}

#[test]
fn depth_is_judged_with_every_scaling() {
    let folder = Folder::new();
    let (run, patient) = depth_folders(&folder);
    let median = json(&["depth", &run, &patient]);
    assert_eq!(median["frames"].as_u64(), Some(3));
    assert!((median["scale"].as_f64().unwrap() - 0.5).abs() < 1e-6);
    for key in ["abs_rel", "sq_rel", "rmse_m", "rmse_log", "silog", "scale_std"] {
        assert!(median[key].as_f64().unwrap() < 0.01, "{key}");
    }
    for key in ["d1", "d2", "d3"] {
        assert_eq!(median[key].as_f64(), Some(1.0), "{key}");
    }
    assert!(median["baselines"]["constant"]["abs_rel"].as_f64().unwrap() > 0.05);
    let none = json(&["depth", &run, &patient, "--scaling", "none"]);
    assert!((none["abs_rel"].as_f64().unwrap() - 1.0).abs() < 1e-6);
    assert!(json(&["depth", &run, &patient, "--scaling", "sequence"])["abs_rel"].as_f64().unwrap() < 1e-3);
    let near = json(&["depth", &run, &patient, "--min", "0.031", "--max", "0.04", "--crop", "garg"]);
    assert_eq!(near["coverage"].as_f64(), Some(1.0));
}

#[test]
fn bad_depth_ends_in_one_sentence() {
    let folder = Folder::new();
    let (run, patient) = depth_folders(&folder);
    fails(&["depth", &folder.path("nothing"), &patient], "nothing");
    fails(&["depth", &run, &folder.path("nothing")], "nothing");
    std::fs::create_dir(folder.path("hollow")).unwrap();
    fails(&["depth", &folder.path("hollow"), &patient], "no depth map");
    fails(&["depth", &run, &patient, "--min", "1", "--max", "0.5"], "--min");
    fails(&["depth", &run, &patient, "--min", "50", "--max", "60"], "no pixel");
    bowl(20, 80, 1).save(folder.path("run/depth/000001.png")).unwrap();
    fails(&["depth", &run, &patient], "different shape");
    folder.file("run/depth/000001.png", "not a picture");
    fails(&["depth", &run, &patient], "000001.png");
}
