use super::*;
use crate::augment::{AugmentConfig, augment};
use crate::testing::clip_of;
use endoscape_core::{DepthMap, Grid, Image};
use endoscape_synthesis::source_from_target;
use nalgebra::Vector3;
use rand::SeedableRng as _;
use rand::rngs::ChaCha8Rng;

const SIZE: Size = Size::new(32, 32);

/// Label of a frame of a camera that moves forwards, 0.01 a frame, before a plane at depth 2.
fn label(position: usize) -> Label {
    let world_from_camera = Pose::translation(0.0, 0.0, 0.01 * position as f64);
    Label { world_from_camera, depth: DepthMap::new(Grid::filled(SIZE, 2.0)) }
}

/// Snippets of three frames at rest in the picture; those of `labelled` have labels.
fn items(labelled: [bool; 2]) -> Vec<Item> {
    let mut clip = clip_of(vec![Image::from_fn(SIZE, |x, y| [x as u8, y as u8, 9]); 3]);
    let item = |labelled: bool| {
        clip.frames.iter_mut().for_each(|frame| frame.label = labelled.then(|| label(frame.position)));
        let frames: Vec<&ClipFrame> = [1, 0, 2].map(|position| &clip.frames[position]).into();
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let snippet = augment(&frames, &clip.camera, &AugmentConfig::none(), rng).unwrap();
        Item { snippet, stands: false }
    };
    labelled.map(item).into()
}

/// A plane at `depth` seen by a camera that moves by `forwards` from the target to each source.
fn prediction(depth: f64, forwards: [f64; 2]) -> Prediction {
    let device = Device::flex();
    let motion = |z: f64| {
        let numbers = [0.0, 0.0, -z as f32, 0.0, 0.0, 0.0].repeat(2);
        source_from_target(
            Tensor::from_data(TensorData::new(numbers, [2, 6]), &device),
            endoscape_core::Rotation::Euler,
        )
    };
    Prediction {
        disparities: vec![Tensor::full([2, 1, 32, 32], 1.0 / depth, &device)],
        source_from_target: forwards.map(motion).into(),
        masks: Vec::new(),
        source_disparities: Vec::new(),
    }
}

fn loss(labelled: [bool; 2], prediction: &Prediction) -> [f32; 2] {
    let lessons = Lessons::new(&items(labelled), SIZE, &Device::flex()).unwrap();
    let LessonLoss { depth, motion } = lessons.loss(prediction);
    [depth, motion].map(|term| term.into_scalar::<f32>())
}

#[test]
fn what_agrees_with_the_labels_costs_nothing() {
    let [depth, motion] = loss([true, true], &prediction(2.0, [-0.01, 0.01]));
    assert!(depth.abs() < 1e-6 && motion.abs() < 1e-6, "{depth} {motion}");
}

#[test]
fn the_scale_of_depth_counts_and_so_does_the_direction_of_motion() {
    let [depth, motion] = loss([true, true], &prediction(4.0, [0.01, -0.01]));
    assert!((depth - 2_f32.ln()).abs() < 1e-6, "{depth}");
    assert!((motion - 0.02).abs() < 1e-6, "{motion}");
}

#[test]
fn snippets_without_labels_do_not_count() {
    assert!(Lessons::new(&items([false, false]), SIZE, &Device::flex()).is_none());
    let wrong = prediction(4.0, [0.01, -0.01]);
    let (both, one) = (loss([true, true], &wrong), loss([false, true], &wrong));
    assert!(both.iter().zip(one).all(|(both, one)| (both - one).abs() < 1e-6), "{both:?} {one:?}");
}

#[test]
fn unknown_depth_does_not_count() {
    let frames: Vec<ClipFrame> = {
        let mut clip = clip_of(vec![Image::from_fn(SIZE, |_, _| [5; 3]); 3]);
        for frame in &mut clip.frames {
            let known = |x: usize, _: usize| if x < 16 { 2.0 } else { 0.0 };
            frame.label = Some(Label { depth: DepthMap::new(Grid::from_fn(SIZE, known)), ..label(frame.position) });
        }
        clip.frames
    };
    let change = ViewChange::new(SIZE, [1.0, 1.0], [0.0, 0.0], [false; 2]);
    let rng = &mut ChaCha8Rng::seed_from_u64(0);
    let lesson = Lesson::of(&frames.iter().collect::<Vec<_>>(), &change, &[const { None }; 3], rng).unwrap();
    assert_eq!(lesson.depth.iter().filter(|depth| **depth == 2.0).count(), 16 * 32);
    assert_eq!(lesson.depth.iter().filter(|depth| **depth == 0.0).count(), 16 * 32);
    let ahead = lesson.source_from_target[1].translation.vector - lesson.source_from_target[0].translation.vector;
    assert!((ahead - Vector3::new(0.0, 0.0, -0.01)).norm() < 1e-12, "{ahead}");
}

#[test]
fn weights_are_checked() {
    assert!(LessonConfig::default().validate().is_ok());
    let error = LessonConfig { motion_weight: f64::NAN, ..LessonConfig::default() }.validate().unwrap_err();
    assert!(error.to_string().contains("lesson.motion_weight"), "{error}");
}
