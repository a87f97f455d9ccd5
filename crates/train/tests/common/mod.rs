//! A made-up scene with exact truth: a painted room seen towards one of its corners along a known path.
//!
//! Chosen so that what a training cannot explain is its own fault: the walls shine by themselves, so brightness
//! constancy holds exactly; the room is convex, so nothing hides anything; the lens is wide and every pixel moves by
//! several times what the turning does, so shifting and turning do not look alike; and the paint has waves long enough
//! to be found from far and short enough to be precise. Lengths are in metres, the room is about 3 wide.

use endoscape_core::{Camera, DepthMap, Grid, Image, Pose, Size};
use endoscape_train::clip::{Clip, ClipFrame};
use nalgebra::{Point2, Point3, Translation3, UnitQuaternion, Vector3};

pub const SIZE: Size = Size::new(64, 48);

/// Half the extent of the room along each axis; its centre is the origin.
const HALF: [f64; 3] = [1.5, 1.2, 1.8];

/// Frames of a camera that moves about in the room, always looking at the same corner.
pub fn room_clip(frames: usize) -> Clip {
    let camera = Camera::from_field_of_view(SIZE, 100_f64.to_radians()).unwrap();
    let frame = |position| {
        let world_from_camera = pose(position as f64);
        let (image, depth) = render(&camera, &world_from_camera);
        ClipFrame {
            position,
            image,
            usable: Grid::filled(SIZE, true),
            world_from_camera: Some(world_from_camera),
            depth: Some(depth),
            label: None,
        }
    };
    Clip { name: "room".into(), frames: (0..frames).map(frame).collect(), camera, fingerprint: "made".into() }
}

/// `world_from_camera` at a time: from frame to frame some 0.3 m and 6 degrees.
fn pose(time: f64) -> Pose {
    let wave = |amplitude: f64, speed: f64, phase: f64| amplitude * (speed * time + phase).sin();
    let at = Translation3::new(wave(0.35, 0.8, 0.0), wave(0.3, 0.7, 2.57), wave(0.3, 0.5, 0.0));
    let turn = UnitQuaternion::from_euler_angles(wave(0.09, 0.8, 0.0), wave(0.09, 1.1, 1.57), wave(0.15, 0.6, 0.0));
    let to_the_corner = UnitQuaternion::from_euler_angles(0.3, 0.6, 0.0);
    Pose::from_parts(at, to_the_corner * turn)
}

/// Pictures and depth along the optical axis, sampled at pixel centres.
fn render(camera: &Camera, world_from_camera: &Pose) -> (Image, DepthMap) {
    let origin = world_from_camera.translation.vector;
    let hit = |x: usize, y: usize| {
        let ray = camera.unproject(&Point2::new(x as f64, y as f64)).unwrap();
        let direction = world_from_camera.rotation * ray;
        let to_wall = |axis: usize| (HALF[axis].copysign(direction[axis]) - origin[axis]) / direction[axis];
        let length = (0..3).map(to_wall).fold(f64::INFINITY, f64::min);
        (Point3::from(origin + direction * length), length * ray.z)
    };
    let image = Image::from_fn(SIZE, |x, y| paint(&hit(x, y).0));
    (image, DepthMap::new(Grid::from_fn(SIZE, |x, y| hit(x, y).1 as f32)))
}

/// Smooth colours without repetition: three octaves of three waves per channel, in directions that a golden spiral
/// spreads over the sphere.
fn paint(p: &Point3<f64>) -> [u8; 3] {
    std::array::from_fn(|channel| {
        let wave = |(octave, wave): (i32, usize)| {
            let number = (9 * channel + 3 * octave as usize + wave) as f64;
            let (z, turn) = (2.0 * (0.618 * number + 0.3).fract() - 1.0, 4.08 * number);
            let around = (1.0 - z * z).sqrt();
            let direction = Vector3::new(around * turn.cos(), around * turn.sin(), z);
            let frequency = 4.0 * 2_f64.powi(octave) * (1.0 + 0.23 * wave as f64);
            0.12 * 0.62_f64.powi(octave) * (frequency * direction.dot(&p.coords) + 5.0 * number).sin()
        };
        let waves = (0..3).flat_map(|octave| (0..3).map(move |wave| (octave, wave)));
        let value = 0.5 + waves.map(wave).sum::<f64>();
        (255.0 * value.clamp(0.0, 1.0)).round() as u8
    })
}
