//! Speed of the products of layers of the two networks at 128 x 416, by every method that can compute them.
//!
//! `cargo bench -p endoscape-kernels --bench layers [NAME]`; items are operations of the direct method, those with
//! padding included, so items per second are comparable between methods. The method chosen is marked by a star.

use divan::{Bencher, counter::ItemsCount};
use endoscape_kernels::{
    Correlation, Epilogue, Geometry, GradientWorkspace, Level, Method, WeightGradient, Workspace, awake,
};
use std::fmt;

/// Name, channels of the large and the small picture, kernel, stride, rows and columns of the large one.
type Layer = (&'static str, [usize; 2], usize, usize, [usize; 2]);

const LAYERS: [Layer; 25] = [
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
    ("pose conv2 5x5/2", [16, 32], 5, 2, [64, 208]),
    ("pose conv3 3x3/2", [32, 64], 3, 2, [32, 104]),
    ("pose conv4 3x3/2", [64, 128], 3, 2, [16, 52]),
    ("pose conv5 3x3/2", [128, 256], 3, 2, [8, 26]),
    ("pose conv6 3x3/2", [256, 256], 3, 2, [4, 13]),
    ("pose conv7 3x3/2", [256, 256], 3, 2, [2, 7]),
    ("pose upconv1 4x4/2", [16, 32], 4, 2, [128, 416]),
];
/// Pictures of a batch in training.
const BATCH: usize = 4;

fn main() {
    divan::main();
}

/// A layer and a method.
#[derive(Clone, Copy)]
struct Case {
    name: &'static str,
    geometry: Geometry,
    method: Method,
    chosen: bool,
}

impl fmt::Display for Case {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, method, chosen, .. } = self;
        write!(formatter, "{name} {method:?}{}", if *chosen { "*" } else { "" })
    }
}

fn geometry_of((_, [large_channels, small_channels], kernel, stride, large): Layer) -> Geometry {
    let small = large.map(|length| length.div_ceil(stride));
    Geometry { large_channels, small_channels, kernel, stride, before: [(kernel - 1) / 2; 2], large, small }
}

fn cases(products: impl Fn(&Geometry) -> (Method, Vec<Method>)) -> Vec<Case> {
    let mut cases = Vec::new();
    for layer in LAYERS {
        let geometry = geometry_of(layer);
        let (chosen, possible) = products(&geometry);
        let case = |method| Case { name: layer.0, geometry, method, chosen: chosen == method };
        cases.extend(possible.into_iter().map(case));
    }
    cases
}

/// All layers in one direction, by all methods that can compute them.
fn correlations(direction: fn(&Geometry, Level) -> Correlation) -> Vec<Case> {
    cases(|geometry| {
        let chosen = direction(geometry, Level::default());
        let possible = Method::ALL.into_iter().filter(|method| chosen.clone().by(*method).method() == *method);
        (chosen.method(), possible.collect())
    })
}

/// Gradients of weights of all layers, by all methods that can compute them.
fn gradients() -> Vec<Case> {
    cases(|geometry| {
        let chosen = WeightGradient::new(geometry, Level::default(), BATCH);
        let possible = Method::ALL.into_iter().filter(|method| chosen.clone().by(*method).method() == *method);
        (chosen.method(), possible.collect())
    })
}

fn correlate(bencher: Bencher, case: &Case, correlation: Correlation, [from, to]: [usize; 2]) {
    let correlation = correlation.by(case.method);
    let packed = correlation.pack(&vec![0.5; case.geometry.weights()]);
    let (input, mut output, mut workspace) = (vec![0.5; from], vec![0.0; to], Workspace::default());
    bencher
        .counter(ItemsCount::new(case.geometry.operations()))
        .bench_local(|| correlation.run(&input, &packed, Epilogue::default(), &mut output, &mut workspace));
}

/// From the large to the small picture: a convolution.
#[divan::bench(args = correlations(Correlation::to_small), sample_count = 9, sample_size = 1)]
fn to_small(bencher: Bencher, case: &Case) {
    let Geometry { large_channels, small_channels, .. } = case.geometry;
    let lengths = [large_channels * case.geometry.large_area(), small_channels * case.geometry.small_area()];
    correlate(bencher, case, Correlation::to_small(&case.geometry, Level::default()), lengths);
}

/// All layers of the motion network one after the other, on threads that are kept awake: a pass without its head.
#[divan::bench(sample_count = 200, sample_size = 1)]
fn motion_pass(bencher: Bencher) {
    let convolution = |geometry: Geometry| {
        let correlation = Correlation::to_small(&geometry, Level::default());
        let packed = correlation.pack(&vec![0.01; geometry.weights()]);
        (correlation, packed, vec![0.0; geometry.small_channels * geometry.small_area()])
    };
    let layers = LAYERS.into_iter().filter(|(name, ..)| name.starts_with("pose conv")).map(geometry_of);
    let mut layers: Vec<_> = layers.map(convolution).collect();
    let (picture, mut workspace) = (vec![0.5; 9 * 128 * 416], Workspace::default());
    let operations = layers.iter().map(|(correlation, ..)| correlation.geometry().operations()).sum::<usize>();
    let epilogue = Epilogue { bias: None, relu: true };
    bencher.counter(ItemsCount::new(operations)).bench_local(|| {
        awake(|| {
            let mut input = picture.as_slice();
            for (correlation, packed, output) in &mut layers {
                correlation.run(input, packed, epilogue, output, &mut workspace);
                input = output;
            }
        });
    });
}

/// From the small to the large picture: its data gradient, or a transposed convolution.
#[divan::bench(args = correlations(Correlation::to_large), sample_count = 9, sample_size = 1)]
fn to_large(bencher: Bencher, case: &Case) {
    let Geometry { large_channels, small_channels, .. } = case.geometry;
    let lengths = [small_channels * case.geometry.small_area(), large_channels * case.geometry.large_area()];
    correlate(bencher, case, Correlation::to_large(&case.geometry, Level::default()), lengths);
}

/// The gradient of the weights, for a batch.
#[divan::bench(args = gradients(), sample_count = 5, sample_size = 1)]
fn weights(bencher: Bencher, case: &Case) {
    let Geometry { large_channels, small_channels, .. } = case.geometry;
    let large = vec![0.5; BATCH * large_channels * case.geometry.large_area()];
    let small = vec![0.5; BATCH * small_channels * case.geometry.small_area()];
    let (mut weights, mut workspace) = (vec![0.0; case.geometry.weights()], GradientWorkspace::default());
    let product = WeightGradient::new(&case.geometry, Level::default(), BATCH).by(case.method);
    bencher
        .counter(ItemsCount::new(BATCH * case.geometry.operations()))
        .bench_local(|| product.run(&large, &small, &mut weights, &mut workspace));
}
