//! What every method promises: an answer for each observation of a spoilt recording, and an account of its cost.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "test helpers fail by panicking and say what they skip"
)]

mod common;
use common::{Folder, json, model, recurrent_model, succeed};
use endoscape_core::trajectory::parse_tum;
use endoscape_core::{Image, Pose, Size};
use endoscape_frames::picture;
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Frames of the recording. From [`JUMP`] on, camera and magnet are in another patient.
const FRAMES: usize = 24;
const JUMP: usize = 14;
/// Black pictures, and pictures that repeat the one before.
const BLACK: [usize; 2] = [5, 6];
const FROZEN: [usize; 2] = [9, 10];
/// A reading that is left out, one of empty cells, one of NaN, and one in which a third of the sensors is silent.
const LEFT_OUT: usize = 3;
const EMPTY: usize = 7;
const NAN: usize = 8;
const PATCHY: usize = 11;

fn simulated(folder: &Folder, name: &str, seed: &str) -> String {
    let out = folder.path(name);
    let frames = FRAMES.to_string();
    succeed(&["simulate", &out, "--frames", &frames, "--size", "96x96", "--effects", "none", "--seed", seed]);
    out
}

fn frame(patient: &str, index: usize) -> std::path::PathBuf {
    Path::new(patient).join(format!("frames/{index:06}.png"))
}

fn poses(file: &str) -> Vec<Pose> {
    parse_tum(&fs::read_to_string(file).unwrap()).unwrap().iter().map(|timed| timed.world_from_camera).collect()
}

/// A recording with everything that happens to recordings, and where the second patient's camera was at its end.
fn spoilt(folder: &Folder) -> (String, Pose) {
    let (patient, other) = (simulated(folder, "patient", "3"), simulated(folder, "other", "4"));
    for index in BLACK {
        picture::write_png(&frame(&patient, index), &Image::from_fn(Size::new(96, 96), |_, _| [0; 3])).unwrap();
    }
    for index in FROZEN {
        fs::copy(frame(&patient, FROZEN[0] - 1), frame(&patient, index)).unwrap();
    }
    for index in JUMP..FRAMES {
        fs::copy(frame(&other, index), frame(&patient, index)).unwrap();
    }
    let readings = |patient: &str| fs::read_to_string(format!("{patient}/magnet.csv")).unwrap();
    let (own, others) = (readings(&patient), readings(&other));
    let lines = own.lines().take(1 + JUMP).chain(others.lines().skip(1 + JUMP));
    let spoilt = lines.enumerate().filter(|(line, _)| *line != 1 + LEFT_OUT).map(|(line, text)| reading(line, text));
    fs::write(format!("{patient}/magnet.csv"), spoilt.collect::<String>()).unwrap();
    (patient, *poses(&format!("{other}/poses.tum")).last().unwrap())
}

/// A line of the readings as the recording has it; the first one is the head.
fn reading(line: usize, text: &str) -> String {
    let cell = |(column, cell): (usize, &str)| match line.checked_sub(1) {
        Some(EMPTY) if column > 1 => String::new(),
        Some(NAN) if column > 1 => "NaN".to_owned(),
        Some(PATCHY) if column > 1 && column / 3 % 3 == 0 => String::new(),
        _ => cell.to_owned(),
    };
    text.split(',').enumerate().map(cell).collect::<Vec<_>>().join(",") + "\n"
}

/// Every observation has a finite pose and a line, none is forgotten in the account, and the cost is told.
fn assert_promises_kept(summary: &Value, observations: usize) {
    let (method, out) = (summary["method"].as_str().unwrap(), summary["out"].as_str().unwrap());
    let table = fs::read_to_string(format!("{out}/frames.csv")).unwrap();
    let counted = (poses(&format!("{out}/trajectory.tum")).len(), table.lines().count() - 1);
    assert_eq!(counted, (observations, observations), "{method}");
    let lost = summary["lost_frames"].as_array().unwrap().len();
    assert_eq!(summary["tracked"].as_u64().unwrap() as usize + lost, observations, "{method}");
    for figure in [&summary["fps"], &summary["latency_ms"]["p95"], &summary["peak_memory_mb"]] {
        assert!(figure.as_f64().is_some_and(|figure| figure > 0.0), "{method}: {summary}");
    }
    assert!(Path::new(out).join("report.html").is_file(), "{method}");
}

