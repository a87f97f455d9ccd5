//! Bicubic Catmull-Rom patches over a net of points.
//!
//! The net is stored with one more row and column of points on each side (wrapped, or continued by a parabola), so
//! that every patch finds its sixteen points in four runs of memory.

use super::{patch_columns, single};
use glam::Vec3A;
use nalgebra::Vector3;
use obvhs::aabb::Aabb;

/// Points of a net with its margin.
#[derive(Clone, Debug, Default)]
pub struct Net {
    points: Vec<Vector3<f64>>,
    /// Points per stored row.
    stride: usize,
    /// Patches per row.
    across: usize,
}

/// A point of a patch with its derivatives by both coordinates.
#[derive(Clone, Copy, Debug)]
pub struct Jet {
    pub point: Vector3<f64>,
    pub by_a: Vector3<f64>,
    pub by_b: Vector3<f64>,
}

impl Net {
    /// Takes the points of a net, row after row.
    pub fn new(points: &[Vector3<f64>], rows: usize, columns: usize, wrapped: bool) -> Self {
        let across = patch_columns(columns, wrapped);
        let stride = across + 3;
        let mut stored = Vec::with_capacity((rows + 2) * stride);
        let row_of = |row: usize, stored: &mut Vec<Vector3<f64>>| {
            let row = &points[row * columns..(row + 1) * columns];
            if wrapped {
                stored.extend((0..stride).map(|i| row[(i + columns - 1) % columns]));
            } else {
                stored.push(continued(row[0], row[1], row[2.min(columns - 1)]));
                stored.extend_from_slice(row);
                stored.push(continued(row[columns - 1], row[columns - 2], row[columns.saturating_sub(3)]));
            }
        };
        stored.resize(stride, Vector3::zeros());
        (0..rows).for_each(|row| row_of(row, &mut stored));
        let at = |row: usize, i: usize, stored: &[Vector3<f64>]| stored[row * stride + i];
        for i in 0..stride {
            let third = 3.min(rows);
            stored[i] = continued(at(1, i, &stored), at(2, i, &stored), at(third, i, &stored));
        }
        for i in 0..stride {
            let end = (at(rows, i, &stored), at(rows - 1, i, &stored), at(rows.saturating_sub(2).max(1), i, &stored));
            stored.push(continued(end.0, end.1, end.2));
        }
        Self { points: stored, stride, across }
    }

    /// The sixteen points of a patch, four runs of four.
    fn support(&self, cell: u32) -> [&[Vector3<f64>]; 4] {
        let first = cell as usize / self.across * self.stride + cell as usize % self.across;
        std::array::from_fn(|i| &self.points[first + i * self.stride..first + i * self.stride + 4])
    }

    /// The patch at coordinates `a` (along rows) and `b` (along columns), both 0 to 1.
    pub fn jet(&self, cell: u32, a: f64, b: f64) -> Jet {
        let ((wa, da), (wb, db)) = (weights(a), weights(b));
        let mut jet = Jet { point: Vector3::zeros(), by_a: Vector3::zeros(), by_b: Vector3::zeros() };
        for (i, row) in self.support(cell).into_iter().enumerate() {
            let value = row[0] * wb[0] + row[1] * wb[1] + row[2] * wb[2] + row[3] * wb[3];
            let slope = row[0] * db[0] + row[1] * db[1] + row[2] * db[2] + row[3] * db[3];
            jet.point += value * wa[i];
            jet.by_a += value * da[i];
            jet.by_b += slope * wa[i];
        }
        jet
    }

    /// The patch's middle as a flat parallelogram, the start of Newton's method.
    pub fn flat(&self, cell: u32) -> Jet {
        let [_, low, high, _] = self.support(cell);
        Jet {
            point: (low[1] + low[2] + high[1] + high[2]) * 0.25,
            by_a: (high[1] + high[2] - low[1] - low[2]) * 0.5,
            by_b: (low[2] + high[2] - low[1] - high[1]) * 0.5,
        }
    }

    /// A box around the patch: that of its Bezier points, whose hull holds it, to single precision.
    pub fn bounds(&self, cell: u32) -> Aabb {
        let rows = self.support(cell).map(|row| bezier(std::array::from_fn(|i| single(&row[i]))));
        let columns = (0..4).map(|column| rows.map(|row| row[column]));
        columns.flat_map(bezier).fold(Aabb::empty(), |all, point| Aabb::new(all.min.min(point), all.max.max(point)))
    }
}

/// The next value of a parabola through three, from the nearest to the farthest.
fn continued(first: Vector3<f64>, second: Vector3<f64>, third: Vector3<f64>) -> Vector3<f64> {
    (first - second) * 3.0 + third
}

/// Bezier points of one Catmull-Rom span.
fn bezier([p, q, r, s]: [Vec3A; 4]) -> [Vec3A; 4] {
    [q, q + (r - p) * (1.0 / 6.0), r - (s - q) * (1.0 / 6.0), r]
}

/// Weights of the four points of a span and their derivatives.
fn weights(t: f64) -> ([f64; 4], [f64; 4]) {
    let (t2, t3) = (t * t, t * t * t);
    (
        [
            0.5 * (-t + 2.0 * t2 - t3),
            0.5 * (2.0 - 5.0 * t2 + 3.0 * t3),
            0.5 * (t + 4.0 * t2 - 3.0 * t3),
            0.5 * (t3 - t2),
        ],
        [
            0.5 * (-1.0 + 4.0 * t - 3.0 * t2),
            0.5 * (-10.0 * t + 9.0 * t2),
            0.5 * (1.0 + 8.0 * t - 9.0 * t2),
            0.5 * (3.0 * t2 - 2.0 * t),
        ],
    )
}

/// Steps of Newton's method before a patch is given up; it doubles the digits in each.
const STEPS: usize = 8;
/// Remaining distance between ray and surface, metres; far below any use of the truth.
const CONVERGED_M: f64 = 1e-10;
/// Neighbouring patches both accept a hit this far beyond their common edge, so that no ray slips between them.
const SEAM: f64 = 1e-7;

/// Where a ray meets a patch: distance along the unit direction and the two coordinates.
pub fn intersect(net: &Net, cell: u32, origin: &Vector3<f64>, direction: &Vector3<f64>) -> Option<(f64, f64, f64)> {
    let (mut a, mut b) = (0.5, 0.5);
    let mut jet = net.flat(cell);
    for step in 0..STEPS {
        let normal = jet.by_a.cross(&jet.by_b);
        let to_point = jet.point - origin;
        let distance = normal.dot(&to_point) / normal.dot(direction);
        // From the present point to the ray, within the tangent plane.
        let rest = direction * distance - to_point;
        let area = normal.norm_squared();
        let (da, db) = (rest.cross(&jet.by_b).dot(&normal) / area, jet.by_a.cross(&rest).dot(&normal) / area);
        if !(da.is_finite() && db.is_finite()) {
            return None;
        }
        // The flat start counts with a wide margin, later steps know better.
        let margin = if step == 0 { 1.0 } else { 0.3 };
        a += da;
        b += db;
        if a < -margin || a > 1.0 + margin || b < -margin || b > 1.0 + margin {
            return None;
        }
        if step > 0 && rest.norm_squared() < CONVERGED_M * CONVERGED_M {
            let inside = |t: f64| (-SEAM..=1.0 + SEAM).contains(&t);
            return (inside(a) && inside(b)).then_some((distance, a, b));
        }
        jet = net.jet(cell, a, b);
    }
    None
}
