//! What floats between the wall and the lens: pooled fluid, bubbles, debris.
//!
//! Particles hang in the lumen in a loose lattice of cells, each with its own place and size from the hash of its
//! cell, so any part of the lumen can be filled without a list of all of them. Fluid fills the organ up to a level
//! below the camera; its surface is a plane square to gravity.

use crate::random::{Key, noise};
use crate::render::{Moment, Sample, Scene};
use crate::sensor::Veil;
use crate::{Effect, Effects};
use nalgebra::Vector3;
use rayon::prelude::*;

/// Edge of a cell of the lattice, metres; on average every third cell holds a particle.
const CELL_M: f64 = 0.008;
/// Cells looked at around the camera in each direction.
const REACH: i64 = 3;
/// The patient lies on the back: gravity points along the world's z.
const DOWN: Vector3<f64> = Vector3::new(0.0, 0.0, 1.0);
/// Height of the camera above the fluid as a share of the distance from which the wall is usually seen.
const LEVEL: f64 = 0.45;
/// Depth of fluid at which a third of the light is left on its way down and up, metres.
const MURKY_M: f64 = 0.008;
/// Reflectance of water seen from straight above (Fresnel, index 1.33).
const WATER: f64 = 0.02;
/// What deep fluid gives back: bile with mucus, yellow-brown.
const BILE: [f64; 3] = [0.09, 0.056, 0.02];
/// What the still surface mirrors: mucosa lit from farther away.
const MIRRORED: [f64; 3] = [0.09, 0.045, 0.035];

/// Everything in the lumen that is not wall.
#[derive(Clone, Debug)]
pub struct Medium {
    effects: Effects,
    key: Key,
}

/// A ball in the camera's frame.
#[derive(Clone, Copy, Debug)]
struct Ball {
    centre: Vector3<f64>,
    radius_m: f64,
    /// Clear with a bright rim, or opaque.
    is_bubble: bool,
    key: Key,
}

impl Medium {
    /// What the effects ask for.
    pub fn new(effects: Effects, seed: u64) -> Self {
        Self { effects, key: Key::new(seed).of("medium") }
    }

    /// What veils the wall in a frame; `None` if nothing can.
    pub fn veil(&self, scene: &Scene<'_>, now: &Moment<'_>, samples: &[Sample], time_s: f64) -> Option<Veil> {
        let wanted = [Effect::Fluid, Effect::Bubbles, Effect::Debris];
        if !wanted.iter().any(|effect| self.effects.has(*effect)) {
            return None;
        }
        let world_from_camera = now.world_from_camera[now.world_from_camera.len() / 2];
        let balls = self.balls(&world_from_camera, time_s);
        let down = world_from_camera.rotation.inverse() * DOWN;
        let level_m = self.effects.has(Effect::Fluid).then(|| LEVEL * scene.anatomy.usual_distance_m());
        let pixel = |(at, sample): (usize, &Sample)| -> (f32, [f32; 3]) {
            let Some(ray) = scene.optics.ray(at).filter(|_| sample.is_wall()) else { return (0.0, [0.0; 3]) };
            let mut veil = level_m.map_or((0.0, [0.0; 3]), |level_m| self.fluid(&ray, &down, level_m, sample, time_s));
            for ball in &balls {
                veil = ball.over(veil, &ray, sample);
            }
            veil
        };
        let (cover, light) = samples.par_iter().enumerate().map(pixel).unzip();
        Some(Veil { cover, light })
    }

    /// The particles around the camera, farthest first.
    fn balls(&self, world_from_camera: &endoscape_core::Pose, time_s: f64) -> Vec<Ball> {
        let here = world_from_camera.translation.vector / CELL_M;
        let cell = here.map(|x| x.floor() as i64);
        let range = || -REACH..=REACH;
        let cells = range().flat_map(|x| range().flat_map(move |y| range().map(move |z| [x, y, z])));
        let mut balls: Vec<Ball> = cells
            .filter_map(|[x, y, z]| {
                let word = |axis: i64, offset: i64| (axis + offset) as u64;
                let key = self.key.at(word(cell.x, x)).at(word(cell.y, y)).at(word(cell.z, z));
                let corner = Vector3::new((cell.x + x) as f64, (cell.y + y) as f64, (cell.z + z) as f64);
                self.ball(key, &corner, time_s)
            })
            .map(|ball| Ball {
                centre: (world_from_camera.inverse() * nalgebra::Point3::from(ball.centre)).coords,
                ..ball
            })
            // Nothing sits inside the window.
            .filter(|ball| ball.centre.norm() > ball.radius_m + 0.003)
            .collect();
        balls.sort_by(|a, b| b.centre.norm().total_cmp(&a.centre.norm()));
        balls
    }

    fn ball(&self, key: Key, corner: &Vector3<f64>, time_s: f64) -> Option<Ball> {
        let mut series = key.series();
        let is_bubble = series.range(0.0, 1.0) < 0.5;
        let effect = if is_bubble { Effect::Bubbles } else { Effect::Debris };
        if series.range(0.0, 1.0) > 0.35 || !self.effects.has(effect) {
            return None;
        }
        let mut part = || series.range(0.2, 0.8);
        let within = Vector3::new(part(), part(), part());
        let (slow, phase) = (series.range(0.2, 0.6), series.range(0.0, 6.0));
        let drift =
            Vector3::new((slow * time_s + phase).sin(), (0.8 * slow * time_s).cos(), (0.6 * slow * time_s).sin());
        let radius_m = if is_bubble { series.range(0.0005, 0.0016) } else { series.range(0.0003, 0.0011) };
        Some(Ball { centre: (corner + within + drift * 0.15) * CELL_M, radius_m, is_bubble, key })
    }

