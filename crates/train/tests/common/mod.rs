//! A made-up organ with exact truth: a bent, folded tube with painted walls, seen along a known path.
//!
//! The walls shine by themselves: brightness constancy holds exactly, so what a training cannot explain is its own
//! fault. Lengths are in the unit of the networks' depth; the tube is about 1 wide.

use endoscape_core::{Camera, DepthMap, Grid, Image, Pose, Size};
use endoscape_train::clip::{Clip, ClipFrame};
use nalgebra::{Matrix3, Point2, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Radius of the bend and of the tube.
const BEND: f64 = 4.0;
const TUBE: f64 = 1.0;

pub const SIZE: Size = Size::new(64, 48);

/// Frames of a camera that moves along the tube, sways and turns.
pub fn tube_clip(frames: usize) -> Clip {
    let camera = Camera::from_field_of_view(SIZE, 80_f64.to_radians()).unwrap();
    let frame = |position| {
        let world_from_camera = pose(position as f64);
        let (image, depth) = render(&camera, &world_from_camera);
        ClipFrame {
            position,
            image,
            usable: Grid::filled(SIZE, true),
            world_from_camera: Some(world_from_camera),
            depth: Some(depth),
        }
    };
    Clip { name: "tube".into(), frames: (0..frames).map(frame).collect(), camera, fingerprint: "made".into() }
}

/// `world_from_camera` at a time; z looks along the tube.
pub fn pose(time: f64) -> Pose {
    let along = 0.025 * time;
    let centre = Vector3::new(BEND * along.cos(), 0.0, BEND * along.sin());
    let out = centre.normalize();
    let sway = out * (0.15 * (0.9 * time).sin()) + Vector3::y() * (0.15 * (0.7 * time + 1.0).cos());
    let ahead = Vector3::new(-along.sin(), 0.0, along.cos());
    let down = Vector3::y();
    let axes = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[down.cross(&ahead), down, ahead]));
    let turn = UnitQuaternion::from_euler_angles(
        0.06 * (0.8 * time).sin(),
        0.06 * (1.1 * time).cos(),
        0.10 * (0.6 * time).sin(),
    );
    Pose::from_parts(Translation3::from(centre + sway), UnitQuaternion::from_rotation_matrix(&axes) * turn)
}

/// Distance to the wall, positive inside, with gentle folds.
fn inside(point: &Point3<f64>) -> f64 {
    let from_axis = point.x.hypot(point.z) - BEND;
    let (along, around) = (point.z.atan2(point.x), point.y.atan2(from_axis));
    let folds = 0.08 * (14.0 * along).sin() + 0.06 * (2.0 * around + 5.0 * along).sin();
    TUBE * (1.0 + folds) - from_axis.hypot(point.y)
}

fn render(camera: &Camera, world_from_camera: &Pose) -> (Image, DepthMap) {
    let ray = |x: usize, y: usize| camera.unproject(&Point2::new(x as f64, y as f64)).unwrap();
    let hit = |x: usize, y: usize| {
        let origin = Point3::from(world_from_camera.translation.vector);
        let (direction, mut length) = (world_from_camera.rotation * ray(x, y), 0.0);
        for _ in 0..400 {
            length += 0.4 * inside(&(origin + direction * length)).max(0.0);
        }
        (origin + direction * length, length * ray(x, y).z)
    };
    let image = Image::from_fn(SIZE, |x, y| paint(&hit(x, y).0.coords));
    let depth = Grid::from_fn(SIZE, |x, y| hit(x, y).1 as f32);
    (image, DepthMap::new(depth))
}

/// Smooth colours without repetition.
fn paint(p: &Vector3<f64>) -> [u8; 3] {
    let wave = |a: f64, b: f64, c: f64, phase: f64| (a * p.x + b * p.y + c * p.z + phase).sin();
    let red = 0.5 + 0.17 * (wave(3.1, 4.7, -2.4, 0.0) + wave(-5.6, 2.3, 4.9, 1.0) + 0.6 * wave(9.3, -7.9, 8.1, 2.0));
    let green = 0.5 + 0.17 * (wave(-4.1, 3.9, 3.3, 0.7) + wave(6.2, 5.1, -3.8, 2.1) + 0.6 * wave(-8.3, 9.1, 7.4, 0.2));
    let blue = 0.5 + 0.17 * (wave(2.2, -5.3, 4.4, 1.9) + wave(4.8, 6.6, 5.7, 0.4) + 0.6 * wave(7.7, 8.8, -9.2, 1.2));
    [red, green, blue].map(|value| (255.0 * value.clamp(0.0, 1.0)).round() as u8)
}
