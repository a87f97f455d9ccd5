//! What the wall is made of: colour, vessels, relief and the class of every place.
//!
//! Detail comes from a [`Tile`] painted once per patient and laid over the wall; large patches come from noise, and
//! lesions lie over both. All of it hangs on coordinates that move with the tissue.

mod tile;

pub use tile::Tile;

use crate::anatomy::{Anatomy, LesionKind};
use crate::random::{Key, noise, turbulence};
use crate::surface::{Coordinates, Hit, Topology};
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Class of a pixel in the label maps, by its value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Label {
    /// Nothing was met.
    Background = 0,
    /// Ordinary mucosa.
    Mucosa = 1,
    /// The crest of a fold.
    Fold = 2,
    /// A polyp.
    Polyp = 3,
    /// An ulcer.
    Ulcer = 4,
    /// Blood on the wall.
    Bleeding = 5,
    /// A reddened patch.
    Patch = 6,
    /// A visible vessel.
    Vessel = 7,
}

impl Label {
    /// All classes by value, with the names written beside the maps.
    pub const NAMES: [&'static str; 8] =
        ["background", "mucosa", "fold", "polyp", "ulcer", "bleeding", "patch", "vessel"];
}

/// How places of the wall are laid out flat, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Chart {
    /// x along a tube and y around it.
    Tube {
        /// Length once around.
        circumference_m: f64,
    },
    /// The position at rest.
    Space,
}

impl Chart {
    /// The chart's coordinates of a place on a tube.
    pub fn of_tube(&self, along_m: f64, around_rad: f64) -> Vector3<f64> {
        match self {
            Self::Tube { circumference_m } => Vector3::new(along_m, circumference_m * around_rad / TAU, 0.0),
            Self::Space => Vector3::new(along_m, 0.0, 0.0),
        }
    }

    /// The chart's coordinates of a place.
    pub fn of(&self, place: &Coordinates) -> Vector3<f64> {
        match self {
            Self::Tube { .. } => self.of_tube(place.along_m, place.around_rad),
            Self::Space => place.rest,
        }
    }

    /// Distance of two places, metres.
    pub fn distance_m(&self, a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
        let mut way = a - b;
        if let Self::Tube { circumference_m } = self {
            way.y -= circumference_m * (way.y / circumference_m).round();
        }
        way.norm()
    }

    /// A point for noise in space that has no seam.
    fn seamless(&self, chart: &Vector3<f64>) -> Vector3<f64> {
        match self {
            Self::Tube { circumference_m } => {
                let around = TAU * chart.y / circumference_m;
                let radius_m = circumference_m / TAU;
                Vector3::new(chart.x, radius_m * around.cos(), radius_m * around.sin())
            }
            Self::Space => *chart,
        }
    }
}

/// Colours and relief of an organ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Linear red, green and blue share of the light thrown back.
    pub base: [f64; 3],
    /// How strongly vessels show.
    pub vessels: f64,
    /// How strongly capillaries show.
    pub capillaries: f64,
    /// Small-scale shape.
    pub relief: Relief,
    /// Roughness of the wet surface (GGX alpha).
    pub roughness: f64,
}

/// Small-scale shape of a mucosa.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Relief {
    /// Smooth with fine crypts, as in the colon.
    Crypts,
    /// Polygonal fields of 2 to 4 mm, as in the stomach (areae gastricae).
    Areae,
    /// Velvet of finger-like villi of half a millimetre, as in the small bowel.
    Villi,
}

impl Look {
    /// Pale pink with clear vessels.
    pub const fn colon() -> Self {
        Self { base: [0.74, 0.29, 0.20], vessels: 1.0, capillaries: 0.6, relief: Relief::Crypts, roughness: 0.075 }
    }

    /// Orange red, vessels hidden.
    pub const fn stomach() -> Self {
        Self { base: [0.72, 0.22, 0.12], vessels: 0.25, capillaries: 0.5, relief: Relief::Areae, roughness: 0.09 }
    }

    /// Yellowish pink velvet.
    pub const fn small_bowel() -> Self {
        Self { base: [0.76, 0.34, 0.17], vessels: 0.4, capillaries: 0.5, relief: Relief::Villi, roughness: 0.11 }
    }
}

