//! Published numbers, reproduced from the published files where those lie beside the repository.

#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "helpers of tests fail and speak as tests do")]

use endoscape_eval::baselines::mean_motion;
use endoscape_eval::rpe::{Delta, DeltaUnit};
use endoscape_eval::trajectory::{Settings, TrajectoryEvaluation, evaluate};
use endoscape_eval::{Alignment, Association, Duplicates, MatrixPose, Poses, Stamps, read, snippets};
use nalgebra::Translation3;
use std::path::PathBuf;

/// The poses of a file of the shared trajectories; `None`, with a line that says so, if it is not here.
fn shared(file: &str) -> Option<Poses> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/trajectories").join(file);
    let Ok(bytes) = std::fs::read(&path) else {
        eprintln!("skipped: {} is not here", path.display());
        return None;
    };
    Some(read::poses(&bytes, None, Duplicates::Refuse).unwrap())
}

fn close(value: f64, expected: f64, relative: f64) {
    assert!((value / expected - 1.0).abs() <= relative, "{value} is not {expected} to {relative:e}");
}

/// Relative errors over 10 m; the published figures leave the pair of the first pose out.
fn kitti_00(method: &str) -> Option<TrajectoryEvaluation> {
    let (estimate, truth) = (shared(&format!("evo/KITTI_00_{method}.txt"))?, shared("evo/KITTI_00_gt.txt")?);
    let delta = Delta { value: 10.0, unit: DeltaUnit::Metres, skip_first: true, ..Delta::default() };
    let settings = Settings { align: Alignment::Se3, delta, ..Settings::default() };
    Some(evaluate(&estimate, &truth, &settings).unwrap())
}

#[test]
fn orb_slam_on_kitti_00_as_in_the_test_data_of_evo() {
    let Some(evaluation) = kitti_00("ORB") else { return };
    let ate = evaluation.errors.ate_m;
    close(ate.rmse, 1.303_449_714_565_026_6, 1e-9);
    close(ate.mean, 1.156_997_128_538_976_8, 1e-9);
    close(ate.median, 1.065_624_769_555_848, 1e-9);
    close(ate.max, 3.587_949_120_678_954, 1e-9);
    close(ate.sse, 7_715.073_440_292_808, 1e-9);
    close(evaluation.errors.rpe.translation_m.rmse, 0.226_261_343_293_101_63, 1e-9);
    close(evaluation.errors.rpe.translation_m.mean, 0.169_017_372_006_532_75, 1e-9);
    assert!(evaluation.warnings.is_empty());
}

#[test]
fn sptam_on_kitti_00_as_in_the_test_data_of_evo() {
    let Some(evaluation) = kitti_00("SPTAM") else { return };
    close(evaluation.errors.ate_m.rmse, 3.738_487_907_582_613, 1e-9);
    close(evaluation.errors.rpe.translation_m.rmse, 0.276_071_090_436_060_04, 1e-9);
}

/// A vehicle that always drives straight ahead scores this on KITTI: the yardstick of five-frame windows.
#[test]
fn constant_motion_on_kitti_in_windows_of_five() {
    for (sequence, mean, std) in [("09", 0.0324, 0.0258), ("10", 0.0238, 0.0233)] {
        let Some(truth) = shared(&format!("kitti_gt/kitti_odom/gt_poses/{sequence}.txt")) else { return };
        let straight: Vec<MatrixPose> = (0..truth.len())
            .map(|frame| MatrixPose::from(Translation3::new(0.0, -0.018 * frame as f64, 0.957 * frame as f64)))
            .collect();
        let estimate = Poses::new(Stamps::Order, straight, Duplicates::Refuse).unwrap();
        let evaluation = snippets::evaluate(&estimate, &truth, Association::Order, 5, None).unwrap();
        let published = evaluation.errors.ate_published;
        assert!((published.mean - mean).abs() <= 0.5e-4, "{sequence}: mean {}", published.mean);
        assert!((published.std - std).abs() <= 0.5e-4, "{sequence}: std {}", published.std);
        close(evaluation.errors.ate_rmse.mean, published.mean * 5_f64.sqrt(), 1e-12);
    }
}

#[test]
fn the_mean_motion_of_kitti_00_to_08() {
    let mut steps = vec![MatrixPose::identity()];
    for sequence in 0..=8 {
        let Some(truth) = shared(&format!("kitti_gt/kitti_odom/gt_poses/{sequence:02}.txt")) else { return };
        for pair in truth.world_from_camera().windows(2) {
            steps.push(steps[steps.len() - 1] * pair[0].inv_mul(&pair[1]));
        }
    }
    let motion = mean_motion(&steps).translation.vector;
    assert!((motion.y + 0.018).abs() < 2e-3 && (motion.z - 0.957).abs() < 2e-3, "{motion}");
}

#[test]
fn the_example_of_kitti_odom_eval() {
    let (Some(estimate), Some(truth)) =
        (shared("kitti_results/example_0/09.txt"), shared("kitti_gt/kitti_odom/gt_poses/09.txt"))
    else {
        return;
    };
    let settings = Settings { align: Alignment::Sim3, ..Settings::default() };
    let evaluation = evaluate(&estimate, &truth, &settings).unwrap();
    assert!((evaluation.errors.ate_m.rmse - 8.386_62).abs() < 0.5e-5, "{}", evaluation.errors.ate_m.rmse);
}
