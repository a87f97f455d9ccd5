//! Does the depth of one frame, carried by the poses, land on the depth of another?

use super::convention::{Convention, DepthReading};
use endoscape_core::{Camera, DepthMap, Pose};
use nalgebra::{Point2, Point3};

/// Samples taken per pair of frames; the median of so many is stable to about 1 %.
const SAMPLES: usize = 30_000;

/// A sample counts as an inlier when it is off by at most this share of its depth.
const INLIER_SHARE_OF_DEPTH: f64 = 0.05;

/// Fewer landed samples than this share of those sent say nothing.
const LEAST_OVERLAP: f64 = 0.05;

/// Four depths around a point belong to one surface if they differ by at most this share.
const ONE_SURFACE: f32 = 0.05;

/// How well the depth of one frame agrees with that of another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// Median absolute difference of depth, metres.
    pub median_m: f64,
    /// 90th percentile of it, metres.
    pub p90_m: f64,
    /// Share of landed samples off by at most 5 % of their depth.
    pub inlier_share: f64,
    /// Share of samples that landed on a known depth of the other frame.
    pub overlap: f64,
}

/// Depth and pose of one frame.
#[derive(Clone, Debug)]
pub struct View {
    /// Number of the frame in its data set.
    pub number: usize,
    /// Its depth.
    pub depth: DepthMap,
    /// Its pose as loaded.
    pub world_from_camera: Pose,
}

/// Projects the depth of `a` into `b` under a convention; `None` when too little of `a` lands on known depth of `b`.
pub fn residual(a: &View, b: &View, convention: &Convention) -> Option<Residual> {
    let b_from_a = convention.pose(&b.world_from_camera).inverse() * convention.pose(&a.world_from_camera);
    let middle = f64::from(a.depth.median_m()?);
    let mut sent = 0_usize;
    let mut landed: Vec<(f64, f64)> = Vec::with_capacity(SAMPLES);
    for (x, y) in sample_pixels(&a.depth) {
        let Some(stored) = a.depth.get(x, y) else { continue };
        let pixel = Point2::new(x as f64, y as f64);
        let Some(point) = point_of(convention, &pixel, read(convention.depth, f64::from(stored), middle)) else {
            continue;
        };
        sent += 1;
        landed.extend(compare(&b.depth, convention, &(b_from_a * point), middle));
    }
    summary(&mut landed, sent)
}

/// Pixels on a regular lattice of about [`SAMPLES`] points.
fn sample_pixels(depth: &DepthMap) -> impl Iterator<Item = (usize, usize)> {
    let size = depth.size();
    let stride = ((size.area() as f64 / SAMPLES as f64).sqrt().floor() as usize).max(1);
    let rows = (stride / 2..size.height).step_by(stride);
    rows.flat_map(move |y| (stride / 2..size.width).step_by(stride).map(move |x| (x, y)))
}

/// A stored depth as the convention understands it.
fn read(reading: DepthReading, stored: f64, middle: f64) -> f64 {
    match reading {
        DepthReading::AlongAxis | DepthReading::AlongRay => stored,
        DepthReading::Inverse => middle * middle / stored,
    }
}

fn point_of(convention: &Convention, pixel: &Point2<f64>, depth: f64) -> Option<Point3<f64>> {
    let camera: &Camera = &convention.camera;
    match convention.depth {
        DepthReading::AlongRay => camera.unproject(pixel).map(|ray| Point3::from(ray * depth)),
        DepthReading::AlongAxis | DepthReading::Inverse => camera.unproject_to_depth(pixel, depth),
    }
}

/// Depth expected at a point and depth found there.
fn compare(depth: &DepthMap, convention: &Convention, point: &Point3<f64>, middle: f64) -> Option<(f64, f64)> {
    let pixel = convention.camera.project(point)?;
    let found = read(convention.depth, sample(depth, &pixel)?, middle);
    let expected = if convention.depth == DepthReading::AlongRay { point.coords.norm() } else { point.z };
    Some((expected, found))
}

/// Depth between pixels: bilinear within one surface, none across an edge or beside unknown pixels.
fn sample(depth: &DepthMap, pixel: &Point2<f64>) -> Option<f64> {
    if pixel.x < 0.0 || pixel.y < 0.0 {
        return None;
    }
    let (x, y) = (pixel.x as usize, pixel.y as usize);
    let corners = [depth.get(x, y)?, depth.get(x + 1, y)?, depth.get(x, y + 1)?, depth.get(x + 1, y + 1)?];
    let (low, high) = corners.iter().fold((f32::MAX, 0.0_f32), |(low, high), d| (low.min(*d), high.max(*d)));
    if high - low > ONE_SURFACE * low {
        return None;
    }
    let (u, v) = (pixel.x - x as f64, pixel.y - y as f64);
    let [a, b, c, d] = corners.map(f64::from);
    Some((1.0 - v) * ((1.0 - u) * a + u * b) + v * ((1.0 - u) * c + u * d))
}

