//! Running a model as a user does: trained here, on good and on spoilt recordings.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "test helpers fail by panicking and say what they skip"
)]

mod common;
use common::{copy, endoscape, fail, json, model, root, sentence, succeed, tube};
use endoscape_core::{Image, Size};
use endoscape_frames::picture;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Frames of the fixture.
const FRAMES: usize = 12;
const CAMERA: &str = "fixtures/tube/camera.toml";

/// A new folder and the path of a run in it.
fn place() -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out").display().to_string();
    (folder, out)
}

fn run(input: &str, out: &str, more: &[&str]) -> Value {
    json(&[&["run", input, "--model", &model(), "--out", out, "--json"], more].concat())
}

/// Lines of `frames.csv` without its head: index, time, tracked, confidence, latency, warning.
fn rows(out: &str) -> Vec<Vec<String>> {
    let table = fs::read_to_string(Path::new(out).join("frames.csv")).unwrap();
    assert_eq!(table.lines().next(), Some("index,time_s,tracked,confidence,latency_ms,warning"));
    table.lines().skip(1).map(|line| line.splitn(6, ',').map(str::to_owned).collect()).collect()
}

fn lines(out: &str, file: &str) -> usize {
    fs::read_to_string(Path::new(out).join(file)).unwrap().lines().count()
}

fn files(out: &str, folder: &str) -> usize {
    fs::read_dir(Path::new(out).join(folder)).map_or(0, Iterator::count)
}

/// Every frame has a finite pose, whatever it shows.
fn assert_complete(out: &str, frames: usize) {
    assert_eq!(
        (lines(out, "trajectory.tum"), lines(out, "trajectory.kitti"), rows(out).len()),
        (frames, frames, frames)
    );
    let poses = endoscape_core::trajectory::parse_tum(&fs::read_to_string(format!("{out}/trajectory.tum")).unwrap());
    assert_eq!(endoscape_core::Trajectory::new(poses.unwrap()).unwrap().len(), frames);
}

fn camera() -> String {
    root().join(CAMERA).display().to_string()
}

#[test]
fn a_model_runs_and_its_results_can_be_evaluated() {
    let (folder, out) = place();
    let summary = run(&tube(), &out, &[]);
    assert_eq!((summary["method"].as_str(), summary["device"].as_str()), (Some("learned"), Some("cpu")));
    let count = |key: &str| summary[key].as_u64().unwrap() as usize;
    assert_eq!(
        (count("frames"), count("tracked") + summary["lost_frames"].as_array().unwrap().len()),
        (FRAMES, FRAMES)
    );
    for key in ["fps", "peak_memory_mb"] {
        assert!(summary[key].as_f64().unwrap() > 0.0, "{key}");
    }
    for stage in ["decode", "preprocess", "depth", "motion", "scale", "write"] {
        let [p50, max] = ["p50", "max"].map(|key| summary["stages_ms"][stage][key].as_f64().unwrap());
        assert!(p50 <= max && max > 0.0, "{stage}");
    }
    assert!(summary["depth"]["unit_per_step"].as_f64().unwrap() > 0.0);
    assert_eq!(summary["depth"]["camera"]["height"], 51);
    assert_complete(&out, FRAMES);
    assert_eq!((files(&out, "depth"), files(&out, "reliability")), (FRAMES, FRAMES));
    let written: Value = serde_json::from_slice(&fs::read(format!("{out}/run.json")).unwrap()).unwrap();
    assert_eq!(written, summary);
    assert!(fs::read_to_string(format!("{out}/report.html")).unwrap().contains("</html>"));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "drafts were left behind");

    let trajectory = json(&["eval", "trajectory", &out, &tube(), "--align", "sim3", "--json"]);
    assert_eq!((trajectory["matched"].as_u64(), trajectory["completeness"].as_f64()), (Some(12), Some(1.0)));
    assert!(trajectory["ate_m"]["rmse"].as_f64().unwrap().is_finite());
    let depth = json(&["eval", "depth", &out, &tube(), "--json"]);
    assert_eq!(depth["frames"], 12);
    assert!(depth["abs_rel"].as_f64().unwrap() > 0.0);
}

#[test]
fn the_same_run_gives_the_same_bytes() {
    let ((_first, a), (_second, b)) = (place(), place());
    run(&tube(), &a, &[]);
    run(&tube(), &b, &[]);
    for file in ["trajectory.tum", "trajectory.kitti", "depth/000007.png", "reliability/000007.png"] {
        let read = |out: &str| fs::read(Path::new(out).join(file)).unwrap();
        assert!(read(&a) == read(&b), "{file} differs");
    }
}

