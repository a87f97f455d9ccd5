//! The middle of the lumen: a smooth curve with a frame that does not twist, and the room around it.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use rayon::prelude::*;

/// Distance between samples of the curve, metres.
const STEP_M: f64 = 0.001;
/// The room at a place is the least within this distance along the axis, so that a path may be smooth.
const WINDOW_M: f64 = 0.016;

/// The curve through the middle of an organ, parametrised by its length.
#[derive(Clone, Debug)]
pub struct Axis {
    points: Vec<Vector3<f64>>,
    frames: Vec<UnitQuaternion<f64>>,
    /// Radius of free space around each sample, smoothed; set by [`Axis::with_room`].
    room_m: Vec<f64>,
    step_m: f64,
}

impl Axis {
    /// A smooth curve through `knots` (at least two, in order), resampled at equal steps.
    pub fn through(knots: &[Vector3<f64>]) -> Self {
        let dense = dense(knots);
        let length_m: f64 = dense.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
        let count = (length_m / STEP_M).ceil().max(2.0) as usize;
        let step_m = length_m / (count - 1) as f64;
        let points = resampled(&dense, count, step_m);
        let frames = untwisted(&points);
        let room_m = vec![0.0; points.len()];
        Self { points, frames, room_m, step_m }
    }

    /// Length of the curve in metres.
    pub fn length_m(&self) -> f64 {
        self.step_m * (self.points.len() - 1) as f64
    }

    /// Point of the curve at a distance along it.
    pub fn point(&self, along_m: f64) -> Vector3<f64> {
        let (at, share) = self.locate(along_m);
        let near = |offset: isize| self.points[at.saturating_add_signed(offset).min(self.points.len() - 1)];
        let [p, q, r, s] = [near(-1), near(0), near(1), near(2)];
        let (t, t2, t3) = (share, share * share, share * share * share);
        (q * 2.0 + (r - p) * t + (p * 2.0 - q * 5.0 + r * 4.0 - s) * t2 + (q * 3.0 - p - r * 3.0 + s) * t3) * 0.5
    }

    /// World from the local frame at a distance along the curve: z along the curve, x and y across, no twist.
    pub fn frame(&self, along_m: f64) -> UnitQuaternion<f64> {
        let (at, share) = self.locate(along_m);
        let next = (at + 1).min(self.frames.len() - 1);
        self.frames[at].try_slerp(&self.frames[next], share, 1e-12).unwrap_or(self.frames[at])
    }

    /// Radius of the ball around the curve that stays free, metres.
    pub fn room_m(&self, along_m: f64) -> f64 {
        let (at, share) = self.locate(along_m);
        let next = (at + 1).min(self.room_m.len() - 1);
        self.room_m[at] + share * (self.room_m[next] - self.room_m[at])
    }

    /// The axis with the free room measured against points of the wall (at its tightest).
    #[must_use]
    pub fn with_room(mut self, wall: &[Vector3<f64>]) -> Self {
        let least = |point: &Vector3<f64>| {
            let nearest = wall.iter().map(|vertex| (vertex - point).norm_squared()).fold(f64::INFINITY, f64::min);
            nearest.sqrt()
        };
        let free: Vec<f64> = self.points.par_iter().map(least).collect();
        let reach = (WINDOW_M / self.step_m).ceil() as usize;
        let window = |at: usize, reach: usize| at.saturating_sub(reach)..(at + reach + 1).min(free.len());
        // A mean over half the window of the least over the whole window stays below the room at every place.
        let lowest: Vec<f64> =
            (0..free.len()).map(|at| free[window(at, reach)].iter().copied().fold(f64::INFINITY, f64::min)).collect();
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let once: Vec<f64> = (0..free.len()).map(|at| mean(&lowest[window(at, reach / 2)])).collect();
        self.room_m = (0..free.len()).map(|at| mean(&once[window(at, reach / 2)])).collect();
        self
    }

    /// The range of the curve around its middle that has at least `least_m` of room; `None` if no place has.
    pub fn passable(&self, least_m: f64) -> Option<(f64, f64)> {
        let widest = self.room_m.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?.0;
        let free = |at: &usize| self.room_m[*at] >= least_m;
        let first = (0..=widest).rev().take_while(free).last()?;
        let last = (widest..self.room_m.len()).take_while(free).last()?;
        Some((first as f64 * self.step_m, last as f64 * self.step_m))
    }

    fn locate(&self, along_m: f64) -> (usize, f64) {
        let place = (along_m / self.step_m).clamp(0.0, (self.points.len() - 1) as f64);
        let at = (place.floor() as usize).min(self.points.len() - 2);
        (at, place - at as f64)
    }
}

