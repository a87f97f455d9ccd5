//! The trajectory the motion network gives when its motions are chained, against truth.

use crate::clip::{Clip, ClipFrame};
use crate::dataset::snippet_frames;
use crate::model::DepthMotionModel;
use burn::tensor::{Device, Tensor};
use endoscape_core::Pose;
use endoscape_nets::network_input;
use nalgebra::{Matrix3, Vector3};

/// Most motions chained in one clip.
const LONGEST_CHAIN: usize = 256;

/// RMSE in metres of the chained camera positions after alignment by a similarity; `None` unless four frames in a row,
/// `gap` apart, have a pose and a motion.
pub fn score_trajectory(model: &DepthMotionModel, clip: &Clip, gap: usize, device: &Device) -> Option<f64> {
    let length = model.pose.sources() + 1;
    let mut world_from_camera = Pose::identity();
    let (mut estimate, mut truth) = (Vec::new(), Vec::new());
    for target in (length / 2 * gap..clip.frames.len()).step_by(gap).take(LONGEST_CHAIN) {
        let Some(true_pose) = clip.frames[target].world_from_camera else { break };
        estimate.push(world_from_camera.translation.vector);
        truth.push(true_pose.translation.vector);
        let Some(frames) = snippet_frames(clip, target, gap, length) else { break };
        world_from_camera *= target_from_next(model, &frames, device);
    }
    if estimate.len() < 4 { None } else { similarity_rmse(&estimate, &truth) }
}

/// Motion to the frame after the target, as the pose of that frame in the target's.
fn target_from_next(model: &DepthMotionModel, frames: &[&ClipFrame], device: &Device) -> Pose {
    let inputs: Vec<Tensor<4>> = frames.iter().map(|frame| network_input(&frame.image, device)).collect();
    // Of the sources in time order the first half lies before the target.
    let next = (frames.len() - 1) / 2;
    let motion = model.pose.forward_motion(inputs[0].clone(), &inputs[1..]).narrow(1, next, 1);
    let mut numbers = [0.0; 6];
    for (number, value) in numbers.iter_mut().zip(motion.into_data().iter::<f32>()) {
        *number = f64::from(value);
    }
    model.pose.rotation().pose(numbers).inverse()
}

/// RMSE left after the best similarity (rotation, translation, scale) from `estimate` to `truth`.
///
/// With `H` the covariance of both and `H = U D V^T`, the least mean square is `var(truth) - tr(D S)^2 / var(estimate)`
/// with `S = diag(1, 1, +-1)` against reflections; S. Umeyama, IEEE TPAMI 13 (1991), equation 33. `None` for fewer than
/// three points.
pub fn similarity_rmse(estimate: &[Vector3<f64>], truth: &[Vector3<f64>]) -> Option<f64> {
    let count = estimate.len().min(truth.len());
    if count < 3 {
        return None;
    }
    let centred = |points: &[Vector3<f64>]| {
        let mean = points[..count].iter().sum::<Vector3<f64>>() / count as f64;
        points[..count].iter().map(|point| point - mean).collect::<Vec<_>>()
    };
    let (estimate, truth) = (centred(estimate), centred(truth));
    let variance = |points: &[Vector3<f64>]| points.iter().map(Vector3::norm_squared).sum::<f64>() / count as f64;
    let covariance: Matrix3<f64> = truth.iter().zip(&estimate).map(|(t, e)| t * e.transpose()).sum();
    let covariance = covariance / count as f64;
    let [first, second, third] = <[f64; 3]>::from(covariance.singular_values());
    let trace = first + second + third * covariance.determinant().signum();
    let explained = if variance(&estimate) > 0.0 { trace * trace / variance(&estimate) } else { 0.0 };
    let rmse = (variance(&truth) - explained).max(0.0).sqrt();
    rmse.is_finite().then_some(rmse)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn points() -> Vec<Vector3<f64>> {
        (0..12).map(f64::from).map(|t| Vector3::new(t.sin(), 0.3 * t, (0.7 * t).cos())).collect()
    }

    proptest! {
        #[test]
        fn a_similarity_leaves_nothing(axis in prop::array::uniform3(-2.0..2.0), shift in prop::array::uniform3(-5.0..5.0), scale in 0.01..100.0_f64) {
            let motion = Pose::new(Vector3::from(shift), Vector3::from(axis));
            let moved: Vec<_> = points().iter().map(|p| motion.rotation * p * scale + motion.translation.vector).collect();
            prop_assert!(similarity_rmse(&points(), &moved).unwrap() < 1e-6 * scale);
        }

        #[test]
        fn the_scale_of_the_estimate_does_not_matter(scale in 0.1..10.0_f64) {
            let bent: Vec<_> = points().iter().map(|p| p + Vector3::new(0.1 * p.y * p.y, 0.0, 0.0)).collect();
            let scaled: Vec<_> = bent.iter().map(|p| p * scale).collect();
            let (a, b) = (similarity_rmse(&bent, &points()).unwrap(), similarity_rmse(&scaled, &points()).unwrap());
            prop_assert!((a - b).abs() < 1e-9 && a > 1e-3);
        }
    }

    #[test]
    fn reflections_and_standing_still_are_no_way_out() {
        let mirrored: Vec<_> = points().iter().map(|p| Vector3::new(-p.x, p.y, p.z)).collect();
        assert!(similarity_rmse(&mirrored, &points()).unwrap() > 0.1);
        let still = vec![Vector3::zeros(); 12];
        let spread = similarity_rmse(&still, &points()).unwrap();
        let mean = points().iter().sum::<Vector3<f64>>() / 12.0;
        let expected = (points().iter().map(|p| (p - mean).norm_squared()).sum::<f64>() / 12.0).sqrt();
        assert!((spread - expected).abs() < 1e-12);
        assert_eq!(similarity_rmse(&still[..2], &still[..2]), None);
    }
}
