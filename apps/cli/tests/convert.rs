//! `endoscape convert`: what is written reads back the same, and nothing is left of a failure.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "test helpers fail by panicking and say what they skip"
)]

mod common;
use common::{endoscape, fail, json, root, sentence, shared, succeed, tube};
use endoscape_core::{CameraModel, Size};
use endoscape_frames::formats;
use std::process::Command;

#[test]
fn a_copy_is_the_same_sequence() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("copy");
    succeed(&["convert", &tube(), out.to_str().unwrap()]);
    let (a, b) = (formats::open(tube().as_ref(), None).unwrap(), formats::open(&out, None).unwrap());
    assert_eq!(a.camera, b.camera);
    assert_eq!(a.frames.len(), b.frames.len());
    for (position, (x, y)) in a.frames.iter().zip(&b.frames).enumerate() {
        assert_eq!((x.number, x.time_s), (y.number, y.time_s));
        let (x_pose, y_pose) = (x.world_from_camera.unwrap(), y.world_from_camera.unwrap());
        assert!((x_pose.to_homogeneous() - y_pose.to_homogeneous()).amax() < 1e-9);
        assert_eq!(a.read_image(position).unwrap(), b.read_image(position).unwrap());
    }
}

#[test]
fn rectifying_keeps_depth_and_poses_consistent() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("pinhole");
    succeed(&["convert", &tube(), out.to_str().unwrap(), "--rectify", "--size", "120x96", "--hfov", "80"]);
    let found = json(&["inspect", out.to_str().unwrap(), "--json"]);
    assert_eq!((&found["width"], &found["camera"]["model"]), (&120.into(), &"pinhole".into()));
    assert!((found["horizontal_fov_deg"].as_f64().unwrap() - 80.0).abs() < 1e-6);
    assert!(found["depth_consistency"]["median_m"].as_f64().unwrap() < 1e-4);
}

#[test]
fn ranges_and_strides_pick_frames() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("some");
    succeed(&["convert", &tube(), out.to_str().unwrap(), "--range", "2..9", "--every", "3"]);
    let sequence = formats::open(&out, None).unwrap();
    assert_eq!(sequence.frames.iter().map(|frame| frame.number).collect::<Vec<_>>(), [2, 5, 8]);
}

#[test]
fn resizing_scales_the_intrinsics() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("half");
    succeed(&["convert", &tube(), out.to_str().unwrap(), "--size", "80x64"]);
    let sequence = formats::open(&out, None).unwrap();
    let camera = sequence.camera.unwrap();
    assert_eq!(
        camera,
        formats::open(tube().as_ref(), None).unwrap().camera.unwrap().scaled_to(Size::new(80, 64)).unwrap()
    );
    assert!(matches!(camera.model(), CameraModel::KannalaBrandt(lens) if lens.intrinsics.cx == 0.5 * 80.5 - 0.25));
}

#[test]
fn an_occupied_folder_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("precious.txt"), "mine").unwrap();
    fail(&["convert", &tube(), folder.path().to_str().unwrap()]);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn requests_that_cannot_be_met_write_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let out = out.to_str().unwrap();
    assert!(fail(&["convert", &tube(), out, "--range", "5..99"]).contains("do not exist in 12 frames"));
    let pictures = root().join("fixtures/tube/frames");
    assert!(fail(&["convert", pictures.to_str().unwrap(), out, "--rectify"]).contains("--camera"));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    let wrong_call = endoscape(&["convert", &tube(), out, "--size", "0x10"]);
    assert_eq!(wrong_call.status.code(), Some(2));
}

/// A limit on file sizes stands for a full disk: writing fails half-way through, whoever runs the test.
#[test]
#[cfg(unix)]
fn a_disk_that_fills_up_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let script = format!(
        "trap '' XFSZ; ulimit -f 20; exec {} convert {} {}",
        env!("CARGO_BIN_EXE_endoscape"),
        tube(),
        out.display()
    );
    let output = Command::new("bash").args(["-c", &script]).output().unwrap();
    assert!(sentence(&output).contains("cannot write"));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn c3vd_rectified_stays_consistent() {
    let Some(path) = shared("c3vd/cecum_t1_a") else { return };
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("c3vd");
    let range = ["--range", "0..31"];
    succeed(&[&["convert", &path, out.to_str().unwrap(), "--rectify", "--size", "320x256"], &range[..]].concat());
    let found = json(&["inspect", out.to_str().unwrap(), "--json"]);
    let check = &found["depth_consistency"];
    assert_eq!((&check["frame_a"], &check["frame_b"]), (&0.into(), &30.into()));
    assert!(check["median_m"].as_f64().unwrap() <= 1e-4, "{check}");
}
