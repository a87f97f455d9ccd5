//! Laws of view synthesis, and the pixel convention.
#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "test helpers fail by panicking and say what they skip")]

mod common;

use burn::tensor::ops::{GridSampleOptions, GridSamplePaddingMode, InterpolateMode};
use burn::tensor::{DType, Device, Tensor};
use common::{SIZE, batch_of, cameras, identity, noise_tensor, number, options, tensor, values};
use endoscape_core::camera::{Intrinsics, Pinhole};
use endoscape_core::{Camera, Size};
use endoscape_synthesis::light::light_disagreement;
use endoscape_synthesis::motion::{Rotation, source_from_target};
use endoscape_synthesis::photometric::{auto_mask, minimum_over_sources, structural_distance};
use endoscape_synthesis::pyramid::{enlarge, shrink, shrink_usable, sizes};
use endoscape_synthesis::warp::{correspond, sample_bilinear};
use endoscape_synthesis::{
    CameraPyramid, LossTerms, ObjectiveConfig, OutOfView, Prediction, View, ViewBatch, objective, synthesize,
};
use proptest::prelude::*;

fn picture(seed: u64) -> Tensor<4> {
    noise_tensor(seed, [1, 3, SIZE.height, SIZE.width], -1.0, 1.0)
}

fn depth(seed: u64) -> Tensor<4> {
    noise_tensor(seed, [1, 1, SIZE.height, SIZE.width], 0.5, 2.0)
}

fn largest<const D: usize>(tensor: Tensor<D>) -> f64 {
    values(tensor).into_iter().fold(0.0, |largest, value| largest.max(value.abs()))
}

#[test]
fn a_camera_that_does_not_move_sees_the_source() {
    for (name, camera) in cameras() {
        let cameras = batch_of(&[camera], SIZE);
        let result = synthesize(picture(1), depth(2), identity(1), &cameras, OutOfView::Border);
        let error = largest((result.image - picture(1)) * result.valid.clone());
        assert!(error < 1e-4, "{name}: {error}");
        assert_eq!(values(result.valid), values(cameras.seen()), "{name} lost pixels");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]
    #[test]
    fn only_the_ratio_of_translation_and_depth_matters(seed in 0_u64..1000, scale in 1e-3..1e3) {
        for (name, camera) in cameras() {
            let cameras = batch_of(&[camera], SIZE);
            let motion = noise_tensor::<2>(seed, [1, 6], -0.3, 0.3);
            let unit = tensor(vec![scale, scale, scale, 1.0, 1.0, 1.0], [1, 6]);
            let moved = |motion, depth| {
                synthesize(picture(3), depth, source_from_target(motion, Rotation::Euler), &cameras, OutOfView::Masked)
            };
            let (a, b) = (moved(motion.clone(), depth(4)), moved(motion * unit, depth(4) * scale));
            prop_assert_eq!(values(a.valid.clone()), values(b.valid), "{}", name);
            prop_assert!(largest((a.image - b.image) * a.valid) < 1e-6, "{}", name);
        }
    }
}

/// A pinhole that moves a plane at depth 2 by one pixel per 0.5 of translation.
fn shifting_camera() -> Camera {
    let intrinsics = Intrinsics { fx: 4.0, fy: 4.0, cx: 2.3, cy: 1.7, skew: 0.0 };
    Camera::new(SIZE, Pinhole { intrinsics }.into()).unwrap()
}

fn shift(columns: f64, rows: f64) -> Tensor<3> {
    source_from_target(tensor(vec![0.5 * columns, 0.5 * rows, 0.0, 0.0, 0.0, 0.0], [1, 6]), Rotation::Euler)
}

fn shifted(source: Tensor<4>, columns: f64, policy: OutOfView) -> endoscape_synthesis::Synthesized {
    let plane = depth(0) * 0.0 + 2.0;
    synthesize(source, plane, shift(columns, 0.0), &batch_of(&[shifting_camera()], SIZE), policy)
}

#[test]
fn pixel_centres_lie_at_integers() {
    let source = picture(5);
    let whole = shifted(source.clone(), 1.0, OutOfView::Masked);
    let expected = source.clone().narrow(3, 1, 5);
    assert!(largest(whole.image.narrow(3, 0, 5) - expected.clone()) < 1e-12, "a shift by a pixel must move pixels");
    let columns = values(whole.valid.narrow(2, 0, 1));
    assert_eq!(columns, [1.0, 1.0, 1.0, 1.0, 1.0, 0.0], "the last column came from outside");
    let half = shifted(source.clone(), 0.5, OutOfView::Masked).image.narrow(3, 0, 5);
    assert!(largest(half - (source.narrow(3, 0, 5) + expected) * 0.5) < 1e-12, "half a pixel mixes two equally");
}

