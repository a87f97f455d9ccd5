//! The wall at one moment: where its points are, and what a ray meets first.

use super::patch::{self, Jet, Net};
use super::{Site, Topology, Wall, single, triangle};
use glam::Vec3A;
use nalgebra::Vector3;
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::{Bvh2, builder::build_bvh2};
use obvhs::ray::{Ray, RayHit};
use rayon::prelude::*;
use std::time::Duration;

/// Boxes grow by this share of their coordinates and this many metres, more than a dozen roundings to single precision
/// lose.
const ROUNDING: (f32, f32) = (1e-6, 1e-7);

/// What a ray met.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    /// The place on the wall.
    pub site: Site,
    /// Distance along the ray, metres.
    pub distance_m: f64,
    /// Unit normal of the surface, towards the ray's origin.
    pub normal: Vector3<f64>,
    /// Unit normal for shading: the same on patches, smoothed over triangles.
    pub shading_normal: Vector3<f64>,
    /// Derivatives of the position by the two coordinates of the site.
    pub tangents: [Vector3<f64>; 2],
}

/// A wall whose vertices have positions at some moment.
#[derive(Clone)]
pub struct Posed<'a> {
    wall: &'a Wall,
    shape: Shape,
    hierarchy: Bvh2,
}

#[derive(Clone)]
enum Shape {
    Patches(Net),
    Triangles { points: Vec<Vector3<f64>>, normals: Vec<Vector3<f64>> },
}

/// A box as the hierarchy's builder wants it.
#[derive(Clone, Copy)]
struct Bounded(Aabb);

impl obvhs::Boundable for Bounded {
    fn aabb(&self) -> Aabb {
        self.0
    }
}

impl<'a> Posed<'a> {
    /// The wall at rest.
    pub fn new(wall: &'a Wall) -> Self {
        let points: Vec<Vector3<f64>> = wall.vertices.iter().map(|vertex| vertex.rest).collect();
        let shape = Shape::new(wall, points);
        let boxes = shape.boxes(wall);
        // Meeting a patch costs more than walking down the tree, so leaves are small.
        let small =
            BvhBuildParams { max_prims_per_leaf: 2, collapse_traversal_cost: 0.5, ..BvhBuildParams::fast_build() };
        let mut hierarchy = build_bvh2(&boxes, small, &mut Duration::default());
        // Children behind their parents: new boxes then take one sweep.
        hierarchy.reorder_in_stack_traversal_order();
        Self { wall, shape, hierarchy }
    }

    /// Moves every vertex to where `position` puts it; the hierarchy keeps its tree and changes its boxes.
    pub fn repose(&mut self, position: impl Fn(&super::Vertex) -> Vector3<f64> + Send + Sync) {
        let points = self.wall.vertices.par_iter().map(position).collect();
        self.shape = Shape::new(self.wall, points);
        let boxes = self.shape.boxes(self.wall);
        let Bvh2 { nodes, primitive_indices, .. } = &mut self.hierarchy;
        nodes.par_iter_mut().filter(|node| node.is_leaf()).for_each(|node| {
            let cells = &primitive_indices[node.first_index as usize..(node.first_index + node.prim_count) as usize];
            node.set_aabb(cells.iter().fold(Aabb::empty(), |all, cell| all.union(&boxes[*cell as usize].0)));
        });
        self.hierarchy.refit_all();
    }

    /// Position of a place on the wall.
    pub fn point(&self, site: Site) -> Vector3<f64> {
        self.jet(site).point
    }

    /// The first place a ray from `origin` along the unit `direction` meets within `farthest_m`.
    pub fn cast(&self, origin: &Vector3<f64>, direction: &Vector3<f64>, farthest_m: f64) -> Option<Hit> {
        let (distance_m, site) = self.nearest(origin, direction, farthest_m)?;
        let jet = self.jet(site);
        let normal = facing(jet.by_a.cross(&jet.by_b), direction);
        let shading_normal = match &self.shape {
            Shape::Patches(_) => normal,
            Shape::Triangles { normals, .. } => facing(self.smooth_normal(site, normals), direction),
        };
        Some(Hit { site, distance_m, normal, shading_normal, tangents: [jet.by_a, jet.by_b] })
    }

    /// Whether anything stands between a point and another.
    pub fn blocked(&self, from: &Vector3<f64>, to: &Vector3<f64>) -> bool {
        let way = to - from;
        let length = way.norm();
        length > 0.0 && self.nearest(from, &(way / length), length).is_some()
    }

