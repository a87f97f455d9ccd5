//! Every product beside a plain loop, on every level of the machine.

use crate::{Correlation, Epilogue, Geometry, GradientWorkspace, Level, Method, WeightGradient, Workspace};
use crate::{bias_gradient, relu_bias_gradient};
use proptest::prelude::*;

/// All triples of a large pixel, a weight and a small pixel that belong together, as indices.
fn for_each_product(geometry: &Geometry, batch: usize, mut visit: impl FnMut(usize, usize, usize)) {
    let Geometry { large_channels, small_channels, kernel, stride, before, large, small } = *geometry;
    for (picture, o, i) in triples([batch, small_channels, large_channels]) {
        for (y, x, tap) in triples([small[0], small[1], kernel * kernel]) {
            let row = (y * stride + tap / kernel).checked_sub(before[0]).filter(|row| *row < large[0]);
            let column = (x * stride + tap % kernel).checked_sub(before[1]).filter(|column| *column < large[1]);
            let (Some(row), Some(column)) = (row, column) else { continue };
            visit(
                ((picture * large_channels + i) * large[0] + row) * large[1] + column,
                (o * large_channels + i) * kernel * kernel + tap,
                ((picture * small_channels + o) * small[0] + y) * small[1] + x,
            );
        }
    }
}

fn triples(counts: [usize; 3]) -> impl Iterator<Item = (usize, usize, usize)> {
    let [a, b, c] = counts;
    (0..a * b * c).map(move |index| (index / (b * c), index / c % b, index % c))
}

/// Numbers in [-1, 1] without a pattern.
fn noise(count: usize, seed: u64) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / (1 << 23) as f32 - 1.0
    };
    (0..count).map(|_| next()).collect()
}

#[track_caller]
fn assert_close(actual: &[f32], expected: &[f64], tolerance: f64, what: &str) {
    let largest = expected.iter().fold(1e-3, |largest: f64, value| largest.max(value.abs()));
    for (index, (actual, expected)) in actual.iter().zip(expected).enumerate() {
        let error = (f64::from(*actual) - expected).abs() / largest;
        assert!(error < tolerance, "{what}: {actual} instead of {expected} at {index}");
    }
}

/// Compares all products of a geometry with the plain loop.
fn check(geometry: &Geometry, batch: usize, level: Level) {
    let large = noise(batch * geometry.large_channels * geometry.large_area(), 1);
    let small = noise(batch * geometry.small_channels * geometry.small_area(), 2);
    let weights = noise(geometry.weights(), 3);
    let bias = noise(geometry.small_channels.max(geometry.large_channels), 4);
    let mut expected = [vec![0.0; large.len()], vec![0.0; weights.len()], vec![0.0; small.len()]];
    for_each_product(geometry, batch, |l, w, s| {
        let [l_value, w_value, s_value] = [large[l], weights[w], small[s]].map(f64::from);
        expected[0][l] += w_value * s_value;
        expected[1][w] += l_value * s_value;
        expected[2][s] += l_value * w_value;
    });
    let what = |product: &str| format!("{product} of {geometry:?}, batch {batch}, {}", level.name());

    let directions = [
        (Correlation::to_small(geometry, level), &large, &expected[2], geometry.small_channels),
        (Correlation::to_large(geometry, level), &small, &expected[0], geometry.large_channels),
    ];
    for (correlation, input, expected, channels) in directions {
        for correlation in Method::ALL.map(|method| correlation.clone().by(method)) {
            let packed = correlation.pack(&weights);
            for relu in [false, true] {
                let mut output = vec![f32::NAN; expected.len()];
                let epilogue = Epilogue { bias: Some(&bias[..channels]), relu };
                correlation.run(input, &packed, epilogue, &mut output, &mut Workspace::default());
                let area = expected.len() / (batch * channels);
                let finished = expected.iter().enumerate().map(|(index, value)| {
                    let value = value + f64::from(bias[index / area % channels]);
                    if relu { value.max(0.0) } else { value }
                });
                let exact = matches!(correlation.method(), Method::Direct | Method::Deep);
                let tolerance = if exact { 1e-5 } else { 3e-5 };
                let what = format!("{:?} {}", correlation.method(), what("picture"));
                assert_close(&output, &finished.collect::<Vec<_>>(), tolerance, &what);
            }
        }
    }
    for method in Method::ALL {
        let product = WeightGradient::new(geometry, level, batch).by(method);
        let mut gradient = vec![f32::NAN; weights.len()];
        product.run(&large, &small, &mut gradient, &mut GradientWorkspace::default());
        assert_close(&gradient, &expected[1], 1e-4, &format!("{:?} {}", product.method(), what("weights")));
    }
}