#[test]
fn sampling_is_grid_sample_with_aligned_corners() {
    let pixels = noise_tensor::<4>(6, [1, 2, 7, 9], -2.0, 8.0);
    let ours = sample_bilinear(picture(7), pixels.clone());
    let normalised = |axis: usize, length: usize| pixels.clone().narrow(1, axis, 1) * (2.0 / (length - 1) as f64) - 1.0;
    let grid = Tensor::cat(vec![normalised(0, SIZE.width), normalised(1, SIZE.height)], 1).permute([0, 2, 3, 1]);
    let burn = |aligned| {
        let options = GridSampleOptions::new(InterpolateMode::Bilinear)
            .with_padding_mode(GridSamplePaddingMode::Border)
            .with_align_corners(aligned);
        picture(7).grid_sample_2d(grid.clone(), options)
    };
    assert!(largest(ours.clone() - burn(true)) < 1e-9);
    assert!(largest(ours - burn(false)) > 0.1, "the other convention must be visible to this test");
}

#[test]
fn autodiff_devices_compute_the_same_numbers() {
    for (name, camera) in cameras() {
        let cameras = batch_of(&[camera], SIZE);
        for policy in [OutOfView::Grey, OutOfView::Masked, OutOfView::Border] {
            let run = |track: fn(Tensor<4>) -> Tensor<4>| {
                let result = synthesize(picture(8), track(depth(9)), shift(1.7, -2.6), &cameras, policy);
                (values(result.image.inner()), values(result.valid.inner()))
            };
            assert_eq!(run(|plain| plain), run(|plain| plain.autodiff().require_grad()), "{name} {policy:?}");
        }
    }
}

#[test]
fn single_precision_is_close_to_double() {
    for (name, camera) in cameras() {
        let single = endoscape_synthesis::CameraBatch::new(
            &[camera],
            SIZE,
            endoscape_synthesis::CameraScaling::Exact,
            (&Device::flex(), DType::F32),
        )
        .unwrap();
        let double = correspond(depth(10), shift(0.4, 0.3), &batch_of(&[camera], SIZE));
        let single = correspond(depth(10).cast(DType::F32), shift(0.4, 0.3).cast(DType::F32), &single);
        let error = largest(double.pixels - single.pixels.cast(DType::F64));
        assert!(error < 1e-3, "{name}: {error} px");
    }
}

#[test]
fn structure_does_not_differ_from_itself() {
    assert!(largest(structural_distance(picture(11), picture(11))) < 1e-12);
    let distance = values(structural_distance(picture(11), picture(12)));
    assert!(distance.iter().all(|value| (0.0..=1.0).contains(value)));
}

#[test]
fn hidden_points_take_their_other_source() {
    let map = |values: [f64; 4]| tensor(values.to_vec(), [1, 1, 1, 4]);
    let errors = vec![map([0.1, 0.9, 0.5, 0.2]), map([0.3, 0.2, 0.1, 0.1])];
    let valid = vec![map([1.0, 1.0, 1.0, 0.0]), map([1.0, 1.0, 0.0, 0.0])];
    let (error, counts) = minimum_over_sources(errors, valid);
    assert_eq!(values(error)[..3], [0.1, 0.2, 0.5]);
    assert_eq!(values(counts), [1.0, 1.0, 1.0, 0.0]);
}

#[test]
fn what_stands_still_is_dropped() {
    let map = |values: [f64; 3]| tensor(values.to_vec(), [1, 1, 1, 3]);
    let kept = auto_mask(map([0.1, 0.3, 0.2]), map([0.2, 0.1, 0.2]));
    assert_eq!(values(kept), [1.0, 0.0, 0.0], "a tie drops the pixel");
}

