//! Renders the small sequence in `fixtures/tube`: a camera flies through a bent, folded tube, with exact depth and
//! poses. Everything in it is computed here, so the repository has real frames to test on without anybody's data.
//!
//! `cargo run --release -p endoscape-frames --example render_tube -- fixtures/tube`

use endoscape_core::camera::{Intrinsics, KannalaBrandt};
use endoscape_core::{Camera, DepthMap, Grid, Image, Pose, Size};
use endoscape_frames::sequence_folder::{Header, Writer, WrittenFrame};
use nalgebra::{Point2, Point3, Rotation3, UnitQuaternion, Vector3};

/// Radius of the circle the tube is bent along, metres.
const BEND_M: f64 = 0.06;
/// Radius of the tube, metres.
const TUBE_M: f64 = 0.015;
/// Frames rendered.
const FRAMES: usize = 12;
/// Path per frame, radians of the bend (about 1 mm).
const STEP_RAD: f64 = 0.017;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let out = std::env::args().nth(1).ok_or("usage: render_tube FOLDER")?;
    let camera = lens()?;
    let mut writer = Writer::create(
        out.as_ref(),
        Header {
            name: "tube".into(),
            fps: Some(10.0),
            camera: Some(camera),
            license: Some("MIT OR Apache-2.0".into()),
            provenance: Some("rendered by crates/frames/examples/render_tube.rs".into()),
            depth_metres_per_unit: None,
        },
    )?;
    for number in 0..FRAMES {
        let world_from_camera = pose(number as f64);
        let (image, depth) = render(&camera, &world_from_camera);
        writer.write_frame(&WrittenFrame {
            number,
            time_s: number as f64 / 10.0,
            image: &image,
            depth: Some(&depth),
            mask: None,
            world_from_camera: Some(world_from_camera),
        })?;
    }
    writer.finish()?;
    Ok(())
}

/// A capsule-like fisheye of about 120 degrees.
fn lens() -> Result<Camera, endoscape_core::CameraError> {
    let intrinsics = Intrinsics { fx: 76.0, fy: 75.0, cx: 80.5, cy: 62.5, skew: 0.0 };
    Camera::new(Size::new(160, 128), KannalaBrandt { intrinsics, k1: -0.03, k2: 0.002, k3: 0.0, k4: 0.0 }.into())
}

/// Along the centre line, wobbling and rolling a little so that no convention hides behind a symmetry.
fn pose(frame: f64) -> Pose {
    let along = STEP_RAD * frame;
    let forward = Vector3::new(-along.sin(), 0.0, along.cos());
    let outward = Vector3::new(along.cos(), 0.0, along.sin());
    let wobble = 0.003 * (0.5 * frame).sin() * outward + Vector3::new(0.0, 0.002 * (0.4 * frame).cos(), 0.0);
    let axes = Rotation3::from_basis_unchecked(&[outward, Vector3::y(), forward]);
    let axes = UnitQuaternion::from_rotation_matrix(&axes);
    let turn = UnitQuaternion::from_euler_angles(0.05 * (0.3 * frame).sin(), 0.08 * (0.2 * frame).cos(), 0.03 * frame);
    Pose::from_parts((BEND_M * outward + wobble).into(), axes * turn)
}

/// Signed distance to the wall, positive inside; folds run around the tube like haustra.
fn inside(p: &Point3<f64>) -> f64 {
    let from_axis = p.x.hypot(p.z) - BEND_M;
    let (along, around) = (p.z.atan2(p.x), p.y.atan2(from_axis));
    let folds = 0.10 * (28.0 * along + 0.8 * (3.0 * around).sin()).sin().powi(3);
    TUBE_M * (1.0 - folds + 0.05 * (2.0 * around + 9.0 * along).sin()) - from_axis.hypot(p.y)
}

/// Distance along a ray to the wall: small safe steps, then bisection to rounding.
fn hit(origin: &Point3<f64>, ray: &Vector3<f64>) -> f64 {
    let mut near = 0.0;
    let mut far = 0.0;
    while inside(&(origin + ray * far)) > 0.0 && far < 0.2 {
        near = far;
        far += (0.3 * inside(&(origin + ray * far))).max(5e-5);
    }
    for _ in 0..50 {
        let middle = 0.5 * (near + far);
        if inside(&(origin + ray * middle)) > 0.0 { near = middle } else { far = middle }
    }
    near
}

fn render(camera: &Camera, world_from_camera: &Pose) -> (Image, DepthMap) {
    let size = camera.size();
    let mut pixels = Vec::with_capacity(3 * size.area());
    let mut depths = Vec::with_capacity(size.area());
    for (x, y) in (0..size.height).flat_map(|y| (0..size.width).map(move |x| (x, y))) {
        let Some(ray) = camera.unproject(&Point2::new(x as f64, y as f64)) else {
            pixels.extend([0; 3]);
            depths.push(0.0);
            continue;
        };
        let origin = Point3::from(world_from_camera.translation.vector);
        let along = hit(&origin, &(world_from_camera.rotation * ray));
        let point = origin + world_from_camera.rotation * ray * along;
        pixels.extend(shade(&point, &origin));
        depths.push((along * ray.z) as f32);
    }
    let image = Image::new(size, pixels).unwrap_or_else(|_| Image::from_fn(size, |_, _| [0; 3]));
    let depth = Grid::new(size, depths).unwrap_or_else(|_| Grid::filled(size, 0.0));
    (image, DepthMap::new(depth))
}

/// Mucosa with vessels under a light at the lens: albedo times cosine over distance squared, then gamma.
fn shade(point: &Point3<f64>, light: &Point3<f64>) -> [u8; 3] {
    let h = 1e-6;
    let slope = |axis: Vector3<f64>| inside(&(point + axis * h)) - inside(&(point - axis * h));
    let normal = Vector3::new(slope(Vector3::x()), slope(Vector3::y()), slope(Vector3::z())).normalize();
    let to_light = light - point;
    let radiance = 1.6e-4 * normal.dot(&to_light.normalize()).max(0.0) / to_light.norm_squared();
    let [r, g, b] = albedo(&(point.coords * 1e3));
    [r, g, b].map(|albedo| (255.0 * (albedo * radiance).min(1.0).powf(1.0 / 2.2)).round() as u8)
}

/// Colour of the wall at a place in millimetres: mottled pink with darker, winding vessels.
fn albedo(p: &Vector3<f64>) -> [f64; 3] {
    let wave = |a: f64, b: f64, c: f64, phase: f64| (a * p.x + b * p.y + c * p.z + phase).sin();
    let mottle = 0.5 + 0.12 * (wave(1.1, 0.7, -0.4, 0.0) + wave(-0.6, 1.3, 0.9, 1.0) + wave(2.3, -1.9, 2.1, 2.0));
    let course = wave(0.5, 0.3, 0.6, 0.4) + 0.6 * wave(0.9, -0.8, 0.5, 1.7) + 0.3 * wave(-1.7, 1.2, 1.5, 0.2);
    let vessel = (-(course / 0.08).powi(2)).exp();
    [0.95 * mottle * (1.0 - 0.35 * vessel), 0.55 * mottle * (1.0 - 0.7 * vessel), 0.45 * mottle * (1.0 - 0.6 * vessel)]
}
