//! Simulated capsules: truth on a smooth way, readings of a simulated array of 5 x 5 sensors with the noise of a real one
//! (see the tests of the magnetic method), and a camera method whose steps have the errors of published ones: 3 % of each
//! step and 0.2 degrees, in a unit of its own that drifts by a tenth within a minute.

use super::*;
use crate::MagneticConfig;
use crate::alignment::aligned;
use endoscape_core::magnetic::{HallArray, Magnet};
use endoscape_core::{Image, Size};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector6};
use std::f64::consts::TAU;
use std::ops::Range;
use std::sync::Arc;

const FRAMES_PER_S: f64 = 30.0;
const READINGS_PER_S: f64 = 50.0;
const NOISE_TESLA: f64 = 4e-7;
const DISTURBANCE_TESLA: f64 = 1e-6;
/// Units of vision per metre.
const UNITS_PER_M: f64 = 37.0;

fn normal(random: &mut fastrand::Rng) -> f64 {
    (-2.0 * (1.0 - random.f64()).ln()).sqrt() * (TAU * random.f64()).cos()
}

fn normals(random: &mut fastrand::Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal(random))
}

fn rig() -> MagneticRig {
    let magnet =
        Magnet { moment_a_m2: 0.25, position_in_camera_m: [0.0, 0.0, -0.012], axis_in_camera: [0.0, 0.0, 1.0] };
    let world_from_array = se3::exp(&Vector6::new(0.2, -0.1, 0.3, 0.3, -0.2, 1.0));
    MagneticRig::new(magnet, HallArray::grid(5, 5, 0.05, &HallArray::TRIAXIAL, NOISE_TESLA), world_from_array).unwrap()
}

/// A capsule that wanders 9 cm above the array, looks about and rolls, far from the roll the array would guess.
fn truth(rig: &MagneticRig, time_s: f64) -> Pose {
    let s = 0.4 * time_s;
    let place = Translation3::new(0.05 * s.cos(), 0.05 * (0.7 * s).sin(), 0.09 + 0.02 * (0.5 * s).sin());
    let turn =
        UnitQuaternion::from_euler_angles(0.6 * (0.9 * s).sin(), 0.5 * (1.1 * s).cos(), 2.0 + 0.8 * (0.6 * s).sin());
    rig.world_from_array() * Pose::from_parts(place, turn)
}

/// A camera method that knows the truth but for its errors; `None` where it is lost.
struct Vision {
    poses: Vec<Option<Pose>>,
}

impl Vision {
    /// Errors add up from frame to frame; after a gap everything starts at a new place.
    fn new(path: &dyn Fn(f64) -> Pose, frames: usize, gap: &Range<f64>, random: &mut fastrand::Rng) -> Self {
        let (mut pose, mut log_drift) = (Pose::identity(), 0.0);
        let mut at = |index: usize| {
            let time_s = index as f64 / FRAMES_PER_S;
            let step = path((time_s - 1.0 / FRAMES_PER_S).max(0.0)).inverse() * path(time_s);
            log_drift += 0.1 * normal(random) / (60.0 * FRAMES_PER_S).sqrt();
            let unit = UNITS_PER_M * f64::exp(log_drift);
            let way = step.translation.vector * unit;
            let way = way + normals(random) * 0.03 * way.norm();
            let turn = step.rotation * UnitQuaternion::from_scaled_axis(normals(random) * 0.2_f64.to_radians());
            pose *= Pose::from_parts(way.into(), turn);
            (!gap.contains(&time_s)).then_some(pose)
        };
        Self { poses: (0..frames).map(&mut at).collect() }
    }
}

impl Odometry for Vision {
    fn name(&self) -> &'static str {
        "vision"
    }

    fn track(&mut self, observation: &Observation) -> Result<Tracked, TrackError> {
        let Observation::Frame(frame) = observation else {
            return Err(TrackError::Failed { method: "vision", index: 0, reason: "a reading was shown to it".into() });
        };
        let world_from_camera = self.poses[frame.index];
        let confidence = if world_from_camera.is_some() { 0.9 } else { 0.0 };
        Ok(Tracked { world_from_camera, confidence, depth: None, reliability: None, warning: None })
    }
}

