//! Noise of the tests: 0.4 uT per component, what a MEMS magnetometer shows (ST LIS3MDL data sheet: 3.2 to 4.1 mG rms
//! in ultra-high-performance mode, range 1.2 mT). Magnet: 0.25 A m^2, a cylinder of N52 (remanence 1.45 T) of 6.4 mm
//! diameter and height, as fits a capsule of 11 mm. Array: 8 x 8 sensors, 3 cm apart.

use super::*;
use endoscape_core::magnetic::{HallArray, Magnet};
use endoscape_core::se3;
use nalgebra::{SVector, Vector6};

const NOISE_TESLA: f64 = 4e-7;
/// Uniform field left after calibration, the default of the method.
const DISTURBANCE_TESLA: f64 = 1e-6;

fn rig(axes: &[[f64; 3]]) -> MagneticRig {
    let magnet =
        Magnet { moment_a_m2: 0.25, position_in_camera_m: [0.0, 0.0, -0.012], axis_in_camera: [0.0, 0.0, 1.0] };
    let world_from_array = se3::exp(&Vector6::new(0.2, -0.1, 0.3, 0.3, -0.2, 1.0));
    MagneticRig::new(magnet, HallArray::grid(8, 8, 0.03, axes, NOISE_TESLA), world_from_array).unwrap()
}

/// A standard normal number (G. Box and M. Muller 1958).
fn normal(random: &mut fastrand::Rng) -> f64 {
    (-2.0 * (1.0 - random.f64()).ln()).sqrt() * (std::f64::consts::TAU * random.f64()).cos()
}

fn normals(random: &mut fastrand::Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal(random))
}

/// A camera over the array with its magnet 5 to 15 cm above it, turned anyhow.
fn random_pose(rig: &MagneticRig, random: &mut fastrand::Rng) -> Pose {
    let rotation = UnitQuaternion::from_scaled_axis(normals(random) * 2.0);
    let magnet_m = Vector3::new(0.16 * random.f64() - 0.08, 0.16 * random.f64() - 0.08, 0.05 + 0.1 * random.f64());
    let camera_m = magnet_m - rotation * Vector3::from(rig.magnet().position_in_camera_m);
    rig.world_from_array() * Pose::from_parts(Translation3::from(camera_m), rotation)
}

fn reading(rig: &MagneticRig, pose: &Pose, index: usize, mut noise: impl FnMut() -> Vector3<f64>) -> MagneticReading {
    let field_tesla = rig.field_tesla(pose).into_iter().map(|field| Some(field + noise())).collect();
    MagneticReading { index, time_s: 0.01 * index as f64, field_tesla }
}

fn track(magnetic: &mut Magnetic, reading: &MagneticReading) -> Tracked {
    magnetic.track(&Observation::Magnetic(reading.clone())).unwrap()
}

/// Distance of the magnets in metres and angle of their axes in radians.
fn errors(rig: &MagneticRig, estimate: &Pose, truth: &Pose) -> (f64, f64) {
    let (a, b) = (rig.dipole_in_array(estimate), rig.dipole_in_array(truth));
    ((a.position_m - b.position_m).norm(), a.moment_a_m2.angle(&b.moment_a_m2))
}

#[test]
fn without_noise_the_magnet_is_found_to_a_micrometre_from_nothing() {
    for axes in [&HallArray::TRIAXIAL[..], &HallArray::TRIAXIAL[2..]] {
        let (rig, mut random) = (rig(axes), fastrand::Rng::with_seed(3));
        for index in 0..40 {
            let truth = random_pose(&rig, &mut random);
            let config = MagneticConfig { disturbance_tesla: 0.0, ..MagneticConfig::default() };
            let mut magnetic = Magnetic::new(config, rig.clone()).unwrap();
            let tracked = track(&mut magnetic, &reading(&rig, &truth, index, Vector3::zeros));
            let (position_m, heading_rad) = errors(&rig, &tracked.world_from_camera.unwrap(), &truth);
            assert!(position_m < 1e-6 && heading_rad < 1e-5, "run {index}: {position_m} m, {heading_rad} rad");
        }
    }
}

/// Error of the last fit, squared and normalised by its covariance: chi-squared of five degrees of freedom.
fn error_squared(rig: &MagneticRig, magnetic: &Magnetic, truth: &Pose) -> f64 {
    let (fit, truth) = (magnetic.last_fit().unwrap(), rig.dipole_in_array(truth));
    let off = truth.position_m - fit.state.position_m;
    let turn = fit.state.tangents().tr_mul(&truth.moment_a_m2.normalize());
    let error = SVector::from([off.x, off.y, off.z, turn.x, turn.y]);
    error.dot(&(fit.covariance.try_inverse().unwrap() * error))
}

