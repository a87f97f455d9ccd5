use super::*;
use endoscape_core::{Grid, Image, MagneticReading, Size, se3};
use endoscape_frames::preprocess::contrast::local;
use endoscape_frames::{Sequence, formats};
use nalgebra::{Vector2, Vector3, Vector6};
use std::path::Path;

fn tube() -> Sequence {
    formats::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/tube"), None).unwrap()
}

/// Fewer points than the default: the pictures are small.
fn direct(sequence: &Sequence) -> Direct {
    Direct::new(DirectConfig { points: 500, ..DirectConfig::default() }, &sequence.camera.unwrap()).unwrap()
}

fn frame(index: usize, image: Image) -> Observation {
    let time_s = 0.1 * index as f64;
    Observation::Frame(Frame { index, time_s, image: Arc::new(image), camera: None, usable: None })
}

fn tube_images(sequence: &Sequence) -> Vec<Image> {
    (0..sequence.frames.len()).map(|i| sequence.read_image(i).unwrap()).collect()
}

fn truth(sequence: &Sequence, index: usize) -> Pose {
    sequence.frames[index].world_from_camera.unwrap()
}

fn motion_error(estimate: &Pose, truth: &Pose) -> (f64, f64) {
    ((estimate.translation.vector - truth.translation.vector).norm(), estimate.rotation.angle_to(&truth.rotation))
}

#[test]
fn known_depth_gives_the_motion_between_two_pictures() {
    let sequence = tube();
    let (camera, images) = (sequence.camera.unwrap(), tube_images(&sequence));
    for index in 0..images.len() - 1 {
        let depth = sequence.read_depth(index).unwrap().unwrap();
        let reference = (&images[index], depth.grid(), None);
        let found = align(reference, &images[index + 1], &camera, &Pose::identity(), 2000).unwrap().unwrap();
        let moved = truth(&sequence, index + 1).inverse() * truth(&sequence, index);
        let (away_m, turned_rad) = motion_error(&found.current_from_reference, &moved);
        let length_m = moved.translation.vector.norm();
        eprintln!(
            "{index}: {:.1} % of {length_m:.4} m, {turned_rad:.5} rad, agreeing {:.2}",
            100.0 * away_m / length_m,
            found.agreeing
        );
        assert!(away_m < 0.05 * length_m, "frame {index}: {away_m} m of {length_m} m");
        assert!(turned_rad < 2e-3, "frame {index}: {turned_rad} rad");
        assert!(found.agreeing > 0.8 && found.visible > 0.7);
    }
}

#[test]
fn a_picture_aligns_to_itself_at_rest_and_gain_is_told_from_motion() {
    let sequence = tube();
    let (camera, image) = (sequence.camera.unwrap(), sequence.read_image(0).unwrap());
    let depth = sequence.read_depth(0).unwrap().unwrap();
    let darker = Image::new(image.size(), image.rgb().iter().map(|v| (f64::from(*v) * 0.8).round() as u8).collect());
    let guess = se3::exp(&Vector6::new(1e-3, 0.0, 0.0, 0.0, 0.01, 0.0));
    let found = align((&image, depth.grid(), None), &darker.unwrap(), &camera, &guess, 1500).unwrap().unwrap();
    let (away_m, turned_rad) = motion_error(&found.current_from_reference, &Pose::identity());
    assert!(away_m < 1e-4 && turned_rad < 1e-3, "{away_m} m, {turned_rad} rad");
    assert!((found.brightness.log_gain.exp() - 0.8).abs() < 0.02, "{:?}", found.brightness);
}

