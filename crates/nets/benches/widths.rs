//! What a network's width costs on the CPU, at the paper's 128 x 416: the measurement behind the `fast` preset.
//!
//! `cargo bench -p endoscape-nets --features burn/simd,burn/rayon`
#![allow(clippy::unwrap_used, reason = "a benchmark has nobody to report an error to")]

use burn::tensor::{Device, Distribution, Tensor};
use divan::Bencher;
use endoscape_nets::{DispNetConfig, PoseMaskNetConfig};

const WIDTHS: [f64; 4] = [1.0, 0.5, 0.25, 0.125];
const TRAINING_BATCH: usize = 4;

fn main() {
    divan::main();
}

fn picture(batch: usize, channels: usize, device: &Device) -> Tensor<4> {
    Tensor::random([batch, channels, 128, 416], Distribution::Uniform(-1.0, 1.0), device)
}

#[divan::bench(args = WIDTHS, sample_count = 10, sample_size = 1)]
fn depth_of_one_frame(bencher: Bencher, width: f64) {
    let device = Device::flex();
    let net = DispNetConfig::default().with_width(width).init(0, &device).unwrap();
    let image = picture(1, 3, &device);
    bencher.bench_local(|| {
        let [disparity, ..] = net.forward(image.clone()).scales;
        disparity.into_data()
    });
}

#[divan::bench(args = WIDTHS, sample_count = 10, sample_size = 1)]
fn motion_of_one_snippet(bencher: Bencher, width: f64) {
    let device = Device::flex();
    let net = PoseMaskNetConfig::default().with_width(width).init(0, &device).unwrap();
    let frames = [picture(1, 3, &device), picture(1, 3, &device), picture(1, 3, &device)];
    let [target, sources @ ..] = &frames;
    bencher.bench_local(|| net.forward_motion(target.clone(), sources).into_data());
}

/// Forward and backward of both networks, without warp, loss and optimiser.
#[divan::bench(args = WIDTHS, sample_count = 3, sample_size = 1)]
fn gradients_of_one_batch(bencher: Bencher, width: f64) {
    let device = Device::flex().autodiff();
    let disp = DispNetConfig::default().with_width(width).init(0, &device).unwrap();
    let pose = PoseMaskNetConfig::default().with_width(width).init(0, &device).unwrap();
    let snippet = picture(TRAINING_BATCH, 9, &device);
    bencher.bench_local(|| {
        let [disparity, ..] = disp.forward(snippet.clone().narrow(1, 0, 3)).scales;
        let seen = pose.forward_snippet(snippet.clone());
        let mask = seen.mask.into_iter().flatten().map(Tensor::mean);
        mask.fold(disparity.mean() + seen.motion.mean(), |sum, mask| sum + mask).backward()
    });
}