/// Root mean square errors in metres and radians and mean normalised error squared over 1,000 single readings, each
/// found from nothing, in a uniform field of the given standard deviation.
fn noisy_runs(disturbance_tesla: f64) -> (f64, f64, f64) {
    let (rig, mut random) = (rig(&HallArray::TRIAXIAL), fastrand::Rng::with_seed(11));
    let (mut squares_m2, mut squares_rad2, mut nees) = (0.0, 0.0, 0.0);
    for index in 0..1000 {
        let truth = random_pose(&rig, &mut random);
        let disturbance = normals(&mut random) * disturbance_tesla;
        let reading = reading(&rig, &truth, index, || disturbance + normals(&mut random) * NOISE_TESLA);
        let config = MagneticConfig { disturbance_tesla, ..MagneticConfig::default() };
        let mut magnetic = Magnetic::new(config, rig.clone()).unwrap();
        let tracked = track(&mut magnetic, &reading);
        let (position_m, heading_rad) = errors(&rig, &tracked.world_from_camera.unwrap(), &truth);
        squares_m2 += position_m * position_m;
        squares_rad2 += heading_rad * heading_rad;
        nees += error_squared(&rig, &magnetic, &truth);
    }
    let (position_m, heading_rad, nees) = ((squares_m2 / 1000.0).sqrt(), (squares_rad2 / 1000.0).sqrt(), nees / 1000.0);
    eprintln!("{:.3} mm, {:.3} deg, NEES {nees:.3} of 5", 1e3 * position_m, heading_rad.to_degrees());
    (position_m, heading_rad, nees)
}

/// Half of the 95 % band of the mean of 1,000 chi-squared numbers of five degrees of freedom.
fn nees_band() -> f64 {
    1.96 * (2.0 * 5.0 / 1000.0_f64).sqrt()
}

#[test]
fn with_sensor_noise_errors_are_small_and_their_covariance_is_honest() {
    let (position_m, heading_rad, nees) = noisy_runs(0.0);
    assert!(position_m < 1e-3 && heading_rad < 1_f64.to_radians(), "{position_m} m, {heading_rad} rad");
    assert!((nees - 5.0).abs() < nees_band(), "mean normalised error squared {nees}");
}

#[test]
fn an_unknown_uniform_field_costs_little_and_is_accounted_for() {
    let (position_m, heading_rad, nees) = noisy_runs(DISTURBANCE_TESLA);
    assert!(position_m < 1.5e-3 && heading_rad < 1.5_f64.to_radians(), "{position_m} m, {heading_rad} rad");
    assert!((nees - 5.0).abs() < nees_band(), "mean normalised error squared {nees}");
}

/// 100 capsules, each followed over 20 readings at 100 Hz through a field of the default strength that it does not know and
/// that walks as the method believes: what the array learns of the field from reading to reading pays.
#[test]
fn followed_from_reading_to_reading_an_unknown_field_costs_less_than_a_tenth() {
    let (rig, mut random) = (rig(&HallArray::TRIAXIAL), fastrand::Rng::with_seed(17));
    let (mut squares_m2, mut squares_rad2, mut nees, mut count) = (0.0, 0.0, 0.0, 0.0);
    for _ in 0..100 {
        let (start, mut disturbance) = (random_pose(&rig, &mut random), normals(&mut random) * DISTURBANCE_TESLA);
        let (way_m, turn_rad) = (normals(&mut random) * 1e-4, normals(&mut random) * 3e-3);
        let step = se3::exp(&Vector6::new(way_m.x, way_m.y, way_m.z, turn_rad.x, turn_rad.y, turn_rad.z));
        let (mut magnetic, mut truth) = (Magnetic::new(MagneticConfig::default(), rig.clone()).unwrap(), start);
        for index in 0..20 {
            disturbance += normals(&mut random) * 1e-7 * 0.01_f64.sqrt();
            let reading = reading(&rig, &truth, index, || disturbance + normals(&mut random) * NOISE_TESLA);
            let tracked = track(&mut magnetic, &reading);
            let (position_m, heading_rad) = errors(&rig, &tracked.world_from_camera.unwrap(), &truth);
            squares_m2 += position_m * position_m;
            squares_rad2 += heading_rad * heading_rad;
            nees += error_squared(&rig, &magnetic, &truth);
            count += 1.0;
            truth *= step;
        }
    }
    let (position_m, heading_rad, nees) = ((squares_m2 / count).sqrt(), (squares_rad2 / count).sqrt(), nees / count);
    eprintln!("followed: {:.3} mm, {:.3} deg, NEES {nees:.3} of 5", 1e3 * position_m, heading_rad.to_degrees());
    assert!(position_m < 1e-3 && heading_rad < 1_f64.to_radians(), "{position_m} m, {heading_rad} rad");
    // The readings of one capsule share the field's error, so that the band of independent ones is too narrow for them.
    assert!((nees - 5.0).abs() < 3.0 * nees_band(), "mean normalised error squared {nees}");
}