#[test]
fn scales_halve_and_meet_their_edges() {
    let expected = [(7, 5), (4, 3), (2, 2), (1, 1)].map(|(width, height)| Size::new(width, height));
    assert_eq!(sizes(Size::new(7, 5), 4), expected);
    let ramp = tensor((0..8).map(f64::from).collect(), [1, 1, 1, 8]);
    assert_eq!(values(shrink(ramp.clone(), [1, 4])), [0.5, 2.5, 4.5, 6.5]);
    // Away from the border, enlarging a shrunk ramp gives the ramp back: edges map to edges.
    let again = values(enlarge(shrink(ramp.clone(), [1, 4]), [1, 8]));
    assert!(again[1..7].iter().zip(&values(ramp)[1..7]).all(|(a, b)| (a - b).abs() < 1e-12), "{again:?}");
    let usable = tensor(vec![1.0, 1.0, 1.0, 0.0], [1, 1, 1, 4]);
    assert_eq!(values(shrink_usable(usable, [1, 2])), [1.0, 0.0]);
}

fn terms_of_equal_pictures(config: &ObjectiveConfig) -> LossTerms {
    let camera = shifting_camera();
    let view = || View { image: picture(13), usable: None };
    let sizes = sizes(SIZE, 2);
    let cameras = CameraPyramid::new(&[camera], &sizes, config.camera_scaling, options()).unwrap();
    let flat = |size: &Size| tensor(vec![0.7; size.area()], [1, 1, size.height, size.width]);
    let prediction = Prediction {
        disparities: sizes.iter().map(flat).collect(),
        source_from_target: vec![identity(1); 2],
        masks: Vec::new(),
        source_disparities: vec![sizes.iter().map(flat).collect(); 2],
    };
    objective(&ViewBatch { target: view(), sources: vec![view(), view()], cameras }, &prediction, config)
}

#[test]
fn nothing_is_lost_between_equal_pictures() {
    // A flat wall under any picture is not what the lamp says.
    let without_light = ObjectiveConfig { light_weight: 0.0, ..ObjectiveConfig::endo() };
    for config in [ObjectiveConfig::paper(), ObjectiveConfig::port(), without_light] {
        let terms = terms_of_equal_pictures(&config);
        for term in [terms.photometric, terms.smoothness, terms.mask, terms.geometry, terms.total] {
            assert!(number(term).abs() < 1e-9, "{config:?}");
        }
    }
    let frozen = terms_of_equal_pictures(&ObjectiveConfig::endo());
    assert_eq!(number(frozen.coverage), 0.0, "frozen frames have nothing to teach");
    assert_eq!(number(terms_of_equal_pictures(&ObjectiveConfig::paper()).coverage), 1.0);
}

/// A tilted wall lit from the lens, with the law of `synthesis::light`, and its depth.
fn lit_wall(camera: &Camera, exposure: f64) -> (Tensor<4>, Tensor<4>) {
    let Size { width, height } = camera.size();
    let normal = nalgebra::Vector3::new(0.4, -0.3, -1.0).normalize();
    let (mut depth, mut light) = (Vec::new(), Vec::new());
    for y in 0..height {
        for x in 0..width {
            let ray = camera.unproject(&nalgebra::Point2::new(x as f64, y as f64)).unwrap();
            // The wall passes 1 in front of the lens.
            let distance = normal.z / normal.dot(&ray);
            depth.push(distance * ray.z);
            let radiance = exposure * normal.dot(&ray).abs().sqrt() / (distance * distance);
            light.push(2.0 * radiance.powf(1.0 / 2.2) - 1.0);
        }
    }
    let shape = [1, 1, height, width];
    (tensor(light, shape).expand([1, 3, height, width]), tensor(depth, shape))
}

#[test]
fn a_wall_lit_from_the_lens_agrees_with_its_light_and_no_other_does() {
    let size = Size::new(24, 18);
    let camera = Camera::from_field_of_view(size, 1.4).unwrap();
    let cameras = batch_of(&[camera], size);
    for exposure in [0.3, 0.6] {
        let (image, depth) = lit_wall(&camera, exposure);
        let disagreement = |depth: Tensor<4>| number(light_disagreement(depth, image.clone(), None, &cameras));
        let truth = disagreement(depth.clone());
        assert!(truth < 0.01, "{truth}");
        assert!((disagreement(depth.clone() * 37.0) - truth).abs() < 1e-6, "the unit of depth counts");
        for wrong in [depth.ones_like(), depth.clone().recip(), depth.clone().powf_scalar(2.0)] {
            let wrong = disagreement(wrong);
            assert!(wrong > 10.0 * truth, "{wrong} of a wrong wall, {truth} of the true one");
        }
    }
}
