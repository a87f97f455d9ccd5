//! Landmarks of maps that were lost, and how a view finds its place among them: the relocalisation that kornia-slam 0.1
//! leaves out.
//!
//! Descriptors are matched by brute force; the pose is EPnP in RANSAC over the matches (V. Lepetit et al., IJCV 2009).

use super::view::View;
use endoscape_core::{Pose, se3};
use kornia_3d::camera::PinholeCamera;
use kornia_3d::pnp::{EPnPParams, LMRefineParams, PnPMethod, RansacParams, solve_pnp_ransac};
use kornia_algebra::{Mat3AF32, Vec2F32, Vec3AF32};
use kornia_imgproc::features::match_descriptors;
use nalgebra::{Matrix3, Point3, Vector3};

/// Landmarks kept, newest first to stay: matching a view against them takes about 0.1 s on one core.
const MOST_LANDMARKS: usize = 6_000;
/// Largest number of differing bits of a match, of 256, and largest ratio to the second best (ORB-SLAM's values for
/// matching without a guess).
const MATCH: (u32, f32) = (50, 0.75);
/// Landmarks that must agree on a pose. ORB-SLAM asks for 50 in its wider search; a chance agreement of 25 does not happen.
const FEWEST_AGREEING: usize = 25;
/// Distance within which a landmark agrees, pixels: 95 % of features with a standard deviation of 1.2 pixels.
const AGREEING_PX: f32 = 3.0;

/// A point of the world with the descriptor it is known by.
#[derive(Clone, Copy, Debug)]
pub struct Landmark {
    /// Place in the run's world and unit.
    pub position: Point3<f64>,
    /// Descriptor.
    pub descriptor: [u8; 32],
}

/// A place found among known landmarks.
#[derive(Clone, Debug)]
pub struct Recognised {
    /// The camera in the run's world.
    pub world_from_camera: Pose,
    /// Agreeing pairs: number of the view's feature, landmark's depth along the optical axis.
    pub depths: Vec<(usize, f64)>,
}

/// What is remembered.
#[derive(Clone, Debug, Default)]
pub struct Memory {
    positions: Vec<Point3<f64>>,
    descriptors: Vec<[u8; 32]>,
}

impl Memory {
    /// Whether nothing is remembered.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Adds landmarks; the oldest beyond [`MOST_LANDMARKS`] are forgotten.
    pub fn add(&mut self, landmarks: impl Iterator<Item = Landmark>) {
        for Landmark { position, descriptor } in landmarks {
            self.positions.push(position);
            self.descriptors.push(descriptor);
        }
        let surplus = self.positions.len().saturating_sub(MOST_LANDMARKS);
        self.positions.drain(..surplus);
        self.descriptors.drain(..surplus);
    }

    /// Where a view was taken from; `None` where too few landmarks agree.
    pub fn recognise(&self, view: &View, camera: &PinholeCamera) -> Option<Recognised> {
        let (most, ratio) = MATCH;
        let pairs = match_descriptors(&view.features.descriptors, &self.descriptors, Some(most), true, Some(ratio));
        if pairs.len() < FEWEST_AGREEING {
            return None;
        }
        let world: Vec<Vec3AF32> = pairs.iter().map(|pair| single(&self.positions[pair.1])).collect();
        let place = |pair: &(usize, usize)| Vec2F32::from_array(view.features.keypoints_xy[pair.0]);
        let image: Vec<Vec2F32> = pairs.iter().map(place).collect();
        let method = PnPMethod::EPnP(EPnPParams { refine_lm: Some(LMRefineParams::new()), ..EPnPParams::default() });
        // A fixed seed: a run repeated is a run repeated.
        let parameters =
            RansacParams { reproj_threshold_px: AGREEING_PX, random_seed: Some(1), ..RansacParams::default() };
        let found = solve_pnp_ransac(&world, &image, &matrix(camera), None, method, &parameters).ok()?;
        if found.inliers.len() < FEWEST_AGREEING {
            return None;
        }
        let rotation = Matrix3::from_iterator(found.pose.rotation.to_cols_array().map(f64::from));
        let translation = Vector3::from(found.pose.translation.to_array().map(f64::from));
        let camera_from_world = se3::from_matrix(&rotation, &translation).ok()?;
        let depth = |index: &usize| {
            let (feature, landmark) = pairs[*index];
            (feature, (camera_from_world * self.positions[landmark]).z)
        };
        let depths = found.inliers.iter().map(depth).collect();
        Some(Recognised { world_from_camera: camera_from_world.inverse(), depths })
    }
}

fn single(point: &Point3<f64>) -> Vec3AF32 {
    Vec3AF32::new(point.x as f32, point.y as f32, point.z as f32)
}

fn matrix(camera: &PinholeCamera) -> Mat3AF32 {
    let [fx, fy, cx, cy] = [camera.fx, camera.fy, camera.cx, camera.cy].map(|value| value as f32);
    let column = |x, y, z| Vec3AF32::new(x, y, z);
    Mat3AF32::from_cols(column(fx, 0.0, 0.0), column(0.0, fy, 0.0), column(cx, cy, 1.0))
}
