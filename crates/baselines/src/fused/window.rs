//! How vision's path lies in the magnet's world: the roll no array sees and the scale no single camera sees, from a
//! window of frames both watched (docs/math.md, "Fusion").
//!
//! The unknowns are the newest pose and the scale: seven numbers, whatever the window's length. Vision's path is taken
//! as rigid, with a doubt that grows with the way to the newest frame.

use crate::least_squares::{self, NormalEquations, Problem, Stop};
use endoscape_core::{Pose, se3};
use nalgebra::{Point3, SMatrix, SVector, UnitQuaternion, UnitVector3, Vector3};

/// Rolls the search starts from: with fewer, half a turn can be a trap.
const STARTS: usize = 8;
const STOP: Stop = Stop { evaluations: 30, relative_decrease: 1e-8 };

/// What both sides said at one frame.
#[derive(Clone, Copy, Debug)]
pub struct Sighting {
    /// The camera in vision's world and unit.
    pub visual_from_camera: Pose,
    /// The magnet's centre in the world, metres, with its variance in m^2.
    pub magnet_m: (Vector3<f64>, f64),
    /// The magnet's axis in the world, with its variance in rad^2.
    pub heading: (Vector3<f64>, f64),
}

/// The magnet on the camera.
#[derive(Clone, Copy, Debug)]
pub struct Mount {
    /// Centre in the camera's frame, metres.
    pub in_camera_m: Vector3<f64>,
    /// Axis in the camera's frame.
    pub axis: UnitVector3<f64>,
}

/// How vision's path is doubted, as shares of what lies between a frame and the newest one.
#[derive(Clone, Copy, Debug)]
pub struct Drift {
    /// Of the way.
    pub way: f64,
    /// Of the turn.
    pub turn: f64,
}

/// The newest pose and the scale, with their covariance (twist, logarithm of the scale).
#[derive(Clone, Debug)]
pub struct Agreement {
    /// Pose of the newest frame.
    pub world_from_camera: Pose,
    /// Logarithm of metres per unit of vision.
    pub log_scale: f64,
    /// Covariance.
    pub covariance: SMatrix<f64, 7, 7>,
}

/// Fits the window; `None` where vision did not move or the window leaves something open.
///
/// `start` gives the place and heading to start from.
pub fn agree(window: &[Sighting], mount: &Mount, start: &Pose, drift: Drift) -> Option<Agreement> {
    let problem = WindowProblem::new(window, mount, drift)?;
    let log_scale = problem.first_log_scale()?;
    let magnet = start * Point3::from(mount.in_camera_m);
    let rolled = |index: usize| {
        let roll = UnitQuaternion::from_axis_angle(&mount.axis, std::f64::consts::TAU * index as f64 / STARTS as f64);
        let rotation = start.rotation * roll;
        let world_from_camera = Pose::from_parts((magnet.coords - rotation * mount.in_camera_m).into(), rotation);
        least_squares::minimise(&problem, (world_from_camera, log_scale), STOP)
    };
    let best = (0..STARTS).filter_map(rolled).min_by(|a, b| a.equations.cost.total_cmp(&b.equations.cost))?;
    // Residuals beyond their doubt speak of a doubt too small.
    let worse = (2.0 * best.equations.cost / (5.0 * window.len() as f64)).max(1.0);
    let covariance = least_squares::covariance(&best.equations.information)? * worse;
    Some(Agreement { world_from_camera: best.state.0, log_scale: best.state.1, covariance })
}

/// One sighting as seen from the newest frame.
struct Row {
    newest_from_camera: Pose,
    magnet_m: Vector3<f64>,
    heading: Vector3<f64>,
    /// Reciprocal variances of the two.
    weights: (f64, f64),
}

struct WindowProblem<'a> {
    rows: Vec<Row>,
    mount: &'a Mount,
}

impl<'a> WindowProblem<'a> {
    fn new(window: &[Sighting], mount: &'a Mount, drift: Drift) -> Option<Self> {
        let newest = window.last()?;
        let newest_from_visual = newest.visual_from_camera.inverse();
        let row = |sighting: &Sighting| {
            let newest_from_camera = newest_from_visual * sighting.visual_from_camera;
            let way_m = (sighting.magnet_m.0 - newest.magnet_m.0).norm();
            let turn_rad = newest_from_camera.rotation.angle();
            let place = sighting.magnet_m.1 + (drift.way * way_m).powi(2);
            let heading = sighting.heading.1 + (drift.turn * turn_rad).powi(2);
            let weights = (1.0 / place, 1.0 / heading);
            Row { newest_from_camera, magnet_m: sighting.magnet_m.0, heading: sighting.heading.0, weights }
        };
        Some(Self { rows: window.iter().map(row).collect(), mount })
    }

    /// Ratio of the extents of both paths.
    fn first_log_scale(&self) -> Option<f64> {
        let extent = |place: &dyn Fn(&Row) -> Vector3<f64>| {
            let mean = self.rows.iter().map(place).sum::<Vector3<f64>>() / self.rows.len() as f64;
            self.rows.iter().map(|row| (place(row) - mean).norm_squared()).sum::<f64>().sqrt()
        };
        let ratio = extent(&|row| row.magnet_m) / extent(&|row| row.newest_from_camera.translation.vector);
        let log_scale = ratio.ln();
        log_scale.is_finite().then_some(log_scale)
    }
}

impl Problem<7> for WindowProblem<'_> {
    type State = (Pose, f64);

    fn linearise(&self, (world_from_newest, log_scale): &(Pose, f64)) -> Option<NormalEquations<7>> {
        let rotation = world_from_newest.rotation.to_rotation_matrix().into_inner();
        let axis = self.mount.axis.into_inner();
        let mut equations = NormalEquations::empty();
        for row in &self.rows {
            let scaled = row.newest_from_camera.translation.vector * log_scale.exp();
            let magnet = row.newest_from_camera.rotation * self.mount.in_camera_m + scaled;
            let turned = row.newest_from_camera.rotation * axis;
            let off = rotation * magnet + world_from_newest.translation.vector - row.magnet_m;
            let turn = rotation * turned - row.heading;
            let (by_magnet, by_turn) = (-rotation * se3::skew(&magnet), -rotation * se3::skew(&turned));
            let by_scale = rotation * scaled;
            for i in 0..3 {
                let (r, m, t) = (rotation.row(i), by_magnet.row(i), by_turn.row(i));
                let place = SVector::from([r[0], r[1], r[2], m[0], m[1], m[2], by_scale[i]]);
                equations.add(off[i], &place, row.weights.0);
                equations.add(turn[i], &SVector::from([0.0, 0.0, 0.0, t[0], t[1], t[2], 0.0]), row.weights.1);
            }
        }
        equations.cost.is_finite().then_some(equations)
    }

    fn moved(&self, (pose, log_scale): &(Pose, f64), step: &SVector<f64, 7>) -> (Pose, f64) {
        (pose * se3::exp(&step.fixed_rows::<6>(0).into_owned()), log_scale + step[6])
    }
}
