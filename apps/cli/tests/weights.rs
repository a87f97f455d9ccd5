//! `endoscape import` and `endoscape export` on the repository's own golden weights.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "test helpers fail by panicking and say what they skip"
)]

mod common;
use common::{fail, root, succeed};

#[test]
fn weights_go_in_and_out() {
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("model");
    let model = model.to_str().unwrap();
    for file in ["port_disp.pth.tar", "port_pose.pth.tar"] {
        let weights = root().join("golden/nets").join(file);
        assert!(succeed(&["import", weights.to_str().unwrap(), model]).contains("tensors matched"));
    }
    for name in ["both.onnx", "weights.safetensors"] {
        let out = folder.path().join(name);
        succeed(&["export", model, out.to_str().unwrap()]);
        assert!(std::fs::metadata(out).unwrap().len() > 10_000);
    }
    assert!(fail(&["export", model, folder.path().join("model.txt").to_str().unwrap()]).contains(".onnx"));
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