/// Line by line: whether the method trusts its pose, its confidence, and what it says.
fn answers(out: &str) -> Vec<(bool, f64, String)> {
    let table = fs::read_to_string(format!("{out}/frames.csv")).unwrap();
    let answer = |line: &str| {
        let cells: Vec<&str> = line.splitn(6, ',').collect();
        (cells[2] == "true", cells[3].parse().unwrap(), cells[5].to_owned())
    };
    table.lines().skip(1).map(answer).collect()
}

fn run(folder: &Folder, patient: &str, method: &str, more: &[&str]) -> Value {
    let out = folder.path(method);
    json(&[&["run", patient, "--method", method, "--depth", "none", "--out", &out, "--json"], more].concat())
}

#[test]
fn methods_that_see_pictures_answer_spoilt_ones() {
    let folder = Folder::new();
    let ((patient, _), (learned, recurrent)) =
        (spoilt(&folder), (model(), recurrent_model(&folder, "recurrent-model", "1")));
    let methods: &[(&str, &[&str])] = &[
        ("learned", &["--model", &learned]),
        ("recurrent", &["--model", &recurrent]),
        ("direct", &[]),
        #[cfg(feature = "orb")]
        ("orb", &[]),
    ];
    for (method, more) in methods {
        let summary = run(&folder, &patient, method, more);
        assert_promises_kept(&summary, FRAMES);
        let answers = answers(summary["out"].as_str().unwrap());
        for index in BLACK {
            let (is_tracked, confidence, warning) = &answers[index];
            assert!(!is_tracked && *confidence == 0.0 && !warning.is_empty(), "{method}, frame {index}: {warning}");
        }
        // A picture that stands moves nobody.
        let poses = poses(&format!("{}/trajectory.tum", summary["out"].as_str().unwrap()));
        let moved = |a: usize, b: usize| (poses[a].translation.vector - poses[b].translation.vector).norm();
        let (frozen, way) = (moved(FROZEN[0] - 1, FROZEN[1]), moved(0, JUMP - 1));
        assert!(frozen <= 0.01 * way, "{method}: {frozen} of {way} while the picture stood still");
    }
}

#[test]
fn methods_that_read_the_magnet_answer_spoilt_readings_and_follow_a_jump() {
    let folder = Folder::new();
    let ((patient, last), learned) = (spoilt(&folder), model());
    let methods: [(&str, &[&str], usize); 2] =
        [("magnetic", &[], FRAMES - 1), ("fused", &["--model", &learned], FRAMES)];
    for (method, more, observations) in methods {
        let summary = run(&folder, &patient, method, more);
        assert_promises_kept(&summary, observations);
        let poses = poses(&format!("{}/trajectory.tum", summary["out"].as_str().unwrap()));
        // Where the magnet is does not depend on the turn about its axis; the camera is 9 mm in front of it.
        let magnet = |pose: &Pose| (pose * Pose::translation(0.0, 0.0, -0.009)).translation.vector;
        let off_m = (magnet(poses.last().unwrap()) - magnet(&last)).norm();
        assert!(off_m < 3e-3, "{method}: {off_m} m from the magnet at the end");
    }
    let magnetic = answers(&folder.path("magnetic"));
    for reading in [EMPTY, NAN] {
        // The reading before these is missing in the file.
        let (is_tracked, confidence, warning) = &magnetic[reading - 1];
        assert!(!is_tracked && *confidence == 0.0 && warning.contains("usable"), "reading {reading}: {warning}");
    }
    assert!(magnetic[PATCHY - 1].0, "{:?}", magnetic[PATCHY - 1]);
}
