//! From a moment of the organ and a pose of the camera to light and truth in every pixel.
//!
//! One ray per pixel through its centre. What it meets gives depth, class and, with the wall and the pose of the next
//! frame, the surface flow; the lamps give the light. Pixels are independent, so threads share them freely.

use crate::anatomy::Anatomy;
use crate::light::{Lamps, Lit};
use crate::mucosa::{Label, Mucosa};
use crate::surface::Posed;
use crate::{Effect, Effects};
use endoscape_core::{Camera, Pose, Size};
use nalgebra::{Point2, Point3, Vector3};
use rayon::prelude::*;

/// Directions farther than this off the axis are not imaged: the edge of the window, and where depth along the axis
/// loses its meaning.
const FIELD_STOP_RAD: f64 = 84.0 / 180.0 * std::f64::consts::PI;
/// No view in an organ is longer, metres.
const FARTHEST_M: f64 = 2.0;

/// A camera with the direction of every pixel worked out once.
#[derive(Clone, Debug)]
pub struct Optics {
    camera: Camera,
    rays: Vec<Option<Vector3<f64>>>,
    /// Angle a pixel covers, radians.
    pixel_rad: f64,
}

impl Optics {
    /// Works out the directions.
    pub fn new(camera: Camera) -> Self {
        let size = camera.size();
        let ray = |at: usize| {
            let pixel = Point2::new((at % size.width) as f64, (at / size.width) as f64);
            camera.unproject(&pixel).filter(|ray| ray.z > FIELD_STOP_RAD.cos())
        };
        let rays: Vec<Option<Vector3<f64>>> = (0..size.area()).into_par_iter().map(ray).collect();
        let middle = size.area() / 2 + size.width / 2;
        let pair = (rays.get(middle).copied().flatten(), rays.get(middle.saturating_sub(1)).copied().flatten());
        let pixel_rad = match pair {
            (Some(a), Some(b)) => a.angle(&b),
            _ => 1.0 / size.width as f64,
        };
        Self { camera, rays, pixel_rad }
    }

    /// The camera.
    pub const fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Size of the picture.
    pub const fn size(&self) -> Size {
        self.camera.size()
    }

    /// Angle that a pixel in the middle covers, radians.
    pub const fn pixel_rad(&self) -> f64 {
        self.pixel_rad
    }

    /// Unit direction of a pixel in the camera's frame, `None` outside the field of view.
    pub fn ray(&self, at: usize) -> Option<Vector3<f64>> {
        self.rays[at]
    }
}

/// What does not change from frame to frame.
#[derive(Clone, Copy, Debug)]
pub struct Scene<'a> {
    /// The organ.
    pub anatomy: &'a Anatomy,
    /// Its surface.
    pub mucosa: &'a Mucosa,
    /// The camera.
    pub optics: &'a Optics,
    /// The lamps around it.
    pub lamps: &'a Lamps,
    /// What is switched on.
    pub effects: Effects,
}

/// A moment: the wall, and where the camera was while each row was read.
pub struct Moment<'a> {
    /// The wall.
    pub wall: &'a Posed<'a>,
    /// Pose of the camera for every row, `world_from_camera`; all alike with a global shutter.
    pub world_from_camera: Vec<Pose>,
}

/// What one pixel sees. Outside the field of view and beyond holes everything is zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// Depth along the optical axis, metres; 0 where nothing was met.
    pub depth_m: f64,
    /// Distance along the ray, metres; 0 where nothing was met.
    pub distance_m: f64,
    /// Diffuse light, linear red, green and blue.
    pub diffuse: [f64; 3],
    /// Highlights, linear, white.
    pub specular: f64,
    /// Class of the surface, the value of a [`Label`].
    pub label: u8,
    /// Displacement in pixels of this place of the wall until the next frame; `None` if it leaves the lens's domain.
    pub flow: Option<[f64; 2]>,
}

impl Scene<'_> {
    /// All pixels of a frame, row after row.
    ///
    /// `next` is the moment of the following frame, whose middle row's pose the flow leads to.
    pub fn render(&self, now: &Moment<'_>, next: &Moment<'_>) -> Vec<Sample> {
        let size = self.optics.size();
        let next_camera = next.world_from_camera[size.height / 2].inverse();
        let rows = (0..size.height).into_par_iter();
        let row = |y: usize| {
            (0..size.width).map(move |x| (x, y)).map(|(x, y)| self.sample(x, y, now, next, &next_camera)).collect()
        };
        let rows: Vec<Vec<Sample>> = rows.map(row).collect();
        rows.concat()
    }

    fn sample(&self, x: usize, y: usize, now: &Moment<'_>, next: &Moment<'_>, next_camera_from_world: &Pose) -> Sample {
        let Some(ray) = self.optics.rays[y * self.optics.size().width + x] else { return Sample::default() };
        let world_from_camera = &now.world_from_camera[y];
        let origin = world_from_camera.translation.vector;
        let Some(hit) = now.wall.cast(&origin, &(world_from_camera.rotation * ray), FARTHEST_M) else {
            return Sample::default();
        };
        let point = ray * hit.distance_m;
        let into_camera = world_from_camera.rotation.inverse();
        let normal = into_camera * hit.shading_normal;
        // A slanted wall fills the pixel with more of itself; beyond a factor of a few, detail is gone anyway.
        let slant = (-normal.dot(&ray)).max(0.25);
        let footprint_m = hit.distance_m * self.optics.pixel_rad / slant.sqrt();
        let material = self.mucosa.material(self.anatomy, &hit, footprint_m);
        let place = Lit { point, normal, slope: into_camera * material.slope };
        let world = origin + world_from_camera.rotation * point;
        let visible = |lamp: &crate::light::Lamp| {
            !self.effects.has(Effect::Shadow) || {
                let lamp = origin + world_from_camera.rotation * lamp.position;
                // Just above the wall, so that it does not hide from itself.
                !now.wall.blocked(&lamp, &(world + (lamp - world) * 2e-3 + hit.normal * 5e-5))
            }
        };
        let light = self.lamps.shine(&place, &material, self.effects, visible);
        let later = next_camera_from_world * Point3::from(next.wall.point(hit.site));
        let flow = self.optics.camera.project(&later).map(|pixel| [pixel.x - x as f64, pixel.y - y as f64]);
        Sample {
            depth_m: point.z,
            distance_m: hit.distance_m,
            diffuse: light.diffuse,
            specular: light.specular,
            label: material.label as u8,
            flow,
        }
    }
}

impl Sample {
    /// Whether the ray met the wall.
    pub fn is_wall(&self) -> bool {
        self.label != Label::Background as u8
    }
}
