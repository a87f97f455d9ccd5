//! Laws the errors obey, and trajectories that must not end in NaN.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail and speak as tests do")]

use endoscape_eval::snippets;
use endoscape_eval::trajectory::{Settings, TrajectoryEvaluation, evaluate};
use endoscape_eval::{Alignment, Association, Duplicates, EvalError, MatrixPose, Poses, Stamps};
use nalgebra::{Rotation3, Translation3, Vector3};
use proptest::prelude::*;

fn poses(list: Vec<MatrixPose>) -> Poses {
    let times_s = (0..list.len()).map(|index| index as f64 * 0.1).collect();
    Poses::new(Stamps::Seconds(times_s), list, Duplicates::Refuse).unwrap()
}

fn motion(numbers: [f64; 6]) -> MatrixPose {
    let [x, y, z, a, b, c] = numbers;
    MatrixPose::from_parts(Translation3::new(x, y, z), Rotation3::from_scaled_axis(Vector3::new(a, b, c)))
}

fn chain(steps: &[[f64; 6]]) -> Vec<MatrixPose> {
    let mut list = vec![MatrixPose::identity()];
    for step in steps {
        list.push(list[list.len() - 1] * motion(*step));
    }
    list
}

fn steps() -> impl Strategy<Value = Vec<[f64; 6]>> {
    let step = (prop::array::uniform3(-0.1..0.1_f64), prop::array::uniform3(-0.2..0.2_f64));
    prop::collection::vec(step.prop_map(|(t, r)| [t[0], t[1], t[2] + 0.3, r[0], r[1], r[2]]), 12..40)
}

fn judged(estimate: &[MatrixPose], truth: &[MatrixPose], align: Alignment) -> TrajectoryEvaluation {
    let settings = Settings { align, ..Settings::default() };
    evaluate(&poses(estimate.to_vec()), &poses(truth.to_vec()), &settings).unwrap()
}

fn scaled(list: &[MatrixPose], scale: f64) -> Vec<MatrixPose> {
    let by =
        |pose: &MatrixPose| MatrixPose::from_parts(Translation3::from(pose.translation.vector * scale), pose.rotation);
    list.iter().map(by).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn equal_trajectories_have_no_error(steps in steps()) {
        let truth = chain(&steps);
        for align in [Alignment::None, Alignment::Se3, Alignment::Sim3, Alignment::Scale, Alignment::First] {
            let evaluation = judged(&truth, &truth, align);
            prop_assert!(evaluation.errors.ate_m.max < 1e-9);
            prop_assert!(evaluation.errors.rpe.translation_m.max < 1e-9);
            prop_assert!((evaluation.scale - 1.0).abs() < 1e-9);
            prop_assert_eq!(evaluation.warnings.len(), 0);
        }
    }

    #[test]
    fn the_aligned_group_changes_nothing(steps in steps(), noise in steps(), moved in prop::array::uniform6(-3.0..3.0_f64), scale in 0.1..10.0_f64) {
        let truth = chain(&steps);
        let noisy: Vec<[f64; 6]> = steps.iter().zip(noise.iter().cycle()).map(|(a, b)| {
            std::array::from_fn(|index| a[index] + 0.1 * b[index])
        }).collect();
        let estimate = chain(&noisy);
        let world = motion(moved);
        let rigid: Vec<MatrixPose> = estimate.iter().map(|pose| world * pose).collect();
        let (before, after) = (judged(&estimate, &truth, Alignment::Se3), judged(&rigid, &truth, Alignment::Se3));
        prop_assert!((before.errors.ate_m.rmse - after.errors.ate_m.rmse).abs() < 1e-8);
        prop_assert!((before.errors.rotation_deg.rmse - after.errors.rotation_deg.rmse).abs() < 1e-6);
        let similar = scaled(&rigid, scale);
        let (before, after) = (judged(&estimate, &truth, Alignment::Sim3), judged(&similar, &truth, Alignment::Sim3));
        prop_assert!((before.errors.ate_m.rmse - after.errors.ate_m.rmse).abs() < 1e-8);
        prop_assert!((before.scale / (after.scale * scale) - 1.0).abs() < 1e-8);
        // A correction can only help, and a larger group helps more.
        let rmse = |align| judged(&estimate, &truth, align).errors.ate_m.rmse;
        prop_assert!(rmse(Alignment::Sim3) <= rmse(Alignment::Se3) + 1e-9);
        prop_assert!(rmse(Alignment::Se3) <= rmse(Alignment::None).min(rmse(Alignment::First)) + 1e-9);
    }

    #[test]
    fn without_scale_estimate_and_truth_may_change_places(a in steps(), b in steps()) {
        let count = a.len().min(b.len());
        let (a, b) = (chain(&a[..count]), chain(&b[..count]));
        let (ab, ba) = (judged(&a, &b, Alignment::Se3), judged(&b, &a, Alignment::Se3));
        prop_assert!((ab.errors.ate_m.rmse - ba.errors.ate_m.rmse).abs() < 1e-8);
        prop_assert!((ab.errors.rpe.rotation_deg.rmse - ba.errors.rpe.rotation_deg.rmse).abs() < 1e-6);
    }

    #[test]
    fn inverted_estimates_are_recognised(steps in steps()) {
        let truth = chain(&steps);
        let poses_inverted: Vec<MatrixPose> = truth.iter().map(MatrixPose::inverse).collect();
        let motions_inverted = chain(&steps).windows(2).fold(vec![MatrixPose::identity()], |mut list, pair| {
            list.push(list[list.len() - 1] * pair[1].inv_mul(&pair[0]));
            list
        });
        for inverted in [poses_inverted, motions_inverted] {
            let evaluation = judged(&inverted, &truth, Alignment::None);
            prop_assert!(evaluation.warnings.iter().any(|warning| warning.contains("camera_from_world")));
        }
    }

    #[test]
    fn windows_do_not_depend_on_frame_or_scale(steps in steps(), moved in prop::array::uniform6(-3.0..3.0_f64), scale in 0.1..10.0_f64) {
        let truth = chain(&steps);
        let world = motion(moved);
        let other: Vec<MatrixPose> = truth.iter().map(|pose| world * pose).collect();
        let nearest = Association::Nearest { tolerance_s: 0.01 };
        let evaluation = snippets::evaluate(&poses(scaled(&other, scale)), &poses(truth), nearest, 5, None).unwrap();
        prop_assert!(evaluation.errors.ate_rmse.mean < 1e-9);
        prop_assert!(evaluation.errors.rotation_rad.mean < 1e-7);
    }
}

