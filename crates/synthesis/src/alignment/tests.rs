use super::*;
use crate::camera::CameraScaling;
use crate::camera::tests::cameras;
use burn::tensor::{DType, Device, TensorCreationOptions};
use endoscape_core::{Camera, Size};

const SIZE: Size = Size::new(40, 32);

fn options() -> TensorCreationOptions {
    (&Device::flex(), DType::F64).into()
}

fn tensor<const D: usize>(values: Vec<f64>, shape: [usize; D]) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), options())
}

fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f64> {
    tensor.try_into_vec_as::<f64>().unwrap()
}

fn largest<const D: usize>(tensor: Tensor<D>) -> f64 {
    values(tensor.abs().max().reshape([1])).into_iter().fold(0.0, f64::max)
}

/// Smooth, of one colour and faint, so that slopes say what small shifts do and nothing meets its limit.
fn picture() -> Tensor<4> {
    let value = |x: usize, y: usize| 0.06 * (0.3 * x as f64).sin() + 0.05 * (0.25 * y as f64 + 0.05 * x as f64).cos();
    let plane: Vec<f64> = (0..SIZE.height).flat_map(|y| (0..SIZE.width).map(move |x| value(x, y))).collect();
    tensor(plane.repeat(3), [1, 3, SIZE.height, SIZE.width])
}

fn depth() -> Tensor<4> {
    let value = |x: usize, y: usize| 1.0 + 0.01 * x as f64 + 0.02 * y as f64;
    let plane = (0..SIZE.height).flat_map(|y| (0..SIZE.width).map(move |x| value(x, y))).collect();
    tensor(plane, [1, 1, SIZE.height, SIZE.width])
}

fn batch_of(camera: Camera) -> CameraBatch {
    CameraBatch::new(&[camera], SIZE, CameraScaling::Exact, options()).unwrap()
}

fn identity() -> Tensor<3> {
    tensor(vec![1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0], [1, 3, 4])
}

fn motion(numbers: [f64; 6]) -> Tensor<2> {
    tensor(numbers.to_vec(), [1, 6])
}

#[test]
fn nothing_speaks_against_the_right_motion() {
    for (name, camera) in cameras().into_iter().enumerate() {
        let alignment = Alignment::new(picture(), depth(), &batch_of(camera));
        let evidence = alignment.evidence(contrast(picture()), identity());
        assert_eq!(evidence.dims(), [1, EVIDENCE_CHANNELS, SIZE.height, SIZE.width]);
        assert!(largest(evidence.narrow(1, 1, 7)) < 1e-4, "camera {name}");
    }
}

#[test]
fn a_difference_is_what_its_motion_does_to_first_order() {
    for (name, camera) in cameras().into_iter().enumerate() {
        let cameras = batch_of(camera);
        let alignment = Alignment::new(picture(), depth(), &cameras);
        for part in 0..6 {
            let small = std::array::from_fn(|k| if k == part { 1e-3 } else { 0.0 });
            // The target seen from a source that has moved: wrong by that motion if none is assumed.
            let rebuilt = alignment.difference(contrast(picture()), alignment.transform(motion(small)));
            let slope =
                alignment.sensitivity.clone().narrow(1, part, 1) * (1e-3 * SIZE.width as f64 / SENSITIVITY_GAIN);
            let shown = rebuilt.clone().not_equal_scalar(0.0).float().cast(DType::F64);
            // At the border slopes are not known and surroundings one-sided.
            let inner = |all: Tensor<4>| all.narrow(2, 3, SIZE.height - 6).narrow(3, 3, SIZE.width - 6);
            let error = largest(inner((rebuilt.clone() - slope) * shown)) / largest(inner(rebuilt));
            assert!(error < 0.25, "camera {name}, part {part}: {error}");
        }
    }
}

#[test]
fn a_unit_of_length_never_matters() {
    for (name, camera) in cameras().into_iter().enumerate() {
        let cameras = batch_of(camera);
        let evidence = |unit: f64| {
            let moved = source_from_target(
                motion([0.02 * unit, 0.01 * unit, -0.03 * unit, 0.01, 0.0, 0.02]),
                Rotation::AxisAngle,
            );
            Alignment::new(picture(), depth() * unit, &cameras).evidence(contrast(picture()), moved)
        };
        assert!(largest(evidence(1.0) - evidence(250.0)) < 1e-6, "camera {name}");
    }
}

#[test]
fn motions_are_corrected_by_what_is_left() {
    let camera = cameras()[0];
    let alignment = Alignment::new(picture(), depth(), &batch_of(camera));
    let unit = values(alignment.unit.clone().reshape([1]))[0];
    let first = source_from_target(motion([0.1, -0.2, 0.05, 0.1, 0.2, -0.1]), Rotation::AxisAngle);
    let corrected = alignment.corrected(motion([0.3, 0.1, -0.2, -0.2, 0.1, 0.05]), first.clone());
    // By hand: rotations multiply, the translation of the first is turned and that of the second, in typical depths, added.
    let second =
        source_from_target(motion([0.3 * unit, 0.1 * unit, -0.2 * unit, -0.2, 0.1, 0.05]), Rotation::AxisAngle);
    let expected = |row: usize, column: usize| {
        let (a, b) = (values(second.clone()), values(first.clone()));
        let product: f64 = (0..3).map(|k| a[4 * row + k] * b[4 * k + column]).sum();
        product + if column == 3 { a[4 * row + 3] } else { 0.0 }
    };
    for (index, value) in values(corrected).into_iter().enumerate() {
        assert!((value - expected(index / 4, index % 4)).abs() < 1e-12);
    }
}

#[test]
fn unknown_depth_and_poison_are_no_evidence() {
    let camera = cameras()[0];
    for poison in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e9] {
        let mut holes = values(depth());
        (0..holes.len()).step_by(3).for_each(|pixel| holes[pixel] = poison);
        let alignment = Alignment::new(picture(), tensor(holes, [1, 1, SIZE.height, SIZE.width]), &batch_of(camera));
        let moved = source_from_target(motion([0.02, 0.0, 0.01, 0.0, 0.01, 0.0]), Rotation::AxisAngle);
        let evidence = values(alignment.evidence(contrast(picture()), moved));
        assert!(evidence.iter().all(|value| value.is_finite()), "{poison}");
        let difference = &evidence[SIZE.area()..2 * SIZE.area()];
        assert!(difference.iter().step_by(3).all(|value| *value == 0.0), "{poison}");
        assert!(difference.iter().any(|value| *value != 0.0), "{poison}");
    }
}

#[test]
fn contrast_ignores_the_lamp() {
    let brighter = (picture() * 0.5 + 0.5) * 1.5 * 2.0 - 1.0;
    let (as_is, brighter) = (contrast(picture()), contrast(brighter));
    // Not exactly: a little is added to the brightness of the surroundings.
    assert!(largest(as_is.clone() - brighter) < 0.05 * largest(as_is));
}