#[test]
fn pixels_of_no_weight_have_no_say() {
    let sequence = tube();
    let (camera, images) = (sequence.camera.unwrap(), tube_images(&sequence));
    let depth = sequence.read_depth(0).unwrap().unwrap();
    let size = depth.size();
    // Depth is wrong by a factor on the left half, which the weights rule out.
    let broken =
        Grid::from_fn(size, |x, y| depth.get(x, y).unwrap_or(0.0) * if x < size.width / 2 { 3.0 } else { 1.0 });
    let weights = Grid::from_fn(size, |x, _| if x < size.width / 2 { 0.0 } else { 1.0 });
    let moved = truth(&sequence, 1).inverse() * truth(&sequence, 0);
    let error_m = |weights| {
        let found = align((&images[0], &broken, weights), &images[1], &camera, &Pose::identity(), 2000);
        motion_error(&found.unwrap().unwrap().current_from_reference, &moved).0
    };
    let (with_m, without_m) = (error_m(Some(&weights)), error_m(None));
    assert!(with_m < 0.5 * without_m, "{with_m} m with weights, {without_m} m without");
}

#[test]
fn pictures_of_known_motion_correct_depths() {
    let sequence = tube();
    let (camera, images) = (sequence.camera.unwrap(), tube_images(&sequence));
    let truth_depth = sequence.read_depth(0).unwrap().unwrap();
    let wrong = Grid::from_fn(truth_depth.size(), |x, y| {
        let wave = 0.15 * (0.2 * x as f32).sin() * (0.17 * y as f32).cos();
        truth_depth.get(x, y).unwrap_or(0.0) * (1.0 + wave)
    });
    let lenses = Lenses::new(&camera, 4).unwrap();
    let pyramids: Vec<_> = images.iter().map(|image| Pyramid::new(&local(image), None, &lenses)).collect();
    let mut reference = Reference::of_depth((&pyramids[0], &lenses), (&wrong, 0.15), None, 800);
    let error = |reference: &Reference| {
        let share = |point: &point::Point| {
            let depth = truth_depth.get(point.pixel.x as usize, point.pixel.y as usize).unwrap();
            (point.inverse_depth.mean * f64::from(depth) - 1.0).abs()
        };
        reference.points.iter().map(share).sum::<f64>() / reference.points.len() as f64
    };
    let before = error(&reference);
    for (index, pyramid) in pyramids.iter().enumerate().skip(1) {
        let motion = truth(&sequence, index).inverse() * truth(&sequence, 0);
        let known = Alignment::guess(motion, Brightness::default());
        reference.observe(pyramid, &lenses, &known, BRIGHTNESS_NOISE);
    }
    let after = error(&reference);
    assert!(after < 0.65 * before, "{before} became {after}");
}

#[test]
fn the_derivative_of_a_lens_is_that_of_its_projection() {
    let fisheye = tube().camera.unwrap();
    let pinhole = Camera::from_field_of_view(Size::new(160, 128), 1.5).unwrap();
    for camera in [fisheye, pinhole] {
        let lens = lens::Lens::new(camera);
        let point = Vector3::new(0.03, -0.02, 0.1);
        let (h, slope) = (1e-7, lens.linearise(&point).unwrap().1);
        for axis in 0..3 {
            let step = Vector3::ith(axis, h);
            let numeric = (lens.project(&(point + step)).unwrap() - lens.project(&(point - step)).unwrap()) / (2.0 * h);
            assert!((numeric - slope.column(axis)).amax() < 1e-3 * slope.amax());
        }
        let ray = lens.ray(&Vector2::new(40.0, 50.0)).unwrap();
        assert!((lens.project(&(ray * 7.0)).unwrap() - Vector2::new(40.0, 50.0)).amax() < 1e-6);
    }
}

/// Positions against the truth after alignment at the first pose and by scale: root mean square over the path's length.
fn share_of_path(sequence: &Sequence, poses: &[Pose]) -> f64 {
    let first = truth(sequence, 0).inverse();
    let pairs: Vec<(Vector3<f64>, Vector3<f64>)> = poses
        .iter()
        .enumerate()
        .map(|(i, pose)| {
            ((poses[0].inverse() * pose).translation.vector, (first * truth(sequence, i)).translation.vector)
        })
        .collect();
    let scale =
        pairs.iter().map(|(e, t)| e.dot(t)).sum::<f64>() / pairs.iter().map(|(e, _)| e.norm_squared()).sum::<f64>();
    let squares: f64 = pairs.iter().map(|(e, t)| (e * scale - t).norm_squared()).sum();
    let path_m: f64 = pairs.windows(2).map(|pair| (pair[1].1 - pair[0].1).norm()).sum();
    (squares / pairs.len() as f64).sqrt() / path_m
}

