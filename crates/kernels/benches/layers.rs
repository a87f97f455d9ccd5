//! Speed of layers of the two networks at 128 x 416, beside the fastest this machine multiplies at all.
//!
//! `cargo bench -p endoscape-kernels [-- BATCH]` prints milliseconds and GFLOP/s of each product; operations with
//! padding count.
#![allow(clippy::print_stdout, reason = "a benchmark prints")]

use endoscape_kernels::weight_gradient::GradientWorkspace;
use endoscape_kernels::{Correlation, Epilogue, Geometry, Level, Workspace, weight_gradient};
use std::time::Instant;

/// Name, channels of the large and the small picture, kernel, stride, rows and columns of the large one.
type Layer = (&'static str, [usize; 2], usize, usize, [usize; 2]);

const LAYERS: [Layer; 19] = [
    ("disp conv1 7x7/2", [3, 32], 7, 2, [128, 416]),
    ("disp conv1b 7x7", [32, 32], 7, 1, [64, 208]),
    ("disp conv2 5x5/2", [32, 64], 5, 2, [64, 208]),
    ("disp conv2b 5x5", [64, 64], 5, 1, [32, 104]),
    ("disp conv3 3x3/2", [64, 128], 3, 2, [32, 104]),
    ("disp conv3b 3x3", [128, 128], 3, 1, [16, 52]),
    ("disp conv4b 3x3", [256, 256], 3, 1, [8, 26]),
    ("disp conv5b 3x3", [512, 512], 3, 1, [4, 13]),
    ("disp conv7b 3x3", [512, 512], 3, 1, [1, 4]),
    ("disp iconv6 3x3", [1024, 512], 3, 1, [4, 13]),
    ("disp upconv5 3x3/2", [256, 512], 3, 2, [8, 26]),
    ("disp iconv4 3x3", [256, 128], 3, 1, [16, 52]),
    ("disp iconv3 3x3", [129, 64], 3, 1, [32, 104]),
    ("disp iconv2 3x3", [65, 32], 3, 1, [64, 208]),
    ("disp upconv1 3x3/2", [16, 32], 3, 2, [128, 416]),
    ("disp iconv1 3x3", [17, 16], 3, 1, [128, 416]),
    ("disp head1 3x3", [16, 1], 3, 1, [128, 416]),
    ("pose conv1 7x7/2", [9, 16], 7, 2, [128, 416]),
    ("pose upconv1 4x4/2", [16, 32], 4, 2, [128, 416]),
];

fn median_ms(mut run: impl FnMut()) -> f64 {
    run();
    let time = |_| {
        let begun = Instant::now();
        run();
        begun.elapsed().as_secs_f64() * 1e3
    };
    let mut times: Vec<f64> = (0..7).map(time).collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

fn main() {
    let batch = std::env::args().skip(1).find_map(|argument| argument.parse().ok()).unwrap_or(1);
    let level = Level::default();
    println!("{}, batch {batch}; milliseconds and GFLOP/s", level.name());
    println!("{:<20} {:>16} {:>16} {:>16}", "layer", "to small", "to large", "weights");
    let mut totals = [0.0; 3];
    for (name, [large_channels, small_channels], kernel, stride, large) in LAYERS {
        let small = large.map(|length| length.div_ceil(stride));
        let before = [(kernel - 1) / 2; 2];
        let geometry = Geometry { large_channels, small_channels, kernel, stride, before, large, small };
        let mut from = vec![0.5; batch * large_channels * geometry.large_area()];
        let mut to = vec![0.5; batch * small_channels * geometry.small_area()];
        let mut weights = vec![0.5; geometry.weights()];
        let (mut workspace, mut sums) = (Workspace::default(), GradientWorkspace::default());
        let mut best = [f64::INFINITY; 2];
        let mut all = String::new();
        for method in endoscape_kernels::Method::ALL {
            let Ok(down) = Correlation::to_small(&geometry, level).by(method) else { continue };
            let packed = down.pack(&weights);
            let small_ms = median_ms(|| down.run(&from, &packed, Epilogue::default(), &mut to, &mut workspace));
            let Ok(up) = Correlation::to_large(&geometry, level).by(method) else { continue };
            let packed = up.pack(&weights);
            let large_ms = median_ms(|| up.run(&to, &packed, Epilogue::default(), &mut from, &mut workspace));
            all += &format!("  {small_ms:>7.3} {large_ms:>7.3}");
            best = [best[0].min(small_ms), best[1].min(large_ms)];
        }
        let [small_ms, large_ms] = best;
        println!("{name:<20} {all}   chosen {:?} {:?}", Correlation::to_small(&geometry, level).method(), Correlation::to_large(&geometry, level).method());
        let weights_ms = median_ms(|| weight_gradient(&geometry, level, &from, &to, &mut weights, &mut sums));
        let cell = |ms: f64| format!("{ms:>9.3} {:>6.0}", (batch * geometry.operations()) as f64 / ms / 1e6);
        println!("{name:<20} {} {} {}", cell(small_ms), cell(large_ms), cell(weights_ms));
        for (total, ms) in totals.iter_mut().zip([small_ms, large_ms, weights_ms]) {
            *total += ms;
        }
    }
    println!("sum {totals:.1?} ms");
}
