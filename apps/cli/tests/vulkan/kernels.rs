//! Our kernels beside their reference in plain tensor operations, which the processor runs in double precision.

use super::{difference, vulkan};
use burn::cubecl::logging::{LaunchObservation, LaunchObserver};
use burn::tensor::{DType, Device, Tensor, TensorData};
use endoscape_core::camera::{Intrinsics, KannalaBrandt, Omnidirectional, Pinhole, RadialTangential, Unified};
use endoscape_core::{Camera, Rotation, Size};
use endoscape_synthesis::warp::{Correspondence, correspond, sample_bilinear};
use endoscape_synthesis::{
    CameraBatch, CameraPyramid, CameraScaling, ObjectiveConfig, Prediction, View, ViewBatch, objective,
    source_from_target,
};
use std::sync::{Arc, Mutex};
use std::thread::{self, ThreadId};

/// Where a computation runs, and in which precision.
type Place = (Device, DType);

/// Where the plain tensor operations are used.
fn reference() -> Place {
    (Device::flex().autodiff(), DType::F64)
}

/// Where our kernels for the processor are used.
fn processor() -> Place {
    (Device::flex().autodiff(), DType::F32)
}

fn tensor<const D: usize>(numbers: &[f32], shape: [usize; D], place: &Place) -> Tensor<D> {
    let (device, dtype) = place;
    Tensor::from_data(TensorData::new(numbers.to_vec(), shape), (device, *dtype))
}

fn numbers<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().iter().collect()
}

/// Numbers between `low` and `high` that look random and are the same on every machine.
fn noise(seed: u64, count: usize, low: f32, high: f32) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = || {
        // Marsaglia's xorshift.
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / (1_u64 << 24) as f32
    };
    (0..count + 8).map(|_| low + (high - low) * next()).skip(8).collect()
}

/// Puts each of `values` into the place of some of `numbers`, all over them.
fn spoil(numbers: &mut [f32], values: &[f32]) {
    for (index, number) in numbers.iter_mut().enumerate().filter(|(index, _)| index % 13 == 5) {
        *number = values[index / 13 % values.len()];
    }
}

/// The largest difference as a share of the largest number, where `counts` is 1.
fn difference_where(counts: &[f32], a: &[f32], b: &[f32]) -> f32 {
    let count = |values: &[f32]| -> Vec<f32> {
        let chosen = values.iter().zip(counts.iter().cycle()).filter(|(_, counts)| **counts > 0.5);
        chosen.map(|(value, _)| *value).collect()
    };
    difference(&count(a), &count(b))
}

/// A picture and where it is read.
struct Reading {
    picture: Vec<f32>,
    positions: Vec<f32>,
    /// How much each colour counts in the sum whose gradient is taken.
    weights: Vec<f32>,
    shape: [usize; 4],
    read: [usize; 2],
}

impl Reading {
    fn new(shape: [usize; 4], read: [usize; 2]) -> Self {
        let [batch, channels, height, width] = shape;
        let area = read[0] * read[1];
        let largest = height.max(width) as f32;
        let mut positions = noise(2, batch * 2 * area, -0.3 * largest, 1.3 * largest);
        spoil(&mut positions, &[f32::INFINITY, -0.0, f32::NEG_INFINITY, width as f32 - 1.0, 1e30, f32::NAN, -1e30]);
        Self {
            picture: noise(1, shape.iter().product(), -1.0, 1.0),
            positions,
            weights: noise(3, batch * channels * area, -1.0, 1.0),
            shape,
            read,
        }
    }

    /// The colours and the gradient of the positions.
    fn at(&self, place: &Place) -> [Vec<f32>; 2] {
        let ([batch, channels, ..], [rows, columns]) = (self.shape, self.read);
        let positions = tensor(&self.positions, [batch, 2, rows, columns], place).require_grad();
        let read = sample_bilinear(tensor(&self.picture, self.shape, place), positions.clone());
        let weights = tensor(&self.weights, [batch, channels, rows, columns], place);
        let gradient = positions.grad(&(read.clone() * weights).sum().backward()).unwrap();
        [numbers(read), numbers(gradient)]
    }

    /// 1 where both coordinates of a position are numbers, for each of them.
    fn numeric(&self) -> Vec<f32> {
        let area = self.read[0] * self.read[1];
        let pictures = self.positions.chunks(2 * area);
        let numeric = |picture: &[f32]| -> Vec<f32> {
            let (columns, rows) = picture.split_at(area);
            let numeric = columns.iter().zip(rows).map(|(column, row)| !column.is_nan() && !row.is_nan());
            numeric.map(f32::from).collect::<Vec<f32>>().repeat(2)
        };
        pictures.flat_map(numeric).collect()
    }
}

