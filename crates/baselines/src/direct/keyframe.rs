//! A picture whose points later pictures are aligned to, and how its depths are born from the one before it.

use super::align::{Alignment, Brightness, Reference, moved_ray};
use super::point::{self, InverseDepth, Point};
use super::pyramid::{Lenses, Pyramid};
use super::search::Target;
use endoscape_core::{DepthMap, Grid, Pose, Size};
use nalgebra::Vector2;
use std::collections::HashSet;
use std::sync::Arc;

/// Points that are not found this often in a row are given up.
const GIVE_UP: u32 = 4;
/// Side of the cells whose depths say something about a new point among them, pixels.
const NEIGHBOURHOOD: usize = 16;
/// Added standard deviation of a depth that is handed over, as a share of it.
const HAND_OVER_SHARE: f64 = 0.03;
/// Added standard deviation of a depth guessed from those around, as a share of it.
const GUESS_SHARE: f64 = 0.1;
/// Standard deviation of a depth nothing is known about, as a share of the scene's middle one.
pub const UNKNOWN_SHARE: f64 = 0.5;

/// A picture with its place and brightness in the world of the run.
#[derive(Clone, Debug)]
pub struct View {
    /// The picture.
    pub pyramid: Arc<Pyramid>,
    /// Its place.
    pub world_from_camera: Pose,
    /// Its brightness against the first picture's.
    pub brightness: Brightness,
}

impl View {
    /// Motion and brightness from this view to another.
    pub fn to(&self, other: &Self) -> (Pose, Brightness) {
        let log_gain = other.brightness.log_gain - self.brightness.log_gain;
        let offset = other.brightness.offset - log_gain.exp() * self.brightness.offset;
        (other.world_from_camera.inverse() * self.world_from_camera, Brightness { log_gain, offset })
    }

    /// The view an alignment from this one ends in.
    pub fn aligned(&self, alignment: &Alignment, pyramid: Arc<Pyramid>) -> Self {
        let step = alignment.brightness;
        let offset = step.log_gain.exp() * self.brightness.offset + step.offset;
        let brightness = Brightness { log_gain: self.brightness.log_gain + step.log_gain, offset };
        let world_from_camera = self.world_from_camera * alignment.current_from_reference.inverse();
        Self { pyramid, world_from_camera, brightness }
    }
}

/// A view with points.
#[derive(Clone, Debug)]
pub struct Keyframe {
    /// The picture and its place.
    pub view: View,
    /// Its points.
    pub reference: Reference,
}

impl Keyframe {
    /// A keyframe whose points all lie at one inverse depth, as far as is known.
    pub fn flat(view: View, lenses: &Lenses, count: usize, inverse_depth: f64) -> Self {
        let guess = unknown(inverse_depth);
        Self::with(view, lenses, Vec::new(), count, |_, _| guess)
    }

    /// A keyframe that takes over the points of the one before it that it sees, and fills the gaps with new ones, whose
    /// depths are guessed from those around them.
    pub fn after(previous: &Self, view: View, lenses: &Lenses, count: usize, noise: f64) -> Self {
        let kept = previous.handed_over(&view, lenses, count, noise);
        let seeds = by_cell(&kept, view.pyramid.level(0).size());
        let fallback = unknown(previous.middle_inverse_depth());
        Self::with(view, lenses, kept, count, |x, y| nearby(&seeds, x, y).unwrap_or(fallback))
    }

    /// The given points, and new ones in the cells that have none.
    fn with(
        view: View,
        lenses: &Lenses,
        mut points: Vec<Point>,
        count: usize,
        depth: impl Fn(usize, usize) -> InverseDepth,
    ) -> Self {
        let level = view.pyramid.level(0);
        let side = point::cell_side(level.size(), count);
        let taken: HashSet<(usize, usize)> = points.iter().map(|point| cell(&point.pixel, side)).collect();
        let fresh = point::select(&view.pyramid, count).into_iter().filter_map(|(x, y)| {
            let pixel = Vector2::new(x as f64, y as f64);
            let point = || Point::new(level, lenses.level(0), pixel, depth(x, y));
            if taken.contains(&cell(&pixel, side)) { None } else { point() }
        });
        points.extend(fresh);
        let reference = Reference::new(points, &view.pyramid, lenses);
        Self { view, reference }
    }

    /// The points whose depth is known, moved to where a new view sees them; one, the best known, of each cell.
    fn handed_over(&self, view: &View, lenses: &Lenses, count: usize, noise: f64) -> Vec<Point> {
        let (level, lens) = (view.pyramid.level(0), lenses.level(0));
        let (motion, brightness) = self.view.to(view);
        let target = Target { level, lens, motion, brightness, noise };
        let mut known: Vec<&Point> = self.reference.points.iter().filter(|point| point.found > 0).collect();
        known.sort_by(|a, b| a.inverse_depth.doubt().total_cmp(&b.inverse_depth.doubt()));
        let side = point::cell_side(level.size(), count);
        let mut taken = HashSet::new();
        let moved = |point: &Point| {
            let InverseDepth { mean, variance } = point.inverse_depth;
            let q = moved_ray(&motion, &point.ray, mean);
            let pixel = lens.project(&q)?;
            let (x, y) = whole(&pixel, level.size())?;
            let usable = view.pyramid.is_usable(x, y, point::MARGIN) && target.agrees(point);
            if !(usable && q.z > 0.0 && taken.insert(cell(&pixel, side))) {
                return None;
            }
            // Depth q_z / rho differs from the old one by t_z whatever rho is, so d rho' / d rho = (rho' / rho)^2.
            let after = mean / q.z;
            let variance = variance * (after / mean).powi(4) + (HAND_OVER_SHARE * after).powi(2);
            let moved = Point::new(level, lens, pixel, InverseDepth { mean: after, variance })?;
            Some(Point { found: point.found, ..moved })
        };
        known.into_iter().filter_map(moved).collect()
    }