#[test]
fn depth_is_stored_as_asked_and_both_forms_agree() {
    let ((_first, png), (_second, npy), (_third, none)) = (place(), place(), place());
    run(&tube(), &png, &[]);
    run(&tube(), &npy, &["--depth", "npy"]);
    run(&tube(), &none, &["--depth", "none", "--range", "2..5"]);
    let abs_rel = |out: &str| json(&["eval", "depth", out, &tube(), "--json"])["abs_rel"].as_f64().unwrap();
    let (a, b) = (abs_rel(&png), abs_rel(&npy));
    assert!((a - b).abs() < 2e-3 * b, "{a} and {b}");
    assert!(!Path::new(&none).join("depth").exists());
    assert_complete(&none, 3);
    assert_eq!(rows(&none)[0][0], "2");
}

/// The fixture's pictures with four spoilt ones among them: black (3), white (5), the one before (7), cut short (9).
fn spoilt() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let good = |index: usize| PathBuf::from(tube()).join(format!("frames/{index:06}.png"));
    let place = |index: usize| folder.path().join(format!("{index:06}.png"));
    let flat = |value: u8| Image::from_fn(Size::new(160, 128), |_, _| [value; 3]);
    let mut next = 0;
    for index in 0..FRAMES + 3 {
        match index {
            3 => picture::write_png(&place(index), &flat(0)).unwrap(),
            5 => picture::write_png(&place(index), &flat(255)).unwrap(),
            7 => drop(fs::copy(place(6), place(7)).unwrap()),
            _ => {
                fs::copy(good(next), place(index)).unwrap();
                next += 1;
            }
        }
    }
    let bytes = fs::read(place(9)).unwrap();
    fs::write(place(9), &bytes[..bytes.len() / 2]).unwrap();
    folder
}

#[test]
fn spoilt_frames_get_a_pose_a_low_confidence_and_a_warning() {
    let (folder, (_place, out)) = (spoilt(), place());
    let summary = run(folder.path().to_str().unwrap(), &out, &["--camera", &camera()]);
    assert_complete(&out, FRAMES + 3);
    assert_eq!(summary["frames"], 15);
    let rows = rows(&out);
    for (index, word) in [(3, "black"), (5, "over-exposed"), (7, "repeats"), (9, "000009.png")] {
        let [_, _, tracked, confidence, _, warning] = &rows[index][..] else { panic!("{:?}", rows[index]) };
        assert_eq!((tracked.as_str(), confidence.parse::<f64>().unwrap()), ("false", 0.0), "{warning}");
        assert!(warning.contains(word), "{word} is not in: {warning}");
    }
    for index in [0, 1, 2, 4, 6, 8, 10] {
        let flaws = ["black", "over-exposed", "repeat", "png"];
        assert!(flaws.iter().all(|flaw| !rows[index][5].contains(flaw)), "frame {index}: {}", rows[index][5]);
    }
    let lost: Vec<u64> = summary["lost_frames"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap()).collect();
    assert!([3, 5, 7, 9].iter().all(|frame| lost.contains(frame)), "{lost:?}");
    let tum = fs::read_to_string(format!("{out}/trajectory.tum")).unwrap();
    let pose = |index: usize| tum.lines().nth(index).unwrap().split_once(' ').unwrap().1.to_owned();
    assert_eq!(pose(6), pose(7), "a frozen picture moves nobody");
}

/// A video made by ffmpeg; `None`, said so, where ffmpeg is not here.
fn video(arguments: &[&str], path: &Path) -> Option<String> {
    let made = Command::new("ffmpeg").args(["-loglevel", "error"]).args(arguments).arg(path).status();
    if !made.is_ok_and(|status| status.success()) {
        eprintln!("skipped: ffmpeg is not here");
        return None;
    }
    Some(path.display().to_string())
}

#[test]
fn damaged_and_dark_stretches_of_a_video_lose_no_frame() {
    let (folder, out) = place();
    let path = folder.path().join("clip.avi");
    let dark = "geq=lum='if(between(N,5,7),0,lum(X,Y))':cb=128:cr=128";
    let made =
        video(&["-f", "lavfi", "-i", "testsrc=size=96x64:rate=10:duration=3", "-vf", dark, "-c:v", "mjpeg"], &path);
    let Some(input) = made else { return };
    // Every frame of this kind of video is a JPEG of its own; two of them lose their contents.
    let mut bytes = fs::read(&path).unwrap();
    let starts: Vec<usize> = (0..bytes.len() - 3).filter(|at| bytes[*at..*at + 3] == [0xFF, 0xD8, 0xFF]).collect();
    for frame in [12, 13] {
        bytes[starts[frame] + 2..starts[frame + 1] - 16].fill(0x55);
    }
    fs::write(&path, bytes).unwrap();
    let summary = run(&input, &out, &["--hfov", "80"]);
    assert_eq!(summary["frames"], 30);
    assert_complete(&out, 30);
    let rows = rows(&out);
    assert!((5..8).all(|frame| rows[frame][5].contains("black") && rows[frame][2] == "false"), "{rows:?}");
    assert!((12..14).all(|frame| !rows[frame][5].is_empty() && rows[frame][2] == "false"), "{rows:?}");
}