/// The geometry of a convolution as the networks pad it.
fn convolution(channels: [usize; 2], kernel: usize, stride: usize, same: bool, large: [usize; 2]) -> Geometry {
    let small = large.map(|length| length.div_ceil(stride));
    let before = [0, 1].map(|axis| {
        let total = ((small[axis] - 1) * stride + kernel).saturating_sub(large[axis]);
        if same { total / 2 } else { (kernel - 1) / 2 }
    });
    Geometry { large_channels: channels[0], small_channels: channels[1], kernel, stride, before, large, small }
}

/// The geometry of an up-convolution that is cut to `large`.
fn up_convolution(channels: [usize; 2], kernel: usize, same: bool, large: [usize; 2]) -> Geometry {
    let dropped = if same { (kernel - 2) / 2 } else { (kernel - 1) / 2 };
    let small = large.map(|length| length.div_ceil(2));
    Geometry {
        large_channels: channels[1],
        small_channels: channels[0],
        kernel,
        stride: 2,
        before: [dropped; 2],
        large,
        small,
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn products_of_convolutions_are_those_of_the_plain_loop(
        channels in [1_usize..24, 1_usize..24],
        kernel in prop::sample::select(vec![1_usize, 3, 4, 5, 7]),
        stride in 1_usize..3,
        same in any::<bool>(),
        size in [1_usize..24, 1_usize..40],
        batch in 1_usize..4,
    ) {
        let geometry = convolution(channels, kernel, stride, same, size);
        Level::all().into_iter().for_each(|level| check(&geometry, batch, level));
    }

    #[test]
    fn products_of_up_convolutions_are_those_of_the_plain_loop(
        channels in [1_usize..24, 1_usize..24],
        kernel in prop::sample::select(vec![2_usize, 3, 4, 5, 7]),
        same in any::<bool>(),
        size in [1_usize..24, 1_usize..40],
        batch in 1_usize..4,
    ) {
        let geometry = up_convolution(channels, kernel, same, size);
        Level::all().into_iter().for_each(|level| check(&geometry, batch, level));
    }
}

#[test]
fn many_channels_and_wide_pictures_are_cut_correctly() {
    let geometries = [
        convolution([3, 32], 7, 2, false, [31, 200]),
        convolution([17, 16], 3, 1, false, [40, 211]),
        convolution([130, 140], 3, 1, false, [9, 13]),
        convolution([260, 130], 3, 2, true, [4, 13]),
        convolution([512, 512], 3, 1, false, [1, 4]),
        up_convolution([140, 130], 3, false, [7, 13]),
    ];
    for geometry in geometries {
        Level::all().into_iter().for_each(|level| check(&geometry, 2, level));
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let geometry = convolution([20, 24], 3, 1, false, [33, 47]);
    let results = |threads: usize, method: Method| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let (large, small) = (noise(2 * 20 * 33 * 47, 1), noise(2 * 24 * 33 * 47, 2));
            let correlation = Correlation::to_small(&geometry, Level::default()).by(method);
            let packed = correlation.pack(&noise(geometry.weights(), 3));
            let mut output = vec![0.0; small.len()];
            correlation.run(&large, &packed, Epilogue::default(), &mut output, &mut Workspace::default());
            let mut gradient = vec![0.0; geometry.weights()];
            let product = WeightGradient::new(&geometry, Level::default(), 2).by(method);
            product.run(&large, &small, &mut gradient, &mut GradientWorkspace::default());
            (output, gradient)
        })
    };
    for method in Method::ALL {
        assert_eq!(results(1, method), results(3, method));
    }
}

#[test]
fn a_bias_receives_the_sum_of_its_channel() {
    let gradient = noise(3 * 2 * 37, 5);
    let mut bias = [f32::NAN; 2];
    bias_gradient(&gradient, 37, &mut bias);
    let expected = [0, 1].map(|channel| {
        let planes = gradient.chunks_exact(37).skip(channel).step_by(2);
        planes.flatten().copied().map(f64::from).sum::<f64>()
    });
    assert_close(&bias, &expected, 1e-5, "bias");
}

#[test]
fn a_relu_stops_the_gradient_where_it_let_nothing_through() {
    let (before, output) = (noise(3 * 2 * 37, 5), noise(3 * 2 * 37, 6));
    let stopped = |(gradient, output): (&f32, &f32)| if *output > 0.0 { f64::from(*gradient) } else { 0.0 };
    let expected: Vec<f64> = before.iter().zip(&output).map(stopped).collect();
    let (mut gradient, mut bias) = (before, [f32::NAN; 2]);
    relu_bias_gradient(&mut gradient, &output, 37, &mut bias);
    assert_close(&gradient, &expected, 1e-9, "gradient");
    let sum = |channel: usize| expected.chunks_exact(37).skip(channel).step_by(2).flatten().sum::<f64>();
    assert_close(&bias, &[sum(0), sum(1)], 1e-5, "bias");
}
