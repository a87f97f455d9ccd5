//! Shapes, sizes and laws of the two networks.

use burn::module::{Module, ModuleVisitor, Param};
use burn::tensor::{Device, Distribution, Gradients, Tensor};
use endoscape_nets::{DispNetConfig, MaskHead, NetsConfig, Padding, PoseMaskNetConfig};

fn noise(channels: usize, [height, width]: [usize; 2], device: &Device) -> Tensor<4> {
    Tensor::random([1, channels, height, width], Distribution::Uniform(-1.0, 1.0), device)
}

/// `ceil(size / 2^scale)`.
fn halved(size: [usize; 2], scale: usize) -> [usize; 2] {
    size.map(|extent| extent.div_ceil(1 << scale))
}

#[test]
fn disparity_has_four_scales_of_any_size_within_its_range() {
    let device = Device::flex();
    for (padding, batch_norm) in [(Padding::Symmetric, false), (Padding::Same, true)] {
        let config = DispNetConfig { padding, batch_norm, ..DispNetConfig::default() }.with_width(1.0 / 16.0);
        let net = config.init(0, &device).unwrap();
        for size in [[127, 211], [64, 128], [256, 320], [1, 1], [2, 130]] {
            let pyramid = net.forward(noise(3, size, &device));
            for (scale, disparity) in pyramid.scales.iter().enumerate() {
                let [height, width] = halved(size, scale);
                assert_eq!(disparity.dims(), [1, 1, height, width]);
                let (low, high) =
                    (disparity.clone().min().into_scalar::<f32>(), disparity.clone().max().into_scalar::<f32>());
                assert!(low >= 0.01 && high <= 10.011, "{low} {high}");
            }
            let product = (pyramid.depth(0) * pyramid.scales[0].clone() - 1.0).abs().max().into_scalar::<f32>();
            assert!(product < 1e-5);
        }
    }
}

#[test]
fn motion_and_mask_follow_the_snippet_length_at_any_size() {
    let device = Device::flex();
    for (snippet_length, mask, padding) in [
        (3, MaskHead::Sigmoid, Padding::Symmetric),
        (5, MaskHead::Softmax, Padding::Same),
        (7, MaskHead::Softmax, Padding::Symmetric),
    ] {
        let config =
            PoseMaskNetConfig { snippet_length, mask, padding, mask_kernels: [3, 3, 4, 5, 7], ..Default::default() };
        let net = config.with_width(1.0 / 8.0).init(0, &device).unwrap();
        for size in [[127, 211], [64, 128], [1, 3]] {
            let sources: Vec<_> = (1..snippet_length).map(|_| noise(3, size, &device)).collect();
            let seen = net.forward(noise(3, size, &device), &sources);
            assert_eq!(seen.motion.dims(), [1, snippet_length - 1, 6]);
            for (scale, mask) in seen.mask.unwrap().iter().enumerate() {
                let [height, width] = halved(size, scale);
                assert_eq!(mask.dims(), [1, snippet_length - 1, height, width]);
                assert!(mask.clone().min().into_scalar::<f32>() > 0.0 && mask.clone().max().into_scalar::<f32>() < 1.0);
            }
        }
    }
}

#[test]
fn without_a_mask_the_motion_is_the_same() {
    let device = Device::flex();
    let net = PoseMaskNetConfig::default().with_width(0.125).init(0, &device).unwrap();
    let (target, sources) = (noise(3, [40, 56], &device), [noise(3, [40, 56], &device), noise(3, [40, 56], &device)]);
    let with_mask = net.forward(target.clone(), &sources).motion;
    let joined = Tensor::cat(vec![target.clone(), sources[0].clone(), sources[1].clone()], 1);
    for other in [net.forward_motion(target, &sources), net.forward_snippet(joined).motion] {
        assert_eq!(with_mask.clone().into_data(), other.into_data());
    }
    let maskless = PoseMaskNetConfig { mask: MaskHead::None, ..Default::default() }.with_width(0.125);
    assert!(!maskless.init(0, &device).unwrap().has_mask());
}

#[test]
fn parameter_counts_are_those_of_the_published_networks() {
    let device = Device::flex();
    let millions = |count: usize| (count as f64 / 1e4).round() / 100.0;
    let port = NetsConfig::endo();
    assert_eq!(millions(port.disp.parameter_count()), 31.60);
    assert_eq!(millions(port.pose.motion_parameter_count()), 1.59);
    for config in [NetsConfig::fast(), NetsConfig::paper()] {
        let config = NetsConfig { disp: config.disp.with_width(0.125), pose: config.pose, ..config };
        assert_eq!(config.disp.init(0, &device).unwrap().num_params(), config.disp.parameter_count());
        assert_eq!(config.pose.init(0, &device).unwrap().num_params(), config.pose.parameter_count());
    }
    assert!(NetsConfig::fast().disp.parameter_count() * 10 < port.disp.parameter_count());
}

#[test]
fn every_parameter_receives_a_gradient() {
    let device = Device::flex().autodiff();
    let disp = DispNetConfig::default().with_width(1.0 / 16.0).init(0, &device).unwrap();
    let pose = PoseMaskNetConfig::default().with_width(1.0 / 8.0).init(0, &device).unwrap();
    let sources = [noise(3, [33, 47], &device), noise(3, [33, 47], &device)];
    let target = noise(3, [33, 47], &device);
    let seen = pose.forward(target.clone(), &sources);
    let mut sum =
        seen.motion.sum() + disp.forward(target).scales.into_iter().map(Tensor::mean).reduce(|a, b| a + b).unwrap();
    for mask in seen.mask.unwrap() {
        sum = sum + mask.mean();
    }
    let gradients = sum.backward();
    for (network, dead) in [("disp", dead_parameters(&disp, &gradients)), ("pose", dead_parameters(&pose, &gradients))]
    {
        assert_eq!(dead, 0, "{network}");
    }
}

/// Parameters the gradients do not reach.
fn dead_parameters(module: &impl Module, gradients: &Gradients) -> usize {
    struct Dead<'a>(&'a Gradients, usize);
    impl ModuleVisitor for Dead<'_> {
        fn visit_float<const D: usize>(&mut self, parameter: &Param<Tensor<D>>) {
            self.1 += usize::from(parameter.val().grad(self.0).is_none());
        }
    }
    let mut dead = Dead(gradients, 0);
    module.visit(&mut dead);
    dead.1
}

#[test]
fn a_fresh_network_sees_the_middle_of_the_range_in_a_black_picture() {
    let device = Device::flex();
    let net = DispNetConfig::default().with_width(0.125).init(0, &device).unwrap();
    // Zero biases keep the features of a black picture at zero, so the coarsest head says alpha / 2 + beta.
    let [.., coarsest] = net.forward(Tensor::zeros([1, 3, 32, 48], &device)).scales;
    assert!((coarsest - 5.01).abs().max().into_scalar::<f32>() < 1e-6);
}
