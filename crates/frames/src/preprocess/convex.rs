//! Convex hulls and circles around points in the picture, pixels.

/// A point in the picture, column and row.
pub type Point = [f64; 2];

/// Twice the signed area of the triangle; positive if `c` lies to the left of the way from `a` to `b` (y up).
fn cross(a: Point, b: Point, c: Point) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

fn distance(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Corners of the convex hull in one turning sense; A. M. Andrew's monotone chain (1979).
pub fn hull(mut points: Vec<Point>) -> Vec<Point> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    points.dedup();
    let chain = |points: &mut dyn Iterator<Item = &Point>| {
        let mut chain: Vec<Point> = Vec::new();
        for point in points {
            while let [.., a, b] = chain[..] {
                if cross(a, b, *point) > 0.0 {
                    break;
                }
                chain.pop();
            }
            chain.push(*point);
        }
        // The last corner opens the other chain.
        chain.pop();
        chain
    };
    let mut corners = chain(&mut points.iter());
    corners.extend(chain(&mut points.iter().rev()));
    corners
}

/// The hull with as few corners as keep every dropped one within `tolerance` of the new outline.
///
/// Corners go one by one, the flattest first (Visvalingam's rule with height instead of area).
pub fn simplified(mut corners: Vec<Point>, tolerance: f64) -> Vec<Point> {
    while corners.len() > 3 {
        let count = corners.len();
        let height = |i: usize| {
            let (before, after) = (corners[(i + count - 1) % count], corners[(i + 1) % count]);
            cross(before, corners[i], after).abs() / distance(before, after).max(f64::MIN_POSITIVE)
        };
        let flattest = (0..count).map(|i| (i, height(i))).min_by(|a, b| a.1.total_cmp(&b.1));
        match flattest {
            Some((i, height)) if height <= tolerance => corners.remove(i),
            _ => break,
        };
    }
    corners
}

/// Signed distance of a point to the line through an edge of a hull as [`hull`] turns it, positive inside.
pub fn depth_behind(edge: (Point, Point), point: Point) -> f64 {
    cross(edge.0, edge.1, point) / distance(edge.0, edge.1).max(f64::MIN_POSITIVE)
}

/// Centre and radius of the circle nearest to the points in the algebraic sense (I. Kasa, 1976), refitted to the half
/// of the points that lie closest, until that settles; `None` without at least three points off one line.
pub fn circle(points: &[Point]) -> Option<(Point, f64)> {
    let mut kept = points.to_vec();
    let mut fit = kasa(&kept)?;
    for _ in 0..10 {
        let error = |point: &Point| (distance(*point, fit.0) - fit.1).abs();
        kept = points.to_vec();
        kept.sort_by(|a, b| error(a).total_cmp(&error(b)));
        kept.truncate(points.len().div_ceil(2).max(3));
        fit = kasa(&kept)?;
    }
    Some(fit)
}

fn kasa(points: &[Point]) -> Option<(Point, f64)> {
    let count = points.len() as f64;
    // Around the mean the numbers stay small and the equations well conditioned.
    let mean = [0, 1].map(|axis| points.iter().map(|p| p[axis]).sum::<f64>() / count);
    let mut normal = nalgebra::Matrix3::zeros();
    let mut right = nalgebra::Vector3::zeros();
    for point in points {
        let (x, y) = (point[0] - mean[0], point[1] - mean[1]);
        let row = nalgebra::Vector3::new(x, y, 1.0);
        normal += row * row.transpose();
        right += row * (x * x + y * y);
    }
    let (xx, xy, yy) = (normal[(0, 0)], normal[(0, 1)], normal[(1, 1)]);
    // Points on one line leave the centre free to run away.
    if xx * yy - xy * xy <= 1e-6 * (xx + yy).powi(2) {
        return None;
    }
    let solution = normal.cholesky()?.solve(&right);
    let (x, y) = (0.5 * solution.x, 0.5 * solution.y);
    let radius = (solution.z + x * x + y * y).sqrt();
    radius.is_finite().then_some(([mean[0] + x, mean[1] + y], radius))
}

/// Share of the points within `tolerance` of the circle.
pub fn on_circle(points: &[Point], (centre, radius): (Point, f64), tolerance: f64) -> f64 {
    let near = points.iter().filter(|point| (distance(**point, centre) - radius).abs() <= tolerance).count();
    near as f64 / points.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hull_of_a_filled_octagon_has_eight_corners() {
        let inside = |x: i32, y: i32| (x + y - 100).abs() <= 70 && (x - y).abs() <= 70;
        let points = (0..=100).flat_map(|x| (0..=100).map(move |y| (x, y)));
        let points = points.filter(|(x, y)| inside(*x, *y)).map(|(x, y)| [f64::from(x), f64::from(y)]).collect();
        assert_eq!(simplified(hull(points), 1.0).len(), 8);
        assert!(hull(vec![[1.0, 1.0]; 4]).len() <= 1);
        assert!(hull(Vec::new()).is_empty());
    }

    #[test]
    fn a_circle_is_found_among_strays() {
        let mut points: Vec<Point> =
            (0..100).map(|i| f64::from(i) * 0.04).map(|a| [50.0 + 30.0 * a.cos(), 40.0 + 30.0 * a.sin()]).collect();
        points.extend((0..20).map(|i| [60.0 + f64::from(i), 20.0]));
        let (centre, radius) = circle(&points).unwrap();
        assert!(distance(centre, [50.0, 40.0]) < 0.01 && (radius - 30.0).abs() < 0.01, "{centre:?} {radius}");
        assert!(circle(&[[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]).is_none());
    }
}