#[test]
fn a_picture_is_read_as_by_the_reference() {
    let Some(gpu) = vulkan() else { return };
    let gpu = (gpu.autodiff(), DType::F32);
    let odd = [([1, 3, 7, 9], [5, 11]), ([3, 1, 33, 17], [31, 3]), ([2, 3, 48, 65], [48, 65])];
    let thin = [([2, 3, 1, 5], [4, 4]), ([2, 2, 6, 1], [3, 7]), ([1, 1, 1, 1], [2, 3])];
    for (shape, read) in odd.into_iter().chain(thin) {
        let reading = Reading::new(shape, read);
        let [colours, gradient] = reading.at(&gpu);
        let [expected, of_expected] = reading.at(&reference());
        let found = difference(&expected, &colours);
        assert!(found < 1e-4, "{shape:?} {read:?}: {found}");
        // Positions that are none have a gradient that is none in the reference.
        let found = difference_where(&reading.numeric(), &of_expected, &gradient);
        assert!(found < 1e-3, "{shape:?} {read:?}: {found}");
        let [colours_there, gradient_there] = reading.at(&processor());
        let found = [difference(&colours_there, &colours), difference(&gradient_there, &gradient)];
        assert!(found[0] < 1e-4 && found[1] < 1e-3, "{shape:?} {read:?}: {found:?}");
    }
}

#[test]
fn a_picture_that_wants_a_gradient_gets_that_of_the_reference() {
    let Some(gpu) = vulkan() else { return };
    let gradient = |place: &Place| {
        let picture = tensor(&noise(1, 2 * 3 * 9 * 7, -1.0, 1.0), [2, 3, 9, 7], place).require_grad();
        // Many positions add to the same pixels, those outside to the border's.
        let positions = tensor(&noise(2, 2 * 2 * 40 * 40, -4.0, 12.0), [2, 2, 40, 40], place);
        let read = sample_bilinear(picture.clone(), positions);
        numbers(picture.grad(&read.square().sum().backward()).unwrap())
    };
    let found = difference(&gradient(&reference()), &gradient(&(gpu.autodiff(), DType::F32)));
    assert!(found < 1e-3, "{found}");
}

#[test]
fn tensors_are_read_however_they_lie_in_memory() {
    let Some(gpu) = vulkan() else { return };
    let read = |place: &Place| {
        let rotated = tensor(&noise(1, 3 * 9 * 7, -1.0, 1.0), [1, 9, 7, 3], place).permute([0, 3, 2, 1]);
        let positions = tensor(&noise(2, 2 * 6 * 5 * 5, -2.0, 10.0), [2, 6, 5, 5], place).require_grad();
        let read = sample_bilinear(rotated.expand([2, 3, 7, 9]), positions.clone().narrow(1, 3, 2));
        // Every colour has the same gradient, one number in memory.
        let gradient = positions.grad(&read.clone().sum().backward()).unwrap();
        [numbers(read), numbers(gradient)]
    };
    let [expected, found] = [reference(), (gpu.clone().autodiff(), DType::F32)].map(|place| read(&place));
    let differences = [0, 1].map(|part| difference(&expected[part], &found[part]));
    assert!(differences[0] < 1e-4 && differences[1] < 1e-3, "{differences:?}");
    let plain = (gpu, DType::F32);
    let picture = tensor(&noise(1, 3 * 9 * 7, -1.0, 1.0), [1, 3, 9, 7], &plain);
    let alone = sample_bilinear(picture.clone(), tensor(&[3.0, 0.5], [1, 2, 1, 1], &plain));
    assert!(!alone.device().is_autodiff());
    let expected = (picture.clone().narrow(2, 0, 1) + picture.narrow(2, 1, 1)).narrow(3, 3, 1) * 0.5;
    assert!(difference(&numbers(expected), &numbers(alone)) < 1e-6);
}

const SIZE: Size = Size { width: 31, height: 23 };

/// A camera of every model.
fn cameras() -> Vec<(&'static str, Camera)> {
    let intrinsics = Intrinsics { fx: 21.0, fy: 22.0, cx: 14.6, cy: 11.1, skew: 0.3 };
    let wide = Intrinsics { fx: 12.5, fy: 12.6, ..intrinsics };
    let polynomial = [769.243600037458, 0.0, -8.12770624150226e-4, 6.25674244578925e-7, -1.1966218214428e-9];
    let stretch = [[0.99998688, 0.00288274], [-0.00296317, 1.0]];
    let omnidirectional = Omnidirectional { cx: 678.5, cy: 543.0, polynomial, stretch };
    let small = |model| Camera::new(SIZE, model).unwrap();
    vec![
        ("pinhole", small(Pinhole { intrinsics }.into())),
        (
            "radial-tangential",
            small(RadialTangential::from_opencv(intrinsics, &[0.4, 0.1, 1e-3, 2e-3, 0.01, 0.7, 0.2, 0.03]).into()),
        ),
        ("kannala-brandt", small(KannalaBrandt { intrinsics: wide, k1: -0.1, k2: -2e-3, k3: 2e-3, k4: -1e-4 }.into())),
        ("unified", small(Unified { intrinsics, xi: 0.9, k1: -0.05, k2: 0.01 }.into())),
        (
            "omnidirectional",
            Camera::new(Size::new(1350, 1080), omnidirectional.into()).unwrap().scaled_to(SIZE).unwrap(),
        ),
    ]
}

