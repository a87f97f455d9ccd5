//! Relative motions to poses: docs/math.md, "From motions to a trajectory".

use endoscape_core::{Pose, se3};

/// Share of a motion that is expected to go on from one unseen frame to the next: after a few frames without sight the
/// predicted camera has come to rest, about five frames' motion further.
const PERSISTENCE: f64 = 0.8;

/// The motion in the middle between two estimates of the same motion, along the geodesic of SE(3):
/// `a exp(log(a^-1 b) / 2)`.
///
/// A forward estimate and the inverse of a backward one have opposite biases towards rest or towards the usual motion,
/// which their mean loses.
pub fn midway(a: &Pose, b: &Pose) -> Pose {
    a * part(&(a.inverse() * b), 0.5)
}

/// The motion `motion` would have reached after the share `share` of its time at constant twist.
pub fn part(motion: &Pose, share: f64) -> Pose {
    se3::exp(&(se3::log(motion) * share))
}

/// The same motion with its translation in another unit.
pub fn scaled(motion: &Pose, factor: f64) -> Pose {
    let mut motion = *motion;
    motion.translation.vector *= factor;
    motion
}

/// The same pose with a rotation of unit length to the last digit.
///
/// Products of quaternions lose a digit's worth of it each time, and inverting takes unit length for granted: in a chain
/// of corrected poses the loss doubles from link to link until it shows.
pub fn renormalised(mut pose: Pose) -> Pose {
    pose.rotation.renormalize();
    pose
}

/// Whether every number of a motion is finite.
pub fn is_finite(motion: &Pose) -> bool {
    let numbers = motion.translation.vector.iter().chain(motion.rotation.coords.iter());
    numbers.into_iter().all(|value| value.is_finite())
}

/// How far two estimates of one motion agree, from 0 to 1: `1 - |log(a^-1 b)| / (|log a| + |log b|)`.
///
/// Translation is in the networks' unit, of the order of the distance to the scene, so that one radian and one unit
/// weigh alike. Two motions that are no motion agree.
pub fn agreement(a: &Pose, b: &Pose) -> f64 {
    let length = |motion: &Pose| se3::log(motion).norm();
    let sum = length(a) + length(b);
    if sum < f64::MIN_POSITIVE { 1.0 } else { (1.0 - length(&(a.inverse() * b)) / sum).clamp(0.0, 1.0) }
}

/// Where the camera has been and how it moves: what is needed to say where it is without seeing anything.
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    world_from_camera: Pose,
    /// Pose of the latest frame seen from the one before.
    step: Pose,
}

impl Default for Motion {
    fn default() -> Self {
        Self { world_from_camera: Pose::identity(), step: Pose::identity() }
    }
}

impl Motion {
    /// The latest pose.
    pub const fn pose(&self) -> Pose {
        self.world_from_camera
    }

    /// Takes the pose of the next frame.
    pub fn arrive(&mut self, world_from_camera: Pose) {
        self.step = self.world_from_camera.inverse() * world_from_camera;
        self.world_from_camera = world_from_camera;
    }

    /// The pose of the next frame if the motion goes on as it is.
    pub fn expected(&self) -> Pose {
        renormalised(self.world_from_camera * self.step)
    }

    /// Goes on by a fading part of the latest step and returns the pose reached.
    pub fn coast(&mut self) -> Pose {
        self.step = part(&self.step, PERSISTENCE);
        self.world_from_camera = renormalised(self.world_from_camera * self.step);
        self.world_from_camera
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;
    use proptest::prelude::*;

    fn pose(twist: [f64; 6]) -> Pose {
        se3::exp(&Vector6::from(twist))
    }

    fn distance(a: &Pose, b: &Pose) -> f64 {
        (a.to_homogeneous() - b.to_homogeneous()).amax()
    }

    proptest! {
        #[test]
        fn the_middle_is_symmetric_and_halves_the_way(a in prop::array::uniform6(-1.0..1.0), b in prop::array::uniform6(-1.0..1.0)) {
            let (a, b) = (pose(a), pose(b));
            let middle = midway(&a, &b);
            prop_assert!(distance(&middle, &midway(&b, &a)) < 1e-9);
            let (first, second) = (se3::log(&(a.inverse() * middle)), se3::log(&(middle.inverse() * b)));
            prop_assert!((first - second).norm() < 1e-9);
        }

        #[test]
        fn a_motion_and_the_inverse_of_its_inverse_agree(a in prop::array::uniform6(-1.0..1.0)) {
            let forward = pose(a);
            let backward = forward.inverse();
            prop_assert!(distance(&midway(&forward, &backward.inverse()), &forward) < 1e-9);
            prop_assert!(agreement(&forward, &backward.inverse()) > 1.0 - 1e-6);
        }

        #[test]
        fn opposite_biases_cancel(a in prop::array::uniform6(-0.3..0.3), bias in -0.3..0.3_f64) {
            // Both directions stretched by the same share of the motion, as towards a usual speed.
            let truth = pose(a);
            let (forward, backward) = (part(&truth, 1.0 + bias), part(&truth.inverse(), 1.0 - bias));
            prop_assert!(distance(&midway(&forward, &backward.inverse()), &truth) < 1e-9);
        }

        #[test]
        fn the_unit_of_length_commutes_with_chaining(a in prop::array::uniform6(-1.0..1.0), b in prop::array::uniform6(-1.0..1.0), factor in 0.1..10.0_f64) {
            let (a, b) = (pose(a), pose(b));
            prop_assert!(distance(&scaled(&(a * b), factor), &(scaled(&a, factor) * scaled(&b, factor))) < 1e-9);
        }
    }

    #[test]
    fn long_chains_of_corrections_stay_rigid() {
        let step = pose([0.1, 0.0, 0.02, 0.01, -0.02, 0.03]);
        let (mut previous, mut latest) = (Pose::identity(), step);
        for _ in 0..10_000 {
            let corrected = renormalised(previous * midway(&(previous.inverse() * latest), &step));
            (previous, latest) = (corrected, renormalised(corrected * step));
        }
        assert!((latest.rotation.norm() - 1.0).abs() < 1e-15);
        assert!(distance(&(previous.inverse() * latest), &step) < 1e-9);
    }

    #[test]
    fn nothing_agrees_with_nothing_and_opposites_disagree() {
        let still = Pose::identity();
        assert_eq!(agreement(&still, &still), 1.0);
        let forward = pose([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]);
        assert!(agreement(&forward, &forward.inverse()) < 1e-9);
        assert!(!is_finite(&scaled(&forward, f64::NAN)));
    }

    #[test]
    fn an_unseen_camera_goes_on_and_comes_to_rest() {
        let mut motion = Motion::default();
        motion.arrive(pose([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]));
        let depths: Vec<f64> = (0..60).map(|_| motion.coast().translation.z).collect();
        assert!((depths[0] - 1.8).abs() < 1e-12);
        assert!((depths[59] - 5.0).abs() < 1e-4 && depths.is_sorted());
    }
}
