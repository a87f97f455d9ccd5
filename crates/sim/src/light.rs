//! Lamps beside the lens, and what the wet wall makes of their light.
//!
//! A lamp is a point: irradiance falls with the square of the distance and with the cosine to the wall. Diffuse
//! reflection is Lambert's, `albedo / pi`. The wet surface adds a microfacet highlight (B. Walter et al., "Microfacet
//! models for refraction through rough surfaces", EGSR 2007) with the reflectance of water.

use crate::mucosa::Material;
use crate::{Effect, Effects};
use nalgebra::Vector3;
use std::f64::consts::{PI, TAU};

/// Reflectance of a film of water at normal incidence, ((n - 1) / (n + 1))^2 with n = 1.38.
const WET: f64 = 0.025;

/// One lamp in the camera's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lamp {
    /// Position, metres.
    pub position: Vector3<f64>,
    /// Unit direction of its axis.
    pub axis: Vector3<f64>,
    /// Radiant intensity along the axis, in units in which a white wall square to one lamp of intensity pi at 1 m has
    /// radiance 1.
    pub intensity: f64,
    /// Fall-off away from the axis: intensity times cosine to this power; 1 is a bare diode, 0 shines evenly.
    pub spot: f64,
}

/// The lamps around a lens.
#[derive(Clone, Debug, PartialEq)]
pub struct Lamps(pub Vec<Lamp>);

impl Lamps {
    /// `count` lamps on a ring around the lens, in its plane, looking ahead.
    pub fn ring(count: usize, radius_m: f64, spot: f64) -> Self {
        let lamp = |i: usize| {
            let angle = TAU * (i as f64 + 0.5) / count as f64;
            Lamp {
                position: Vector3::new(radius_m * angle.cos(), radius_m * angle.sin(), 0.0),
                axis: Vector3::z(),
                intensity: PI / count as f64,
                spot,
            }
        };
        Self((0..count).map(lamp).collect())
    }

    /// One lamp at the lens itself that shines evenly: the light model of textbooks.
    pub fn at_lens() -> Self {
        Self(vec![Lamp { position: Vector3::zeros(), axis: Vector3::z(), intensity: PI, spot: 0.0 }])
    }
}

/// Light from a place towards the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Radiance {
    /// Diffuse red, green and blue.
    pub diffuse: [f64; 3],
    /// Highlight, white.
    pub specular: f64,
}

/// A place as the lamps see it, in the camera's frame.
#[derive(Clone, Copy, Debug)]
pub struct Lit {
    /// The place, metres.
    pub point: Vector3<f64>,
    /// Unit normal towards the camera's side.
    pub normal: Vector3<f64>,
    /// Slope of the fine relief, in the camera's frame.
    pub slope: Vector3<f64>,
}

impl Lamps {
    /// Radiance of a place towards the camera, under lamps for which `visible` says yes.
    pub fn shine(
        &self,
        place: &Lit,
        material: &Material,
        effects: Effects,
        visible: impl Fn(&Lamp) -> bool,
    ) -> Radiance {
        let rough_normal = (place.normal - (place.slope - place.normal * place.slope.dot(&place.normal))).normalize();
        // Skin scatters the fine relief away in the diffuse light, more so in red.
        let soft = effects.has(Effect::Subsurface);
        let diffuse_normal = if soft { (place.normal + rough_normal).normalize() } else { place.normal };
        let to_camera = -place.point.normalize();
        let mut radiance = Radiance::default();
        for lamp in &self.0 {
            let way = lamp.position - place.point;
            let distance = way.norm();
            let to_lamp = way / distance;
            let off_axis = -to_lamp.dot(&lamp.axis);
            if off_axis <= 0.0 || !visible(lamp) {
                continue;
            }
            let spot = match lamp.spot {
                0.0 => 1.0,
                // Bare diodes are the usual lamps, and a power is slow.
                1.0 => off_axis,
                spot => off_axis.powf(spot),
            };
            let irradiance = lamp.intensity * spot / (distance * distance);
            let cosine = diffuse_normal.dot(&to_lamp);
            for (channel, wrap) in [0.22, 0.10, 0.07].into_iter().enumerate() {
                let wrap = if soft { wrap } else { 0.0 };
                // Wrapped shading keeps the energy: the factor is 1 for light from straight above.
                let lit = ((cosine + wrap) / (1.0 + wrap)).max(0.0);
                radiance.diffuse[channel] += irradiance * lit * material.albedo[channel] / PI;
            }
            if effects.has(Effect::Specular) {
                radiance.specular += irradiance * highlight(&rough_normal, &to_lamp, &to_camera, material.roughness);
            }
        }
        radiance
    }
}

/// Reflectance of the wet surface times the cosine to the lamp: GGX distribution, Smith's joint shadowing, Schlick's
/// Fresnel term (equations 33 and 34 of the paper; C. Schlick, 1994).
fn highlight(normal: &Vector3<f64>, to_lamp: &Vector3<f64>, to_camera: &Vector3<f64>, alpha: f64) -> f64 {
    let (n_l, n_v) = (normal.dot(to_lamp), normal.dot(to_camera));
    if n_l <= 0.0 || n_v <= 0.0 {
        return 0.0;
    }
    let half = (to_lamp + to_camera).normalize();
    let (n_h, v_h) = (normal.dot(&half), to_camera.dot(&half).max(0.0));
    let a2 = alpha * alpha;
    let spread = n_h * n_h * (a2 - 1.0) + 1.0;
    let distribution = a2 / (PI * spread * spread);
    let smith = |cosine: f64| (a2 + (1.0 - a2) * cosine * cosine).sqrt();
    let visibility = 0.5 / (n_l * smith(n_v) + n_v * smith(n_l));
    let fresnel = WET + (1.0 - WET) * (1.0 - v_h).powi(5);
    distribution * visibility * fresnel * n_l
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mucosa::Label;

    fn material() -> Material {
        Material { albedo: [0.8, 0.4, 0.3], slope: Vector3::zeros(), roughness: 0.2, label: Label::Mucosa }
    }

    fn place(x: f64, z: f64) -> Lit {
        Lit { point: Vector3::new(x, 0.0, z), normal: -Vector3::z(), slope: Vector3::zeros() }
    }

    #[test]
    fn light_falls_with_cosine_and_square_of_distance() {
        let shine = |x: f64, z: f64| Lamps::at_lens().shine(&place(x, z), &material(), Effects::none(), |_| true);
        assert!((shine(0.0, 1.0).diffuse[0] - 0.8).abs() < 1e-12);
        assert!((shine(0.0, 0.5).diffuse[1] - 4.0 * 0.4).abs() < 1e-12);
        let (x, z) = (0.7_f64, 0.4_f64);
        let squared = x * x + z * z;
        assert!((shine(x, z).diffuse[2] - 0.3 * z / squared.sqrt() / squared).abs() < 1e-12);
    }

    #[test]
    fn highlights_lie_where_the_mirror_image_of_the_lamp_is() {
        let lamps = Lamps(vec![Lamp { position: Vector3::new(0.004, 0.0, 0.0), ..Lamps::at_lens().0[0] }]);
        let effects = Effects::none().with(Effect::Specular);
        let glare = |x: f64| lamps.shine(&place(x, 0.02), &material(), effects, |_| true).specular;
        // Half-way between lens and lamp, seen in a flat mirror.
        let best = (0..100).map(|i| 0.0001 * f64::from(i)).max_by(|a, b| glare(*a).total_cmp(&glare(*b))).unwrap();
        assert!((best - 0.002).abs() < 2e-4, "{best}");
    }
}
