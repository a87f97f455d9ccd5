//! Gradients through both networks and the whole objective: against PyTorch's numbers, where they are at hand, and
//! against central differences in double precision.

#![allow(clippy::print_stderr, reason = "tests say what they skip")]

use crate::disp_net::SCALES;
use crate::weights::{NamedArrays, collect, naming};
use crate::{Checkpoint, DispNet, DispNetConfig, NetsConfig, Network, PoseMaskNet, PoseMaskNetConfig};
use burn::module::{Module, ModuleMapper, Param, ParamId};
use burn::tensor::{DType, Device, Gradients, Tensor, TensorData};
use endoscape_core::camera::{Intrinsics, Pinhole};
use endoscape_core::{Camera, Size};
use endoscape_synthesis::{
    CameraPyramid, ObjectiveConfig, Prediction, Rotation, View, ViewBatch, objective, pyramid, source_from_target,
};
use safetensors::SafeTensors;
use std::path::{Path, PathBuf};

/// A snippet and both networks.
struct Setup {
    batch: ViewBatch,
    disp: DispNet,
    pose: PoseMaskNet,
}

impl Setup {
    /// The total of the port's objective; `tap` as in [`DispNet::forward_tapped`].
    fn loss(&self, tap: impl FnMut(usize, Tensor<4>) -> Tensor<4>) -> Tensor<1> {
        let target = self.batch.target.image.clone();
        let sources: Vec<_> = self.batch.sources.iter().map(|source| source.image.clone()).collect();
        let seen = self.pose.forward(target.clone(), &sources);
        let motion = |source| seen.motion.clone().narrow(1, source, 1).squeeze_dim::<2>(1);
        let prediction = Prediction {
            disparities: self.disp.forward_tapped(target, tap).scales.to_vec(),
            source_from_target: (0..sources.len()).map(|at| source_from_target(motion(at), Rotation::Euler)).collect(),
            masks: seen.mask.unwrap().to_vec(),
            source_disparities: Vec::new(),
        };
        objective(&self.batch, &prediction, &ObjectiveConfig::port()).total
    }
}

/// Replaces every parameter by its gradient.
struct ToGradients<'a>(&'a Gradients);

impl ModuleMapper for ToGradients<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let gradient = param.val().grad(self.0).unwrap_or_else(|| param.val().inner().zeros_like());
        Param::initialized(param.id, gradient)
    }
}

/// Gradients of a network under the names of its parameters in the port.
fn gradients_of<M: Module>(network: &M, gradients: &Gradients, rename: fn(&str) -> String) -> NamedArrays {
    collect(&network.clone().map(&mut ToGradients(gradients)), rename).unwrap()
}

/// Largest difference relative to the largest expected number.
fn relative_error(got: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(got.len(), expected.len());
    let scale = expected.iter().fold(0.0_f32, |largest, value| largest.max(value.abs()));
    got.iter().zip(expected).fold(0.0_f32, |largest, (a, b)| largest.max((a - b).abs())) / scale
}

/// PyTorch's files, beside the main checkout or, one folder deeper, a worktree.
fn golden_folder() -> Option<PathBuf> {
    let above = ["../../../shared/golden", "../../../../shared/golden"];
    let folder = above.map(|path| Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).into_iter().find(|p| p.is_dir());
    if folder.is_none() {
        eprintln!("skipped: the golden numbers of PyTorch are not here");
    }
    folder
}

/// Tensors of PyTorch's file.
struct Golden(Vec<u8>);

impl Golden {
    fn values(&self, name: &str) -> (Vec<f32>, Vec<usize>) {
        let file = SafeTensors::deserialize(&self.0).unwrap();
        let view = file.tensor(name).unwrap();
        let values = view.data().as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
        (values, view.shape().to_vec())
    }

    fn names(&self, prefix: &str) -> Vec<String> {
        let file = SafeTensors::deserialize(&self.0).unwrap();
        file.names().into_iter().filter_map(|name| name.strip_prefix(prefix)).map(str::to_owned).collect()
    }

    fn view(&self, name: &str, device: &Device) -> View {
        let (values, shape) = self.values(name);
        View { image: Tensor::from_data(TensorData::new(values, shape), device), usable: None }
    }