/// The wall's material at a hit.
#[derive(Clone, Copy, Debug)]
pub struct Material {
    /// Linear red, green and blue share of the light thrown back.
    pub albedo: [f64; 3],
    /// Slope of the fine relief in space, metres per metre, pointing uphill into the lumen.
    pub slope: Vector3<f64>,
    /// Roughness of the surface (GGX alpha).
    pub roughness: f64,
    /// The class.
    pub label: Label,
}

/// Everything needed to tell the material of a place.
#[derive(Clone, Debug)]
pub struct Mucosa {
    tile: Tile,
    key: Key,
}

impl Mucosa {
    /// Paints the tile of a patient.
    pub fn new(look: &Look, seed: u64) -> Self {
        let key = Key::new(seed).of("mucosa");
        Self { tile: Tile::paint(look.relief, key), key }
    }

    /// The material at a hit; `footprint_m` is the extent of the pixel on the wall.
    pub fn material(&self, anatomy: &Anatomy, hit: &Hit, footprint_m: f64) -> Material {
        let place = anatomy.wall.coordinates(hit.site);
        let chart = anatomy.chart.of(&place);
        let (texel, slope) = self.detail(anatomy, hit, &place, footprint_m);
        let seamless = anatomy.chart.seamless(&chart);
        let look = &anatomy.look;
        let mottle = turbulence(self.key.at(1), &(seamless / 0.011));
        let redness = 0.5 + 0.5 * noise(self.key.at(2), &(seamless / 0.034));
        let (vessel, capillary) = (look.vessels * texel.vessel, look.capillaries * texel.capillary);
        let shade = (1.0 + 0.10 * mottle) * (1.0 - 0.28 * texel.cavity);
        let tint = |channel: usize, absorbed: f64| {
            let painted = look.base[channel] * shade * (1.0 - [0.0, 0.16, 0.14][channel] * redness);
            painted * (1.0 - absorbed * vessel) * (1.0 - 0.6 * absorbed * capillary)
        };
        let own = [tint(0, 0.30), tint(1, 0.62), tint(2, 0.58)];
        let label = match (vessel > 0.45, place.fold > 0.5) {
            (true, _) => Label::Vessel,
            (false, true) => Label::Fold,
            (false, false) => Label::Mucosa,
        };
        let albedo = anatomy.texture.as_ref().and_then(|_| textured(anatomy, hit)).unwrap_or(own);
        let plain = Material { albedo, slope, roughness: look.roughness, label };
        self.diseased(anatomy, plain, &chart, &seamless)
    }

    /// Vessels and relief; the slope is turned into space.
    fn detail(
        &self,
        anatomy: &Anatomy,
        hit: &Hit,
        place: &Coordinates,
        footprint_m: f64,
    ) -> (tile::Texel, Vector3<f64>) {
        let chart = anatomy.chart.of(place);
        match (&anatomy.chart, &anatomy.wall.topology) {
            // The closed ends have no "around": a layout by angle would shrink to a star there.
            (Chart::Tube { circumference_m }, Topology::Patches { columns, .. }) if !self.is_end(anatomy, place) => {
                // A whole number of tiles around the tube, so that there is no seam.
                let tiles = (circumference_m / Tile::EXTENT_M).round().max(1.0);
                let texel = self.tile.at(chart.x / Tile::EXTENT_M, tiles * chart.y / circumference_m, footprint_m);
                let [along, around] = hit.tangents;
                let cell_m = circumference_m / *columns as f64;
                let spread = |tangent: Vector3<f64>| tangent / tangent.norm_squared().max(1e-12);
                // The relief is as steep as painted where the net has its usual spacing.
                let slope = spread(along) * texel.slope[0] * cell_m + spread(around) * texel.slope[1] * cell_m;
                (texel, slope)
            }
            _ => self.three_sided(&place.rest, &hit.shading_normal, footprint_m),
        }
    }

    /// Whether a place of a tube belongs to its closed ends; the border is ragged, so that it does not show.
    fn is_end(&self, anatomy: &Anatomy, place: &Coordinates) -> bool {
        let ragged_m = 0.004 * noise(self.key.at(4), &(place.rest / 0.004));
        let from_end_m = place.along_m.min(anatomy.axis.length_m() - place.along_m) + ragged_m;
        from_end_m < anatomy.cap_m(place.along_m)
    }

