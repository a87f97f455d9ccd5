//! Where the pixels of one frame lie in another: equations 1 and 2 of docs/math.md in double precision, on a lattice.
//!
//! The training has the same on tensors; here nothing is differentiated and a few thousand pixels say enough.

use endoscape_core::{Camera, CameraError, Grid, Pose, Size};
use nalgebra::{Point2, Point3, Vector3};

/// Most pixels of the lattice: enough for a median within a few parts in a thousand.
pub const LATTICE: usize = 4096;

/// Directions farther from the optical axis than 87 degrees have no useful depth along it (as in training).
const LEAST_COSINE: f64 = 0.05;

/// A pixel of one frame found in another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moved {
    /// Index of the pixel in the frame it comes from, row after row.
    pub from: usize,
    /// Its position in the other frame, pixel centres at integers; inside the picture.
    pub to: Point2<f64>,
    /// Its depth along the other camera's axis, in the unit of the depth it was moved with.
    pub depth: f64,
}

/// A camera with the rays of some of its pixels.
#[derive(Clone, Debug)]
pub struct Reprojector {
    camera: Camera,
    /// Index of a pixel and its direction with `z = 1`.
    rays: Vec<(usize, Vector3<f64>)>,
}

impl Reprojector {
    /// Rays of at most `count` pixels of a regular lattice over the whole picture of `size`.
    ///
    /// # Errors
    /// [`CameraError::Empty`] for a size without pixels.
    pub fn new(camera: &Camera, size: Size, count: usize) -> Result<Self, CameraError> {
        let camera = camera.scaled_to(size)?;
        let step = ((size.area() as f64 / count.max(1) as f64).sqrt().ceil() as usize).max(1);
        let ray = |x: usize, y: usize| {
            let direction = camera.unproject(&Point2::new(x as f64, y as f64))?;
            (direction.z >= LEAST_COSINE).then(|| (y * size.width + x, direction / direction.z))
        };
        let rows = (step / 2..size.height).step_by(step);
        let rays = rows.flat_map(|y| (step / 2..size.width).step_by(step).filter_map(move |x| ray(x, y))).collect();
        Ok(Self { camera, rays })
    }

    /// Pixels of the lattice that see anything.
    pub const fn len(&self) -> usize {
        self.rays.len()
    }

    /// Whether no pixel sees anything.
    pub const fn is_empty(&self) -> bool {
        self.rays.is_empty()
    }

    /// Indices of those pixels.
    pub fn pixels(&self) -> impl Iterator<Item = usize> + '_ {
        self.rays.iter().map(|(pixel, _)| *pixel)
    }

    /// The pixels with a known depth that lie in the other picture, in the order of the lattice.
    pub fn reproject(&self, depth: &Grid<f32>, other_from_this: &Pose) -> Vec<Moved> {
        let moved = |(from, ray): &(usize, Vector3<f64>)| {
            let known = depth.values().get(*from).copied().map(f64::from).filter(|d| d.is_finite() && *d > 0.0)?;
            let point = other_from_this * Point3::from(ray * known);
            let to = self.camera.project(&point).filter(|to| self.camera.contains(to))?;
            (point.z > 0.0).then_some(Moved { from: *from, to, depth: point.z })
        };
        self.rays.iter().filter_map(moved).collect()
    }
}

/// The value between four pixels, whose centres lie at integers; the outer half of border pixels takes their value.
///
/// `None` outside the picture.
pub fn bilinear(grid: &Grid<f32>, at: &Point2<f64>) -> Option<f64> {
    let Size { width, height } = grid.size();
    let inside = |value: f64, extent: usize| value >= -0.5 && value <= extent as f64 - 0.5;
    if width == 0 || height == 0 || !inside(at.x, width) || !inside(at.y, height) {
        return None;
    }
    let cell = |value: f64, extent: usize| {
        let value = value.clamp(0.0, (extent - 1) as f64);
        let first = (value as usize).min(extent.saturating_sub(2));
        (first, (first + 1).min(extent - 1), value - first as f64)
    };
    let ((left, right, across), (top, low, down)) = (cell(at.x, width), cell(at.y, height));
    let mix = |row: &[f32]| f64::from(row[left]) * (1.0 - across) + f64::from(row[right]) * across;
    Some(mix(grid.row(top)) * (1.0 - down) + mix(grid.row(low)) * down)
}