    fn nearest(&self, origin: &Vector3<f64>, direction: &Vector3<f64>, farthest_m: f64) -> Option<(f64, Site)> {
        if !(origin.iter().chain(direction.iter()).all(|x| x.is_finite())) {
            return None;
        }
        let mut best: Option<(f64, Site)> = None;
        let ray = Ray::new(single(origin), single(direction), 0.0, farthest_m as f32);
        self.hierarchy.ray_traverse(ray, &mut RayHit::none(), |_, at| {
            let cell = self.hierarchy.primitive_indices[at];
            let reach = best.map_or(farthest_m, |(distance, _)| distance);
            match self.meet(cell, origin, direction) {
                Some((distance, a, b)) if distance > 0.0 && distance < reach => {
                    best = Some((distance, Site { cell, a, b }));
                    distance as f32
                }
                _ => f32::INFINITY,
            }
        });
        best
    }

    fn meet(&self, cell: u32, origin: &Vector3<f64>, direction: &Vector3<f64>) -> Option<(f64, f64, f64)> {
        match &self.shape {
            Shape::Patches(net) => patch::intersect(net, cell, origin, direction),
            Shape::Triangles { points, .. } => {
                triangle::intersect(&corners(self.wall, points, cell), origin, direction)
            }
        }
    }

    fn jet(&self, site: Site) -> Jet {
        match &self.shape {
            Shape::Patches(net) => net.jet(site.cell, site.a, site.b),
            Shape::Triangles { points, .. } => {
                let [p, q, r] = corners(self.wall, points, site.cell);
                Jet { point: p + (q - p) * site.a + (r - p) * site.b, by_a: q - p, by_b: r - p }
            }
        }
    }

    fn smooth_normal(&self, site: Site, normals: &[Vector3<f64>]) -> Vector3<f64> {
        let [p, q, r] = corners(self.wall, normals, site.cell);
        p * (1.0 - site.a - site.b) + q * site.a + r * site.b
    }
}

impl Shape {
    fn new(wall: &Wall, points: Vec<Vector3<f64>>) -> Self {
        match &wall.topology {
            Topology::Patches { rows, columns, wrapped } => Self::Patches(Net::new(&points, *rows, *columns, *wrapped)),
            Topology::Triangles { faces, .. } => {
                let normals = vertex_normals(&points, faces);
                Self::Triangles { points, normals }
            }
        }
    }

    fn boxes(&self, wall: &Wall) -> Vec<Bounded> {
        let grown = |Aabb { min, max }: Aabb| {
            let room = |corner: Vec3A| corner.abs() * ROUNDING.0 + Vec3A::splat(ROUNDING.1);
            Bounded(Aabb::new(min - room(min), max + room(max)))
        };
        let cells = 0..wall.cells() as u32;
        match self {
            Self::Patches(net) => cells.into_par_iter().map(|cell| grown(net.bounds(cell))).collect(),
            Self::Triangles { points, .. } => {
                let bounds = |cell| {
                    let [p, q, r] = corners(wall, points, cell).map(|corner| single(&corner));
                    Aabb::new(p.min(q).min(r), p.max(q).max(r))
                };
                cells.into_par_iter().map(|cell| grown(bounds(cell))).collect()
            }
        }
    }
}

/// Values of the corners of a triangle; a patch has none, so it gives zeros.
fn corners(wall: &Wall, values: &[Vector3<f64>], cell: u32) -> [Vector3<f64>; 3] {
    match &wall.topology {
        Topology::Triangles { faces, .. } => faces[cell as usize].map(|index| values[index as usize]),
        Topology::Patches { .. } => [Vector3::zeros(); 3],
    }
}

/// Normals of the vertices: the sum of those of the triangles around them, weighted by area.
fn vertex_normals(points: &[Vector3<f64>], faces: &[[u32; 3]]) -> Vec<Vector3<f64>> {
    let mut normals = vec![Vector3::zeros(); points.len()];
    for face in faces {
        let [p, q, r] = face.map(|index| points[index as usize]);
        let normal = (q - p).cross(&(r - p));
        face.iter().for_each(|index| normals[*index as usize] += normal);
    }
    normals
}

/// The unit normal that looks against a direction.
fn facing(normal: Vector3<f64>, direction: &Vector3<f64>) -> Vector3<f64> {
    let unit = normal.try_normalize(0.0).unwrap_or(-direction);
    if unit.dot(direction) > 0.0 { -unit } else { unit }
}