/// Two views of a scene.
struct Views {
    cameras: Vec<Camera>,
    depth: Vec<f32>,
    motion: Vec<f32>,
    weights: Vec<f32>,
}

/// What was found, and the gradients of depth and motion vector by a weighted sum of positions and depth.
struct Found {
    positions: Vec<f32>,
    depth: Vec<f32>,
    defined: Vec<f32>,
    in_view: Vec<f32>,
    gradients: [Vec<f32>; 2],
}

impl Views {
    fn new(cameras: Vec<Camera>) -> Self {
        let (batch, area) = (cameras.len(), SIZE.area());
        let mut depth = noise(4, batch * area, 0.5, 2.0);
        spoil(&mut depth, &[0.0, -1.0, f32::NAN, f32::INFINITY, 1e9, 1e-9]);
        Self { cameras, depth, motion: noise(5, batch * 6, -0.2, 0.2), weights: noise(6, batch * area, -1.0, 1.0) }
    }

    /// `counts` are the pixels that the gradient is taken of.
    fn at(&self, place: &Place, counts: &[f32]) -> Found {
        let (batch, shape) = (self.cameras.len(), [self.cameras.len(), 1, SIZE.height, SIZE.width]);
        let cameras = CameraBatch::new(&self.cameras, SIZE, CameraScaling::Exact, (&place.0, place.1)).unwrap();
        let depth = tensor(&self.depth, shape, place).require_grad();
        let motion = tensor(&self.motion, [batch, 6], place).require_grad();
        let matrix = source_from_target(motion.clone(), Rotation::Euler);
        let Correspondence { pixels, depth: in_source, defined, in_view } = correspond(depth.clone(), matrix, &cameras);
        let weights = tensor(&self.weights, shape, place) * tensor(counts, shape, place);
        let total = (pixels.clone() * weights.clone()).sum() * 0.1 + (in_source.clone() * weights).sum();
        let gradients = total.backward();
        let gradients = [numbers(depth.grad(&gradients).unwrap()), numbers(motion.grad(&gradients).unwrap())];
        let [positions, depth, defined, in_view] = [pixels, in_source, defined, in_view].map(numbers);
        Found { positions, depth, defined, in_view, gradients }
    }
}

fn assert_found_as_by_the_reference(name: &str, cameras: Vec<Camera>, gpu: &Place) {
    let views = Views::new(cameras);
    let everywhere = vec![1.0; views.depth.len()];
    let [found, expected] = [gpu, &reference()].map(|place| views.at(place, &everywhere));
    // Rounding may move a pixel over the border of what is defined or seen.
    let differ = |a: &[f32], b: &[f32]| a.iter().zip(b).filter(|(a, b)| a != b).count();
    let (of_defined, of_view) = (differ(&found.defined, &expected.defined), differ(&found.in_view, &expected.in_view));
    assert!(of_defined.max(of_view) <= views.depth.len() / 100, "{name}: {of_defined} {of_view}");
    let both: Vec<f32> = found.defined.iter().zip(&expected.defined).map(|(a, b)| a * b).collect();
    assert!(both.iter().sum::<f32>() > 0.5 * both.len() as f32, "{name}: little is defined");
    let planes: Vec<f32> = both.chunks(SIZE.area()).flat_map(|plane| plane.repeat(2)).collect();
    let [found, expected] = [gpu, &reference()].map(|place| views.at(place, &both));
    let values = [
        difference_where(&planes, &expected.positions, &found.positions),
        difference_where(&both, &expected.depth, &found.depth),
    ];
    assert!(values[0] < 1e-4 && values[1] < 1e-4, "{name}: {values:?}");
    assert!(found.positions.iter().chain(&found.depth).all(|number| number.is_finite()), "{name}");
    let gradients = [0, 1].map(|input| difference(&expected.gradients[input], &found.gradients[input]));
    assert!(gradients[0] < 1e-3 && gradients[1] < 1e-3, "{name}: {gradients:?}");
}

