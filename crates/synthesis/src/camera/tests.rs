//! Tensors against the exact cameras of `endoscape_core`.

use super::*;
use burn::tensor::{DType, Device};
use endoscape_core::camera::{Intrinsics, KannalaBrandt, Omnidirectional, Pinhole, RadialTangential, Unified};
use nalgebra::Point3;
use proptest::prelude::*;

const SIZE: Size = Size { width: 135, height: 108 };

/// The lens C3VD publishes, shrunk with its picture.
fn omnidirectional() -> Camera {
    let lens = Omnidirectional {
        cx: 678.544839263292,
        cy: 542.975887548343,
        polynomial: [769.243600037458, 0.0, -8.12770624150226e-4, 6.25674244578925e-7, -1.1966218214428e-9],
        stretch: [[0.99998688, 0.00288274], [-0.00296317, 1.0]],
    };
    Camera::new(Size::new(1350, 1080), lens.into()).unwrap()
}

/// One camera of each model, two of the distorted ones.
pub(crate) fn cameras() -> Vec<Camera> {
    let intrinsics = Intrinsics { fx: 76.7, fy: 76.5, cx: 67.9, cy: 54.35, skew: 0.3 };
    let wide = Intrinsics { fx: 40.0, fy: 41.0, skew: 0.0, ..intrinsics };
    [
        Pinhole { intrinsics }.into(),
        RadialTangential::from_opencv(intrinsics, &[-0.2486, 0.0614, 0.001, -0.0007]).into(),
        RadialTangential::from_opencv(intrinsics, &[0.4, 0.1, 1e-4, 2e-4, 0.01, 0.7, 0.2, 0.03]).into(),
        KannalaBrandt { intrinsics: wide, k1: -0.139, k2: -2.3e-3, k3: 2.1e-3, k4: -1.2e-4 }.into(),
        Unified { intrinsics, xi: 0.9, k1: 0.0, k2: 0.0 }.into(),
        Unified { intrinsics, xi: 1.4, k1: -0.1, k2: 0.02 }.into(),
    ]
    .into_iter()
    .map(|model| Camera::new(SIZE, model).unwrap())
    .chain([omnidirectional().scaled_to(SIZE).unwrap()])
    .collect()
}

fn options() -> TensorCreationOptions {
    (&Device::flex(), DType::F64).into()
}

/// One point per picture, shown to a batch of one-pixel pictures.
fn project(cameras: &[Camera], points: &[Point3<f64>]) -> Vec<Option<[f64; 2]>> {
    let batch = CameraBatch { groups: group(&shifted(cameras), &options()), ..one_pixel() };
    let values: Vec<f64> = points.iter().flat_map(|point| [point.x, point.y, point.z]).collect();
    let points = Tensor::from_data(TensorData::new(values, [points.len(), 3, 1, 1]), options());
    let nearest = points.clone().narrow(1, 0, 1).zeros_like() + 1e-6;
    let Projected { pixels, in_domain } = batch.project(points, nearest);
    let pixels = pixels.try_into_vec_as::<f64>().unwrap();
    let in_domain = in_domain.int().try_into_vec_as::<i64>().unwrap();
    pixels.chunks(2).zip(in_domain).map(|(pixel, inside)| (inside == 1).then(|| [pixel[0], pixel[1]])).collect()
}

fn shifted(cameras: &[Camera]) -> Vec<ShiftedCamera> {
    cameras.iter().map(|camera| ShiftedCamera { camera: *camera, shift: [0.0, 0.0] }).collect()
}

fn one_pixel() -> CameraBatch {
    CameraBatch::new(&cameras()[..1], Size::new(1, 1), CameraScaling::Exact, options()).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn tensors_project_like_the_exact_cameras(x in -1.5..1.5, y in -1.2..1.2, z in -0.2..1.0_f64, scale in 1e-2..1e2) {
        let cameras = cameras();
        let point = Point3::new(x, y, z) * scale;
        // A mixed batch also proves that grouping puts every picture back into its place.
        for (camera, pixel) in cameras.iter().zip(project(&cameras, &vec![point; cameras.len()])) {
            let exact = camera.project(&point);
            let near = exact.filter(|exact| exact.x.abs() < 300.0 && exact.y.abs() < 300.0 && camera.contains(exact));
            match (near, pixel) {
                (Some(exact), Some([u, v])) =>
                    prop_assert!((exact.x - u).hypot(exact.y - v) < 1e-4, "{camera:?}: {exact} but ({u}, {v})"),
                (Some(exact), None) => prop_assert!(false, "{camera:?} lost {point}, seen at {exact}"),
                (None, Some(_)) => prop_assert!(exact.is_some(), "{camera:?} invented a pixel for {point}"),
                (None, None) => {}
            }
        }
    }
}

