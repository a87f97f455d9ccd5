//! `endoscape inspect` on our own fixture and, where it is present, on real data.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "test helpers fail by panicking and say what they skip"
)]

mod common;
use common::{copy, fail, json, shared, succeed, tube};

#[test]
fn the_fixture_is_consistent() {
    let found = json(&["inspect", &tube(), "--json"]);
    assert_eq!(found["format"], "sequence");
    assert_eq!(found["frames"], 12);
    assert_eq!(found["width"], 160);
    assert_eq!(found["camera"]["model"], "kannala-brandt");
    assert_eq!(found["has_poses"], true);
    assert_eq!(found["has_depth"], true);
    let check = &found["depth_consistency"];
    assert!(check["median_m"].as_f64().unwrap() < 2e-5, "{check}");
    assert!(check["inlier_share"].as_f64().unwrap() > 0.9, "{check}");
    assert_eq!(found["warnings"], serde_json::json!([]));
}

#[test]
fn wrong_conventions_are_told_apart_and_named() {
    let folder = tempfile::tempdir().unwrap();
    copy(tube(), folder.path());
    let poses = folder.path().join("poses.tum");
    let text = std::fs::read_to_string(&poses).unwrap();
    let inverted: Vec<_> = endoscape_core::trajectory::parse_tum(&text)
        .unwrap()
        .into_iter()
        .map(|pose| endoscape_core::TimedPose { world_from_camera: pose.world_from_camera.inverse(), ..pose })
        .collect();
    std::fs::write(&poses, endoscape_core::trajectory::to_tum(&inverted)).unwrap();
    let found = json(&["inspect", folder.path().to_str().unwrap(), "--json"]);
    let warnings = found["warnings"].to_string();
    assert!(warnings.contains("inverse pose (camera_from_world)"), "{warnings}");
}

#[test]
fn a_preview_is_a_picture() {
    let folder = tempfile::tempdir().unwrap();
    let sheet = folder.path().join("sheet.png");
    succeed(&["inspect", &tube(), "--preview", sheet.to_str().unwrap()]);
    assert!(endoscape_frames::picture::read(&sheet).unwrap().size().width > 1000);
}

#[test]
fn people_get_text() {
    let text = succeed(&["inspect", &tube()]);
    assert!(text.contains("12 frames of 160x128, format sequence"), "{text}");
    assert!(text.contains("as loaded"), "{text}");
}

#[test]
fn a_wrong_format_is_refused() {
    assert!(fail(&["inspect", &tube(), "--format", "c3vd"]).contains("no c3vd data"));
}

#[test]
fn c3vd_obeys_the_published_convention() {
    let Some(path) = shared("c3vd/cecum_t1_a") else { return };
    let found = json(&["inspect", &path, "--json"]);
    assert_eq!((&found["format"], &found["frames"]), (&"c3vd".into(), &150.into()));
    assert!((found["path_length_m"].as_f64().unwrap() - 0.0363).abs() < 5e-5);
    let check = &found["depth_consistency"];
    assert_eq!((&check["frame_a"], &check["frame_b"]), (&0.into(), &30.into()));
    let right = check["median_m"].as_f64().unwrap();
    assert!(right <= 3e-5, "{check}");
    for wrong in [
        "inverse pose (camera_from_world)",
        "inverse pose, OpenGL camera axes",
        "pinhole without distortion",
        "depth along the ray",
    ] {
        let scores = found["conventions"].as_array().unwrap();
        let score = scores.iter().find(|score| score["name"] == wrong).unwrap();
        if let Some(median) = score["median_m"].as_f64() {
            assert!(median > 20.0 * right, "{wrong}: {median}");
        }
    }
}

#[test]
fn every_real_sequence_is_recognised() {
    let expected = [
        ("c3vd/cecum_t1_a_original_files", "c3vd", 1),
        ("endoslam/UnityCam/Stomach", "endoslam-unity", 270),
        ("simcol3d/Frames", "simcol3d", 10),
        ("bronchoscope-phantom/VisualServoing_2024-09-29_18-55-31", "bronchoscope", 234),
        ("clips/rvim_endo.mp4", "video", 250),
        ("clips/eg_pulling_gt.mp4", "video", 63),
        ("clips/jk_endoscope.avi", "video", 183),
        ("kitti-odometry", "kitti-odometry", 300),
        ("kitti-odometry/sequences/00", "kitti-odometry", 300),
        ("kitti-raw/2011_09_26/2011_09_26_drive_0095_sync", "kitti-raw", 80),
        ("kitti-raw/2011_09_26/lidar_excerpt", "kitti-raw", 1),
        ("tum/freiburg1_rpy", "tum", 24),
    ];
    for (path, format, frames) in expected {
        let Some(path) = shared(path) else { return };
        let found = json(&["inspect", &path, "--json"]);
        assert_eq!((&found["format"], &found["frames"]), (&format.into(), &frames.into()), "{path}");
    }
}

#[test]
fn poses_of_another_recording_are_found_out() {
    let Some(path) = shared("endoslam/UnityCam/Stomach") else { return };
    let found = json(&["inspect", &path, "--json"]);
    let warnings = found["warnings"].to_string();
    assert!(warnings.contains("do not seem to belong to these frames"), "{warnings}");
}