/// Every number of an answer, by way of its JSON form: NaN and infinity would come out as null.
fn is_finite(evaluation: &TrajectoryEvaluation) -> bool {
    let e = &evaluation.errors;
    let statistics = [e.ate_m, e.rotation_deg, e.full, e.rpe.translation_m, e.rpe.rotation_deg];
    let numbers = statistics.iter().flat_map(|s| [s.rmse, s.mean, s.median, s.std, s.min, s.max, s.sse]);
    numbers.chain([evaluation.scale, evaluation.completeness]).chain(e.endpoint_drift_percent).all(f64::is_finite)
}

#[test]
fn degenerate_trajectories_give_an_error_or_a_number() {
    let rest = vec![MatrixPose::identity(); 10];
    let line: Vec<MatrixPose> = (0..10).map(|i| MatrixPose::translation(0.0, 0.0, f64::from(i))).collect();
    let curve = chain(&[[0.1, 0.0, 0.3, 0.1, 0.2, 0.0]; 9]);
    for (estimate, truth) in [(&rest, &curve), (&curve, &rest), (&line, &curve), (&line, &line), (&rest, &rest)] {
        for align in [Alignment::None, Alignment::Se3, Alignment::Sim3, Alignment::Scale, Alignment::First] {
            let settings = Settings { align, ..Settings::default() };
            match evaluate(&poses(estimate.clone()), &poses(truth.clone()), &settings) {
                Ok(evaluation) => assert!(is_finite(&evaluation), "{align}: {evaluation:?}"),
                Err(error) => assert_eq!(error, EvalError::Degenerate { alignment: align.name() }),
            }
        }
    }
    let straight = judged(&line, &line, Alignment::Scale);
    assert_eq!((straight.scale, straight.errors.ate_m.max), (1.0, 0.0));
}

#[test]
fn one_pose_is_too_few() {
    let one = poses(vec![MatrixPose::identity()]);
    let error = evaluate(&one, &one, &Settings::default()).unwrap_err();
    assert!(matches!(error, EvalError::TooFew { got: 1, needed: 2, .. }));
}

#[test]
fn the_constant_baseline_is_perfect_on_a_screw() {
    let screw = chain(&[[0.02, 0.0, 0.3, 0.05, 0.1, 0.0]; 60]);
    let evaluation = judged(&screw, &screw, Alignment::Se3);
    assert!(evaluation.baselines.constant.ate_m.rmse < 1e-9);
    assert!(evaluation.baselines.zero.ate_m.rmse > 0.1);
    assert!(evaluation.baselines.previous.rpe.translation_m.median < 1e-9);
    assert_eq!(evaluation.errors.segments.len(), 5);
    assert!(evaluation.errors.segments.iter().all(|errors| errors.translation_m < 1e-9));
}

#[test]
fn a_scale_that_drifts_shows_along_the_path() {
    let truth = chain(&[[0.02, 0.0, 0.3, 0.05, 0.1, 0.0]; 100]);
    let mut estimate = vec![truth[0]];
    for (index, pair) in truth.windows(2).enumerate() {
        let mut step = pair[0].inv_mul(&pair[1]);
        step.translation.vector /= 1.0 + index as f64 * 0.01;
        estimate.push(estimate[estimate.len() - 1] * step);
    }
    let evaluation = judged(&estimate, &truth, Alignment::Sim3);
    let scales: Vec<f64> = evaluation.scale_along_path.iter().map(|part| part.scale).collect();
    assert_eq!(scales.len(), 10);
    assert!(scales.windows(2).all(|pair| pair[1] > pair[0]) && scales[9] > 1.7, "{scales:?}");
    assert!(evaluation.scale_drift_percent.unwrap() > 10.0);
}
