//! The error-state Kalman filter: a pose, the pose at the last frame, and the scale of vision (docs/math.md, "Fusion").
//!
//! The pose at the last frame is a stochastic clone (S. Roumeliotis and J. Burdick, ICRA 2002): the motion vision
//! measures ties two poses together, so both are in the state. Errors are twists on the right, `X = X' exp(d)`, so they
//! are in the camera's frame and metres.
//!
//! Invariant: the covariance stays symmetric and positive (Joseph's form).

use endoscape_core::{Pose, se3};
use nalgebra::{Matrix2, Matrix3, Matrix5, Matrix6, SMatrix, SVector, UnitVector3, Vector3};

/// Error states: pose (6), clone (6), logarithm of the scale (1).
pub const STATES: usize = 13;
/// Place of the clone's error.
const CLONE: usize = 6;
/// Place of the scale's error.
const SCALE: usize = 12;
/// Linearisations of one update: the second already halves what a large correction leaves.
const ITERATIONS: usize = 3;
/// Chi-squared that one measurement in ten thousand exceeds, for 5 and 6 degrees of freedom; rarer still for 3.
const GATE: f64 = 27.0;

type Covariance = SMatrix<f64, STATES, STATES>;

/// How fast the unknown may change where nothing is measured.
#[derive(Clone, Copy, Debug)]
pub struct Walk {
    /// Translation, metres per root second.
    pub translation_m: f64,
    /// Rotation, radians per root second.
    pub rotation_rad: f64,
    /// Logarithm of the scale, per root second.
    pub log_scale: f64,
}

/// A magnet in the camera and where the array saw it.
#[derive(Clone, Debug)]
pub struct MagnetFix {
    /// Its centre in the camera's frame, metres.
    pub in_camera_m: Vector3<f64>,
    /// Its axis in the camera's frame.
    pub axis_in_camera: UnitVector3<f64>,
    /// Its centre in the world, metres.
    pub in_world_m: Vector3<f64>,
    /// Two unit vectors in the world across its axis.
    pub across: SMatrix<f64, 3, 2>,
    /// Covariance of its centre and of the axis along [`MagnetFix::across`].
    pub covariance: Matrix5<f64>,
}

/// A motion vision saw, from the clone to now, in vision's unit.
#[derive(Clone, Copy, Debug)]
pub struct VisualStep {
    /// `clone_from_camera`.
    pub motion: Pose,
    /// Standard deviation of its translation, metres.
    pub translation_sigma_m: f64,
    /// Standard deviation of its rotation, radians.
    pub rotation_sigma_rad: f64,
}

/// The state and its covariance.
#[derive(Clone, Debug)]
pub struct Filter {
    /// Seconds.
    pub time_s: f64,
    /// Where the camera is.
    pub world_from_camera: Pose,
    /// Where it was at the last frame.
    pub world_from_clone: Pose,
    /// Logarithm of metres per unit of vision.
    pub log_scale: f64,
    covariance: Covariance,
}

impl Filter {
    /// A filter that knows pose and scale as well as `covariance` of (twist, logarithm of the scale) says.
    pub fn new(time_s: f64, world_from_camera: Pose, log_scale: f64, covariance: &SMatrix<f64, 7, 7>) -> Self {
        let mut spread = SMatrix::<f64, STATES, 7>::zeros();
        spread.fixed_view_mut::<6, 6>(0, 0).fill_with_identity();
        spread.fixed_view_mut::<6, 6>(CLONE, 0).fill_with_identity();
        spread[(SCALE, 6)] = 1.0;
        let covariance = spread * covariance * spread.transpose();
        Self { time_s, world_from_camera, world_from_clone: world_from_camera, log_scale, covariance }
    }

    /// The same knowledge at another time.
    pub fn starting_at(&self, time_s: f64) -> Self {
        Self { time_s, ..self.clone() }
    }

    /// Covariance of the pose's error twist.
    pub fn pose_covariance(&self) -> Matrix6<f64> {
        self.covariance.fixed_view::<6, 6>(0, 0).into_owned()
    }

    /// Largest standard deviation of the position over all directions, metres.
    pub fn position_sigma_m(&self) -> f64 {
        largest_sigma(&self.covariance.fixed_view::<3, 3>(0, 0).into_owned())
    }

    /// Largest standard deviation of the rotation over all axes, radians.
    pub fn rotation_sigma_rad(&self) -> f64 {
        largest_sigma(&self.covariance.fixed_view::<3, 3>(3, 3).into_owned())
    }