    /// The port's batch and weights.
    fn setup(&self, folder: &Path, device: &Device) -> Setup {
        let size = Size::new(128, 64);
        let (k, _) = self.values("intrinsics");
        let pinhole = |k: &[f32]| {
            let [fx, skew, cx, fy, cy] = [k[0], k[1], k[2], k[4], k[5]].map(f64::from);
            Camera::new(size, Pinhole { intrinsics: Intrinsics { fx, fy, cx, cy, skew } }.into()).unwrap()
        };
        let cameras: Vec<Camera> = k.chunks(9).map(pinhole).collect();
        let scaling = ObjectiveConfig::port().camera_scaling;
        let batch = ViewBatch {
            target: self.view("target", device),
            sources: ["source0", "source1"].map(|name| self.view(name, device)).to_vec(),
            cameras: CameraPyramid::new(&cameras, &pyramid::sizes(size, SCALES), scaling, device).unwrap(),
        };
        let import = |file: &str, network| Checkpoint::import(&folder.join(file), Some(network), device).unwrap().0;
        Setup {
            batch,
            disp: import("dispnet.pth.tar", Network::Disp).disp.unwrap(),
            pose: import("posenet.pth.tar", Network::Pose).pose.unwrap(),
        }
    }

    fn assert_close(&self, name: &str, got: &[f32]) {
        let error = relative_error(got, &self.values(name).0);
        assert!(error < 1e-3, "{name} is off by {error:.1e}");
    }
}

#[test]
fn gradients_of_parameters_are_those_of_pytorch() {
    let Some(folder) = golden_folder() else { return };
    let golden = Golden(std::fs::read(folder.join("expected.safetensors")).unwrap());
    let setup = golden.setup(&folder, &Device::flex().autodiff());
    let gradients = setup.loss(|_, disparity| disparity).backward();
    let networks = [
        ("grad_dispnet.", gradients_of(&setup.disp, &gradients, naming::disp_net)),
        ("grad_posenet.", gradients_of(&setup.pose, &gradients, naming::pose_mask_net)),
    ];
    for (prefix, ours) in networks {
        let names = golden.names(prefix);
        assert!(!names.is_empty(), "{prefix}");
        names.iter().for_each(|name| golden.assert_close(&format!("{prefix}{name}"), &ours[name].values));
    }
}

#[test]
fn gradients_of_disparities_include_the_way_through_the_finer_scales() {
    let Some(folder) = golden_folder() else { return };
    let golden = Golden(std::fs::read(folder.join("expected.safetensors")).unwrap());
    let setup = golden.setup(&folder, &Device::flex().autodiff());
    for cut in 0..SCALES {
        let mut leaf = None;
        let total = setup.loss(|scale, disparity| {
            if scale != cut {
                return disparity;
            }
            leaf.insert(disparity.detach().require_grad()).clone()
        });
        let gradient = leaf.unwrap().grad(&total.backward()).unwrap();
        golden.assert_close(&format!("grad_disp{cut}"), &gradient.into_data().iter::<f32>().collect::<Vec<_>>());
    }
}

/// Numbers in [-1, 1] by SplitMix64: the device's own generator is shared with tests that run at the same time.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((mixed ^ (mixed >> 31)) >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    fn tensor<const D: usize>(&mut self, dims: [usize; D], (middle, reach): (f64, f64), device: &Device) -> Tensor<D> {
        let values: Vec<f64> = (0..dims.iter().product()).map(|_| middle + reach * self.next()).collect();
        Tensor::from_data(TensorData::new(values, dims), (device, DType::F64))
    }
}

/// A tensor as a parameter, of its own gradient where the device has any.
fn parameter<const D: usize>(id: ParamId, value: Tensor<D>) -> Param<Tensor<D>> {
    Param::initialized(id, if value.device().is_autodiff() { value.require_grad() } else { value })
}

/// Fills every parameter, in double precision.
struct Fill(Noise);

impl ModuleMapper for Fill {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let (dims, device) = (param.val().dims(), param.val().device());
        let inputs: usize = dims[1..].iter().product();
        // Where all inputs are zero, the zero bias of a fresh layer would sit on the kink of the ReLU.
        let range = if D == 1 { (0.1, 0.05) } else { (0.0, (3.0 / inputs as f64).sqrt()) };
        parameter(param.id, self.0.tensor(dims, range, &device))
    }
}