    /// The surface of the fluid seen along a ray, and the murk below it.
    fn fluid(
        &self,
        ray: &Vector3<f64>,
        down: &Vector3<f64>,
        level_m: f64,
        sample: &Sample,
        time_s: f64,
    ) -> (f32, [f32; 3]) {
        let descent = ray.dot(down);
        if descent <= 1e-3 || level_m / descent >= sample.distance_m {
            return (0.0, [0.0; 3]);
        }
        let surface_m = level_m / descent;
        let below_m = sample.distance_m - surface_m;
        let cover = 1.0 - (-below_m / MURKY_M).exp();
        let nearness = 1.0 / (surface_m * surface_m).max(1e-8);
        let ripple = noise(self.key.at(9), &(ray * surface_m / 0.004 + Vector3::repeat(0.7 * time_s)));
        // Scattered light comes from all depths, so the surface darkens little towards grazing angles; there it mirrors.
        let scattered = cover * descent.sqrt() * (1.0 + 0.08 * ripple);
        let mirrors = WATER + (1.0 - WATER) * (1.0 - descent).powi(5) * (0.7 + 0.3 * ripple).max(0.0);
        let lamps = (-descent.acos().powi(2) / 0.004 * (1.0 + 0.5 * ripple)).exp();
        let channel = |c: usize| nearness * (BILE[c] * scattered + MIRRORED[c] * mirrors + 0.5 * lamps);
        let colour = [channel(0) as f32, channel(1) as f32, channel(2) as f32];
        (cover as f32, colour)
    }
}

impl Ball {
    /// The veil of a pixel with this ball in front of it.
    fn over(&self, (cover, light): (f32, [f32; 3]), ray: &Vector3<f64>, sample: &Sample) -> (f32, [f32; 3]) {
        let along = self.centre.dot(ray);
        let aside = (self.centre.norm_squared() - along * along).max(0.0).sqrt() / self.radius_m;
        if along <= 0.0 || aside >= 1.3 || along - self.radius_m > sample.distance_m {
            return (cover, light);
        }
        let nearness = 1.0 / (along * along);
        let (hides, glow) =
            if self.is_bubble { self.bubble(aside, ray, nearness) } else { self.crumb(aside, ray, along, nearness) };
        let kept = (1.0 - hides) as f32;
        let light = std::array::from_fn(|c| light[c] * kept + glow[c] as f32);
        (1.0 - (1.0 - cover) * kept, light)
    }

    /// A thin shell: clear in the middle, dark then bright at the rim, with the mirror image of the lamps on top.
    fn bubble(&self, aside: f64, ray: &Vector3<f64>, nearness: f64) -> (f64, [f64; 3]) {
        if aside >= 1.0 {
            return (0.0, [0.0; 3]);
        }
        let rim = aside.powi(8);
        let towards = (ray - self.centre / self.centre.norm()) / (self.radius_m / self.centre.norm());
        let spark = |x: f64, y: f64| (-((towards.x - x).powi(2) + (towards.y - y).powi(2)) / 0.012).exp();
        let glint = 1.5 * (spark(-0.25, -0.25) + 0.6 * spark(0.3, 0.28));
        ((0.16 + 0.55 * rim + glint).min(1.0), [0.42, 0.38, 0.34].map(|c| nearness * (c * rim * 0.25 + 0.25 * glint)))
    }

    /// An opaque crumb with a ragged outline.
    fn crumb(&self, aside: f64, ray: &Vector3<f64>, along: f64, nearness: f64) -> (f64, [f64; 3]) {
        let ragged = 1.0 + 0.35 * noise(self.key, &(ray * (along / (0.6 * self.radius_m))));
        let inside = ((ragged - aside) / 0.15).clamp(0.0, 1.0);
        let round = (1.0 - (aside / 1.35).powi(2)).max(0.0).sqrt();
        let colour = if self.key.at(3).uniform() < 0.5 { [0.42, 0.27, 0.07] } else { [0.55, 0.47, 0.30] };
        (inside, colour.map(|c| c * round * nearness * inside * 0.4))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn particles_are_where_the_effects_say() {
        let pose = endoscape_core::Pose::identity();
        let count = |effects: Effects, bubbles: bool| {
            let balls = Medium::new(effects, 3).balls(&pose, 1.0);
            balls.iter().filter(|ball| ball.is_bubble == bubbles).count()
        };
        let bubbles = Effects::none().with(Effect::Bubbles);
        assert!(count(bubbles, true) > 10 && count(bubbles, false) == 0);
        assert_eq!(count(Effects::none(), true), 0);
    }

    #[test]
    fn an_opaque_crumb_hides_what_is_behind_and_only_that() {
        let centre = Vector3::new(0.0, 0.0, 0.01);
        let ball = Ball { centre, radius_m: 0.001, is_bubble: false, key: Key::new(1) };
        let wall = |distance_m: f64| Sample { distance_m, label: 1, ..Sample::default() };
        let cover =
            |ray: Vector3<f64>, distance_m: f64| ball.over((0.0, [0.0; 3]), &ray.normalize(), &wall(distance_m)).0;
        assert_eq!(cover(Vector3::z(), 0.03), 1.0);
        assert_eq!(cover(Vector3::z(), 0.005), 0.0);
        assert_eq!(cover(Vector3::new(0.2, 0.0, 1.0), 0.03), 0.0);
    }
}