    /// Standard deviation of the logarithm of the scale.
    pub fn scale_sigma(&self) -> f64 {
        self.covariance[(SCALE, SCALE)].sqrt()
    }

    /// Adds doubt about the scale, as a standard deviation of its logarithm.
    pub fn doubt_scale(&mut self, sigma: f64) {
        self.covariance[(SCALE, SCALE)] += sigma * sigma;
    }

    /// Lets time pass: the pose may have moved by a random walk.
    pub fn predict(&mut self, time_s: f64, walk: &Walk) {
        let elapsed_s = (time_s - self.time_s).max(0.0);
        self.time_s = self.time_s.max(time_s);
        for axis in 0..3 {
            self.covariance[(axis, axis)] += walk.translation_m.powi(2) * elapsed_s;
            self.covariance[(3 + axis, 3 + axis)] += walk.rotation_rad.powi(2) * elapsed_s;
        }
        self.covariance[(SCALE, SCALE)] += walk.log_scale.powi(2) * elapsed_s;
    }

    /// Makes the present pose the one the next motion starts from.
    pub fn clone_pose(&mut self) {
        self.world_from_clone = self.world_from_camera;
        let columns = self.covariance.fixed_columns::<6>(0).into_owned();
        self.covariance.fixed_columns_mut::<6>(CLONE).copy_from(&columns);
        let rows = self.covariance.fixed_rows::<6>(0).into_owned();
        self.covariance.fixed_rows_mut::<6>(CLONE).copy_from(&rows);
    }

    /// Learns from the magnet; `false` where it contradicts the state, which then stays.
    pub fn see_magnet(&mut self, fix: &MagnetFix) -> bool {
        self.update(GATE, &fix.covariance, |filter| filter.magnet_residual(fix))
    }

    /// Learns from a fix that is believed whatever the state is.
    pub fn take_magnet(&mut self, fix: &MagnetFix) {
        self.update(f64::INFINITY, &fix.covariance, |filter| filter.magnet_residual(fix));
    }

    /// Learns from a motion; `false` where it contradicts the state, which then stays.
    pub fn see_motion(&mut self, step: &VisualStep) -> bool {
        let mut noise = Matrix6::zeros();
        for axis in 0..3 {
            noise[(axis, axis)] = step.translation_sigma_m.powi(2);
            noise[(3 + axis, 3 + axis)] = step.rotation_sigma_rad.powi(2);
        }
        self.update(GATE, &noise, |filter| filter.motion_residual(&step.motion))
    }

    /// Learns from a motion, or from its rotation alone where the whole contradicts the state; `false` in that case. A
    /// wall that moves deceives vision about the way, hardly about the turn.
    pub fn follow(&mut self, step: &VisualStep) -> bool {
        let agrees = self.see_motion(step);
        if !agrees {
            self.see_turn(step);
        }
        agrees
    }

    /// Learns from a motion's rotation alone; `false` where it contradicts the state, which then stays.
    pub fn see_turn(&mut self, step: &VisualStep) -> bool {
        let noise = Matrix3::from_diagonal_element(step.rotation_sigma_rad.powi(2));
        self.update(GATE, &noise, |filter| {
            let (off, derivative) = filter.motion_residual(&step.motion);
            (off.fixed_rows::<3>(3).into_owned(), derivative.fixed_rows::<3>(3).into_owned())
        })
    }

    /// Where the magnet should be and how well that is known: variances of its place (m^2) and axis (rad^2), means
    /// over the directions.
    pub fn magnet_variances(&self, in_camera_m: &Vector3<f64>, axis: &UnitVector3<f64>) -> (f64, f64) {
        let covariance = self.pose_covariance();
        let mut by_pose = SMatrix::<f64, 3, 6>::zeros();
        by_pose.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
        by_pose.fixed_view_mut::<3, 3>(0, 3).copy_from(&-se3::skew(in_camera_m));
        let place = by_pose * covariance * by_pose.transpose();
        let turn = se3::skew(axis) * covariance.fixed_view::<3, 3>(3, 3) * se3::skew(axis).transpose();
        (place.trace() / 3.0, turn.trace() / 2.0)
    }