fn frame(index: usize) -> Observation {
    showing(index, index)
}

/// A frame that shows the picture of another.
fn showing(index: usize, picture: usize) -> Observation {
    let image = Arc::new(Image::from_fn(Size::new(1, 1), |_, _| [picture as u8, (picture >> 8) as u8, 0]));
    Observation::Frame(Frame { index, time_s: index as f64 / FRAMES_PER_S, image, camera: None, usable: None })
}

/// Readings with noise in a uniform field that stays; none while `gap`.
fn readings(rig: &MagneticRig, seconds: f64, gap: &Range<f64>, random: &mut fastrand::Rng) -> Vec<MagneticReading> {
    let disturbance = normals(random) * DISTURBANCE_TESLA;
    let reading = |index: usize| {
        let time_s = index as f64 / READINGS_PER_S;
        let field = rig.field_tesla(&truth(rig, time_s)).into_iter();
        let field_tesla = field.map(|b| Some(b + disturbance + normals(random) * NOISE_TESLA)).collect();
        MagneticReading { index, time_s, field_tesla }
    };
    let all = (0..(seconds * READINGS_PER_S) as usize).map(reading);
    all.filter(|reading| !gap.contains(&reading.time_s)).collect()
}

/// Poses by frame with their truth, and the method after the last frame.
struct Run {
    fused: Vec<(Tracked, Pose)>,
    /// The poses as they stand at the end.
    revised: Vec<Pose>,
    covariances: Vec<nalgebra::Matrix6<f64>>,
    scale: f64,
}

const NEVER: Range<f64> = -1.0..-0.5;

/// Told how good the simulated camera method is.
fn config() -> FusedConfig {
    let floor_rad = 0.2_f64.to_radians();
    FusedConfig {
        walk_log_scale: 0.1 / 60_f64.sqrt(),
        wall_m_per_s: 0.0,
        visual_share: 0.03,
        visual_floor_m: 1e-5,
        visual_turn_share: 0.03,
        visual_floor_rad: floor_rad,
        ..FusedConfig::default()
    }
}

fn run(seed: u64, seconds: f64, no_vision: &Range<f64>, no_array: &Range<f64>) -> Run {
    run_with(config(), seed, seconds, no_vision, no_array)
}

fn run_with(config: FusedConfig, seed: u64, seconds: f64, no_vision: &Range<f64>, no_array: &Range<f64>) -> Run {
    run_in(&|_| Pose::identity(), config, seed, seconds, no_vision, no_array)
}

/// The same before a wall that moves by itself: vision sees the camera's way along it.
fn run_in(
    wall: &dyn Fn(f64) -> Pose,
    config: FusedConfig,
    seed: u64,
    seconds: f64,
    no_vision: &Range<f64>,
    no_array: &Range<f64>,
) -> Run {
    let (rig, mut random) = (rig(), fastrand::Rng::with_seed(seed));
    let frames = (seconds * FRAMES_PER_S) as usize;
    let along = |time_s: f64| wall(time_s).inverse() * truth(&rig, time_s);
    let vision = Vision::new(&along, frames, no_vision, &mut random);
    let mut readings = readings(&rig, seconds, no_array, &mut random).into_iter().peekable();
    let mut fused = Fused::new(config, Box::new(vision), rig.clone()).unwrap();
    let (mut tracked, mut covariances, mut revised) = (Vec::new(), Vec::new(), Vec::new());
    for index in 0..frames {
        let time_s = index as f64 / FRAMES_PER_S;
        while let Some(reading) = readings.next_if(|reading| reading.time_s <= time_s) {
            fused.track(&Observation::Magnetic(reading)).unwrap();
        }
        tracked.push((fused.track(&frame(index)).unwrap(), truth(&rig, time_s)));
        for pose in fused.revisions() {
            revised[(pose.time_s * FRAMES_PER_S).round() as usize] = pose.world_from_camera;
        }
        revised.push(tracked[index].0.world_from_camera.unwrap());
        covariances.push(fused.pose_covariance().unwrap());
    }
    Run { fused: tracked, revised, covariances, scale: fused.scale().unwrap() }
}