    /// Searches every point in another view and gives up those that are never found.
    pub fn observe(&mut self, other: &View, lenses: &Lenses, noise: f64) {
        let (motion, brightness) = self.view.to(other);
        let alignment = Alignment::guess(motion, brightness);
        self.reference.observe(&other.pyramid, lenses, &alignment, noise);
        self.reference.retain_points(|point| point.missed < GIVE_UP);
    }

    /// Lets only points whose depth has been found have a say in alignments, if they are enough: a guessed depth, were
    /// it ever so uncertain, pulls the motion its way in every frame.
    pub fn trust_found(&mut self, fewest: usize) {
        let found = self.reference.points.iter().filter(|point| point.found > 0).count();
        for point in &mut self.reference.points {
            point.weight = if point.found > 0 || found < fewest { 1.0 } else { 0.0 };
        }
    }

    /// The middle inverse depth of the points that have been found, or of all.
    pub fn middle_inverse_depth(&self) -> f64 {
        let points = &self.reference.points;
        let middle = |found: u32| {
            let mut all: Vec<f64> = points.iter().filter(|p| p.found >= found).map(|p| p.inverse_depth.mean).collect();
            let middle = all.len() / 2;
            (!all.is_empty()).then(|| *all.select_nth_unstable_by(middle, f64::total_cmp).1)
        };
        middle(1).or_else(|| middle(0)).unwrap_or(1.0)
    }

    /// Root mean square of the points' ways in pixels that the translation alone causes.
    pub fn parallax(&self, motion: &Pose, lenses: &Lenses) -> f64 {
        let lens = lenses.level(0);
        let way = |point: &Point| {
            let (turned, moved) =
                (motion.rotation * point.ray, moved_ray(motion, &point.ray, point.inverse_depth.mean));
            Some((lens.project(&moved)? - lens.project(&turned)?).norm_squared())
        };
        let ways: Vec<f64> = self.reference.points.iter().filter_map(way).collect();
        (ways.iter().sum::<f64>() / ways.len().max(1) as f64).sqrt()
    }

    /// The points' depths as seen by a camera moved by `motion`; pixels between them are unknown.
    pub fn depth_seen_from(&self, motion: &Pose, lenses: &Lenses, size: Size) -> DepthMap {
        let mut depth = Grid::filled(size, 0.0_f32);
        for point in self.reference.points.iter().filter(|point| point.found > 0) {
            let moved = moved_ray(motion, &point.ray, point.inverse_depth.mean);
            let Some(pixel) = lenses.level(0).project(&moved).and_then(|pixel| whole(&pixel, size)) else {
                continue;
            };
            let z = (moved.z / point.inverse_depth.mean) as f32;
            let place = &mut depth.values_mut()[pixel.1 * size.width + pixel.0];
            *place = if *place > 0.0 { place.min(z) } else { z };
        }
        DepthMap::new(depth)
    }
}

fn unknown(mean: f64) -> InverseDepth {
    InverseDepth { mean, variance: (UNKNOWN_SHARE * mean).powi(2) }
}

fn whole(pixel: &Vector2<f64>, size: Size) -> Option<(usize, usize)> {
    let inside = |p: f64, extent: usize| p >= -0.5 && p < extent as f64 - 0.5;
    let (inside_x, inside_y) = (inside(pixel.x, size.width), inside(pixel.y, size.height));
    (inside_x && inside_y).then(|| ((pixel.x + 0.5) as usize, (pixel.y + 0.5) as usize))
}

fn cell(pixel: &Vector2<f64>, side: usize) -> (usize, usize) {
    ((pixel.x + 0.5) as usize / side, (pixel.y + 0.5) as usize / side)
}

/// Depths gathered by cells of [`NEIGHBOURHOOD`] pixels.
fn by_cell(points: &[Point], size: Size) -> Grid<Vec<InverseDepth>> {
    let cells = Size::new(size.width.div_ceil(NEIGHBOURHOOD), size.height.div_ceil(NEIGHBOURHOOD));
    let mut gathered = Grid::filled(cells, Vec::new());
    for point in points {
        let (x, y) = cell(&point.pixel, NEIGHBOURHOOD);
        gathered.values_mut()[y * cells.width + x].push(point.inverse_depth);
    }
    gathered
}

/// Depth of a place from the seeds of its cell and those around it: their weighted mean with their spread.
fn nearby(seeds: &Grid<Vec<InverseDepth>>, x: usize, y: usize) -> Option<InverseDepth> {
    let (cx, cy) = (x / NEIGHBOURHOOD, y / NEIGHBOURHOOD);
    let around = (cy.saturating_sub(1)..=cy + 1).flat_map(|y| (cx.saturating_sub(1)..=cx + 1).map(move |x| (x, y)));
    let all: Vec<InverseDepth> = around.filter_map(|(x, y)| seeds.get(x, y)).flatten().copied().collect();
    let weight = |seed: &InverseDepth| 1.0 / seed.variance;
    let total: f64 = all.iter().map(weight).sum();
    if total <= 0.0 {
        return None;
    }
    let mean = all.iter().map(|seed| weight(seed) * seed.mean).sum::<f64>() / total;
    let spread = all.iter().map(|seed| weight(seed) * (seed.mean - mean).powi(2)).sum::<f64>() / total;
    let own = all.len() as f64 / total;
    Some(InverseDepth { mean, variance: own + spread + (GUESS_SHARE * mean).powi(2) })
}