    /// Measured minus expected place and axis of the magnet, with the derivative of what is expected.
    fn magnet_residual(&self, fix: &MagnetFix) -> (SVector<f64, 5>, SMatrix<f64, 5, STATES>) {
        let rotation = self.world_from_camera.rotation.to_rotation_matrix().into_inner();
        let place = rotation * fix.in_camera_m + self.world_from_camera.translation.vector;
        let axis = fix.axis_in_camera.into_inner();
        let (off, turn) = (fix.in_world_m - place, -fix.across.tr_mul(&(rotation * axis)));
        let mut derivative = SMatrix::<f64, 5, STATES>::zeros();
        derivative.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
        derivative.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-rotation * se3::skew(&fix.in_camera_m)));
        derivative.fixed_view_mut::<2, 3>(3, 3).copy_from(&(-fix.across.transpose() * rotation * se3::skew(&axis)));
        (SVector::from([off.x, off.y, off.z, turn.x, turn.y]), derivative)
    }

    /// Measured minus expected motion since the clone, with the derivative of what is expected.
    fn motion_residual(&self, motion: &Pose) -> (SVector<f64, 6>, SMatrix<f64, 6, STATES>) {
        let expected = self.world_from_clone.inverse() * self.world_from_camera;
        let rotation = expected.rotation.to_rotation_matrix().into_inner();
        let scaled = motion.translation.vector * self.log_scale.exp();
        let off = scaled - expected.translation.vector;
        let turn = (expected.rotation.inverse() * motion.rotation).scaled_axis();
        let mut derivative = SMatrix::<f64, 6, STATES>::zeros();
        derivative.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
        derivative.fixed_view_mut::<3, 3>(0, CLONE).copy_from(&-Matrix3::identity());
        derivative.fixed_view_mut::<3, 3>(0, CLONE + 3).copy_from(&se3::skew(&expected.translation.vector));
        derivative.fixed_view_mut::<3, 1>(0, SCALE).copy_from(&-scaled);
        derivative.fixed_view_mut::<3, 3>(3, 3).fill_with_identity();
        derivative.fixed_view_mut::<3, 3>(3, CLONE + 3).copy_from(&-rotation.transpose());
        (SVector::from([off.x, off.y, off.z, turn.x, turn.y, turn.z]), derivative)
    }

    /// The iterated Kalman update (B. Bell and F. Cathey, IEEE TAC 1993), refused where chi-squared exceeds `gate`.
    fn update<const M: usize>(
        &mut self,
        gate: f64,
        noise: &SMatrix<f64, M, M>,
        residual: impl Fn(&Self) -> (SVector<f64, M>, SMatrix<f64, M, STATES>),
    ) -> bool {
        let prior = self.clone();
        let mut correction = SVector::<f64, STATES>::zeros();
        let mut posterior = prior.covariance;
        for iteration in 0..ITERATIONS {
            let (off, derivative) = residual(self);
            let innovation = derivative * prior.covariance * derivative.transpose() + noise;
            let Some(inverse) = innovation.try_inverse() else { break };
            let unlikely = iteration == 0 && off.dot(&(inverse * off)) > gate;
            if unlikely || !off.iter().all(|value| value.is_finite()) {
                *self = prior;
                return false;
            }
            let gain = prior.covariance * derivative.transpose() * inverse;
            correction = gain * (off + derivative * correction);
            let kept = Covariance::identity() - gain * derivative;
            posterior = kept * prior.covariance * kept.transpose() + gain * noise * gain.transpose();
            *self = prior.moved(&correction);
        }
        self.covariance = 0.5 * (posterior + posterior.transpose());
        true
    }

    fn moved(&self, correction: &SVector<f64, STATES>) -> Self {
        let twist = |from: usize| se3::exp(&correction.fixed_rows::<6>(from).into_owned());
        Self {
            world_from_camera: self.world_from_camera * twist(0),
            world_from_clone: self.world_from_clone * twist(CLONE),
            log_scale: self.log_scale + correction[SCALE],
            ..self.clone()
        }
    }
}

fn largest_sigma(covariance: &Matrix3<f64>) -> f64 {
    covariance.symmetric_eigenvalues().max().max(0.0).sqrt()
}

impl MagnetFix {
    /// The fix turned and moved into the world by `world_from_array`.
    pub fn in_world(mut self, world_from_array: &Pose) -> Self {
        let rotation = world_from_array.rotation.to_rotation_matrix().into_inner();
        self.in_world_m = rotation * self.in_world_m + world_from_array.translation.vector;
        self.across = rotation * self.across;
        let mut turn = Matrix5::zeros();
        turn.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
        turn.fixed_view_mut::<2, 2>(3, 3).copy_from(&Matrix2::identity());
        self.covariance = turn * self.covariance * turn.transpose();
        self
    }
}