/// Root mean square errors of place (m) and orientation (rad).
fn errors(pairs: &[(Pose, Pose)]) -> (f64, f64) {
    let mean = |of: &dyn Fn(&Pose) -> f64| {
        pairs.iter().map(|(estimate, truth)| of(&(truth.inverse() * estimate)).powi(2)).sum::<f64>()
            / pairs.len() as f64
    };
    (mean(&|off| off.translation.vector.norm()).sqrt(), mean(&|off| off.rotation.angle()).sqrt())
}

fn pairs(run: &Run, seconds: Range<f64>) -> Vec<(Pose, Pose)> {
    let frame = |time_s: f64| (time_s * FRAMES_PER_S) as usize;
    let part = &run.fused[frame(seconds.start)..frame(seconds.end).min(run.fused.len())];
    part.iter().map(|(tracked, truth)| (tracked.world_from_camera.unwrap(), *truth)).collect()
}

/// The same of the poses as they stand at the end.
fn revised_pairs(run: &Run, seconds: Range<f64>) -> Vec<(Pose, Pose)> {
    let told = pairs(run, seconds.clone());
    let first = (seconds.start * FRAMES_PER_S) as usize;
    told.into_iter().zip(&run.revised[first..]).map(|((_, truth), revised)| (*revised, truth)).collect()
}

/// What each parent reaches on the same kind of run: the array alone at its readings, and vision alone after the best
/// similarity onto the truth, which no user has.
fn parents(seed: u64, seconds: f64) -> ((f64, f64), (f64, f64)) {
    let (rig, mut random) = (rig(), fastrand::Rng::with_seed(seed));
    let frames = (seconds * FRAMES_PER_S) as usize;
    let vision = Vision::new(&|time_s| truth(&rig, time_s), frames, &NEVER, &mut random);
    let mut magnetic = Magnetic::new(MagneticConfig::default(), rig.clone()).unwrap();
    let found = readings(&rig, seconds, &NEVER, &mut random).into_iter().map(|reading| {
        let tracked = magnetic.track(&Observation::Magnetic(reading.clone())).unwrap();
        (tracked.world_from_camera.unwrap(), truth(&rig, reading.time_s))
    });
    let array = errors(&found.collect::<Vec<_>>());
    let truths: Vec<Pose> = (0..frames).map(|index| truth(&rig, index as f64 / FRAMES_PER_S)).collect();
    let seen: Vec<Pose> = vision.poses.iter().map(|pose| pose.unwrap()).collect();
    let aligned = aligned(&seen, &truths).into_iter().zip(truths).collect::<Vec<_>>();
    (array, errors(&aligned))
}

#[test]
fn six_degrees_of_freedom_are_better_than_either_parents() {
    // Once told how good vision is, and twice with the defaults, which take it for worse.
    for (seed, config) in [(1, config()), (2, FusedConfig::default()), (3, FusedConfig::default())] {
        let run = run_with(config, seed, 40.0, &NEVER, &NEVER);
        let fused = errors(&pairs(&run, 5.0..40.0));
        let (array, vision) = parents(seed, 40.0);
        let show = |(m, rad): (f64, f64)| format!("{:.2} mm {:.2} deg", 1e3 * m, rad.to_degrees());
        eprintln!("seed {seed}: fused {}, array {}, vision {}", show(fused), show(array), show(vision));
        assert!(fused.0 < array.0 && fused.0 < vision.0, "{fused:?} {array:?} {vision:?}");
        assert!(fused.1 < array.1 && fused.1 < vision.1, "{fused:?} {array:?} {vision:?}");
    }
}

