//! Tensors in double precision, scenes and cameras for the tests, and derivatives by central differences.
#![allow(dead_code, reason = "every test file uses its own part")]

use burn::tensor::{DType, Device, Tensor, TensorCreationOptions, TensorData};
use endoscape_core::camera::{Intrinsics, KannalaBrandt, Omnidirectional, Pinhole, RadialTangential, Unified};
use endoscape_core::{Camera, Size};
use endoscape_synthesis::{CameraBatch, CameraScaling};

/// Small enough for central differences over every number, with unequal sides.
pub const SIZE: Size = Size { width: 6, height: 5 };

pub fn options() -> TensorCreationOptions {
    (&Device::flex(), DType::F64).into()
}

pub fn tensor<const D: usize>(values: Vec<f64>, shape: [usize; D]) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), options())
}

/// Numbers of an input whose derivative is checked.
const SAMPLE: usize = 24;

/// Numbers between `low` and `high` that look random and are the same on every machine.
pub fn noise(seed: u64, count: usize, low: f64, high: f64) -> Vec<f64> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = || {
        // Marsaglia's xorshift.
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    (0..count + 8).map(|_| low + (high - low) * next()).skip(8).collect()
}

pub fn noise_tensor<const D: usize>(seed: u64, shape: [usize; D], low: f64, high: f64) -> Tensor<D> {
    tensor(noise(seed, shape.iter().product(), low, high), shape)
}

pub fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f64> {
    tensor.try_into_vec_as::<f64>().unwrap()
}

pub fn number(tensor: Tensor<1>) -> f64 {
    tensor.into_scalar::<f64>()
}

/// Compares the gradient of `function` at `inputs` with central differences, number by number; of larger inputs, for a
/// sample of numbers spread over rows, columns and channels.
///
/// `function` must return one number; its inputs are handed over as `[batch, channels, height, width]`.
pub fn assert_gradient(name: &str, inputs: &[Tensor<4>], function: impl Fn(&[Tensor<4>]) -> Tensor<1>) {
    let tracked: Vec<Tensor<4>> = inputs.iter().map(|input| input.clone().autodiff().require_grad()).collect();
    let gradients = function(&tracked).backward();
    for (index, input) in inputs.iter().enumerate() {
        let analytic = values(tracked[index].grad(&gradients).unwrap_or_else(|| input.zeros_like()));
        let scale = analytic.iter().fold(1e-3, |largest: f64, value| largest.max(value.abs()));
        // 37 shares no factor with the sizes of the tests, so the first steps all hit different numbers.
        for element in (0..analytic.len().min(SAMPLE)).map(|step| step * 37 % analytic.len()) {
            let analytic = analytic[element];
            let numeric = central_difference(inputs, index, element, &function);
            let error = (analytic - numeric).abs() / scale;
            assert!(
                error < 2e-6,
                "{name}: input {index}[{element}] has gradient {analytic}, differences say {numeric}"
            );
        }
    }
}

fn central_difference(
    inputs: &[Tensor<4>],
    index: usize,
    element: usize,
    function: impl Fn(&[Tensor<4>]) -> Tensor<1>,
) -> f64 {
    const STEP: f64 = 1e-6;
    let at = |offset: f64| {
        let mut moved = inputs.to_vec();
        let mut numbers = values(moved[index].clone());
        numbers[element] += offset;
        moved[index] = tensor(numbers, moved[index].dims());
        number(function(&moved))
    };
    (at(STEP) - at(-STEP)) / (2.0 * STEP)
}

/// A sum with unequal weights, so that no symmetry hides an error.
pub fn weighted_sum<const D: usize>(tensor: Tensor<D>) -> Tensor<1> {
    let weights = noise_tensor(77, tensor.dims(), -1.0, 1.0);
    (tensor * weights).sum()
}

/// One camera of every model for pictures of [`SIZE`], in the order of their names.
pub fn cameras() -> Vec<(&'static str, Camera)> {
    let intrinsics = Intrinsics { fx: 4.1, fy: 4.3, cx: 2.6, cy: 2.1, skew: 0.05 };
    let omnidirectional = Omnidirectional {
        cx: 678.5,
        cy: 543.0,
        polynomial: [769.243600037458, 0.0, -8.12770624150226e-4, 6.25674244578925e-7, -1.1966218214428e-9],
        stretch: [[0.99998688, 0.00288274], [-0.00296317, 1.0]],
    };
    let wide = Intrinsics { fx: 2.5, fy: 2.6, ..intrinsics };
    let small = |model| Camera::new(SIZE, model).unwrap();
    let rational = RadialTangential::from_opencv(intrinsics, &[0.4, 0.1, 1e-3, 2e-3, 0.01, 0.7, 0.2, 0.03]);
    vec![
        ("pinhole", small(Pinhole { intrinsics }.into())),
        ("radial-tangential 5", small(RadialTangential::from_opencv(intrinsics, &[-0.1, 0.02, 0.003, -0.002]).into())),
        ("radial-tangential 8", small(rational.into())),
        ("kannala-brandt", small(KannalaBrandt { intrinsics: wide, k1: -0.1, k2: -2e-3, k3: 2e-3, k4: -1e-4 }.into())),
        ("unified", small(Unified { intrinsics, xi: 0.9, k1: -0.05, k2: 0.01 }.into())),
        (
            "omnidirectional",
            Camera::new(Size::new(1350, 1080), omnidirectional.into()).unwrap().scaled_to(SIZE).unwrap(),
        ),
    ]
}

pub fn batch_of(cameras: &[Camera], size: Size) -> CameraBatch {
    CameraBatch::new(cameras, size, CameraScaling::Exact, options()).unwrap()
}

/// `[batch, 3, 4]` without any motion.
pub fn identity(batch: usize) -> Tensor<3> {
    let one = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    tensor(one.repeat(batch), [batch, 3, 4])
}
