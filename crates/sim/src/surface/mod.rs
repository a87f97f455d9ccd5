//! The wall of an organ as a surface that rays meet exactly.
//!
//! A [`Wall`] is the organ at rest: vertices with the coordinates that deformation and texture need. A [`Posed`] is
//! the wall at one moment, with a bounding-volume hierarchy over it. Two kinds of wall exist:
//!
//! * a net of vertices joined by bicubic Catmull-Rom patches (E. Catmull, R. Rom, 1974). The patches *are* the
//!   surface: a hit is found by Newton's method on the patch, so depth, normal and flow follow one smooth surface to
//!   rounding, and a net sampled from a sphere follows the sphere to the fourth order of its spacing;
//! * triangles, for imported meshes; there the flat triangles are the surface, and only shading is smoothed.
//!
//! A place on the wall is a [`Site`]: a cell and two coordinates within it. It belongs to the tissue, not to space, so
//! the same site at two moments is the surface flow.

mod patch;
mod posed;
mod triangle;

pub use posed::{Hit, Posed};

use glam::Vec3A;
use nalgebra::Vector3;

/// One vertex at rest, with what deformation and texture need to know about it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vertex {
    /// Position in the world, metres.
    pub rest: Vector3<f64>,
    /// From the vertex to the middle of the lumen, metres.
    pub inward: Vector3<f64>,
    /// Distance along the organ, metres.
    pub along_m: f64,
    /// Angle around the organ's axis.
    pub around_rad: f64,
    /// How much of a fold this is, 0 to 1.
    pub fold: f32,
}

/// How vertices are joined.
#[derive(Clone, Debug, PartialEq)]
pub enum Topology {
    /// A net of `rows` x `columns` vertices, row after row; every four neighbours bound a bicubic patch.
    Patches {
        /// Vertices along the organ.
        rows: usize,
        /// Vertices around it.
        columns: usize,
        /// Whether the last column joins the first.
        wrapped: bool,
    },
    /// Flat triangles, three vertex indices each.
    Triangles {
        /// The corners.
        faces: Vec<[u32; 3]>,
        /// Texture coordinates of the corners, as OBJ files have them.
        texture_coordinates: Option<Vec<[[f32; 2]; 3]>>,
    },
}

/// An organ's wall at rest.
#[derive(Clone, Debug, PartialEq)]
pub struct Wall {
    /// Vertices; of a net row after row.
    pub vertices: Vec<Vertex>,
    /// How they are joined.
    pub topology: Topology,
}

/// A place on the wall that moves with the tissue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Site {
    /// Patch or triangle.
    pub cell: u32,
    /// First coordinate: along the net, or the weight of the second corner of a triangle.
    pub a: f64,
    /// Second coordinate: around the net, or the weight of the third corner.
    pub b: f64,
}

/// Where on the organ a site is, in coordinates that do not move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coordinates {
    /// Distance along the organ, metres.
    pub along_m: f64,
    /// Angle around the organ's axis; meaningless on triangles.
    pub around_rad: f64,
    /// Position at rest, metres; on nets between the four vertices around, which is all their users need.
    pub rest: Vector3<f64>,
    /// How much of a fold this is, 0 to 1.
    pub fold: f32,
}

impl Wall {
    /// A net from a function of the vertex's row and column.
    pub fn net(rows: usize, columns: usize, wrapped: bool, mut vertex: impl FnMut(usize, usize) -> Vertex) -> Self {
        let vertices = (0..rows * columns).map(|at| vertex(at / columns, at % columns)).collect();
        Self { vertices, topology: Topology::Patches { rows, columns, wrapped } }
    }

    /// Number of patches or triangles.
    pub fn cells(&self) -> usize {
        match &self.topology {
            Topology::Patches { rows, columns, wrapped } => (rows - 1) * patch_columns(*columns, *wrapped),
            Topology::Triangles { faces, .. } => faces.len(),
        }
    }

    /// Where on the organ a site is.
    pub fn coordinates(&self, site: Site) -> Coordinates {
        match &self.topology {
            Topology::Patches { columns, wrapped, .. } => {
                let across = patch_columns(*columns, *wrapped);
                let (row, column) = (site.cell as usize / across, site.cell as usize % across);
                let at = |row: usize, column: usize| &self.vertices[row * columns + column % columns];
                let (here, next) = (at(row, column), at(row + 1, column));
                let turn = if *wrapped { std::f64::consts::TAU / *columns as f64 } else { 0.0 };
                Coordinates {
                    along_m: here.along_m + site.a * (next.along_m - here.along_m),
                    around_rad: here.around_rad + site.b * turn,
                    rest: here
                        .rest
                        .lerp(&next.rest, site.a)
                        .lerp(&at(row, column + 1).rest.lerp(&at(row + 1, column + 1).rest, site.a), site.b),
                    fold: here.fold,
                }
            }
            Topology::Triangles { faces, .. } => {
                let [p, q, r] = faces[site.cell as usize].map(|index| &self.vertices[index as usize]);
                let mix = |p: f64, q: f64, r: f64| p + site.a * (q - p) + site.b * (r - p);
                Coordinates {
                    along_m: mix(p.along_m, q.along_m, r.along_m),
                    around_rad: p.around_rad,
                    rest: p.rest + (q.rest - p.rest) * site.a + (r.rest - p.rest) * site.b,
                    fold: p.fold,
                }
            }
        }
    }
}

/// Patches around a net of `columns` vertices.
const fn patch_columns(columns: usize, wrapped: bool) -> usize {
    if wrapped { columns } else { columns - 1 }
}

/// A point in single precision, as boxes and the hierarchy have it.
fn single(point: &Vector3<f64>) -> Vec3A {
    Vec3A::new(point.x as f32, point.y as f32, point.z as f32)
}

#[cfg(test)]
mod tests;
