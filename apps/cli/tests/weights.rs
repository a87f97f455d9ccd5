//! `endoscape import` and `endoscape export` on the repository's own golden weights.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "test helpers fail by panicking and say what they skip"
)]

mod common;
use common::{endoscape, fail, root, succeed, tube};
use std::path::Path;

/// Imports the golden weights of both networks into one checkpoint and returns its path.
fn imported(folder: &Path) -> String {
    let model = folder.join("model").display().to_string();
    for file in ["port_disp.pth.tar", "port_pose.pth.tar"] {
        let weights = root().join("golden/nets").join(file);
        assert!(succeed(&["import", weights.to_str().unwrap(), &model]).contains("tensors matched"));
    }
    model
}

#[test]
fn weights_go_in_and_out() {
    let folder = tempfile::tempdir().unwrap();
    let model = &imported(folder.path());
    for name in ["both.onnx", "weights.safetensors"] {
        let out = folder.path().join(name);
        succeed(&["export", model, out.to_str().unwrap()]);
        assert!(std::fs::metadata(out).unwrap().len() > 10_000);
    }
    assert!(fail(&["export", model, folder.path().join("model.txt").to_str().unwrap()]).contains(".onnx"));
}

#[test]
fn weights_that_do_not_say_how_they_were_trained_are_used_with_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let model = imported(folder.path());
    let picture = |name: &str| format!("{}/frames/{name}", tube());
    let output = endoscape(&["motion", &picture("000000.png"), &picture("000001.png"), "--model", &model]);
    let told = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{told}");
    assert!(told.starts_with("warning: ") && told.contains("416x128") && told.contains("--size"), "{told}");
    assert_eq!(told.lines().count(), 1);
}

#[test]
fn what_is_no_weights_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (file, out) = (folder.path().join("weights.pth"), folder.path().join("model"));
    let whole = std::fs::read(root().join("golden/nets/port_disp.pth.tar")).unwrap();
    std::fs::write(&file, &whole[..whole.len() / 2]).unwrap();
    assert!(fail(&["import", file.to_str().unwrap(), out.to_str().unwrap()]).contains("weights.pth"));
    assert!(!out.exists());
}
