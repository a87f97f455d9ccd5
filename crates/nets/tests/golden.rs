//! Agreement with independent implementations: NumPy (in the repository) and PyTorch (where the files are at hand).
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

mod common;

use burn::tensor::{Device, Tensor};
use common::{Expected, golden, shared_golden};
use endoscape_nets::{Checkpoint, DispNet, Network, PoseMaskNet, Rotation};
use std::path::Path;

fn import_disp(path: &Path, device: &Device) -> DispNet {
    let (checkpoint, report) = Checkpoint::import(path, Some(Network::Disp), device).unwrap();
    assert!(!report.matched.is_empty());
    checkpoint.disp.unwrap()
}

fn import_pose(path: &Path, device: &Device) -> PoseMaskNet {
    let (checkpoint, report) = Checkpoint::import(path, Some(Network::Pose), device).unwrap();
    assert!(!report.matched.is_empty());
    checkpoint.pose.unwrap()
}

/// Compares every output; names in the file end in `suffix`.
fn compare(expected: &Expected, disp: &DispNet, pose: &PoseMaskNet, motion_name: &str, suffix: &str, device: &Device) {
    let target: Tensor<4> = expected.tensor("target", device);
    let sources: Vec<_> = (0..pose.sources()).map(|i| expected.tensor(&format!("source{i}"), device)).collect();
    for (scale, disparity) in disp.forward(target.clone()).scales.into_iter().enumerate() {
        expected.assert_close(&format!("disp{scale}{suffix}"), disparity);
    }
    let seen = pose.forward(target.clone(), &sources);
    for (scale, mask) in seen.mask.unwrap().into_iter().enumerate() {
        expected.assert_close(&format!("mask{scale}{suffix}"), mask);
    }
    expected.assert_close(&format!("{motion_name}{suffix}"), seen.motion);
    expected.assert_close(&format!("{motion_name}{suffix}"), pose.forward_motion(target, &sources));
}

#[test]
fn imported_port_weights_give_the_numbers_of_numpy() {
    for device in [Device::flex(), Device::flex().autodiff()] {
        let disp = import_disp(&golden("port_disp.pth.tar"), &device);
        let pose = import_pose(&golden("port_pose.pth.tar"), &device);
        compare(&Expected::read(&golden("port_expected.safetensors")), &disp, &pose, "motion", "", &device);
    }
}

#[test]
fn the_paper_flavour_gives_the_numbers_of_numpy_in_training_and_inference() {
    let expected = Expected::read(&golden("paper_expected.safetensors"));
    for (device, suffix) in [(Device::flex(), ""), (Device::flex().autodiff(), "_train")] {
        let (checkpoint, report) = Checkpoint::import(&golden("paper_weights.safetensors"), None, &device).unwrap();
        assert!(!report.matched.is_empty());
        compare(&expected, &checkpoint.disp.unwrap(), &checkpoint.pose.unwrap(), "motion", suffix, &device);
    }
}

#[test]
fn imported_port_weights_give_the_numbers_of_pytorch() {
    let files = ["dispnet.pth.tar", "posenet.pth.tar", "expected.safetensors"].map(shared_golden);
    let [Some(disp), Some(pose), Some(expected)] = files else { return };
    let expected = Expected::read(&expected);
    for device in [Device::flex().autodiff(), Device::flex()] {
        let (disp, pose) = (import_disp(&disp, &device), import_pose(&pose, &device));
        compare(&expected, &disp, &pose, "pose", "", &device);
        let target: Tensor<4> = expected.tensor("target", &device);
        let sources = ["source0", "source1"].map(|name| expected.tensor(name, &device));
        let [disparity, ..] = disp.forward(target.clone()).scales;
        expected.assert_close("disp_eval", disparity);
        let seen = pose.forward(target, &sources);
        expected.assert_close("pose_eval", seen.motion);
        let [mask, ..] = seen.mask.unwrap();
        expected.assert_close("mask_eval", mask);
    }
}

#[test]
fn motions_become_the_matrices_of_pytorch() {
    let Some(path) = shared_golden("expected.safetensors") else { return };
    let (expected, device) = (Expected::read(&path), Device::flex());
    let vectors: Tensor<2> = expected.tensor("vector_for_matrix", &device);
    let vectors: Vec<f32> = vectors.into_data().iter().collect();
    for (rotation, name) in [(Rotation::Euler, "matrix_euler"), (Rotation::Quaternion, "matrix_quat")] {
        let matrices: Tensor<3> = expected.tensor(name, &device);
        let matrices: Vec<f32> = matrices.into_data().iter().collect();
        for (vector, matrix) in vectors.chunks_exact(6).zip(matrices.chunks_exact(12)) {
            let ours = rotation.pose(std::array::from_fn(|i| f64::from(vector[i]))).to_homogeneous();
            for (i, &theirs) in matrix.iter().enumerate() {
                assert!((ours[(i / 4, i % 4)] - f64::from(theirs)).abs() < 1e-6, "{name} entry {i}");
            }
        }
    }
}
