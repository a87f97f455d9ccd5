//! A walk past a bumpy, textured wall, drawn here with its exact poses; the pictures hold enough corners for a map.

use super::*;
use crate::alignment::aligned;
use endoscape_core::camera::{Intrinsics, KannalaBrandt};
use endoscape_core::{CameraModel, Image, MagneticReading, Mask, Size, se3};
use nalgebra::{Point2, Vector6};
use std::sync::Arc;

const SIZE: Size = Size::new(320, 240);

fn camera() -> Camera {
    Camera::from_field_of_view(SIZE, 1.2).unwrap()
}

fn config() -> OrbConfig {
    OrbConfig { features: 800, parallax_deg: 2.0, ..OrbConfig::ordinary() }
}

/// The camera at a frame: to the right, forwards and turning a little, 2 m from the wall.
fn truth(index: usize) -> Pose {
    let s = index as f64;
    se3::exp(&Vector6::new(0.05 * s, 0.15 * (0.1 * s).sin(), 0.004 * s, 0.0, 0.004 * s, 0.002 * s))
}

/// Depth of the wall over the world's x and y.
fn wall_m(x: f64, y: f64) -> f64 {
    2.0 + 0.4 * (2.2 * x).sin() * (2.6 * y).cos()
}

/// A random number of a place, 0 to 1.
fn noise(x: i64, y: i64) -> f64 {
    let mut bits =
        (x.wrapping_mul(0x9E37_79B9_7F4A_7C15_u64 as i64) ^ y.wrapping_mul(0xC2B2_AE3D_27D4_EB4F_u64 as i64)) as u64;
    bits = (bits ^ (bits >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    (bits >> 40) as f64 / (1_u64 << 24) as f64
}

/// Brightness of the wall, tiles of random grey of two sizes, over the 8 mm a pixel sees of it.
fn brightness(x: f64, y: f64) -> f64 {
    let tile = |x: f64, y: f64, side: f64| noise((x / side).floor() as i64, (y / side).floor() as i64);
    let at = |x: f64, y: f64| 255.0 * (0.6 * tile(x, y, 0.11) + 0.4 * tile(x, y, 0.043));
    let offsets_m = [-0.003, -0.001, 0.001, 0.003];
    let all = offsets_m.iter().flat_map(|dx| offsets_m.iter().map(move |dy| at(x + dx, y + dy)));
    all.sum::<f64>() / 16.0
}

fn picture(world_from_camera: &Pose) -> Image {
    let camera = camera();
    Image::from_fn(SIZE, |x, y| {
        let ray = world_from_camera * camera.unproject(&Point2::new(x as f64, y as f64)).unwrap();
        let start = world_from_camera.translation.vector;
        // The wall is not steep: rounds of "how far is it where the ray would meet it" end on it.
        let mut depth_m = 2.0;
        for _ in 0..12 {
            let hit = start + ray * ((depth_m - start.z) / ray.z);
            depth_m = wall_m(hit.x, hit.y);
        }
        let hit = start + ray * ((depth_m - start.z) / ray.z);
        [brightness(hit.x, hit.y).round() as u8; 3]
    })
}

fn observation(index: usize, image: Image) -> Observation {
    let time_s = index as f64 / 10.0;
    Observation::Frame(Frame { index, time_s, image: Arc::new(image), camera: None, usable: None })
}

/// Root mean square of the places' errors after the best similarity, as a share of the path.
fn share_of_path(estimates: &[Pose], truths: &[Pose]) -> f64 {
    let place = |pose: &Pose| pose.translation.vector;
    let pairs = || aligned(estimates, truths).into_iter().zip(truths);
    let squares: f64 = pairs().map(|(estimate, truth)| (place(&estimate) - place(truth)).norm_squared()).sum();
    let path_m: f64 = truths.windows(2).map(|pair| (place(&pair[1]) - place(&pair[0])).norm()).sum();
    (squares / truths.len() as f64).sqrt() / path_m
}

#[test]
fn the_way_along_the_wall_is_followed() {
    let mut orb = Orb::new(config(), &camera()).unwrap();
    let (mut estimates, mut truths) = (Vec::new(), Vec::new());
    for index in 0..24 {
        let tracked = orb.track(&observation(index, picture(&truth(index)))).unwrap();
        if tracked.confidence > 0.1 {
            estimates.push(tracked.world_from_camera.unwrap());
            truths.push(truth(index));
        }
    }
    assert!(truths.len() >= 18, "{} of 24 frames tracked", truths.len());
    let share = share_of_path(&estimates, &truths);
    eprintln!("{} frames, error {:.2} % of the path", truths.len(), 100.0 * share);
    assert!(share < 0.03, "error {share} of the path");
}

#[test]
fn a_lost_way_is_found_again_by_known_landmarks() {
    let mut orb = Orb::new(config(), &camera()).unwrap();
    let mut before = Vec::new();
    for index in 0..14 {
        let tracked = orb.track(&observation(index, picture(&truth(index)))).unwrap();
        before.push((tracked.confidence, tracked.world_from_camera));
    }
    assert!(before[13].0 > 0.1);
    // Darkness for longer than a map is waited for, then a place that was seen before.
    let black = Image::from_fn(SIZE, |_, _| [0; 3]);
    for index in 14..22 {
        let tracked = orb.track(&observation(index, black.clone())).unwrap();
        assert!(tracked.confidence == 0.0 && tracked.warning.is_some(), "{:?}", tracked.warning);
        assert_eq!(tracked.world_from_camera, before[13].1);
    }
    let unit = before[13].1.unwrap().translation.vector.norm();
    for (index, place) in [(22, 12), (23, 10), (24, 8)] {
        let tracked = orb.track(&observation(index, picture(&truth(place)))).unwrap();
        assert!(tracked.confidence > 0.1, "frame {index}: {:?}", tracked.warning);
        let off = tracked.world_from_camera.unwrap().translation.vector - before[place].1.unwrap().translation.vector;
        assert!(off.norm() < 0.05 * unit, "frame {index}: {} of {unit}", off.norm());
    }
}

#[test]
fn frozen_pictures_move_nobody_and_a_cut_ends_in_a_new_start() {
    let mut orb = Orb::new(config(), &camera()).unwrap();
    let mut show = |index: usize, place: &Pose| orb.track(&observation(index, picture(place))).unwrap();
    let before: Vec<Tracked> = (0..14).map(|index| show(index, &truth(index))).collect();
    let place = |tracked: &Tracked| tracked.world_from_camera.unwrap().translation.vector;
    let last = before.last().unwrap();
    assert!(last.confidence > 0.1, "{:?}", last.warning);
    for index in 14..18 {
        let frozen = show(index, &truth(13));
        assert!((place(&frozen) - place(last)).norm() < 0.02 * place(last).norm(), "frame {index}");
    }
    // 40 m along the wall: nothing there was seen before.
    let after: Vec<Tracked> =
        (18..46).map(|index| show(index, &(Pose::translation(40.0, 0.0, 0.0) * truth(index - 18)))).collect();
    assert!(after[0].confidence == 0.0 && after[0].warning.is_some());
    assert!(after.iter().all(|tracked| place(tracked).iter().all(|x| x.is_finite())));
    let says = |tracked: &Tracked| tracked.warning.as_ref().is_some_and(|warning| warning.contains("a new start"));
    assert!(after.iter().any(says) && after.last().unwrap().confidence > 0.1);
}

/// The fisheye of the tube in the fixtures.
fn fisheye() -> Camera {
    let intrinsics = Intrinsics { fx: 76.0, fy: 75.0, cx: 80.5, cy: 62.5, skew: 0.0 };
    let model = KannalaBrandt { intrinsics, k1: -0.03, k2: 0.002, k3: 0.0, k4: 0.0 };
    Camera::new(Size::new(160, 128), CameraModel::KannalaBrandt(model)).unwrap()
}

#[test]
fn a_lens_is_rectified_and_masked_pixels_have_no_features() {
    let eye = Eye::new(&config(), &fisheye()).unwrap();
    let mut random = fastrand::Rng::with_seed(1);
    let image = Image::from_fn(Size::new(160, 128), |_, _| [random.u8(..); 3]);
    let usable = Mask::from_fn(Size::new(160, 128), |x, _| x < 80);
    let frame = Frame { index: 0, time_s: 0.0, image: Arc::new(image), camera: None, usable: Some(Arc::new(usable)) };
    let view = eye.see(&frame).unwrap();
    assert!(view.features.len() > 20, "{} features", view.features.len());
    assert!(view.features.keypoints_xy.iter().all(|[x, _]| *x < 90.0));
}

#[test]
fn pictures_without_corners_are_answered() {
    let mut orb = Orb::new(OrbConfig::endoscopic(), &camera()).unwrap();
    let mut random = fastrand::Rng::with_seed(1);
    for index in 0..4 {
        let black = orb.track(&observation(2 * index, Image::from_fn(SIZE, |_, _| [0; 3]))).unwrap();
        let noise = orb.track(&observation(2 * index + 1, Image::from_fn(SIZE, |_, _| [random.u8(..); 3]))).unwrap();
        for tracked in [black, noise] {
            assert!(tracked.confidence == 0.0 && tracked.world_from_camera.is_none());
            assert!(tracked.warning.unwrap().contains("no map yet"));
        }
    }
}

#[test]
fn wrong_inputs_are_refused_with_a_reason() {
    let mut orb = Orb::new(config(), &camera()).unwrap();
    let error = orb.track(&observation(3, Image::from_fn(Size::new(8, 8), |_, _| [9; 3]))).unwrap_err().to_string();
    assert!(error.contains("8x8") && error.contains("320x240"), "{error}");
    let reading = MagneticReading { index: 0, time_s: 0.0, field_tesla: Vec::new() };
    assert!(orb.track(&Observation::Magnetic(reading)).is_err());
    let refusal = |config: OrbConfig| Orb::new(config, &camera()).err().unwrap().to_string();
    assert!(refusal(OrbConfig { features: 3, ..config() }).contains("features"));
    assert!(refusal(OrbConfig { clip_limit: f64::NAN, ..config() }).contains("clip_limit"));
    assert!(refusal(OrbConfig { width: 40, ..config() }).contains("width"));
}
