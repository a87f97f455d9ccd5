//! What a source would have shown had the camera been turned about its centre.
//!
//! Turning moves every pixel by an amount that depends on its ray alone, not on depth, so it can be made up exactly. A
//! network that has seen few recordings recalls how the camera usually moves at a place; turned at random, a source tells
//! it nothing of the kind, and it has to measure.

use super::view::ViewChange;
use endoscape_core::{Camera, Pose, Size};
use nalgebra::{Point2, Point3, UnitQuaternion, Vector3};
use rand::{Rng, RngExt};

/// Largest turn about each axis, radians: 4 degrees, some 6 pixels of 160 through a lens of 83 degrees.
const LARGEST: f64 = 0.07;

/// Pixels between the places that are projected; between them they are interpolated.
const SPACING: usize = 8;

/// A turn of the camera of a changed view.
#[derive(Clone, Debug)]
pub struct Turn {
    /// From the frame of the camera as it was to that of the turned one.
    turned_from_before: UnitQuaternion<f64>,
    columns: usize,
    /// Places in the picture before, every [`SPACING`] pixels, row after row.
    places: Vec<[f64; 2]>,
}

impl Turn {
    /// Draws a turn that brings into view what the change has cropped away and, about the optical axis apart, no more: at
    /// the edges nothing is known, and a network would soon read the turn off the edge. `None` for lenses that do not
    /// cover their picture.
    pub fn draw(change: &ViewChange, camera: &Camera, rng: &mut impl Rng) -> Option<Self> {
        let [left, right, upper, lower] = hidden_angles(change, camera)?;
        let corner_px = 0.5 * (camera.size().width as f64).hypot(camera.size().height as f64);
        let roll = (0.5 * change.hidden().into_iter().fold(f64::INFINITY, f64::min) / corner_px).min(LARGEST);
        // About the axis that points down, what was ahead moves to the right; about the one to the right, upwards.
        let about = Vector3::new(
            rng.random_range(-upper..=lower),
            rng.random_range(-right..=left),
            rng.random_range(-roll..=roll),
        );
        Self::new(camera, UnitQuaternion::new(about))
    }

    /// The turn of a camera.
    pub fn new(camera: &Camera, turned_from_before: UnitQuaternion<f64>) -> Option<Self> {
        let Size { width, height } = camera.size();
        let before_from_turned = turned_from_before.inverse();
        let (columns, rows) = (width.div_ceil(SPACING) + 1, height.div_ceil(SPACING) + 1);
        let place = |index: usize| {
            let at = [index % columns, index / columns].map(|step| (step * SPACING) as f64);
            let ray: Vector3<f64> = before_from_turned * camera.unproject(&Point2::from(at))?;
            camera.project(&Point3::from(ray)).map(|pixel| [pixel.x, pixel.y])
        };
        let places = (0..columns * rows).map(place).collect::<Option<Vec<_>>>()?;
        Some(Self { turned_from_before, columns, places })
    }

    /// Where in the picture before a pixel of the turned camera shows what is there.
    pub fn place(&self, x: usize, y: usize) -> [f64; 2] {
        let (column, row) = (x / SPACING, y / SPACING);
        let (u, v) = ((x % SPACING) as f64 / SPACING as f64, (y % SPACING) as f64 / SPACING as f64);
        let corner = |right: usize, below: usize| self.places[(row + below) * self.columns + column + right];
        [0, 1].map(|axis| {
            let above = corner(0, 0)[axis] * (1.0 - u) + corner(1, 0)[axis] * u;
            let below = corner(0, 1)[axis] * (1.0 - u) + corner(1, 1)[axis] * u;
            above * (1.0 - v) + below * v
        })
    }

    /// The motion from a target to the turned camera, given that to the camera before.
    pub fn motion(&self, source_from_target: &Pose) -> Pose {
        self.turned_from_before * source_from_target
    }
}