#[test]
fn the_way_through_the_tube_is_followed_without_depth() {
    let sequence = tube();
    let mut direct = direct(&sequence);
    let mut poses = Vec::new();
    for (index, image) in tube_images(&sequence).into_iter().enumerate() {
        let tracked = direct.track(&frame(index, image)).unwrap();
        eprintln!("{index}: {:.2} {:?}", tracked.confidence, tracked.warning);
        assert!(tracked.confidence > 0.4, "frame {index}: {:?}", tracked.warning);
        poses.push(tracked.world_from_camera.unwrap());
    }
    let share = share_of_path(&sequence, &poses);
    eprintln!("error {:.1} % of the path", 100.0 * share);
    assert!(share < 0.1, "error {share} of the path");
}

#[test]
fn black_frozen_and_foreign_frames_keep_the_way() {
    let sequence = tube();
    let (size, images) = (sequence.size, tube_images(&sequence));
    let mut direct = direct(&sequence);
    let black = Image::from_fn(size, |_, _| [0; 3]);
    let mut random = fastrand::Rng::with_seed(1);
    let noise = Image::from_fn(size, |_, _| [random.u8(..); 3]);
    let early = direct.track(&frame(0, black.clone())).unwrap();
    assert!(early.confidence == 0.0 && early.warning.is_some());
    let shown =
        [&images[0], &images[1], &images[2], &images[2], &images[2], &black, &images[3], &noise, &noise, &images[4]];
    let tracked: Vec<Tracked> =
        shown.iter().enumerate().map(|(i, image)| direct.track(&frame(i + 1, (*image).clone())).unwrap()).collect();
    for (index, tracked) in tracked.iter().enumerate() {
        let poisoned = [5, 7, 8].contains(&index);
        assert_eq!(tracked.confidence == 0.0, poisoned, "frame {index}: {:?}", tracked.warning);
        assert_eq!(tracked.warning.is_some(), poisoned);
    }
    let pose = |index: usize| tracked[index].world_from_camera.unwrap();
    assert_eq!((pose(2), pose(2)), (pose(3), pose(4)), "a picture that stands moves nobody");
    assert_eq!(pose(4), pose(5));
}

#[test]
fn a_cut_to_another_place_ends_in_a_new_start() {
    let sequence = tube();
    let images = tube_images(&sequence);
    let mut direct = direct(&sequence);
    for (index, image) in images.iter().enumerate().take(4) {
        direct.track(&frame(index, image.clone())).unwrap();
    }
    // Upside down and mirrored brightness: nothing agrees any more.
    let size = sequence.size;
    let foreign = |image: &Image| {
        Image::from_fn(size, |x, y| image.get(x, size.height - 1 - y).unwrap_or_default().map(|v| 255 - v))
    };
    let tracked: Vec<Tracked> =
        (4..12).map(|index| direct.track(&frame(index, foreign(&images[index]))).unwrap()).collect();
    assert!(
        tracked.iter().any(|tracked| tracked.warning.as_ref().is_some_and(|warning| warning.contains("new start")))
    );
    assert!(tracked.iter().all(|tracked| tracked.world_from_camera.is_some()));
    assert!(tracked.last().unwrap().confidence > 0.0);
}

#[test]
fn wrong_inputs_are_refused_with_a_reason() {
    let camera = tube().camera.unwrap();
    let mut direct = Direct::new(DirectConfig::default(), &camera).unwrap();
    let error = direct.track(&frame(3, Image::from_fn(Size::new(8, 8), |_, _| [9; 3]))).unwrap_err().to_string();
    assert!(error.contains("8x8") && error.contains("160x128"), "{error}");
    let reading = MagneticReading { index: 0, time_s: 0.0, field_tesla: Vec::new() };
    assert!(direct.track(&Observation::Magnetic(reading)).is_err());
    let config = DirectConfig { points: 3, ..DirectConfig::default() };
    assert!(Direct::new(config, &camera).unwrap_err().to_string().contains("points"));
}