/// A capsule on a slow screw through the volume.
fn path(rig: &MagneticRig, step: usize) -> Pose {
    let s = step as f64 * 0.01;
    let place = Translation3::new(0.05 * s.cos(), 0.05 * s.sin(), 0.09 + 0.02 * (0.5 * s).sin());
    rig.world_from_array() * Pose::from_parts(place, UnitQuaternion::from_euler_angles(s, 0.7 * s, 0.2))
}

#[test]
fn a_drifting_disturbance_is_followed() {
    let (rig, mut random) = (rig(&HallArray::TRIAXIAL), fastrand::Rng::with_seed(5));
    let mut magnetic = Magnetic::new(MagneticConfig::default(), rig.clone()).unwrap();
    let mut disturbance = normals(&mut random) * DISTURBANCE_TESLA;
    for index in 0..300 {
        let truth = path(&rig, index);
        disturbance += normals(&mut random) * 1e-7 * 0.01_f64.sqrt();
        let reading = reading(&rig, &truth, index, || disturbance + normals(&mut random) * NOISE_TESLA);
        let tracked = track(&mut magnetic, &reading);
        let (position_m, heading_rad) = errors(&rig, &tracked.world_from_camera.unwrap(), &truth);
        assert!(position_m < 2e-3 && heading_rad < 0.03, "reading {index}: {position_m} m, {heading_rad} rad");
        assert!(tracked.confidence > 0.5, "reading {index}: {}", tracked.confidence);
    }
    let believed = magnetic.last_fit().unwrap().field.mean_tesla;
    assert!((believed - disturbance).amax() < 1e-6, "{believed} is not {disturbance}");
}

#[test]
fn broken_sensors_are_refused_and_counted() {
    let (rig, mut random) = (rig(&HallArray::TRIAXIAL), fastrand::Rng::with_seed(7));
    for index in 0..30 {
        let truth = random_pose(&rig, &mut random);
        let mut broken = reading(&rig, &truth, index, || normals(&mut random) * NOISE_TESLA);
        for sensor in [3, 17, 40, 41, 63] {
            broken.field_tesla[sensor] = Some(normals(&mut random) * 1e-3);
        }
        let mut magnetic = Magnetic::new(MagneticConfig::default(), rig.clone()).unwrap();
        let tracked = track(&mut magnetic, &broken);
        // 29.8 is passed once in 60,000 by chance.
        assert!(error_squared(&rig, &magnetic, &truth) < 29.8, "run {index}");
        assert!(magnetic.last_fit().unwrap().outliers >= 5);
        assert!(tracked.confidence > 0.5 && tracked.confidence < 0.95, "{}", tracked.confidence);
    }
}

#[test]
fn a_sudden_jump_is_followed_at_once() {
    let rig = rig(&HallArray::TRIAXIAL);
    let mut magnetic = Magnetic::new(MagneticConfig::default(), rig.clone()).unwrap();
    let mut random = fastrand::Rng::with_seed(9);
    for index in 0..30 {
        let truth = random_pose(&rig, &mut random);
        let tracked = track(&mut magnetic, &reading(&rig, &truth, index, || normals(&mut random) * NOISE_TESLA));
        assert!(error_squared(&rig, &magnetic, &truth) < 29.8, "jump {index}: {:?}", tracked.warning);
    }
}