/// Moves one number of one parameter.
struct Moved {
    /// Position of the parameter, counting down while the network is walked through, and of the number in it.
    parameter: isize,
    element: usize,
    by: f64,
}

impl ModuleMapper for Moved {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        self.parameter -= 1;
        if self.parameter != -1 {
            return param;
        }
        let value = param.val();
        let mut numbers: Vec<f64> = value.clone().into_data().iter::<f64>().collect();
        numbers[self.element] += self.by;
        let options = (&value.device(), DType::F64);
        parameter(param.id, Tensor::from_data(TensorData::new(numbers, value.dims()), options))
    }
}

/// Largest gradient of every parameter, in the order of the module: position in the parameter, value.
struct Largest<'a> {
    gradients: &'a Gradients,
    found: Vec<(usize, f64)>,
}

impl ModuleMapper for Largest<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let gradient: Vec<f64> = param.val().grad(self.gradients).unwrap().into_data().iter().collect();
        let largest = gradient.into_iter().enumerate().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
        self.found.push(largest.unwrap());
        param
    }
}

/// Random pictures of 24x20 and tiny networks in double precision.
fn small_setup(device: &Device) -> Setup {
    let size = Size::new(24, 20);
    let disp = DispNetConfig { encoder: [3, 4, 4, 5, 5, 5, 5], decoder: [5, 5, 4, 4, 3, 3, 2], ..Default::default() };
    let pose = PoseMaskNetConfig {
        encoder: [3, 4, 4, 5, 5],
        motion: [4, 4],
        mask_decoder: [4, 4, 3, 3, 2],
        ..Default::default()
    };
    let Checkpoint { disp, pose, .. } =
        Checkpoint::init(NetsConfig { disp, pose, ..NetsConfig::default() }, 0, device).unwrap();
    let mut noise = Noise(7);
    let mut view = || View { image: noise.tensor([1, 3, 20, 24], (0.0, 1.0), device), usable: None };
    let camera = Camera::from_field_of_view(size, 1.2).unwrap();
    let scaling = ObjectiveConfig::port().camera_scaling;
    let sizes = pyramid::sizes(size, SCALES);
    let batch = ViewBatch {
        target: view(),
        sources: vec![view(), view()],
        cameras: CameraPyramid::new(&[camera], &sizes, scaling, (device, DType::F64)).unwrap(),
    };
    let mut fill = Fill(noise);
    Setup { batch, disp: disp.unwrap().map(&mut fill), pose: pose.unwrap().map(&mut fill) }
}

#[test]
fn gradients_of_every_parameter_agree_with_central_differences() {
    const STEP: f64 = 1e-6;
    let setup = small_setup(&Device::flex().autodiff());
    let gradients = setup.loss(|_, disparity| disparity).backward();
    let largest = |found: fn(&Setup, &mut Largest<'_>)| {
        let mut largest = Largest { gradients: &gradients, found: Vec::new() };
        found(&setup, &mut largest);
        largest.found
    };
    let of_disp = largest(|setup, largest| drop(setup.disp.clone().map(largest)));
    let of_pose = largest(|setup, largest| drop(setup.pose.clone().map(largest)));
    let plain = small_setup(&Device::flex());
    let slope = |in_disp: bool, parameter: usize, element: usize| {
        let at = |by: f64| {
            let mut moved = Moved { parameter: parameter as isize, element, by };
            let (disp, pose) = (plain.disp.clone(), plain.pose.clone());
            let (disp, pose) = if in_disp { (disp.map(&mut moved), pose) } else { (disp, pose.map(&mut moved)) };
            Setup { batch: plain.batch.clone(), disp, pose }.loss(|_, disparity| disparity).into_scalar::<f64>()
        };
        (at(STEP) - at(-STEP)) / (2.0 * STEP)
    };
    let all = of_disp.iter().enumerate().map(|at| (true, at)).chain(of_pose.iter().enumerate().map(|at| (false, at)));
    for (in_disp, (parameter, &(element, gradient))) in all {
        let numeric = slope(in_disp, parameter, element);
        // The differences themselves are rounded: 1e-16 of the loss over a step of 1e-6, a few times over.
        let error = (gradient - numeric).abs() / gradient.abs().max(1e-4);
        assert!(error < 1e-4, "depth network {in_disp}, parameter {parameter}: {gradient}, differences say {numeric}");
    }
}