#[test]
fn the_omnidirectional_inverse_is_exact_over_the_whole_picture() {
    let camera = omnidirectional();
    let angles: Vec<f64> = (0..200).map(|step| 1.7 * f64::from(step) / 200.0).collect();
    for angle in angles {
        let point = Point3::new(0.8 * angle.sin(), 0.6 * angle.sin(), angle.cos());
        let exact = camera.project(&point).unwrap();
        let [u, v] = project(&[camera], &[point])[0].unwrap();
        let error = (exact.x - u).hypot(exact.y - v);
        assert!(error < 1e-3, "{error} px at {angle}");
    }
}

#[test]
fn rays_lead_back_to_their_pixels() {
    for camera in cameras() {
        let size = Size::new(20, 16);
        let batch = CameraBatch::new(&[camera], size, CameraScaling::Exact, options()).unwrap();
        let rays = batch.rays();
        let Projected { pixels, in_domain } = batch.project(rays.clone() * 3.0, batch.seen() * 1e-3);
        let (u, v) = (pixels.clone().narrow(1, 0, 1), pixels.narrow(1, 1, 1));
        let seen = batch.seen() * in_domain.clone().float().cast(DType::F64);
        assert!((seen.clone() - batch.seen()).abs().max().into_scalar::<f64>() < 0.5, "{camera:?}");
        let columns = pixel_index(size, 0);
        let rows = pixel_index(size, 1);
        let error = ((u - columns).abs() + (v - rows).abs()) * seen;
        assert!(error.max().into_scalar::<f64>() < 1e-4, "{camera:?}");
    }
}

fn pixel_index(size: Size, axis: usize) -> Tensor<4> {
    let index = |at: usize| if axis == 0 { at % size.width } else { at / size.width };
    let values: Vec<f64> = (0..size.area()).map(|at| index(at) as f64).collect();
    Tensor::from_data(TensorData::new(values, [1, 1, size.height, size.width]), options())
}

#[test]
fn divided_intrinsics_are_those_of_sfmlearner() {
    let camera = cameras()[0];
    let size = Size::new(27, 27);
    let batch = CameraBatch::new(&[camera], size, CameraScaling::Divided, options()).unwrap();
    let ray = batch.rays().slice([0..1, 0..2, 3..4, 5..6]).try_into_vec_as::<f64>().unwrap();
    // fx, skew and cx shrink by 5, fy and cy by 4.
    let y = (3.0 - 54.35 / 4.0) / (76.5 / 4.0);
    let x = (5.0 - 67.9 / 5.0 - 0.3 / 5.0 * y) / (76.7 / 5.0);
    assert!((ray[0] - x).abs() < 1e-12 && (ray[1] - y).abs() < 1e-12);
    let Projected { pixels, .. } = batch.project(batch.rays(), batch.seen() * 1e-3);
    let pixel = pixels.slice([0..1, 0..2, 3..4, 5..6]).try_into_vec_as::<f64>().unwrap();
    assert!((pixel[0] - 5.0).abs() < 1e-12 && (pixel[1] - 3.0).abs() < 1e-12);
}

#[test]
fn equal_cameras_are_kept_once() {
    let camera = cameras()[3];
    let batch = CameraBatch::new(&[camera; 4], Size::new(8, 6), CameraScaling::Exact, options()).unwrap();
    assert_eq!(batch.rays().dims(), [1, 3, 6, 8]);
    assert!(matches!(CameraBatch::new(&[], SIZE, CameraScaling::Exact, options()), Err(SynthesisError::NoCamera)));
}