/// Lengths of a run's path against the true ones: the slope of its places over the true places.
fn length_ratio(pairs: &[(Pose, Pose)]) -> f64 {
    let centre =
        |of: &dyn Fn(&(Pose, Pose)) -> Vector3<f64>| pairs.iter().map(of).sum::<Vector3<f64>>() / pairs.len() as f64;
    let (mean, mean_truth) = (centre(&|p| p.0.translation.vector), centre(&|p| p.1.translation.vector));
    let products = pairs.iter().map(|(estimate, truth)| {
        let (e, t) = (estimate.translation.vector - mean, truth.translation.vector - mean_truth);
        (e.dot(&t), t.norm_squared())
    });
    let (along, whole) = products.fold((0.0, 0.0), |sum, p| (sum.0 + p.0, sum.1 + p.1));
    along / whole
}

#[test]
fn lengths_are_metres() {
    let run = run(4, 40.0, &NEVER, &NEVER);
    let ratio = length_ratio(&pairs(&run, 5.0..40.0));
    assert!((ratio - 1.0).abs() < 0.02, "the way is {ratio} of the true one");
    // The unit of vision itself drifts; it is followed.
    assert!((run.scale * UNITS_PER_M).ln().abs() < 0.2, "{} units", 1.0 / run.scale);
}

/// A wall that goes 8 mm up and down with the breath, fifteen times a minute: 13 mm/s where the capsule makes some 20.
#[test]
fn a_breathing_wall_bends_no_lengths() {
    let wall = |time_s: f64| Pose::translation(0.0, 0.0, 8e-3 * (TAU * 0.25 * time_s).sin());
    for seed in 30..33 {
        let run = |config| pairs(&run_in(&wall, config, seed, 40.0, &NEVER, &NEVER), 5.0..40.0);
        let (doubting, trusting) = (run(FusedConfig::default()), run(config()));
        let (fused, misled, (array, _)) = (errors(&doubting), errors(&trusting), parents(seed, 40.0));
        eprintln!("seed {seed}: {fused:?}, vision trusted {misled:?}, array {array:?}");
        assert!(fused.0 < array.0 && fused.1 < array.1 && fused.0 < misled.0, "{fused:?} {misled:?} {array:?}");
        let ratio = length_ratio(&doubting);
        assert!((ratio - 1.0).abs() < 0.02, "the way is {ratio} of the true one");
    }
}

#[test]
fn five_seconds_without_the_camera_cost_the_roll_alone() {
    let run = run(5, 40.0, &(15.0..20.0), &NEVER);
    let during = errors(&pairs(&run, 15.0..20.0));
    assert!(during.0 < 3e-3 && during.1 < 0.8, "{during:?}");
    let after = errors(&pairs(&run, 26.0..40.0));
    assert!(after.0 < 1.5e-3 && after.1 < 0.03, "{after:?}");
    let warned = run.fused[(18.0 * FRAMES_PER_S) as usize].0.warning.as_ref().unwrap();
    assert!(warned.contains("the camera sees no motion"), "{warned}");
    assert!(run.fused.iter().skip(60).all(|(tracked, _)| tracked.confidence > 0.1));
}

#[test]
fn five_seconds_without_the_array_go_on_in_metres() {
    let run = run(6, 40.0, &NEVER, &(20.0..25.0));
    // 150 steps of vision, 0.2 degrees each about every axis, add up to 0.074 rad; 3 % of each 0.7 mm to 0.5 mm, and 0.074
    // rad of 70 mm to 5 mm.
    let during = errors(&pairs(&run, 20.0..25.0));
    assert!(during.0 < 5e-3 && during.1 < 0.074, "{during:?}");
    let after = errors(&pairs(&run, 25.5..40.0));
    assert!(after.0 < 1.5e-3 && after.1 < 0.03, "{after:?}");
    let warned = run.fused[(23.0 * FRAMES_PER_S) as usize].0.warning.as_ref().unwrap();
    assert!(warned.contains("the array does not see"), "{warned}");
}