/// Angles that lie hidden beyond the middle of the left, right, upper and lower edge, at most [`LARGEST`] each.
fn hidden_angles(change: &ViewChange, camera: &Camera) -> Option<[f64; 4]> {
    let [left, right, upper, lower] = change.hidden();
    let [last_x, last_y] = [camera.size().width, camera.size().height].map(|extent| extent as f64 - 1.0);
    let angle = |edge: [f64; 2], beyond: [f64; 2]| {
        let ray = |at: [f64; 2]| camera.unproject(&Point2::from(at));
        Some(ray(edge)?.angle(&ray(beyond)?).min(LARGEST))
    };
    let (x, y) = (0.5 * last_x, 0.5 * last_y);
    Some([
        angle([0.0, y], [-left, y])?,
        angle([last_x, y], [last_x + right, y])?,
        angle([x, 0.0], [x, -upper])?,
        angle([x, last_y], [x, last_y + lower])?,
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use endoscape_core::camera::{Intrinsics, KannalaBrandt};
    use rand::SeedableRng;
    use rand::rngs::ChaCha8Rng;

    const SIZE: Size = Size::new(64, 48);

    fn lenses() -> [Camera; 2] {
        let intrinsics = Intrinsics { fx: 30.0, fy: 31.0, cx: 31.0, cy: 24.5, skew: 0.0 };
        let fisheye = KannalaBrandt { intrinsics, k1: 0.02, k2: -0.01, k3: 0.003, k4: 0.0 };
        [Camera::from_field_of_view(SIZE, 80_f64.to_radians()).unwrap(), Camera::new(SIZE, fisheye.into()).unwrap()]
    }

    /// A point seen by the turned camera at a pixel was seen by the camera before at the place that the turn names, and a
    /// motion to the turned camera takes it there.
    #[test]
    fn turned_pixels_and_motions_agree() {
        for camera in lenses() {
            let turn = Turn::new(&camera, UnitQuaternion::new(Vector3::new(0.03, -0.05, 0.04))).unwrap();
            let before_from_target = Pose::new(Vector3::new(0.1, -0.05, 0.2), Vector3::new(0.02, 0.01, -0.03));
            let turned_from_target = turn.motion(&before_from_target);
            for (x, y) in [(10, 8), (17, 21), (40, 35), (63, 47)] {
                let ray = camera.unproject(&Point2::new(x as f64, y as f64)).unwrap();
                let point = turned_from_target.inverse() * Point3::from(ray * 3.0);
                let before = camera.project(&(before_from_target * point)).unwrap();
                let [u, v] = turn.place(x, y);
                assert!((u - before.x).hypot(v - before.y) < 0.05, "{u} {v} instead of {before}");
            }
        }
    }

    #[test]
    fn a_drawn_turn_shows_next_to_nothing_that_is_not_known() {
        let rng = &mut ChaCha8Rng::seed_from_u64(3);
        let mut largest = 0.0_f64;
        for camera in lenses() {
            for step in 0..40 {
                let (x, y) = (f64::from(step % 5) / 4.0, f64::from(step % 7) / 6.0);
                let mirrored = [step % 2 == 0, step % 3 == 0];
                let change = ViewChange::new(SIZE, [1.15, 1.12], [x, y], mirrored);
                let changed = change.camera(&camera).unwrap();
                let turn = Turn::draw(&change, &changed, rng).unwrap();
                largest = largest.max(turn.turned_from_before.angle());
                let [left, right, upper, lower] = change.hidden();
                for (column, row) in [(0, 0), (63, 0), (0, 47), (63, 47), (31, 0), (0, 24)] {
                    let [u, v] = turn.place(column, row);
                    let beyond = [-left - u, u - 63.0 - right, -upper - v, v - 47.0 - lower];
                    assert!(beyond.iter().all(|pixels| *pixels < 2.5), "{beyond:?} pixels at {column} {row}");
                }
            }
        }
        assert!(largest > 0.05, "turns of at most {largest} rad");
    }

    #[test]
    fn where_nothing_was_cropped_nothing_turns() {
        let camera = lenses()[0];
        let whole = ViewChange::new(SIZE, [1.0, 1.0], [0.0, 0.0], [false; 2]);
        let turn = Turn::draw(&whole, &camera, &mut ChaCha8Rng::seed_from_u64(1)).unwrap();
        assert_eq!(turn.turned_from_before.angle(), 0.0);
    }
}
