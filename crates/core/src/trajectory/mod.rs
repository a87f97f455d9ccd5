//! Where the camera was, when.

mod text;

pub use text::{TextError, numbers, parse_euroc, parse_kitti, parse_tum, records, to_kitti, to_tum};

use crate::Pose;
use nalgebra::Translation3;
use thiserror::Error;

/// One pose with its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedPose {
    /// Seconds on the clock of the source.
    pub time_s: f64,
    /// Maps camera points (metres, x right, y down, z forward) to the world.
    pub world_from_camera: Pose,
}

/// Why poses are no trajectory.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum TrajectoryError {
    /// NaN or infinity in a pose or its time.
    #[error("pose {index} holds a number that is not finite")]
    NotFinite {
        /// Position of the pose.
        index: usize,
    },
    /// Times that stand still or run backwards.
    #[error("pose {index} at {time_s} s does not come after the one before it at {previous_s} s")]
    NotIncreasing {
        /// Position of the later pose.
        index: usize,
        /// Its time in seconds.
        time_s: f64,
        /// Time of the pose before it, in seconds.
        previous_s: f64,
    },
    /// As many times as poses are needed.
    #[error("{poses} poses but {times} times")]
    Unpaired {
        /// Number of poses.
        poses: usize,
        /// Number of times.
        times: usize,
    },
}

/// Poses of one camera in strictly increasing time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    poses: Vec<TimedPose>,
}

impl Trajectory {
    /// Takes poses in time order.
    ///
    /// # Errors
    /// [`TrajectoryError::NotFinite`] or [`TrajectoryError::NotIncreasing`].
    pub fn new(poses: Vec<TimedPose>) -> Result<Self, TrajectoryError> {
        for (index, pose) in poses.iter().enumerate() {
            let numbers = pose.world_from_camera.translation.vector;
            let rotation = pose.world_from_camera.rotation.coords;
            if !(pose.time_s.is_finite() && numbers.iter().chain(rotation.iter()).all(|x| x.is_finite())) {
                return Err(TrajectoryError::NotFinite { index });
            }
        }
        for (index, pair) in poses.windows(2).enumerate() {
            if pair[1].time_s <= pair[0].time_s {
                let (time_s, previous_s) = (pair[1].time_s, pair[0].time_s);
                return Err(TrajectoryError::NotIncreasing { index: index + 1, time_s, previous_s });
            }
        }
        Ok(Self { poses })
    }

    /// Pairs poses with their times.
    ///
    /// # Errors
    /// [`TrajectoryError::Unpaired`], or as [`Trajectory::new`].
    pub fn from_times(times_s: &[f64], world_from_camera: &[Pose]) -> Result<Self, TrajectoryError> {
        if times_s.len() != world_from_camera.len() {
            return Err(TrajectoryError::Unpaired { poses: world_from_camera.len(), times: times_s.len() });
        }
        let pair = |(time_s, pose): (&f64, &Pose)| TimedPose { time_s: *time_s, world_from_camera: *pose };
        Self::new(times_s.iter().zip(world_from_camera).map(pair).collect())
    }

    /// Number of poses.
    pub const fn len(&self) -> usize {
        self.poses.len()
    }

    /// Whether there is no pose at all.
    pub const fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// The poses in time order.
    pub fn poses(&self) -> &[TimedPose] {
        &self.poses
    }