#[test]
fn one_frame_is_a_video_too() {
    let (folder, out) = place();
    let source = ["-f", "lavfi", "-i", "testsrc=size=96x64:rate=10:duration=1", "-frames:v", "1"];
    let Some(input) = video(&source, &folder.path().join("one.mp4")) else { return };
    let summary = run(&input, &out, &["--hfov", "80"]);
    assert_eq!((summary["frames"].as_u64(), summary["tracked"].as_u64()), (Some(1), Some(1)));
    assert_complete(&out, 1);
}

#[test]
fn a_picture_of_numbers_that_are_none_is_a_picture() {
    let (folder, (_place, out)) = (tempfile::tempdir().unwrap(), place());
    for index in 0..3 {
        let colour = |x: u32, y: u32| {
            let value = ((x * (3 + index) + 7 * y) % 50) as f32 / 50.0;
            image::Rgb(if index == 1 && x < 40 { [f32::NAN, f32::INFINITY, -1.0] } else { [value; 3] })
        };
        let picture = image::Rgb32FImage::from_fn(96, 64, colour);
        image::DynamicImage::from(picture).save(folder.path().join(format!("{index}.tiff"))).unwrap();
    }
    run(folder.path().to_str().unwrap(), &out, &["--camera", &camera()]);
    assert_complete(&out, 3);
}

/// Refused with one sentence that holds the words, and nothing written.
fn refused(input: &str, model: &str, more: &[&str], words: &[&str]) {
    let (folder, out) = place();
    let sentence = fail(&[&["run", input, "--model", model, "--out", &out], more].concat());
    for word in words {
        assert!(sentence.contains(word), "`{word}` is not in: {sentence}");
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "something was left behind");
}

/// A copy of the model with one file of its checkpoint changed.
fn spoilt_model(file: &str, change: impl Fn(Vec<u8>) -> Vec<u8>) -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    copy(Path::new(&model()).join("best"), folder.path());
    let path = folder.path().join(file);
    fs::write(&path, change(fs::read(&path).unwrap())).unwrap();
    let model = folder.path().display().to_string();
    (folder, model)
}

#[test]
fn models_that_do_not_fit_are_named() {
    let (_truncated, cut) = spoilt_model("weights.safetensors", |bytes| bytes[..bytes.len() / 2].to_vec());
    refused(&tube(), &cut, &[], &["weights.safetensors"]);
    let wider = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap().replacen("[4, 4, 8", "[4, 6, 8", 1).into_bytes();
    let (_mismatched, other) = spoilt_model("config.toml", wider);
    refused(&tube(), &other, &[], &["weights.safetensors", "restore the files of one checkpoint"]);
    let without = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap().replace("\"steps\"", "\"stops").into_bytes();
    let (_damaged, damaged) = spoilt_model("manifest.json", without);
    refused(&tube(), &damaged, &[], &["manifest.json"]);
    refused(&tube(), "no/such/model", &[], &["no/such/model", "no such checkpoint"]);
    let (folder, out) = place();
    let sentence = fail(&["run", &tube(), "--out", &out]);
    assert!(sentence.contains("--model"), "{sentence}");
    drop(folder);
}

#[test]
fn inputs_that_do_not_fit_are_named() {
    let two_sizes = spoilt();
    picture::write_png(&two_sizes.path().join("000004.png"), &Image::from_fn(Size::new(8, 8), |_, _| [1; 3])).unwrap();
    refused(two_sizes.path().to_str().unwrap(), &model(), &[], &["000004.png", "8x8", "160x128"]);
    let folder = tempfile::tempdir().unwrap();
    let camera = folder.path().join("camera.yaml");
    fs::write(&camera, "this is no calibration").unwrap();
    refused(&tube(), &model(), &["--camera", camera.to_str().unwrap()], &["camera.yaml"]);
    refused(&tube(), &model(), &["--range", "50..60"], &["has no frames from 50 on", "12 frames"]);
    refused(&tube(), &model(), &["--size", "8x8"], &["`width` is 8"]);
    let broken = tempfile::tempdir().unwrap();
    for entry in fs::read_dir(spoilt().path()).unwrap() {
        let bytes = fs::read(entry.as_ref().unwrap().path()).unwrap();
        fs::write(broken.path().join(entry.unwrap().file_name()), &bytes[..60]).unwrap();
    }
    refused(broken.path().to_str().unwrap(), &model(), &[], &["none of its frames can be decoded"]);
}