#[test]
fn frames_before_the_roll_is_known_are_told_anew() {
    for seed in 40..44 {
        let run = run_with(FusedConfig::default(), seed, 20.0, &NEVER, &NEVER);
        let unknown =
            |(tracked, _): &(Tracked, Pose)| tracked.warning.as_ref().is_some_and(|w| w.contains("not known"));
        let known_s = run.fused.iter().position(|at| !unknown(at)).unwrap() as f64 / FRAMES_PER_S;
        let (told, revised) = (errors(&pairs(&run, 0.0..known_s)), errors(&revised_pairs(&run, 0.0..known_s)));
        eprintln!("seed {seed}: {known_s:.1} s, told {told:?}, revised {revised:?}");
        // Three standard deviations of the doubt at which the roll counts as known.
        assert!(revised.1 < 0.3 && revised.1 < told.1 && revised.0 < told.0, "{told:?} {revised:?}");
        let (all, array) = (errors(&revised_pairs(&run, 0.0..20.0)), parents(seed, 20.0).0);
        assert!(all.0 < array.0 && all.1 < array.1, "{all:?} {array:?}");
    }
}

#[test]
fn what_is_found_after_a_gap_reaches_back_into_it() {
    let run = run(5, 40.0, &(15.0..20.0), &NEVER);
    let (told, revised) = (errors(&pairs(&run, 18.0..20.0)), errors(&revised_pairs(&run, 18.0..20.0)));
    assert!(revised.1 < told.1, "{told:?} {revised:?}");
    // What was known before the gap stays as it was.
    assert_eq!(run.revised[300], run.fused[300].0.world_from_camera.unwrap());
}

/// Doubt about the scale after the frame 300, which vision does not answer, less that at the frame before.
fn doubt_by(observation: &Observation) -> f64 {
    let (rig, mut random) = (rig(), fastrand::Rng::with_seed(3));
    let vision = Vision::new(&|time_s| truth(&rig, time_s), 301, &(10.0..11.0), &mut random);
    let readings = readings(&rig, 10.0, &NEVER, &mut random);
    let fused = Fused::new(config(), Box::new(vision), rig.clone()).unwrap();
    let mut recorded = Recorded::new(fused, readings);
    for index in 0..300 {
        recorded.track(&frame(index)).unwrap();
    }
    let sigma = |recorded: &Recorded<Fused>| recorded.method.filter.as_ref().unwrap().scale_sigma();
    let before = sigma(&recorded);
    recorded.track(observation).unwrap();
    sigma(&recorded) - before
}

#[test]
fn a_repeated_picture_raises_no_doubt_about_the_scale() {
    let (repeated, lost) = (doubt_by(&showing(300, 299)), doubt_by(&frame(300)));
    assert!(repeated < 0.01 && lost > 0.1, "{repeated} {lost}");
}

#[test]
fn without_both_the_pose_is_not_trusted_and_found_again() {
    let run = run(7, 40.0, &(15.0..20.0), &(15.0..20.0));
    let (blind, _) = &run.fused[(18.0 * FRAMES_PER_S) as usize];
    assert!(blind.confidence == 0.0 && blind.world_from_camera.is_some());
    let after = errors(&pairs(&run, 28.0..40.0));
    assert!(after.0 < 1.5e-3 && after.1 < 0.03, "{after:?}");
}

#[test]
fn the_covariance_is_honest() {
    let mut nees = Vec::new();
    for seed in 20..28 {
        let run = run(seed, 20.0, &NEVER, &NEVER);
        for index in (200..run.fused.len()).step_by(100) {
            let (tracked, truth) = &run.fused[index];
            let error = se3::log(&(tracked.world_from_camera.unwrap().inverse() * truth));
            nees.push(error.dot(&(run.covariances[index].try_inverse().unwrap() * error)));
        }
    }
    let mean = nees.iter().sum::<f64>() / nees.len() as f64;
    eprintln!("normalised error squared {mean:.2} of 6");
    // Neighbours share their field's error, so that the band of independent ones does not apply: within a factor of 1.5.
    assert!((4.0..9.0).contains(&mean), "{mean}");
}

