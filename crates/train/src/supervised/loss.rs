//! Squared errors of motions: docs/math.md, "Recurrent odometry".

use burn::tensor::Tensor;
use endoscape_core::Pose;

/// The six numbers the network should give for a motion: translation in units of `unit_m`, then axis times angle in
/// radians.
pub fn target_of(previous_from_current: &Pose, unit_m: f64) -> [f32; 6] {
    let (t, w) = (previous_from_current.translation.vector / unit_m, previous_from_current.rotation.scaled_axis());
    [t.x, t.y, t.z, w.x, w.y, w.z].map(|number| number as f32)
}

/// The terms of the loss, each `[1]` and on the device.
#[derive(Clone, Debug)]
pub struct MotionLoss {
    /// Mean squared length of the translation error, in square units.
    pub translation: Tensor<1>,
    /// Mean squared length of the rotation error, square radians.
    pub rotation: Tensor<1>,
    /// What is minimised: translation plus weighted rotation.
    pub total: Tensor<1>,
}

impl MotionLoss {
    /// Compares motions with the truth.
    ///
    /// # Shapes
    /// - `motion`, `truth`: `[batch, time, 6]`
    pub fn new(motion: Tensor<3>, truth: Tensor<3>, rotation_weight: f64) -> Self {
        let squares = (motion - truth).square();
        let mean_length = |first: usize| squares.clone().narrow(2, first, 3).sum_dim(2).mean();
        let (translation, rotation) = (mean_length(0), mean_length(3));
        let total = translation.clone() + rotation.clone().mul_scalar(rotation_weight);
        Self { translation, rotation, total }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::Device;
    use endoscape_core::Rotation;

    #[test]
    fn the_loss_is_the_formula() {
        let device = Device::flex();
        let truth = Tensor::from_data([[[0.0; 6], [1.0, 0.0, 0.0, 0.0, 0.0, 0.1]]], &device);
        let motion = Tensor::from_data([[[3.0, 4.0, 0.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0, 0.2, 0.1]]], &device);
        let MotionLoss { translation, rotation, total } = MotionLoss::new(motion, truth, 100.0);
        for (term, expected) in [(translation, 12.5), (rotation, 0.02), (total, 14.5)] {
            assert!((term.into_scalar::<f32>() - expected).abs() < 1e-5, "{expected}");
        }
    }

    #[test]
    fn targets_are_motions_in_the_unit() {
        let motion = Rotation::AxisAngle.pose([0.002, -0.004, 0.001, 0.1, -0.2, 0.3]);
        let expected = [1.0, -2.0, 0.5, 0.1, -0.2, 0.3];
        let target = target_of(&motion, 0.002);
        assert!(target.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{target:?}");
    }
}
