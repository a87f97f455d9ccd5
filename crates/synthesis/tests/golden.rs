//! Parity with SfMLearner's PyTorch port, whose numbers lie beside the repository; skipped where they do not.
#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "test helpers fail by panicking and say what they skip")]

use burn::tensor::{Device, Tensor, TensorData};
use endoscape_core::camera::{Intrinsics, Pinhole};
use endoscape_core::{Camera, Size};
use endoscape_synthesis::motion::{Rotation, source_from_target};
use endoscape_synthesis::warp::{correspond, sample_bilinear};
use endoscape_synthesis::{
    CameraBatch, CameraPyramid, CameraScaling, LossTerms, ObjectiveConfig, OutOfView, Prediction, View, ViewBatch,
    objective, pyramid, synthesize,
};
use safetensors::SafeTensors;

const SIZE: Size = Size { width: 128, height: 64 };

/// The port's numbers, or `None` where they are not at hand.
struct Golden(Vec<u8>);

impl Golden {
    fn open() -> Option<Self> {
        // Worktrees lie one folder deeper than the main checkout.
        let path = |up: &str| format!("{}/{up}/shared/golden/expected.safetensors", env!("CARGO_MANIFEST_DIR"));
        let bytes = std::fs::read(path("../../..")).or_else(|_| std::fs::read(path("../../../.."))).ok();
        if bytes.is_none() {
            eprintln!("skipped: no golden numbers at {}", path("../../.."));
        }
        bytes.map(Self)
    }

    fn values(&self, name: &str) -> (Vec<f32>, Vec<usize>) {
        let file = SafeTensors::deserialize(&self.0).unwrap();
        let view = file.tensor(name).unwrap();
        let numbers = view.data().chunks_exact(4).map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap()));
        (numbers.collect(), view.shape().to_vec())
    }

    fn tensor<const D: usize>(&self, name: &str) -> Tensor<D> {
        let (values, shape) = self.values(name);
        Tensor::from_data(TensorData::new(values, shape), &Device::flex())
    }

    fn cameras(&self) -> Vec<Camera> {
        let (k, _) = self.values("intrinsics");
        let pinhole = |k: &[f32]| {
            let [fx, skew, cx, fy, cy] = [k[0], k[1], k[2], k[4], k[5]].map(f64::from);
            Camera::new(SIZE, Pinhole { intrinsics: Intrinsics { fx, fy, cx, cy, skew } }.into()).unwrap()
        };
        k.chunks(9).map(pinhole).collect()
    }
}

fn numbers<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.try_into_vec_as::<f32>().unwrap()
}

/// Largest difference relative to the largest expected number.
fn relative_error(got: &[f32], expected: &[f32]) -> f64 {
    assert_eq!(got.len(), expected.len());
    let scale = expected.iter().fold(0.0_f32, |largest, value| largest.max(value.abs()));
    let error = got.iter().zip(expected).fold(0.0_f32, |largest, (a, b)| largest.max((a - b).abs()));
    f64::from(error) / f64::from(scale)
}

fn assert_close<const D: usize>(golden: &Golden, name: &str, got: Tensor<D>, tolerance: f64) {
    let error = relative_error(&numbers(got), &golden.values(name).0);
    eprintln!("{name}: {error:.1e}");
    assert!(error < tolerance, "{name} is off by {error}");
}

#[test]
fn matrices() {
    let Some(golden) = Golden::open() else { return };
    let vector: Tensor<2> = golden.tensor("vector_for_matrix");
    assert_close(&golden, "matrix_euler", source_from_target(vector.clone(), Rotation::Euler), 1e-6);
    assert_close(&golden, "matrix_quat", source_from_target(vector, Rotation::Quaternion), 1e-6);
}

#[test]
fn warps() {
    let Some(golden) = Golden::open() else { return };
    let depth = golden.tensor::<4>("disp0").recip();
    let motion = golden.tensor::<3>("pose").narrow(1, 0, 1).squeeze_dim::<2>(1);
    let motion = source_from_target(motion, Rotation::Euler);
    let cameras = CameraBatch::new(&golden.cameras(), SIZE, CameraScaling::Divided, &Device::flex()).unwrap();
    let source: Tensor<4> = golden.tensor("source0");
    let masked = synthesize(source.clone(), depth.clone(), motion.clone(), &cameras, OutOfView::Masked);
    assert_close(&golden, "warp_valid", masked.valid, 1e-6);
    assert_close(&golden, "warp_border", masked.image, 1e-3);
    // A frame of zeros around the source turns "nearest border pixel" into the port's "zero outside".
    let framed = source.pad([(1, 1), (1, 1)], burn::tensor::ops::PadMode::Constant(0.0));
    let pixels = correspond(depth, motion, &cameras).pixels + 1.0;
    assert_close(&golden, "warp_zeros", sample_bilinear(framed, pixels), 1e-3);
}

struct Outputs {
    disparities: Vec<Tensor<4>>,
    masks: Vec<Tensor<4>>,
    pose: Tensor<3>,
}

fn outputs(golden: &Golden) -> Outputs {
    let track = |name: String| golden.tensor::<4>(&name).autodiff().require_grad();
    Outputs {
        disparities: (0..4).map(|scale| track(format!("disp{scale}"))).collect(),
        masks: (0..4).map(|scale| track(format!("mask{scale}"))).collect(),
        pose: golden.tensor::<3>("pose").autodiff().require_grad(),
    }
}

fn terms(golden: &Golden, outputs: &Outputs) -> LossTerms {
    let view = |name: &str| View { image: golden.tensor(name), usable: None };
    let config = ObjectiveConfig::port();
    let sizes = pyramid::sizes(SIZE, 4);
    let cameras = CameraPyramid::new(&golden.cameras(), &sizes, config.camera_scaling, &Device::flex()).unwrap();
    let batch = ViewBatch { target: view("target"), sources: vec![view("source0"), view("source1")], cameras };
    let motion =
        |source| source_from_target(outputs.pose.clone().narrow(1, source, 1).squeeze_dim::<2>(1), Rotation::Euler);
    let prediction = Prediction {
        disparities: outputs.disparities.clone(),
        source_from_target: vec![motion(0), motion(1)],
        masks: outputs.masks.clone(),
        source_disparities: Vec::new(),
    };
    objective(&batch, &prediction, &config)
}

#[test]
fn losses() {
    let Some(golden) = Golden::open() else { return };
    let terms = terms(&golden, &outputs(&golden));
    assert_close(&golden, "loss_photometric_zeros", terms.photometric.clone(), 1e-5);
    assert_close(&golden, "loss_photometric_border", terms.photometric, 1e-5);
    assert_close(&golden, "loss_mask", terms.mask, 1e-5);
    assert_close(&golden, "loss_smooth_depth_2p3", terms.smoothness, 1e-5);
    assert_close(&golden, "loss_total", terms.total, 1e-5);
}

#[test]
fn gradients() {
    let Some(golden) = Golden::open() else { return };
    let outputs = outputs(&golden);
    let gradients = terms(&golden, &outputs).total.backward();
    assert_close(&golden, "grad_pose", outputs.pose.grad(&gradients).unwrap(), 1e-3);
    for (scale, mask) in outputs.masks.iter().enumerate() {
        assert_close(&golden, &format!("grad_mask{scale}"), mask.grad(&gradients).unwrap(), 1e-3);
    }
    // The port's gradients of the coarser disparities include the network's way from them to the finer ones; without
    // a network only the finest can be compared.
    assert_close(&golden, "grad_disp0", outputs.disparities[0].grad(&gradients).unwrap(), 1e-3);
}