#[test]
fn pixels_are_found_as_by_the_reference() {
    let Some(gpu) = vulkan() else { return };
    let gpu = (gpu.autodiff(), DType::F32);
    for (name, camera) in cameras() {
        assert_found_as_by_the_reference(name, vec![camera; 2], &gpu);
    }
    let [(_, pinhole), .., (_, fisheye)] = cameras()[..] else { panic!("there are several models") };
    let narrow = Intrinsics { fx: 40.0, fy: 41.0, cx: 15.0, cy: 11.0, skew: 0.0 };
    let narrow = Camera::new(SIZE, Pinhole { intrinsics: narrow }.into()).unwrap();
    assert_found_as_by_the_reference("two pinholes", vec![pinhole, narrow, pinhole], &gpu);
    assert_found_as_by_the_reference("two models", vec![fisheye, pinhole], &gpu);
}

/// The kernels that one thread launches.
struct Launches {
    thread: ThreadId,
    names: Mutex<Vec<&'static str>>,
}

impl LaunchObserver for Launches {
    fn launched(&self, kernel: &'static str) {
        if thread::current().id() == self.thread {
            self.names.lock().unwrap().push(kernel);
        }
    }
}

/// The loss of a training step, and its gradients by a disparity of the target, by one of a source, and by the motion.
fn step(config: &ObjectiveConfig, place: &Place) -> [Vec<f32>; 4] {
    let size = Size::new(64, 48);
    let coarse = Size::new(32, 24);
    let shape = |channels: usize, size: Size| [2, channels, size.height, size.width];
    let map = |seed: u64, channels: usize, size: Size, low: f32, high: f32| {
        tensor(&noise(seed, 2 * channels * size.area(), low, high), shape(channels, size), place)
    };
    let view = |seed: u64| View { image: map(seed, 3, size, -1.0, 1.0), usable: None };
    let intrinsics = Intrinsics { fx: 50.0, fy: 50.0, cx: 31.5, cy: 23.5, skew: 0.0 };
    let camera = Camera::new(size, Pinhole { intrinsics }.into()).unwrap();
    let cameras = CameraPyramid::new(&[camera; 2], &[size, coarse], config.camera_scaling, &place.0).unwrap();
    let batch = ViewBatch { target: view(11), sources: vec![view(12), view(13)], cameras };
    let disparities = [size, coarse].map(|size| map(14, 1, size, 0.5, 2.0).require_grad());
    let motion = tensor(&noise(15, 12, -0.1, 0.1), [2, 6], place).require_grad();
    let source_from_target =
        [1.0, -1.0].map(|sign| source_from_target(motion.clone() * sign, Rotation::Euler)).to_vec();
    let source_disparities = [16, 17].map(|seed| [size, coarse].map(|size| map(seed, 1, size, 0.5, 2.0)).to_vec());
    let source_disparities = source_disparities.map(|scales| scales.into_iter().map(Tensor::require_grad).collect());
    let prediction = Prediction {
        disparities: disparities.to_vec(),
        source_from_target,
        masks: Vec::new(),
        source_disparities: source_disparities.to_vec(),
    };
    let total = objective(&batch, &prediction, config).total;
    let gradients = total.backward();
    let of = |disparity: &Tensor<4>| disparity.grad(&gradients).map_or_else(Vec::new, numbers);
    let of_disparities = [of(&disparities[0]), of(&prediction.source_disparities[1][0])];
    let [of_target, of_source] = of_disparities;
    [numbers(total), of_target, of_source, numbers(motion.grad(&gradients).unwrap())]
}

#[test]
fn a_training_step_goes_through_our_kernels() {
    let Some(gpu) = vulkan() else { return };
    let launches = Arc::new(Launches { thread: thread::current().id(), names: Mutex::default() });
    let observation = LaunchObservation::new(Arc::clone(&launches) as Arc<dyn LaunchObserver>);
    let with_geometry = ObjectiveConfig { geometry_weight: 0.5, ..ObjectiveConfig::paper() };
    for config in [ObjectiveConfig::paper(), ObjectiveConfig::port(), with_geometry] {
        let expected = step(&config, &processor());
        let found = step(&config, &(gpu.clone().autodiff(), DType::F32));
        assert_eq!(found[2].is_empty(), config.geometry_weight == 0.0);
        let found = [0, 1, 2, 3].map(|part| difference(&expected[part], &found[part]));
        assert!(found.iter().all(|difference| *difference < 1e-3), "{found:?}");
    }
    drop(observation);
    let names = launches.names.lock().unwrap();
    let sampling = ["read", "position_gradient", "picture_gradient"].map(|kernel| format!("sampling::{kernel}_kernel"));
    let correspondence = ["find", "differentiate"].map(|kernel| format!("correspondence::{kernel}_kernel"));
    for kernel in sampling.iter().chain(&correspondence) {
        assert!(names.iter().any(|name| name.contains(kernel)), "{kernel} is not among {names:?}");
    }
}