fn summary(landed: &mut [(f64, f64)], sent: usize) -> Option<Residual> {
    let overlap = landed.len() as f64 / sent.max(1) as f64;
    if landed.is_empty() || overlap < LEAST_OVERLAP {
        return None;
    }
    let within = |(expected, found): &&(f64, f64)| (expected - found).abs() <= INLIER_SHARE_OF_DEPTH * found.abs();
    let inlier_share = landed.iter().filter(within).count() as f64 / landed.len() as f64;
    let mut errors: Vec<f64> = landed.iter().map(|(expected, found)| (expected - found).abs()).collect();
    errors.sort_by(f64::total_cmp);
    let at = |share: f64| errors[((errors.len() - 1) as f64 * share) as usize];
    Some(Residual { median_m: at(0.5), p90_m: at(0.9), inlier_share, overlap })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::inspect::convention::{PoseReading, conventions};
    use endoscape_core::camera::KannalaBrandt;
    use endoscape_core::{Camera, Grid, Size, se3};
    use nalgebra::{Vector3, Vector6};

    /// A fisheye with unequal focal lengths inside a sphere of 50 mm, off its centre.
    pub fn camera() -> Camera {
        let intrinsics = endoscape_core::camera::Intrinsics { fx: 90.0, fy: 84.0, cx: 92.0, cy: 58.0, skew: 0.0 };
        let lens = KannalaBrandt { intrinsics, k1: -0.05, k2: 0.004, k3: 0.0, k4: 0.0 };
        Camera::new(Size::new(192, 128), lens.into()).unwrap()
    }

    pub fn sphere_view(number: usize, world_from_camera: Pose) -> View {
        let camera = camera();
        let depth = Grid::from_fn(camera.size(), |x, y| {
            let Some(ray) = camera.unproject(&Point2::new(x as f64, y as f64)) else { return 0.0 };
            let (o, d) = (world_from_camera.translation.vector, world_from_camera.rotation * ray);
            let b = o.dot(&d);
            let along = -b + (b * b - o.norm_squared() + 0.05 * 0.05).sqrt();
            (along * ray.z) as f32
        });
        View { number, depth: DepthMap::new(depth), world_from_camera }
    }

    fn pair() -> (View, View) {
        // Neither start nor motion has any symmetry, so that every wrong reading shows.
        let first = se3::exp(&Vector6::new(0.012, -0.008, 0.02, 0.4, -0.7, 0.3));
        let motion = se3::exp(&Vector6::new(0.004, -0.002, 0.005, 0.05, -0.03, 0.04));
        (sphere_view(0, first), sphere_view(30, first * motion))
    }

    #[test]
    fn the_true_convention_wins_by_far() {
        let (a, b) = pair();
        let all = conventions(&camera());
        let right = residual(&a, &b, &all[0]).unwrap();
        assert!(right.median_m < 2e-6, "{right:?}");
        assert!(right.inlier_share > 0.99);
        for wrong in &all[1..] {
            if let Some(residual) = residual(&a, &b, wrong) {
                assert!(residual.median_m > 20.0 * right.median_m, "{}: {residual:?}", wrong.name);
            }
        }
    }

    #[test]
    fn a_wrong_loader_is_found_out() {
        let (mut a, mut b) = pair();
        for view in [&mut a, &mut b] {
            view.world_from_camera = view.world_from_camera.inverse();
        }
        let best = conventions(&camera())
            .into_iter()
            .filter_map(|convention| Some((residual(&a, &b, &convention)?.median_m, convention)))
            .min_by(|x, y| x.0.total_cmp(&y.0))
            .unwrap();
        assert_eq!(best.1.pose, PoseReading::Inverse);
    }

    #[test]
    fn nothing_in_common_is_no_residual() {
        let (a, mut b) = pair();
        b.depth = DepthMap::new(Grid::filled(b.depth.size(), 0.0));
        assert_eq!(residual(&a, &b, &conventions(&camera())[0]), None);
        let far = Pose::from_parts(Vector3::new(0.0, 0.0, -9.0).into(), a.world_from_camera.rotation);
        assert_eq!(residual(&a, &sphere_view(1, far), &conventions(&camera())[0]), None);
    }
}
