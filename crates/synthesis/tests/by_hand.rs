//! Values worked out with pencil and paper: the behaviour of SfMLearner's TensorFlow original and the later terms.
#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "test helpers fail by panicking and say what they skip")]

mod common;

use burn::tensor::Tensor;
use common::{SIZE, identity, noise_tensor, number, options, tensor, values};
use endoscape_core::Camera;
use endoscape_core::camera::{Intrinsics, Pinhole};
use endoscape_synthesis::brightness::align_brightness;
use endoscape_synthesis::geometry::depth_disagreement;
use endoscape_synthesis::mask_loss::reliability_cross_entropy;
use endoscape_synthesis::motion::{Rotation, source_from_target};
use endoscape_synthesis::photometric::Average;
use endoscape_synthesis::smoothness::{edge_aware, second_order};
use endoscape_synthesis::{
    CameraPyramid, LossTerms, ObjectiveConfig, OutOfView, Prediction, View, ViewBatch, objective, pyramid,
};

const LN_2: f64 = std::f64::consts::LN_2;

fn constant(value: f64, channels: usize) -> Tensor<4> {
    tensor(vec![value; channels * SIZE.area()], [1, channels, SIZE.height, SIZE.width])
}

/// A target of 0.25 and one source of 1, the camera moved so that four of six columns stay in view; depth 2.
fn terms(config: &ObjectiveConfig, edit: impl FnOnce(&mut ViewBatch, &mut Prediction)) -> LossTerms {
    let intrinsics = Intrinsics { fx: 4.0, fy: 4.0, cx: 2.5, cy: 2.0, skew: 0.0 };
    let camera = Camera::new(SIZE, Pinhole { intrinsics }.into()).unwrap();
    let cameras = CameraPyramid::new(&[camera], &[SIZE], config.camera_scaling, options()).unwrap();
    let view = |value| View { image: constant(value, 3), usable: None };
    let two_columns = tensor(vec![1.0, 0.0, 0.0, 0.0, 0.0, 0.0], [1, 6]);
    let mut batch = ViewBatch { target: view(0.25), sources: vec![view(1.0)], cameras };
    let mut prediction = Prediction {
        disparities: vec![constant(0.5, 1)],
        source_from_target: vec![source_from_target(two_columns, Rotation::Euler)],
        masks: Vec::new(),
        source_disparities: Vec::new(),
    };
    edit(&mut batch, &mut prediction);
    objective(&batch, &prediction, config)
}

fn photometric(config: &ObjectiveConfig) -> f64 {
    number(terms(config, |_, _| ()).photometric)
}

fn assert_near(got: f64, expected: f64) {
    assert!((got - expected).abs() < 1e-9, "{got} instead of {expected}");
}

#[test]
fn what_leaves_the_view_is_priced_by_policy() {
    let with = |out_of_view, average| ObjectiveConfig { out_of_view, average, ..ObjectiveConfig::paper() };
    // In view |0.25 - 1|; outside |0.25 - 0|, nothing, or the border's colour again.
    assert_near(photometric(&with(OutOfView::Grey, Average::ValidPixels)), (4.0 * 0.75 + 2.0 * 0.25) / 6.0);
    assert_near(photometric(&with(OutOfView::Masked, Average::ValidPixels)), 0.75);
    assert_near(photometric(&with(OutOfView::Masked, Average::AllPixels)), 4.0 * 0.75 / 6.0);
    assert_near(photometric(&with(OutOfView::Border, Average::ValidPixels)), 0.75);
}

#[test]
fn grey_pixels_have_a_price_but_no_gradient() {
    let all_outside = tensor(vec![9.0, 0.0, 0.0, 0.0, 0.0, 0.0], [1, 6]).autodiff().require_grad();
    let disparity = constant(0.5, 1).autodiff().require_grad();
    let terms = terms(&ObjectiveConfig::paper(), |batch, prediction| {
        batch.sources[0].image = noise_tensor(1, [1, 3, SIZE.height, SIZE.width], -1.0, 1.0);
        prediction.source_from_target = vec![source_from_target(all_outside.clone(), Rotation::Euler)];
        prediction.disparities = vec![disparity.clone()];
    });
    assert_near(number(terms.photometric.clone().inner()), 0.25);
    let gradients = terms.photometric.backward();
    assert!(values(disparity.grad(&gradients).unwrap()).iter().all(|gradient| *gradient == 0.0));
    assert!(values(all_outside.grad(&gradients).unwrap()).iter().all(|gradient| *gradient == 0.0));
}

#[test]
fn known_bad_pixels_do_not_count() {
    let config = ObjectiveConfig::paper();
    let mut usable = vec![1.0; SIZE.area()];
    // The first row is bad in the target and painted in a colour that would be expensive.
    usable[..SIZE.width].fill(0.0);
    let bad_target = terms(&config, |batch, _| {
        let row = constant(-1.0, 3).narrow(2, 0, 1);
        let rest = constant(0.25, 3).narrow(2, 1, SIZE.height - 1);
        batch.target.image = Tensor::cat(vec![row, rest], 2);
        batch.target.usable = Some(tensor(usable.clone(), [1, 1, SIZE.height, SIZE.width]));
    });
    assert_near(number(bad_target.photometric), photometric(&config));
    assert_near(number(bad_target.coverage), 0.8);
    // A bad pixel of the source spoils the target pixel that reads it.
    let bad_source = terms(&config, |batch, prediction| {
        batch.sources[0].usable = Some(tensor(usable, [1, 1, SIZE.height, SIZE.width]));
        prediction.source_from_target = vec![identity(1)];
    });
    assert_near(number(bad_source.coverage), 0.8);
}