    /// The tile laid on from three sides and mixed by the normal: for walls without a layout of their own.
    fn three_sided(&self, rest: &Vector3<f64>, normal: &Vector3<f64>, footprint_m: f64) -> (tile::Texel, Vector3<f64>) {
        let weights = normal.map(|x| x.abs().powi(6));
        let weights = weights / weights.sum();
        let p = rest / Tile::EXTENT_M;
        let sides = [(p.y, p.z, 1, 2), (p.z, p.x, 2, 0), (p.x, p.y, 0, 1)];
        let (mut mixed, mut slope) = (tile::Texel::default(), Vector3::zeros());
        for (i, (u, v, u_axis, v_axis)) in sides.into_iter().enumerate().filter(|(i, _)| weights[*i] > 0.02) {
            let texel = self.tile.at(u, v, footprint_m);
            mixed.vessel += weights[i] * texel.vessel;
            mixed.capillary += weights[i] * texel.capillary;
            mixed.cavity += weights[i] * texel.cavity;
            slope[u_axis] += weights[i] * texel.slope[0];
            slope[v_axis] += weights[i] * texel.slope[1];
        }
        (mixed, slope)
    }

    /// The material with the lesions over it.
    fn diseased(&self, anatomy: &Anatomy, plain: Material, chart: &Vector3<f64>, seamless: &Vector3<f64>) -> Material {
        let mut material = plain;
        for lesion in &anatomy.lesions {
            let share = anatomy.chart.distance_m(chart, &lesion.centre) / lesion.radius_m;
            if share > 1.6 {
                continue;
            }
            let rough = turbulence(self.key.at(3), &(seamless * (2.2 / lesion.radius_m)));
            // How far inside, with a ragged edge.
            let inside = match lesion.kind {
                LesionKind::Polyp => 1.06 - share,
                LesionKind::Ulcer => 1.0 - share + 0.10 * rough,
                LesionKind::Bleeding => 0.85 - share + 0.45 * rough,
                LesionKind::Patch => 1.0 - share + 0.30 * rough,
            };
            let soft = |width: f64| ((inside / width).clamp(0.0, 1.0), 1.0 - (inside / width).clamp(0.0, 1.0));
            let mix = |colour: [f64; 3], (new, old): (f64, f64), from: [f64; 3]| {
                std::array::from_fn(|c| from[c] * old + colour[c] * new)
            };
            let scaled = |by: [f64; 3]| std::array::from_fn(|c| plain.albedo[c] * by[c]);
            let albedo = material.albedo;
            material.albedo = match lesion.kind {
                LesionKind::Polyp => mix(scaled([0.93 + 0.1 * rough, 0.66, 0.66]), soft(0.25), albedo),
                LesionKind::Ulcer if inside > 0.22 => mix([0.58, 0.44, 0.24], soft(0.55), scaled([0.85, 0.42, 0.40])),
                LesionKind::Ulcer => mix(scaled([0.85, 0.42, 0.40]), soft(0.12), albedo),
                LesionKind::Bleeding => mix([0.33, 0.018, 0.016], soft(0.10), albedo),
                LesionKind::Patch => mix(scaled([0.97, 0.58, 0.60]), soft(0.6), albedo),
            };
            if inside > 0.0 {
                material.label = lesion.label();
                // Blood is a film without relief.
                let flat = if lesion.kind == LesionKind::Bleeding { 0.3 } else { 1.0 };
                material.slope = plain.slope * flat;
            }
        }
        material
    }
}

/// Linear colour of the imported picture at a hit.
fn textured(anatomy: &Anatomy, hit: &Hit) -> Option<[f64; 3]> {
    let Topology::Triangles { texture_coordinates: Some(coordinates), .. } = &anatomy.wall.topology else {
        return None;
    };
    let picture = anatomy.texture.as_ref()?;
    let [p, q, r] = coordinates.get(hit.site.cell as usize)?;
    let mix = |i: usize| f64::from(p[i]) + hit.site.a * f64::from(q[i] - p[i]) + hit.site.b * f64::from(r[i] - p[i]);
    // Texture rows count from the bottom; the picture repeats.
    let (u, v) = (mix(0).rem_euclid(1.0), 1.0 - mix(1).rem_euclid(1.0));
    let size = picture.size();
    let at = |share: f64, extent: usize| ((share * extent as f64) as usize).min(extent - 1);
    let colour = picture.get(at(u, size.width), at(v, size.height))?;
    Some(colour.map(|value| (f64::from(value) / 255.0).powf(2.2)))
}