#[test]
fn a_jump_is_followed() {
    let (rig, mut random) = (rig(), fastrand::Rng::with_seed(9));
    let elsewhere = |time_s: f64| if time_s < 10.0 { truth(&rig, time_s) } else { truth(&rig, time_s + 3.0) };
    let vision = Vision::new(&elsewhere, 600, &(10.0..10.2), &mut random);
    let mut fused = Fused::new(FusedConfig::default(), Box::new(vision), rig.clone()).unwrap();
    for index in 0..600 {
        let time_s = index as f64 / FRAMES_PER_S;
        let field = rig.field_tesla(&elsewhere(time_s)).into_iter();
        let field_tesla = field.map(|b| Some(b + normals(&mut random) * NOISE_TESLA)).collect();
        fused.track(&Observation::Magnetic(MagneticReading { index, time_s, field_tesla })).unwrap();
        let tracked = fused.track(&frame(index)).unwrap();
        if time_s > 10.5 {
            let magnet = Point3::from(rig.magnet().position_in_camera_m);
            let off_m = tracked.world_from_camera.unwrap() * magnet - elsewhere(time_s) * magnet;
            assert!(off_m.norm() < 5e-3, "{} m at {time_s} s", off_m.norm());
        }
    }
}

#[test]
fn observations_that_say_nothing_are_answered() {
    let rig = rig();
    let vision = Vision { poses: vec![None; 40] };
    let mut fused = Fused::new(FusedConfig::default(), Box::new(vision), rig.clone()).unwrap();
    let first = fused.track(&frame(0)).unwrap();
    assert!(first.world_from_camera.is_none() && first.confidence == 0.0 && first.warning.is_some());
    for (index, value) in [None, Some(f64::NAN), Some(1e300), Some(0.0)].into_iter().enumerate() {
        let field_tesla = vec![value.map(Vector3::from_element); 25];
        let reading = MagneticReading { index, time_s: 0.1 * index as f64, field_tesla };
        let tracked = fused.track(&Observation::Magnetic(reading)).unwrap();
        let finite = |pose: Pose| pose.to_homogeneous().iter().all(|x| x.is_finite());
        assert!(tracked.world_from_camera.is_none_or(finite) && tracked.confidence.is_finite());
    }
    let refused = |config| Fused::new(config, Box::new(Vision { poses: Vec::new() }), rig.clone()).err().unwrap();
    let sentence = refused(FusedConfig { visual_share: f64::NAN, ..FusedConfig::default() }).to_string();
    assert!(sentence.contains("visual_share"), "{sentence}");
    let sentence = refused(FusedConfig { wall_m_per_s: -1.0, ..FusedConfig::default() }).to_string();
    assert!(sentence.contains("wall_m_per_s"), "{sentence}");
}

#[test]
fn recorded_readings_come_before_the_frames_they_precede() {
    let (rig, mut random) = (rig(), fastrand::Rng::with_seed(2));
    let vision = Vision::new(&|time_s| truth(&rig, time_s), 90, &NEVER, &mut random);
    let readings = readings(&rig, 3.0, &NEVER, &mut random);
    let fused = Fused::new(FusedConfig::default(), Box::new(vision), rig.clone()).unwrap();
    let mut recorded = Recorded::new(fused, readings);
    for index in 0..90 {
        let tracked = recorded.track(&frame(index)).unwrap();
        let magnet = Point3::from(rig.magnet().position_in_camera_m);
        let off_m = tracked.world_from_camera.unwrap() * magnet - truth(&rig, index as f64 / FRAMES_PER_S) * magnet;
        assert!(off_m.norm() < 5e-3, "{} m at frame {index}", off_m.norm());
    }
}