/// A place in a picture of one size at another, edges to edges.
pub(crate) fn rescaled(at: &Point2<f64>, from: Size, to: Size) -> Point2<f64> {
    let place = |at: f64, from: usize, to: usize| (at + 0.5) * to as f64 / from as f64 - 0.5;
    Point2::new(place(at.x, from.width, to.width), place(at.y, from.height, to.height))
}

/// A dense map at another size, bilinear, edges to edges.
pub(crate) fn stretched(map: &Grid<f32>, size: Size) -> Grid<f32> {
    if map.size() == size {
        return map.clone();
    }
    Grid::from_fn(size, |x, y| {
        let at = rescaled(&Point2::new(x as f64, y as f64), size, map.size());
        bilinear(map, &at).unwrap_or(0.0) as f32
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};

    const SIZE: Size = Size::new(64, 48);

    fn camera() -> Camera {
        Camera::from_field_of_view(Size::new(640, 480), 1.2).unwrap()
    }

    #[test]
    fn a_still_camera_sees_every_pixel_where_it_was() {
        let reprojector = Reprojector::new(&camera(), SIZE, usize::MAX).unwrap();
        let moved = reprojector.reproject(&Grid::filled(SIZE, 2.0), &Pose::identity());
        assert_eq!(moved.len(), SIZE.area());
        for (index, pixel) in moved.iter().enumerate() {
            let expected = Point2::new((index % 64) as f64, (index / 64) as f64);
            assert!(pixel.from == index && (pixel.to - expected).norm() < 1e-9 && pixel.depth == 2.0);
        }
    }

    #[test]
    fn a_step_forward_leaves_less_depth_and_spreads_the_picture() {
        let reprojector = Reprojector::new(&camera(), SIZE, LATTICE).unwrap();
        let forward = Pose::from_parts(Translation3::new(0.0, 0.0, -0.5), UnitQuaternion::identity());
        let moved = reprojector.reproject(&Grid::filled(SIZE, 2.0), &forward);
        assert!(moved.len() < reprojector.len() && !moved.is_empty());
        assert!(moved.iter().all(|pixel| (pixel.depth - 1.5).abs() < 1e-12));
        let backward = reprojector.reproject(&Grid::filled(SIZE, 2.0), &forward.inverse());
        assert_eq!(backward.len(), reprojector.len());
    }

    #[test]
    fn unknown_poisonous_and_passed_depths_are_left_out() {
        let reprojector = Reprojector::new(&camera(), SIZE, LATTICE).unwrap();
        for depth in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert!(reprojector.reproject(&Grid::filled(SIZE, depth), &Pose::identity()).is_empty());
        }
        let through = Pose::translation(0.0, 0.0, -3.0);
        assert!(reprojector.reproject(&Grid::filled(SIZE, 2.0), &through).is_empty());
    }

    #[test]
    fn the_lattice_keeps_to_its_count() {
        for count in [1, 100, 1000] {
            let reprojector = Reprojector::new(&camera(), SIZE, count).unwrap();
            assert!((1..=count).contains(&reprojector.len()), "{} of {count}", reprojector.len());
        }
    }

    #[test]
    fn bilinear_reads_ramps_exactly_and_nothing_outside() {
        let ramp = Grid::from_fn(SIZE, |x, y| 3.0 * x as f32 - 2.0 * y as f32);
        for (x, y) in [(0.0, 0.0), (10.25, 7.5), (63.0, 47.0), (62.9, 0.1)] {
            let value = bilinear(&ramp, &Point2::new(x, y)).unwrap();
            assert!((value - (3.0 * x - 2.0 * y)).abs() < 1e-5);
        }
        assert_eq!(bilinear(&ramp, &Point2::new(-0.4, 0.0)), Some(0.0));
        assert_eq!(bilinear(&ramp, &Point2::new(64.0, 0.0)), None);
        assert_eq!(bilinear(&ramp, &Point2::new(f64::NAN, 0.0)), None);
        assert_eq!(bilinear(&Grid::filled(Size::new(1, 1), 4.0), &Point2::new(0.2, -0.3)), Some(4.0));
    }
}