#[test]
fn a_method_that_is_not_there_is_a_wrong_call() {
    let output = endoscape(&["run", &tube(), "--method", "crystal-ball", "--model", &model()]);
    assert_eq!(output.status.code(), Some(2));
    let text = String::from_utf8(output.stderr).unwrap();
    assert!(text.contains("`crystal-ball` is no method") && text.contains("learned"), "{text}");
}

#[test]
#[cfg(feature = "orb")]
fn orb_slam_answers_every_frame() {
    let (_folder, out) = place();
    let summary = json(&["run", &tube(), "--method", "orb", "--preset", "endo", "--out", &out, "--json"]);
    assert_eq!((summary["method"].as_str(), summary["frames"].as_u64()), (Some("orb"), Some(12)));
    assert_complete(&out, FRAMES);
}

#[test]
#[cfg(not(feature = "orb"))]
fn a_build_without_orb_slam_says_how_to_get_it() {
    let output = endoscape(&["run", &tube(), "--method", "orb"]);
    assert_eq!(output.status.code(), Some(2));
    let text = String::from_utf8(output.stderr).unwrap();
    assert!(text.contains("build it with --features orb"), "{text}");
}

#[test]
fn results_never_replace_anything_and_need_a_folder() {
    let (folder, out) = place();
    fs::create_dir(&out).unwrap();
    fs::write(format!("{out}/notes.txt"), "mine").unwrap();
    let sentence = fail(&["run", &tube(), "--model", &model(), "--out", &out]);
    assert!(sentence.contains("already holds something"), "{sentence}");
    let missing = folder.path().join("none/out").display().to_string();
    let sentence = fail(&["run", &tube(), "--model", &model(), "--out", &missing]);
    assert!(sentence.contains("check that its parent folder exists"), "{sentence}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

/// A limit on the size of files refuses writes as a full disk does.
#[test]
#[cfg(unix)]
fn a_disk_that_refuses_leaves_nothing() {
    let (folder, out) = place();
    let limited = "trap '' XFSZ; ulimit -f 2; exec \"$0\" \"$@\"";
    let output = Command::new("sh")
        .args(["-c", limited, env!("CARGO_BIN_EXE_endoscape"), "run", &tube(), "--model", &model(), "--out", &out])
        .output()
        .unwrap();
    let sentence = sentence(&output);
    assert!(sentence.contains("cannot be written") && sentence.contains("out"), "{sentence}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "something was left behind");
}

#[test]
fn each_network_answers_alone() {
    let (folder, out) = place();
    let frame = |index: usize| format!("{}/frames/{index:06}.png", tube());
    succeed(&["depth", &frame(0), &frame(1), "--model", &model(), "--out", &out]);
    assert!(Path::new(&out).join("000001.png").is_file());
    let about: Value = serde_json::from_slice(&fs::read(format!("{out}/depth.json")).unwrap()).unwrap();
    assert!(about["unit_per_step"].as_f64().unwrap() > 0.0 && about["size"]["width"] == 64);
    let sentence = fail(&["depth", &frame(0), &frame(0), "--model", &model(), "--out", &format!("{out}2")]);
    assert!(sentence.contains("would both become 000000"), "{sentence}");

    let motions = json(&["motion", &frame(0), &frame(1), &frame(2), "--model", &model(), "--json"]);
    assert_eq!(motions["target"].as_str(), Some(frame(1).as_str()));
    assert_eq!(motions["motions"].as_array().unwrap().len(), 2);
    assert_eq!(motions["motions"][1]["source"].as_str(), Some(frame(2).as_str()));
    assert_eq!(motions["motions"][1]["source_from_target"][0].as_array().unwrap().len(), 4);
    let two = json(&["motion", &frame(0), &frame(1), "--model", &model(), "--json"]);
    assert_eq!(two["motions"].as_array().unwrap().len(), 1);
    let sentence = fail(&["motion", &frame(0), &frame(1), &frame(2), &frame(3), "--model", &model()]);
    assert!(sentence.contains("looks at 3 pictures but 4 were given"), "{sentence}");
    let small = folder.path().join("small.png");
    picture::write_png(&small, &Image::from_fn(Size::new(8, 8), |_, _| [1; 3])).unwrap();
    let sentence = fail(&["motion", &frame(0), small.to_str().unwrap(), "--model", &model()]);
    assert!(sentence.contains("small.png is 8x8"), "{sentence}");
}

/// `cargo test --release -p endoscape-cli --test run -- --ignored`: some ten minutes.
#[test]
#[ignore = "runs 100,000 frames"]
fn memory_does_not_grow_with_the_video() {
    let folder = tempfile::tempdir().unwrap();
    let peak = |frames: usize| {
        let source = format!("testsrc=size=64x48:rate=100:duration={}", frames / 100);
        let path = folder.path().join(format!("{frames}.mp4"));
        let input = video(&["-f", "lavfi", "-i", &source, "-preset", "ultrafast"], &path)?;
        let out = folder.path().join(format!("run{frames}")).display().to_string();
        let summary = run(&input, &out, &["--hfov", "80", "--depth", "none"]);
        assert_eq!(summary["frames"], frames as u64);
        assert_eq!(lines(&out, "trajectory.tum"), frames);
        summary["peak_memory_mb"].as_f64()
    };
    let Some((short, long)) = peak(1000).zip(peak(100_000)) else { return };
    eprintln!("peak memory: {short:.0} MB after 1,000 frames, {long:.0} MB after 100,000");
    // The list of frames, some 500 bytes each with its times, is known before the run begins.
    assert!(long < short + 60.0, "{short} MB became {long} MB");
}

#[test]
fn the_direct_method_needs_a_camera_but_no_model() {
    let (_folder, out) = place();
    let summary = json(&["run", &tube(), "--method", "direct", "--out", &out, "--json"]);
    assert_eq!((summary["method"].as_str(), summary["model"].is_null()), (Some("direct"), true));
    assert_eq!((summary["frames"].as_u64(), summary["lost_frames"].as_array().map(Vec::len)), (Some(12), Some(0)));
    assert_complete(&out, FRAMES);
    let trajectory = json(&["eval", "trajectory", &out, &tube(), "--align", "sim3", "--json"]);
    assert!(trajectory["ate_m"]["rmse"].as_f64().unwrap() < 2e-3);
    let pictures = root().join("fixtures/tube/frames").display().to_string();
    let (_elsewhere, out) = place();
    assert!(fail(&["run", &pictures, "--method", "direct", "--out", &out]).contains("needs the camera"));
}

#[test]
fn the_magnetic_method_finds_the_capsule_in_metres() {
    let (folder, out) = place();
    let patient = folder.path().join("patient").display().to_string();
    succeed(&["simulate", &patient, "--frames", "8", "--size", "32x32", "--effects", "none", "--seed", "3"]);
    let summary = json(&["run", &patient, "--method", "magnetic", "--out", &out, "--json"]);
    assert_eq!((summary["frames"].as_u64(), summary["depth"]["unit"].as_str()), (Some(8), Some("metres")));
    assert_complete(&out, 8);
    let trajectory = json(&["eval", "trajectory", &out, &patient, "--align", "none", "--json"]);
    assert!(trajectory["ate_m"]["rmse"].as_f64().unwrap() < 2e-3, "{trajectory}");
    assert!(Path::new(&out).join("report.html").exists());
    let (_elsewhere, out) = place();
    assert!(fail(&["run", &tube(), "--method", "magnetic", "--out", &out]).contains("holds no magnet.toml"));
    let part = |range| ["run", &patient, "--method", "magnetic", "--range", range, "--out", &out, "--json"];
    assert!(fail(&part("90..99")).contains("no reading lies in 90..99"));
    assert_eq!(json(&part("2..5"))["frames"].as_u64(), Some(3));
}

#[test]
fn the_fused_method_answers_every_frame_in_metres() {
    let (folder, out) = place();
    let patient = folder.path().join("patient").display().to_string();
    succeed(&["simulate", &patient, "--frames", "30", "--size", "96x96", "--effects", "none", "--seed", "3"]);
    let summary = json(&["run", &patient, "--method", "fused", "--out", &out, "--json"]);
    assert_eq!((summary["frames"].as_u64(), summary["depth"]["unit"].as_str()), (Some(30), Some("metres")));
    assert!(summary["config"]["settings"]["visual"]["points"].is_u64(), "{summary}");
    assert_complete(&out, 30);
    let trajectory = json(&["eval", "trajectory", &out, &patient, "--align", "none", "--json"]);
    assert!(trajectory["ate_m"]["rmse"].as_f64().unwrap() < 2e-3, "{trajectory}");
    let (_elsewhere, out) = place();
    assert!(fail(&["run", &tube(), "--method", "fused", "--out", &out]).contains("which the fused method needs"));
}