/// Many points on the Catmull-Rom curve through the knots, then rounded off so that curvature is smooth too.
fn dense(knots: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    const PER_SPAN: usize = 64;
    let knot = |at: isize| knots[at.clamp(0, knots.len() as isize - 1) as usize];
    let mut points = Vec::new();
    for span in 0..knots.len() as isize - 1 {
        let [p, q, r, s] = [knot(span - 1), knot(span), knot(span + 1), knot(span + 2)];
        points.extend((0..PER_SPAN).map(|i| {
            let t = i as f64 / PER_SPAN as f64;
            let (t2, t3) = (t * t, t * t * t);
            (q * 2.0 + (r - p) * t + (p * 2.0 - q * 5.0 + r * 4.0 - s) * t2 + (q * 3.0 - p - r * 3.0 + s) * t3) * 0.5
        }));
    }
    points.push(knot(knots.len() as isize));
    for _ in 0..60 {
        let before = points.clone();
        for at in 1..points.len() - 1 {
            points[at] = (before[at - 1] + before[at] * 2.0 + before[at + 1]) * 0.25;
        }
    }
    points
}

fn resampled(dense: &[Vector3<f64>], count: usize, step_m: f64) -> Vec<Vector3<f64>> {
    let mut points = Vec::with_capacity(count);
    let (mut at, mut before_m) = (0, 0.0);
    for i in 0..count {
        let wanted_m = i as f64 * step_m;
        while at + 2 < dense.len() && before_m + (dense[at + 1] - dense[at]).norm() < wanted_m {
            before_m += (dense[at + 1] - dense[at]).norm();
            at += 1;
        }
        let span = dense[at + 1] - dense[at];
        points.push(dense[at] + span * ((wanted_m - before_m) / span.norm().max(1e-12)).clamp(0.0, 1.0));
    }
    points
}

/// Frames along a curve by the double reflection of W. Wang, B. Juttler, D. Zheng, Y. Liu, "Computation of rotation
/// minimizing frames", 2008.
fn untwisted(points: &[Vector3<f64>]) -> Vec<UnitQuaternion<f64>> {
    let last = points.len() - 1;
    let tangent = |at: usize| (points[(at + 1).min(last)] - points[at.saturating_sub(1)]).normalize();
    let seed = if tangent(0).x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    let mut across = (seed - tangent(0) * seed.dot(&tangent(0))).normalize();
    let mut frames = Vec::with_capacity(points.len());
    for at in 0..points.len() {
        let along = tangent(at);
        if at > 0 {
            let way = points[at] - points[at - 1];
            let mirrored = |v: Vector3<f64>, plane: &Vector3<f64>| {
                v - plane * (2.0 * plane.dot(&v) / plane.norm_squared().max(f64::MIN_POSITIVE))
            };
            let (half_across, half_along) = (mirrored(across, &way), mirrored(tangent(at - 1), &way));
            across = mirrored(half_across, &(along - half_along));
            across = (across - along * across.dot(&along)).normalize();
        }
        let matrix = Matrix3::from_columns(&[across, along.cross(&across), along]);
        frames.push(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix)));
    }
    frames
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_steps_and_frames_along_the_curve() {
        let knots: Vec<Vector3<f64>> = (0..12)
            .map(|i| 0.1 * Vector3::new((0.5 * f64::from(i)).cos(), (0.5 * f64::from(i)).sin(), 0.1 * f64::from(i)))
            .collect();
        let axis = Axis::through(&knots);
        for i in 1..100 {
            let along_m = axis.length_m() * f64::from(i) / 101.0;
            let way = axis.point(along_m + 1e-4) - axis.point(along_m - 1e-4);
            assert!((way.norm() / 2e-4 - 1.0).abs() < 0.01);
            assert!((axis.frame(along_m) * Vector3::z()).dot(&way.normalize()) > 0.9999);
        }
    }

    #[test]
    fn room_is_never_more_than_there_is() {
        let axis = Axis::through(&[Vector3::zeros(), Vector3::new(0.0, 0.0, 0.1), Vector3::new(0.0, 0.0, 0.2)]);
        let wall: Vec<Vector3<f64>> = (0..400)
            .map(|i| {
                Vector3::new(0.02 - 0.01 * (-(f64::from(i) - 200.0).powi(2) / 200.0).exp(), 0.0, 0.0005 * f64::from(i))
            })
            .collect();
        let axis = axis.with_room(&wall);
        assert!(axis.room_m(0.1) <= 0.0101 && axis.room_m(0.1) > 0.0099);
        assert!(axis.room_m(0.03) > 0.0195);
        let (from, to) = axis.passable(0.015).unwrap();
        assert!(to < 0.09 || from > 0.11);
        assert_eq!(axis.passable(0.5), None);
    }
}
