//! The recurrent network at work: the same answers as all at once, and frames that must not reach its memory.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "test helpers fail by panicking and say what they skip"
)]

use burn::tensor::{Device, Tensor};
use endoscape_core::{Frame, Image, MagneticReading, Observation, Odometry, Pose, Rotation, Size, Tracked};
use endoscape_nets::{RecurrentCheckpoint, RecurrentVoConfig, TrainedInput, network_input};
use endoscape_odometry::RecurrentOdometry;
use std::sync::Arc;

const SIZE: Size = Size::new(48, 40);
const UNIT_M: f64 = 0.002;

fn checkpoint() -> RecurrentCheckpoint {
    let config = RecurrentVoConfig { stem: [4, 6], grid: 2, hidden: 8, unit_m: UNIT_M, ..RecurrentVoConfig::default() };
    let mut checkpoint = RecurrentCheckpoint::init(config, 11, &Device::flex()).unwrap();
    let Size { width, height } = SIZE;
    checkpoint.manifest.input = Some(TrainedInput { width, height, fixed_gap: 1, least_displacement: 0.0 });
    checkpoint
}

fn odometry() -> RecurrentOdometry {
    RecurrentOdometry::new(checkpoint(), None, &Device::flex()).unwrap()
}

fn picture(shift: usize) -> Image {
    Image::from_fn(SIZE, |x, y| [40 + ((7 * (x + 3 * shift) + 13 * y) % 90) as u8, 60 + (x % 50) as u8, 70])
}

fn show(odometry: &mut RecurrentOdometry, index: usize, image: Image) -> Tracked {
    let image = Arc::new(image);
    odometry
        .track(&Observation::Frame(Frame { index, time_s: index as f64, image, camera: None, usable: None }))
        .unwrap()
}

fn pose(tracked: &Tracked) -> Pose {
    let pose = tracked.world_from_camera.unwrap();
    assert!(pose.to_homogeneous().iter().all(|number| number.is_finite()));
    pose
}

fn distance(a: &Pose, b: &Pose) -> f64 {
    (a.to_homogeneous() - b.to_homogeneous()).amax()
}

/// Poses of pictures shown one after another from `first` on.
fn streamed(odometry: &mut RecurrentOdometry, pictures: &[Image]) -> Vec<Tracked> {
    pictures.iter().enumerate().map(|(index, image)| show(odometry, index, image.clone())).collect()
}

#[test]
fn a_stream_is_the_batch_frame_by_frame() {
    let pictures: Vec<Image> = (0..6).map(picture).collect();
    let poses: Vec<Pose> = streamed(&mut odometry(), &pictures).iter().map(pose).collect();

    let device = Device::flex();
    let inputs: Vec<Tensor<4>> = pictures.iter().map(|image| network_input(image, &device)).collect();
    let pairs = inputs.windows(2).map(|pair| Tensor::cat(pair.to_vec(), 1).unsqueeze_dim::<5>(1)).collect();
    let (motions, _) = checkpoint().net.forward(Tensor::cat(pairs, 1), None);
    let numbers: Vec<f64> = motions.into_data().iter::<f32>().map(f64::from).collect();
    let mut expected = Pose::identity();
    assert_eq!(distance(&poses[0], &expected), 0.0);
    for (motion, pose) in numbers.chunks_exact(6).zip(&poses[1..]) {
        let mut step = Rotation::AxisAngle.pose(motion.try_into().unwrap());
        step.translation.vector *= UNIT_M;
        expected *= step;
        assert!(distance(pose, &expected) < 1e-6, "{pose} instead of {expected}");
    }
    assert!(poses[5].translation.vector.norm() > 0.0, "nothing moved");
}

#[test]
fn spoilt_frames_leave_no_trace_in_the_memory() {
    let good: Vec<Image> = (0..7).map(picture).collect();
    let flat = |value: u8| Image::from_fn(SIZE, |_, _| [value; 3]);
    let mut spoilt = good.clone();
    spoilt.insert(5, flat(120));
    spoilt.insert(3, flat(255));
    // A frame that repeats the one before, which is the third.
    spoilt.insert(2, good[1].clone());
    let (clean, marred) = (streamed(&mut odometry(), &good), streamed(&mut odometry(), &spoilt));
    let kept: Vec<&Tracked> = marred.iter().filter(|tracked| tracked.warning.is_none()).collect();
    assert_eq!(kept.len(), clean.len());
    for (a, b) in clean.iter().zip(kept) {
        assert_eq!(distance(&pose(a), &pose(b)), 0.0);
    }
    for (index, word) in [(2, "repeats"), (4, "over-exposed"), (7, "shows nothing")] {
        let Tracked { confidence, warning, .. } = &marred[index];
        assert_eq!(*confidence, 0.0);
        assert!(warning.as_ref().unwrap().contains(word), "{warning:?}");
    }
    assert!(marred[3].confidence < clean[2].confidence, "a pair across a gap is worth less");
}

#[test]
fn a_long_night_ends_with_a_new_pair() {
    let mut odometry = odometry();
    let pictures: Vec<Image> = (0..3).map(picture).collect();
    streamed(&mut odometry, &pictures);
    for index in 3..9 {
        let dark = show(&mut odometry, index, Image::from_fn(SIZE, |_, _| [2; 3]));
        assert_eq!(dark.confidence, 0.0);
        pose(&dark);
    }
    let first = show(&mut odometry, 9, picture(20));
    assert!(first.confidence == 0.0 && first.warning.as_ref().unwrap().contains("6 frames unseen"), "{first:?}");
    let second = show(&mut odometry, 10, picture(21));
    assert!(second.confidence == 1.0 && second.warning.is_none(), "{second:?}");
}

#[test]
fn numbers_that_are_none_never_come_out() {
    let broken =
        RecurrentCheckpoint { config: RecurrentVoConfig { unit_m: f64::NAN, ..checkpoint().config }, ..checkpoint() };
    let mut odometry = RecurrentOdometry::new(broken, None, &Device::flex()).unwrap();
    let answers = streamed(&mut odometry, &(0..6).map(picture).collect::<Vec<_>>());
    for tracked in &answers[1..] {
        assert_eq!((tracked.confidence, distance(&pose(tracked), &Pose::identity())), (0.0, 0.0));
    }
    let warnings: Vec<&str> = answers[1..].iter().map(|tracked| tracked.warning.as_deref().unwrap()).collect();
    // Frames without an answer are as good as unseen: the third in a row begins a new pair.
    for (warning, words) in warnings.iter().zip(["no finite motion", "no finite motion", "2 frames unseen"]) {
        assert!(warning.contains(words), "{warnings:?}");
    }
}

#[test]
fn pictures_of_any_size_but_nothing_else() {
    let mut odometry = odometry();
    show(&mut odometry, 0, picture(0));
    let wide = Image::from_fn(Size::new(200, 90), |x, y| [(x + y) as u8; 3]);
    pose(&show(&mut odometry, 1, wide));
    let reading = MagneticReading { index: 4, time_s: 0.0, field_tesla: Vec::new() };
    let sentence = odometry.track(&Observation::Magnetic(reading)).unwrap_err().to_string();
    assert!(sentence.contains("no picture"), "{sentence}");
    let tiny = RecurrentOdometry::new(checkpoint(), Some(Size::new(8, 8)), &Device::flex());
    assert!(tiny.err().unwrap().to_string().contains("`width` is 8"));
}
