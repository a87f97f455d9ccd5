//! Networks, training and our own kernels give on Vulkan what they give on the processor. Mesa's software driver is
//! driver enough.
//!
//! `cargo test -p endoscape-cli --features vulkan --test vulkan`

#![cfg(feature = "vulkan")]
#![recursion_limit = "256"]
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "test helpers fail by panicking and say what they skip"
)]

mod common;
#[path = "vulkan/kernels.rs"]
mod kernels;

use burn::tensor::Device;
use burn::tensor::wgpu::WgpuBackend;
use common::{TINY, root, sentence, succeed, tube};
use endoscape_frames::picture;
use endoscape_nets::{Checkpoint, network_input};
use std::path::Path;
use std::sync::OnceLock;

/// The Vulkan device, where a driver answers. It can be opened once in a process.
fn vulkan() -> Option<Device> {
    static DEVICE: OnceLock<Option<Device>> = OnceLock::new();
    let open = || Device::wgpu_options().graphics_api(WgpuBackend::Vulkan).init();
    let device = DEVICE.get_or_init(|| open().inspect_err(|error| eprintln!("skipped: {error}")).ok());
    device.clone()
}

/// Disparity of a picture, and the gradient of its squares' sum by the picture.
fn disparity_and_gradient(device: &Device) -> [Vec<f32>; 2] {
    let device = device.clone().autodiff();
    let (model, _) = Checkpoint::import(&root().join("golden/nets/port_disp.pth.tar"), None, &device).unwrap();
    let image = picture::read(&root().join("fixtures/tube/frames/000000.png")).unwrap();
    let input = network_input(&image, &device).require_grad();
    let disparity = model.disp.unwrap().forward(input.clone()).scales[0].clone();
    let gradient = input.grad(&disparity.clone().square().sum().backward()).unwrap();
    [disparity.into_data(), gradient.into_data()].map(|data| data.iter().collect())
}

/// The largest difference, as a share of the largest number; infinite where one is a number and the other is none.
fn difference(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    let largest = a.iter().fold(1e-9_f32, |largest, value| largest.max(value.abs()));
    let apart = |(a, b): (&f32, &f32)| match (a.is_nan(), b.is_nan()) {
        (false, false) => (a - b).abs(),
        (true, true) => 0.0,
        _ => f32::INFINITY,
    };
    a.iter().zip(b).map(apart).fold(0.0, f32::max) / largest
}

#[test]
fn a_network_and_its_gradient_agree_with_the_processor() {
    let Some(gpu) = vulkan() else { return };
    let [disparity, gradient] = disparity_and_gradient(&Device::flex());
    let [gpu_disparity, gpu_gradient] = disparity_and_gradient(&gpu);
    let found = [difference(&disparity, &gpu_disparity), difference(&gradient, &gpu_gradient)];
    assert!(found[0] < 1e-4 && found[1] < 1e-3, "{found:?}");
}

/// The losses of every step of a short training: one row of `metrics.csv` each.
fn losses(folder: &Path, model: &str, device: &str) -> Vec<Vec<f32>> {
    let (out, config) = (folder.join(device), folder.join("tiny.toml"));
    std::fs::write(&config, format!("learning_rate = 1e-3\nwarmup = 0\n{TINY}")).unwrap();
    let (out_text, config) = (out.display().to_string(), config.display().to_string());
    let task = ["train", "--data", &tube(), "--out", &out_text, "--config", &config, "--init", model];
    succeed(&[&task[..], &["--steps", "4", "--device", device]].concat());
    let table = std::fs::read_to_string(out.join("metrics.csv")).unwrap();
    let columns = |line: &str| line.split(',').skip(4).map(|field| field.parse().unwrap()).collect();
    table.lines().skip(1).map(columns).collect()
}

#[test]
fn a_training_agrees_with_the_processor() {
    if vulkan().is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("model").display().to_string();
    for file in ["port_disp.pth.tar", "port_pose.pth.tar"] {
        succeed(&["import", root().join("golden/nets").join(file).to_str().unwrap(), &model]);
    }
    let (cpu, gpu) = (losses(folder.path(), &model, "cpu"), losses(folder.path(), &model, "vulkan"));
    assert_eq!(cpu.len(), 4);
    for (cpu, gpu) in cpu.iter().zip(&gpu) {
        assert!(difference(cpu, gpu) < 1e-3, "{cpu:?} {gpu:?}");
    }
    assert!((cpu[0][0] - cpu[3][0]).abs() > 1e-3 * cpu[0][0], "the weights have not moved: {cpu:?}");
}

#[test]
fn a_missing_driver_is_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_endoscape"));
    // Both names of the variable, of which loaders know one or the other.
    command.env("VK_ICD_FILENAMES", "/nonexistent").env("VK_DRIVER_FILES", "/nonexistent");
    command.args(["train", "--data", &tube(), "--device", "vulkan", "--out"]).arg(folder.path().join("out"));
    assert!(sentence(&command.output().unwrap()).contains("vulkan does not answer on this computer"));
}
