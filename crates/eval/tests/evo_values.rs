//! Figures evo 1.38.1 computes for trajectories that are written down as formulae here.
//!
//! `python scripts/compare_with_evo.py --print-reference` prints them again.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail and speak as tests do")]

use endoscape_eval::rpe::{Delta, DeltaUnit};
use endoscape_eval::trajectory::{Settings, evaluate};
use endoscape_eval::{Alignment, Duplicates, MatrixPose, Poses, Stamps};
use nalgebra::{Rotation3, Translation3, Vector3};

fn pair() -> (Poses, Poses) {
    let (mut truth, mut estimate) = (Vec::new(), Vec::new());
    for i in (0..120).map(f64::from) {
        let angle = 0.05 * i;
        let position = Vector3::new(3.0 * angle.sin(), 2.0 * (0.7 * angle).cos(), 0.5 * angle);
        let rotation = Rotation3::from_scaled_axis(Vector3::new(0.3, 1.0, -0.2) * 0.4 * angle);
        truth.push((0.1 * i, MatrixPose::from_parts(Translation3::from(position), rotation)));
        let wobble = Vector3::new((1.3 * i).sin(), (2.1 * i).cos(), (0.4 * i + 1.0).sin()) * 0.05;
        let moved = position * 0.5 + wobble + Vector3::new(1.0, -2.0, 3.0);
        let turned = rotation * Rotation3::from_scaled_axis(wobble * 0.4);
        estimate.push((0.1 * i + 0.003, MatrixPose::from_parts(Translation3::from(moved), turned)));
    }
    let poses = |timed: Vec<(f64, MatrixPose)>| {
        let (times_s, poses) = timed.into_iter().unzip();
        Poses::new(Stamps::Seconds(times_s), poses, Duplicates::Refuse).unwrap()
    };
    (poses(estimate), poses(truth))
}

/// Scale; ATE rmse, median; rotation mean; full rmse; pairs; RPE rmse, max; rotation rmse; full mean.
type Figures = [f64; 10];

#[rustfmt::skip]
const CASES: [(Alignment, f64, DeltaUnit, bool, Figures); 5] = [
    (Alignment::None, 1.0, DeltaUnit::Frames, false, [
        1.0, 3.3445212070259673, 3.186552939695017, 1.36648707625545, 3.344701084346614,
        119.0, 0.09588783170675039, 0.15597478131793852, 1.7459568019395593, 0.10041545043040835,
    ]),
    (Alignment::Se3, 0.5, DeltaUnit::Metres, true, [
        1.0, 1.3711406277758487, 1.4410264919517815, 1.4088825092094575, 1.3716077396664823,
        112.0, 0.326575540817384, 0.5241780578471616, 2.0433807977464986, 0.3166473142627567,
    ]),
    (Alignment::Sim3, 0.5, DeltaUnit::Metres, false, [
        1.99648059650167, 0.12243514431642179, 0.12146089814482712, 1.4088825092094575, 0.12755992685492165,
        34.0, 0.16461651925723764, 0.24395918262548172, 1.9174260277164175, 0.16354216670256622,
    ]),
    (Alignment::Scale, 10.0, DeltaUnit::Degrees, true, [
        1.99648059650167, 7.469703711330445, 7.465144360423931, 1.36648707625545, 7.469784252202121,
        180.0, 0.197390348595649, 0.3024004851367451, 2.292753496134939, 0.1956264616587583,
    ]),
    (Alignment::First, 0.2, DeltaUnit::Radians, false, [
        1.0, 1.956349886798432, 1.7049189989674982, 1.9344647847517138, 1.9569990234871764,
        19.0, 0.3583876298282599, 0.5446435197512237, 1.9568007804802907, 0.34415304286464393,
    ]),
];

#[test]
fn all_alignments_and_units() {
    let (estimate, truth) = pair();
    for (align, value, unit, all_pairs, expected) in CASES {
        let delta = Delta { value, unit, all_pairs, skip_first: false };
        let evaluation = evaluate(&estimate, &truth, &Settings { align, delta, ..Settings::default() }).unwrap();
        let (errors, rpe) = (&evaluation.errors, &evaluation.errors.rpe);
        let figures = [
            evaluation.scale,
            errors.ate_m.rmse,
            errors.ate_m.median,
            errors.rotation_deg.mean,
            errors.full.rmse,
            rpe.pairs as f64,
            rpe.translation_m.rmse,
            rpe.translation_m.max,
            rpe.rotation_deg.rmse,
            rpe.full.mean,
        ];
        for (figure, expected) in figures.iter().zip(expected) {
            assert!((figure / expected - 1.0).abs() < 1e-9, "{align} {value}: {figures:?}");
        }
    }
}
