//! Flat triangles.

use nalgebra::Vector3;

/// Neighbouring triangles both accept a hit this far beyond their common edge, so that no ray slips between them.
const SEAM: f64 = 1e-9;

/// Where a ray meets a triangle: distance along the unit direction and the weights of the second and third corner
/// (T. Moller, B. Trumbore, "Fast, minimum storage ray-triangle intersection", 1997).
pub fn intersect(
    corners: &[Vector3<f64>; 3],
    origin: &Vector3<f64>,
    direction: &Vector3<f64>,
) -> Option<(f64, f64, f64)> {
    let (edge_a, edge_b) = (corners[1] - corners[0], corners[2] - corners[0]);
    let across = direction.cross(&edge_b);
    let determinant = edge_a.dot(&across);
    let to_corner = origin - corners[0];
    let a = to_corner.dot(&across) / determinant;
    let over = to_corner.cross(&edge_a);
    let b = direction.dot(&over) / determinant;
    let distance = edge_b.dot(&over) / determinant;
    (a >= -SEAM && b >= -SEAM && a + b <= 1.0 + SEAM && distance.is_finite()).then_some((distance, a, b))
}
