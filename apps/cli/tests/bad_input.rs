//! Whatever is wrong with an input: exit code 1, one sentence, nothing written.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "test helpers fail by panicking and say what they skip"
)]

mod common;
use common::{copy, fail, tube};
use std::fs;
use std::path::Path;

/// Inspects and converts a damaged input; both must refuse it with the same kind of sentence.
fn refused(path: &Path, words: &[&str]) {
    let path = path.to_str().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    for arguments in [vec!["inspect", path], vec!["convert", path, out.to_str().unwrap()]] {
        let sentence = fail(&arguments);
        for word in words {
            assert!(sentence.contains(word), "`{word}` is not in: {sentence}");
        }
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "something was left behind");
}

/// A copy of the fixture with one file changed.
fn damaged(file: &str, change: impl Fn(Vec<u8>) -> Vec<u8>) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    copy(tube(), folder.path());
    let path = folder.path().join(file);
    fs::write(&path, change(fs::read(&path).unwrap())).unwrap();
    folder
}

/// Changes one line (counted from 1) of a text file.
fn with_line(number: usize, line: &str) -> impl Fn(Vec<u8>) -> Vec<u8> {
    let line = line.to_string();
    move |bytes| {
        let text = String::from_utf8(bytes).unwrap();
        let mut lines: Vec<&str> = text.lines().collect();
        lines[number - 1] = &line;
        lines.join("\n").into_bytes()
    }
}

/// A folder like C3VD's: small pictures and a pose file.
fn c3vd(frames: usize, pose_lines: &[String]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let image = endoscape_core::Image::from_fn(endoscape_core::Size::new(27, 22), |x, y| [x as u8, y as u8, 9]);
    for number in 0..frames {
        endoscape_frames::picture::write_png(&folder.path().join(format!("{number}_color.png")), &image).unwrap();
    }
    fs::write(folder.path().join("pose.txt"), pose_lines.join("\n")).unwrap();
    folder
}

fn pose_lines(count: usize) -> Vec<String> {
    (0..count).map(|z| format!("1,0,0,0,0,1,0,0,0,0,1,0,0,0,{z},1")).collect()
}

#[test]
fn missing_and_empty_paths() {
    let folder = tempfile::tempdir().unwrap();
    refused(&folder.path().join("nowhere"), &["nowhere", "no such file or folder"]);
    refused(folder.path(), &["no pictures and no known data set"]);
}

#[test]
fn a_truncated_picture() {
    let folder = damaged("frames/000007.png", |bytes| bytes[..bytes.len() / 2].to_vec());
    refused(folder.path(), &["000007.png"]);
}

#[test]
fn a_picture_of_another_size() {
    let small = endoscape_core::Image::from_fn(endoscape_core::Size::new(8, 8), |_, _| [1; 3]);
    let folder = tempfile::tempdir().unwrap();
    copy(tube(), folder.path());
    endoscape_frames::picture::write_png(&folder.path().join("frames/000003.png"), &small).unwrap();
    refused(folder.path(), &["000003.png", "8x8", "160x128"]);
}

#[test]
fn a_truncated_video() {
    let folder = tempfile::tempdir().unwrap();
    let video = folder.path().join("clip.mp4");
    let made = std::process::Command::new("ffmpeg")
        .args(["-loglevel", "error", "-f", "lavfi", "-i", "testsrc=size=64x48:rate=10:duration=3"])
        .arg(&video)
        .status();
    if !made.is_ok_and(|status| status.success()) {
        eprintln!("skipped: ffmpeg is not here");
        return;
    }
    let bytes = fs::read(&video).unwrap();
    fs::write(&video, &bytes[..bytes.len() / 2]).unwrap();
    refused(&video, &["clip.mp4"]);
}