#[test]
fn second_order_smoothness() {
    let map = |value: fn(f64, f64) -> f64| {
        let at = |index: usize| value((index % SIZE.width) as f64, (index / SIZE.width) as f64);
        tensor((0..SIZE.area()).map(at).collect(), [1, 1, SIZE.height, SIZE.width])
    };
    assert_near(number(second_order(map(|x, y| 3.0 + 2.0 * x - 5.0 * y))), 0.0);
    assert_near(number(second_order(map(|x, _| x * x))), 2.0);
    assert_near(number(second_order(map(|_, y| 1.5 * y * y))), 3.0);
    // d_xy and d_yx both count.
    assert_near(number(second_order(map(|x, y| x * y))), 2.0);
    assert_near(number(second_order(tensor(vec![4.0], [1, 1, 1, 1]))), 0.0);
}

#[test]
fn smoothness_weighs_half_as_much_at_every_coarser_scale() {
    let parabola = |width: usize, height: usize, curvature: f64| {
        let at = |index: usize| 1.0 + curvature * ((index % width) as f64).powi(2);
        tensor((0..width * height).map(at).collect(), [1, 1, height, width])
    };
    let config = ObjectiveConfig::paper();
    let intrinsics = Intrinsics { fx: 4.0, fy: 4.0, cx: 2.5, cy: 2.0, skew: 0.0 };
    let camera = Camera::new(SIZE, Pinhole { intrinsics }.into()).unwrap();
    let smooth = number(
        terms(&config, |batch, prediction| {
            let sizes = pyramid::sizes(SIZE, 2);
            batch.cameras = CameraPyramid::new(&[camera], &sizes, config.camera_scaling, options()).unwrap();
            prediction.disparities = vec![parabola(6, 5, 0.1), parabola(3, 3, 0.3)];
        })
        .smoothness,
    );
    // d_xx is 0.2 at full and 0.6 at half size.
    assert_near(smooth, 0.2 + 0.6 / 2.0);
}

#[test]
fn total_is_the_papers_last_equation() {
    let config = ObjectiveConfig::paper();
    let terms = terms(&config, |_, prediction| {
        prediction.masks = vec![constant(0.5, 1)];
        let ripple = (0..SIZE.area()).map(|index| 0.5 + 0.1 * (index % 2) as f64).collect();
        prediction.disparities = vec![tensor(ripple, [1, 1, SIZE.height, SIZE.width])];
    });
    let [photometric, smooth, mask] = [terms.photometric, terms.smoothness, terms.mask].map(number);
    assert_near(mask, LN_2);
    assert_near(number(terms.total), photometric + 0.4 * smooth + 0.15 * mask);
}

#[test]
fn masks_scale_errors_and_cost_their_logarithm() {
    let config = ObjectiveConfig { out_of_view: OutOfView::Border, ..ObjectiveConfig::paper() };
    let halved = terms(&config, |_, prediction| prediction.masks = vec![constant(0.5, 1)]);
    assert_near(number(halved.photometric), 0.375);
    assert_near(number(reliability_cross_entropy(constant(1.0, 2))), 0.0);
    assert_near(number(reliability_cross_entropy(constant(0.25, 2))), 2.0 * LN_2);
}

#[test]
fn edges_in_the_picture_excuse_edges_in_depth() {
    let step = |low: f64, high: f64| tensor(vec![low, low, high, high], [1, 1, 1, 4]);
    // One of three differences jumps from 1 to 3; the mean is 2.
    assert_near(number(edge_aware(step(1.0, 3.0), &step(0.0, 0.0))), 1.0 / 3.0);
    assert_near(number(edge_aware(step(1.0, 3.0), &step(-1.0, 1.0))), (-2.0_f64).exp() / 3.0);
    assert_near(number(edge_aware(step(10.0, 30.0), &step(0.0, 0.0))), 1.0 / 3.0);
}

#[test]
fn brightness_of_the_target_is_restored() {
    let target = noise_tensor::<4>(2, [1, 3, SIZE.height, SIZE.width], -0.9, 0.9);
    let dimmed = target.clone() * 0.4 - 0.3;
    let valid = constant(1.0, 1);
    let again = align_brightness(dimmed, target.clone(), valid);
    let error = values(again - target).into_iter().fold(0.0, |largest: f64, error| largest.max(error.abs()));
    assert!(error < 1e-4, "{error}");
}

#[test]
fn depths_disagree_by_their_relative_difference() {
    let map = |values: [f64; 3]| tensor(values.to_vec(), [1, 1, 1, 3]);
    let got = values(depth_disagreement(map([1.0, 3.0, 0.02]), map([1.0, 1.0, 0.06])));
    for (got, expected) in got.into_iter().zip([0.0, 0.5, 0.5]) {
        assert_near(got, expected);
    }
}