    /// Times in seconds.
    pub fn times_s(&self) -> impl Iterator<Item = f64> + '_ {
        self.poses.iter().map(|pose| pose.time_s)
    }

    /// Camera positions in the world, metres.
    pub fn positions_m(&self) -> impl Iterator<Item = nalgebra::Vector3<f64>> + '_ {
        self.poses.iter().map(|pose| pose.world_from_camera.translation.vector)
    }

    /// Time from first to last pose in seconds; 0 for fewer than two.
    pub fn duration_s(&self) -> f64 {
        match (self.poses.first(), self.poses.last()) {
            (Some(first), Some(last)) => last.time_s - first.time_s,
            _ => 0.0,
        }
    }

    /// Length of the polygon through all camera positions, in metres.
    pub fn path_length_m(&self) -> f64 {
        let step_m = |pair: &[TimedPose]| distance_m(&pair[0].world_from_camera, &pair[1].world_from_camera);
        // Not `sum`, whose empty sum is -0.0 and would be written so.
        self.poses.windows(2).map(step_m).fold(0.0, |length_m, step_m| length_m + step_m)
    }

    /// Path length in metres from the first pose to each pose, the first being 0.
    pub fn distances_m(&self) -> Vec<f64> {
        let mut travelled = 0.0;
        let mut distances = Vec::with_capacity(self.len());
        for (index, pose) in self.poses.iter().enumerate() {
            if index > 0 {
                travelled += distance_m(&self.poses[index - 1].world_from_camera, &pose.world_from_camera);
            }
            distances.push(travelled);
        }
        distances
    }

    /// Motion of the camera between two poses as `first_from_second`: the second camera's pose seen from the first.
    ///
    /// `None` if either index does not exist.
    pub fn relative(&self, first: usize, second: usize) -> Option<Pose> {
        let (first, second) = (self.poses.get(first)?, self.poses.get(second)?);
        Some(first.world_from_camera.inverse() * second.world_from_camera)
    }

    /// Pose at `time_s`: position linear, rotation along the shortest arc between the neighbours.
    ///
    /// `None` outside the covered time, so that nothing is extrapolated in silence.
    pub fn interpolate(&self, time_s: f64) -> Option<Pose> {
        let after = self.poses.partition_point(|pose| pose.time_s < time_s);
        let right = self.poses.get(after)?;
        if right.time_s == time_s {
            return Some(right.world_from_camera);
        }
        let left = self.poses.get(after.checked_sub(1)?)?;
        let share = (time_s - left.time_s) / (right.time_s - left.time_s);
        let position = |pose: &TimedPose| pose.world_from_camera.translation.vector;
        let rotation = between(&left.world_from_camera, &right.world_from_camera, share);
        Some(Pose::from_parts(Translation3::from(position(left).lerp(&position(right), share)), rotation))
    }

    /// Poses at the given times; times outside the covered range are left out.
    ///
    /// # Errors
    /// As [`Trajectory::new`], for times that do not increase.
    pub fn resampled(&self, times_s: &[f64]) -> Result<Self, TrajectoryError> {
        let at = |time_s: &f64| {
            self.interpolate(*time_s).map(|world_from_camera| TimedPose { time_s: *time_s, world_from_camera })
        };
        Self::new(times_s.iter().filter_map(at).collect())
    }
}

fn distance_m(a: &Pose, b: &Pose) -> f64 {
    (b.translation.vector - a.translation.vector).norm()
}

/// Spherical interpolation that also survives half turns, where the arc is not unique.
fn between(left: &Pose, right: &Pose, share: f64) -> nalgebra::UnitQuaternion<f64> {
    left.rotation.try_slerp(&right.rotation, share, 1e-9).unwrap_or(if share < 0.5 {
        left.rotation
    } else {
        right.rotation
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::se3;
    use nalgebra::Vector6;
    use proptest::prelude::*;

    fn screw(steps: usize) -> Trajectory {
        let twist = Vector6::new(0.3, -0.1, 0.2, 0.1, 0.5, -0.2);
        let timed = |i: usize| TimedPose { time_s: i as f64, world_from_camera: se3::exp(&(twist * i as f64 * 0.1)) };
        Trajectory::new((0..steps).map(timed).collect()).unwrap()
    }

    #[test]
    fn times_must_increase_and_numbers_be_finite() {
        let pose = |time_s| TimedPose { time_s, world_from_camera: Pose::identity() };
        assert!(matches!(
            Trajectory::new(vec![pose(0.0), pose(0.0)]),
            Err(TrajectoryError::NotIncreasing { index: 1, .. })
        ));
        assert_eq!(Trajectory::new(vec![pose(f64::NAN)]), Err(TrajectoryError::NotFinite { index: 0 }));
    }

    #[test]
    fn path_length_is_the_last_distance() {
        let trajectory = screw(20);
        assert!((trajectory.path_length_m() - trajectory.distances_m()[19]).abs() < 1e-12);
        assert_eq!(Trajectory::default().path_length_m().to_string(), "0");
    }

    #[test]
    fn nothing_is_extrapolated() {
        let trajectory = screw(3);
        assert!(trajectory.interpolate(-0.1).is_none());
        assert!(trajectory.interpolate(2.1).is_none());
        assert_eq!(trajectory.resampled(&[-1.0, 0.5, 5.0]).unwrap().len(), 1);
    }

    proptest! {
        #[test]
        fn relative_motions_chain(a in 0_usize..20, b in 0_usize..20, c in 0_usize..20) {
            let t = screw(20);
            let chained = t.relative(a, b).unwrap() * t.relative(b, c).unwrap();
            let direct = t.relative(a, c).unwrap();
            prop_assert!((chained.to_homogeneous() - direct.to_homogeneous()).amax() < 1e-12);
        }

        #[test]
        fn interpolation_hits_the_poses_and_halves_the_way(i in 0_usize..19) {
            let t = screw(20);
            prop_assert_eq!(t.interpolate(i as f64), Some(t.poses()[i].world_from_camera));
            let middle = t.interpolate(i as f64 + 0.5).unwrap();
            let (left, right) = (t.poses()[i].world_from_camera, t.poses()[i + 1].world_from_camera);
            prop_assert!((left.rotation.angle_to(&middle.rotation) - right.rotation.angle_to(&middle.rotation)).abs() < 1e-9);
        }
    }
}
