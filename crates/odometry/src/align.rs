//! Motions corrected by the alignment network, which looks at what is wrong with them.
//!
//! The network reads what `endoscape-synthesis` makes of a target, its depth and a source rebuilt by a motion
//! ([`Alignment`]), as in training; each answer is the motion it looks at next.

use burn::tensor::{Device, Tensor, TensorData};
use endoscape_core::{Camera, Grid, Image, Pose, Size};
use endoscape_nets::{AlignNet, network_input};
use endoscape_synthesis::alignment::contrast;
use endoscape_synthesis::{Alignment, CameraBatch, CameraScaling, SynthesisError};
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// How often the network looks. Chosen on C3VD in one trial: 3 looks left 0.32 mm of ATE where 5 left 0.29; training draws what is left
/// down to a fiftieth of a motion.
const LOOKS: usize = 5;

/// The alignment network on its device.
#[derive(Debug)]
pub struct Aligner {
    net: AlignNet,
    device: Device,
}

impl Aligner {
    /// Takes a network that lives on `device`.
    pub const fn new(net: AlignNet, device: Device) -> Self {
        Self { net, device }
    }

    /// A camera for pictures of `size`.
    ///
    /// # Errors
    /// [`SynthesisError`] for a camera that cannot be scaled.
    pub fn camera(&self, camera: &Camera, size: Size) -> Result<CameraBatch, SynthesisError> {
        CameraBatch::new(&[*camera], size, CameraScaling::Exact, &self.device)
    }

    /// Prepares a picture for others to be aligned with it.
    pub fn target(&self, image: &Image, depth: &Grid<f32>, camera: &CameraBatch) -> Alignment {
        let Size { width, height } = depth.size();
        let depth = TensorData::new(depth.values().to_vec(), [1, 1, height, width]);
        Alignment::new(network_input(image, &self.device), Tensor::from_data(depth, &self.device), camera)
    }

    /// The motion from a target to a picture, translation in the unit of the target's depth, found from the better of
    /// `guesses`; that guess itself where the network's answer explains the picture no better.
    ///
    /// `None` without guesses, and where no answer is finite.
    pub fn aligned(&self, target: &Alignment, source: &Image, guesses: &[Pose]) -> Option<Pose> {
        let source = contrast(network_input(source, &self.device));
        let disagreement =
            |motion: &Tensor<3>| target.disagreement(source.clone(), motion.clone()).into_scalar::<f32>();
        let judged = |motion: Tensor<3>| (disagreement(&motion), motion);
        let better = |a: &(f32, Tensor<3>), b: &(f32, Tensor<3>)| a.0.total_cmp(&b.0);
        let guess = guesses.iter().map(|guess| judged(self.tensor(guess))).min_by(better)?;
        let look = |motion: Tensor<3>| {
            let left = self.net.forward(target.evidence(source.clone(), motion.clone()));
            target.corrected(left, motion)
        };
        let found = judged((0..LOOKS).fold(guess.1.clone(), |motion, _| look(motion)));
        let best = if found.0 < guess.0 { found } else { guess };
        pose(best.1)
    }

    fn tensor(&self, motion: &Pose) -> Tensor<3> {
        let matrix = motion.to_homogeneous();
        let rows: Vec<f32> = (0..12).map(|entry| matrix[(entry / 4, entry % 4)] as f32).collect();
        Tensor::from_data(TensorData::new(rows, [1, 3, 4]), &self.device)
    }
}

/// A transform of `[1, 3, 4]`; `None` unless all of it is finite.
fn pose(transform: Tensor<3>) -> Option<Pose> {
    let numbers: Vec<f64> = transform.into_data().iter::<f32>().map(f64::from).collect();
    let [a, b, c, x, d, e, f, y, g, h, i, z]: [f64; 12] = numbers.try_into().ok()?;
    let rotation = Rotation3::from_matrix(&Matrix3::new(a, b, c, d, e, f, g, h, i));
    let translation = Vector3::new(x, y, z);
    let pose = Pose::from_parts(Translation3::from(translation), UnitQuaternion::from_rotation_matrix(&rotation));
    crate::chain::is_finite(&pose).then_some(pose)
}

#[cfg(test)]
mod tests;
