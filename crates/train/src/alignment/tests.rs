use super::*;
use crate::augment::{AugmentConfig, augment};
use crate::clip::{ClipFrame, Label};
use crate::dataset::Item;
use crate::testing::sliding_clip;
use burn::tensor::Device;
use endoscape_core::{DepthMap, Grid};
use endoscape_nets::AlignNetConfig;
use endoscape_synthesis::ObjectiveConfig;
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;

fn label() -> Pose {
    Pose::new(Vector3::new(0.02, -0.01, 0.03), Vector3::new(0.01, 0.02, -0.03))
}

/// A snippet of a picture that slides before a camera whose labels say so: a plane at depth 2.
fn batch(labelled: bool) -> SnippetBatch {
    let mut clip = sliding_clip(3, 2.0);
    let size = clip.camera.size();
    for frame in &mut clip.frames {
        let world_from_camera = Pose::translation(0.05 * frame.position as f64, 0.0, 0.0);
        let depth = DepthMap::new(Grid::filled(size, 2.0));
        frame.label = labelled.then_some(Label { world_from_camera, depth });
    }
    let frames: Vec<&ClipFrame> = [1, 0, 2].map(|position| &clip.frames[position]).into();
    let rng = &mut ChaCha8Rng::seed_from_u64(0);
    let snippet = augment(&frames, &clip.camera, &AugmentConfig::none(), rng).unwrap();
    let items = [Item { snippet, stands: false }];
    SnippetBatch::new(&items, &ObjectiveConfig::paper(), &Device::flex()).unwrap()
}

#[test]
fn a_start_and_what_is_left_make_the_label() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (mut rests, mut sizes) = (0, Vec::new());
    for _ in 0..400 {
        let Start { source_from_target, left: [x, y, z, rx, ry, rz] } = Start::draw(&label(), 2.0, &mut rng);
        let left = Pose::new(Vector3::new(x, y, z) * 2.0, Vector3::new(rx, ry, rz));
        let whole = left * source_from_target;
        assert!((whole.to_homogeneous() - label().to_homogeneous()).amax() < 1e-12);
        if source_from_target == Pose::identity() {
            rests += 1;
        } else {
            sizes.push(rx.abs().max(ry.abs()).max(rz.abs()));
        }
    }
    assert!((60..140).contains(&rests), "{rests} of 400 begin at rest");
    sizes.sort_by(f64::total_cmp);
    // From a fiftieth of 0.06 to all of it, evenly by ratio.
    assert!(sizes[10] < 0.003 && sizes[sizes.len() - 10] > 0.02, "{sizes:?}");
}

#[test]
fn saying_that_nothing_is_left_is_wrong_by_all_of_it() {
    let net = AlignNetConfig::default().init(0, &Device::flex()).unwrap();
    let batch = batch(true);
    let lessons = batch.lessons.as_ref().unwrap();
    // In any unit.
    let depth = batch.stands.zeros_like().reshape([1, 1, 1, 1]).expand([1, 1, 64, 96]) + 7.0;
    let error = alignment_error(&net, &batch, lessons, depth.clone()).into_scalar::<f32>();
    assert!((error - 1.0).abs() < 1e-6, "{error}");
    let sizes: Vec<f32> = lessons
        .left
        .iter()
        .flat_map(|left| in_largest(left.clone()).into_data().iter().collect::<Vec<f32>>())
        .collect();
    let expected = sizes.iter().map(|size| size / (size + NOISE as f32)).sum::<f32>() / sizes.len() as f32;
    let loss = alignment_loss(&net, &batch, lessons, depth).into_scalar::<f32>();
    assert!((loss - expected).abs() < 1e-5 && loss > 0.3, "{loss} instead of {expected}");
}

#[test]
fn without_labels_there_is_nothing_to_learn_from() {
    assert!(batch(false).lessons.is_none());
}