#[test]
fn readings_that_say_nothing_repeat_the_last_pose_without_trust() {
    let rig = rig(&HallArray::TRIAXIAL);
    let mut magnetic = Magnetic::new(MagneticConfig::default(), rig.clone()).unwrap();
    let poison = |value: Option<f64>, index| MagneticReading {
        index,
        time_s: 0.01 * index as f64,
        field_tesla: vec![value.map(Vector3::from_element); 64],
    };
    let before = track(&mut magnetic, &poison(None, 0));
    assert!(before.world_from_camera.is_none() && before.confidence == 0.0 && before.warning.is_some());
    let known = track(&mut magnetic, &reading(&rig, &path(&rig, 1), 1, Vector3::zeros)).world_from_camera;
    for (index, value) in [None, Some(f64::NAN), Some(f64::INFINITY)].into_iter().enumerate() {
        let tracked = track(&mut magnetic, &poison(value, 2 + index));
        assert_eq!(tracked.world_from_camera, known);
        assert!(tracked.confidence == 0.0 && tracked.warning.is_some());
    }
    // Finite, but no magnet's field.
    for (index, value) in [0.0, 1.0, -1e300].into_iter().enumerate() {
        let tracked = track(&mut magnetic, &poison(Some(value), 5 + index));
        assert!(tracked.confidence < 0.2 && tracked.warning.is_some(), "{value}: {}", tracked.confidence);
        assert!(tracked.world_from_camera.unwrap().to_homogeneous().iter().all(|x| x.is_finite()));
    }
    let truth = path(&rig, 8);
    let again = track(&mut magnetic, &reading(&rig, &truth, 8, Vector3::zeros));
    assert!(errors(&rig, &again.world_from_camera.unwrap(), &truth).0 < 1e-3);
}

#[test]
fn a_measured_bias_is_taken_off() {
    let plain = rig(&HallArray::TRIAXIAL);
    let mut random = fastrand::Rng::with_seed(13);
    let bias: Vec<_> = (0..64).map(|_| normals(&mut random) * 2e-5).collect();
    let quiet = |index| MagneticReading {
        index,
        time_s: 0.01 * index as f64,
        field_tesla: bias.iter().map(|bias| Some(bias + normals(&mut random) * NOISE_TESLA)).collect(),
    };
    let quiet: Vec<_> = (0..200).map(quiet).collect();
    let bias_tesla = calibrate_bias(&quiet, plain.array()).unwrap();
    let array = HallArray { bias_tesla, ..plain.array().clone() };
    let rig = MagneticRig::new(*plain.magnet(), array, *plain.world_from_array()).unwrap();
    let truth = path(&rig, 0);
    let mut biased = bias.iter();
    let reading = reading(&rig, &truth, 0, || *biased.next().unwrap());
    let error_m = |rig: MagneticRig| {
        let mut magnetic = Magnetic::new(MagneticConfig::default(), rig.clone()).unwrap();
        let found = track(&mut magnetic, &reading).world_from_camera;
        found.map_or(f64::INFINITY, |found| errors(&rig, &found, &truth).0)
    };
    let (with_m, without_m) = (error_m(rig), error_m(plain));
    assert!(with_m < 5e-4 && without_m > 2.0 * with_m, "{with_m} m with, {without_m} m without");
    assert!(calibrate_bias(&[], &HallArray::grid(2, 2, 0.1, &HallArray::TRIAXIAL, 1e-6)).is_none());
}

#[test]
fn the_unseen_roll_is_kept_smooth_and_said() {
    let rig = rig(&HallArray::TRIAXIAL);
    let mut magnetic = Magnetic::new(MagneticConfig::default(), rig.clone()).unwrap();
    let tracked: Vec<_> =
        (0..50).map(|index| track(&mut magnetic, &reading(&rig, &path(&rig, index), index, Vector3::zeros))).collect();
    assert!(tracked[0].warning.as_ref().unwrap().contains("axis"));
    assert!(tracked[1..].iter().all(|tracked| tracked.warning.is_none()));
    let turns = tracked.windows(2).map(|pair| {
        let (a, b) = (pair[0].world_from_camera.unwrap(), pair[1].world_from_camera.unwrap());
        let heading = (a * rig.axis_in_camera().into_inner()).angle(&(b * rig.axis_in_camera().into_inner()));
        (a.rotation.angle_to(&b.rotation), heading)
    });
    for (turn_rad, heading_rad) in turns {
        assert!((turn_rad - heading_rad).abs() < 1e-6, "turned {turn_rad} for a heading of {heading_rad}");
    }
}

#[test]
fn pictures_and_foreign_arrays_are_refused_with_a_reason() {
    let mut magnetic = Magnetic::new(MagneticConfig::default(), rig(&HallArray::TRIAXIAL)).unwrap();
    let short = MagneticReading { index: 4, time_s: 0.0, field_tesla: vec![None; 9] };
    let error = magnetic.track(&Observation::Magnetic(short)).unwrap_err().to_string();
    assert!(error.contains("9 sensors where the array has 64"), "{error}");
    let config = MagneticConfig { disturbance_tesla: f64::NAN, ..MagneticConfig::default() };
    assert!(Magnetic::new(config, rig(&HallArray::TRIAXIAL)).unwrap_err().to_string().contains("disturbance_tesla"));
}