#[test]
fn poses_that_are_none() {
    let mut short = pose_lines(10);
    short[6] = short[6].rsplit_once(',').unwrap().0.to_string();
    refused(c3vd(10, &short).path(), &["pose.txt, line 7", "15"]);
    let mut nan = pose_lines(10);
    nan[3] = nan[3].replace("1,0,0,0,0,1", "nan,0,0,0,0,1");
    refused(c3vd(10, &nan).path(), &["pose.txt, line 4"]);
    let mut sheared = pose_lines(10);
    sheared[8] = "1,0.5,0,0,0,1,0,0,0,0,1,0,0,0,8,1".into();
    refused(c3vd(10, &sheared).path(), &["pose.txt, line 9", "not a rotation"]);
    refused(c3vd(10, &pose_lines(6)).path(), &["pose.txt", "6"]);
}

#[test]
fn a_camera_without_focal_length() {
    let folder = tempfile::tempdir().unwrap();
    copy(tube(), folder.path());
    let file = folder.path().join("camera.toml");
    let text = fs::read_to_string(&file).unwrap();
    let zero = text.lines().map(|line| if line.starts_with("fx") { "fx = 0.0" } else { line });
    fs::write(&file, zero.collect::<Vec<_>>().join("\n")).unwrap();
    refused(folder.path(), &["camera.toml", "fx"]);
}

#[test]
fn a_nan_in_a_pose_of_our_own_folder() {
    let folder = damaged("poses.tum", with_line(4, "0.3 nan 0 0 0 0 0 1"));
    refused(folder.path(), &["poses.tum, line 4", "nan"]);
}

#[test]
fn a_workbook_that_is_none() {
    let folder = tempfile::tempdir().unwrap();
    let (frames, poses) = (folder.path().join("Frames"), folder.path().join("Poses"));
    fs::create_dir_all(&frames).unwrap();
    fs::create_dir_all(&poses).unwrap();
    let image = endoscape_core::Image::from_fn(endoscape_core::Size::new(64, 48), |x, y| [x as u8, y as u8, 9]);
    for number in 0..3 {
        endoscape_frames::picture::write_png(&frames.join(format!("frame_{number:06}.png")), &image).unwrap();
    }
    fs::write(poses.join("low_pose.xlsx"), b"this is no workbook").unwrap();
    refused(folder.path(), &["low_pose.xlsx"]);
}

#[test]
fn two_data_sets_in_one_folder() {
    let folder = c3vd(4, &pose_lines(4));
    for entry in fs::read_dir(tube()).unwrap() {
        let entry = entry.unwrap();
        if entry.path().is_file() {
            fs::copy(entry.path(), folder.path().join(entry.file_name())).unwrap();
        }
    }
    refused(folder.path(), &["two data sets", "c3vd", "sequence"]);
}

#[test]
fn a_file_where_a_folder_should_be() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("cecum");
    fs::write(&file, "text").unwrap();
    refused(&file, &["cecum"]);
    fs::create_dir(folder.path().join("KITTI")).unwrap();
    let inside = folder.path().join("KITTI/poses");
    fs::write(&inside, "text").unwrap();
    refused(&inside.join("00.txt"), &["00.txt"]);
}

/// Permissions do not bind the superuser, so the check runs as nobody where that is possible.
#[test]
#[cfg(unix)]
fn a_folder_nobody_may_read() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = tempfile::tempdir().unwrap();
    let (binary, data) = (folder.path().join("endoscape"), folder.path().join("data"));
    fs::copy(env!("CARGO_BIN_EXE_endoscape"), &binary).unwrap();
    copy(tube(), &data);
    let allow = |path: &Path, mode| fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
    allow(folder.path(), 0o755);
    allow(&data, 0o000);
    let as_nobody = ["--reuid=65534", "--regid=65534", "--clear-groups"];
    let output = std::process::Command::new("setpriv").args(as_nobody).arg(&binary).arg("inspect").arg(&data).output();
    allow(&data, 0o755);
    let ran = output.ok().filter(|output| !String::from_utf8_lossy(&output.stderr).contains("setpriv"));
    let Some(output) = ran else {
        eprintln!("skipped: setpriv is not here or may not change the user");
        return;
    };
    assert!(common::sentence(&output).to_lowercase().contains("permission"));
}
