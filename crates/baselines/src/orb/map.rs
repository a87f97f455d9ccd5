//! One map of kornia-slam and where it lies in the run's world.

use super::memory::{Landmark, Recognised};
use super::view::View;
use super::{OrbConfig, PATIENCE_S};
use endoscape_core::{Pose, se3};
use kornia_3d::camera::PinholeCamera;
use kornia_3d::pose::Pose3d;
use kornia_image::{Image as Pixels, ImageSize};
use kornia_slam::mapping::LocalMappingMode;
use kornia_slam::mapping::map::MapPoint;
use kornia_slam::{Frame, SlamConfig, SlamSystem, TrackingStatus};
use nalgebra::{Matrix3, Point3, Vector3};

/// Matched landmarks at which confidence is one half: kornia-slam asks for as many to accept a pose.
const HALF_CONFIDENT: f64 = 30.0;
/// Keyframes of a map that is worth waiting for when its track is lost; a younger one is begun anew at once
/// (kornia-slam's own policy).
const ESTABLISHED: usize = 10;
/// Fewest shared landmarks that settle the ratio of two units.
const FEWEST_SHARED: usize = 10;

/// Largest ratio of a match's differing bits to the second best's, and fewest matches two pictures begin a map with.
const MATCH_RATIO: f32 = 0.8;
const FEWEST_MATCHES: usize = 50;
/// Frames a map may take to begin: its first picture stays the one all others are compared with, so that after a while
/// none resembles it.
const BEGINNING: usize = 30;

/// A map under way.
pub struct Map {
    slam: SlamSystem,
    /// Metres of the run's world per unit of the map, and the motion after it.
    pub scale: f64,
    /// See [`Map::scale`].
    pub world_from_map: Pose,
    /// Whether there are landmarks yet.
    pub has_begun: bool,
    frames: usize,
    keyframes: usize,
    lost_since_s: Option<f64>,
    /// Landmarks before the last frame and how often they had been found.
    before: (usize, u64),
}

/// What a map says of a frame.
pub struct Found {
    /// The camera in the run's world.
    pub world_from_camera: Pose,
    /// 0 to 1 by the number of landmarks found.
    pub confidence: f64,
    /// Whether the frame became a keyframe.
    pub is_keyframe: bool,
    /// Whether it is the one that began the map.
    pub is_first: bool,
}

impl Map {
    /// A map without landmarks.
    pub fn new(config: &OrbConfig, camera: &PinholeCamera) -> Self {
        let mut settings = SlamConfig {
            // In step with the frames, so that a run repeated gives the same numbers.
            local_mapping: LocalMappingMode::Synchronous,
            ..SlamConfig::default()
        };
        // When to give a map up is decided here, where its landmarks can be remembered first.
        settings.tracking_loss_recovery.min_keyframes_for_grace = 0;
        settings.tracking_loss_recovery.timeout_visual_sec = f64::INFINITY;
        // kornia-slam's own ratio, 0.6, leaves too few pairs of tissue to begin or grow a map with.
        settings.two_view_init.match_config.nn_ratio = MATCH_RATIO;
        settings.two_view_init.acceptance_config.min_matches = FEWEST_MATCHES;
        settings.two_view_init.triangulation_config.min_parallax_deg = config.parallax_deg;
        settings.keyframe_policy.min_frames_between = config.keyframe_frames.0;
        settings.keyframe_policy.max_frames_between = config.keyframe_frames.1;
        settings.keyframe_policy.ref_ratio = config.keyframe_share;
        Self {
            slam: SlamSystem::new(camera.clone(), settings),
            scale: 1.0,
            world_from_map: Pose::identity(),
            has_begun: false,
            frames: 0,
            keyframes: 0,
            lost_since_s: None,
            before: (0, 0),
        }
    }

    /// Shows the map a view; `None` where it does not find its place.
    pub fn track(
        &mut self,
        view: &View,
        size: ImageSize,
        previous: Option<&Pixels<u8, 1>>,
        at: (usize, f64),
    ) -> Option<Found> {
        let (index, time_s) = at;
        self.frames += 1;
        let frame = Frame {
            idx: index,
            features: view.features.clone(),
            pose_world_to_cam: Pose3d::IDENTITY,
            image_size: size,
            keypoint_colors: vec![[0; 3]; view.features.len()],
            u_right: Vec::new(),
            depth: Vec::new(),
            keypoints_undist: Vec::new(),
        };
        let result = self.slam.process_frame(frame, previous, &view.pixels, time_s, Vec::new());
        let matched = self.matched();
        if result.status == TrackingStatus::Skipped {
            self.lost_since_s = self.lost_since_s.or(self.has_begun.then_some(time_s));
            return None;
        }
        let world_from_camera = self.in_world(&result.pose_world_to_cam)?;
        self.lost_since_s = None;
        let is_keyframe = result.status == TrackingStatus::KeyframeAccepted;
        self.keyframes += usize::from(is_keyframe);
        let is_first = !std::mem::replace(&mut self.has_begun, true);
        let matched = if is_first { self.slam.num_active_map_points() as f64 } else { matched };
        Some(Found { world_from_camera, confidence: matched / (matched + HALF_CONFIDENT), is_keyframe, is_first })
    }

    /// Whether the track is lost for longer than the map is worth waiting, or the map does not begin.
    pub fn is_given_up(&self, time_s: f64) -> bool {
        if !self.has_begun {
            return self.frames >= BEGINNING;
        }
        let patience_s = if self.keyframes > ESTABLISHED { PATIENCE_S } else { 0.0 };
        self.lost_since_s.is_some_and(|since| time_s - since >= patience_s)
    }

    /// The map's landmarks in the run's world.
    pub fn landmarks(&self) -> Vec<Landmark> {
        let landmark = |point: &MapPoint| Landmark {
            position: self.world_from_map * (position(point) * self.scale),
            descriptor: point.descriptor,
        };
        self.slam.with_map_points(|points| points.iter().filter(|point| !point.culled).map(landmark).collect())
    }

    /// Lays the map into the world so that a keyframe is where it was recognised: turned and moved as its pose says,
    /// scaled by the middle ratio of the depths of landmarks known in both. `false` where too few are shared.
    pub fn tie(&mut self, keyframe: usize, world_from_camera: &Pose, recognised: &Recognised) -> bool {
        let map_from_camera = self.map_from_camera(world_from_camera);
        let depth = |feature: usize| {
            self.slam.with_map_points(|points| {
                let seen = |point: &&MapPoint| {
                    let mut all = point.observations().iter().map(|observation| observation.key);
                    !point.culled && all.any(|key| (key.keyframe_idx, key.feature_idx) == (keyframe, feature))
                };
                points.iter().find(seen).map(|point| (map_from_camera.inverse() * position(point)).z)
            })
        };
        let ratio = |(feature, known): &(usize, f64)| depth(*feature).map(|own| known / own);
        let mut ratios: Vec<f64> = recognised.depths.iter().filter_map(ratio).filter(|ratio| *ratio > 0.0).collect();
        if ratios.len() < FEWEST_SHARED {
            return false;
        }
        let middle = ratios.len() / 2;
        self.lay(
            &map_from_camera,
            &recognised.world_from_camera,
            *ratios.select_nth_unstable_by(middle, f64::total_cmp).1,
        );
        true
    }

    /// Lays the map into the world so that the camera is at `wanted`, with a unit of `scale`.
    pub fn place(&mut self, world_from_camera: &Pose, wanted: &Pose, scale: f64) {
        let map_from_camera = self.map_from_camera(world_from_camera);
        self.lay(&map_from_camera, wanted, scale);
    }

    fn lay(&mut self, map_from_camera: &Pose, world_from_camera: &Pose, scale: f64) {
        self.scale = scale;
        self.world_from_map = world_from_camera * scaled(map_from_camera, scale).inverse();
    }

    fn map_from_camera(&self, world_from_camera: &Pose) -> Pose {
        scaled(&(self.world_from_map.inverse() * world_from_camera), 1.0 / self.scale)
    }

    fn in_world(&self, camera_from_map: &Pose3d) -> Option<Pose> {
        let rotation = Matrix3::from_iterator(camera_from_map.rotation.to_cols_array());
        let translation = Vector3::from(camera_from_map.translation.to_array());
        let camera_from_map = se3::from_matrix(&rotation, &translation).ok()?;
        Some(self.world_from_map * scaled(&camera_from_map.inverse(), self.scale))
    }

    /// How many of the landmarks known before the last frame were found in it.
    fn matched(&mut self) -> f64 {
        let (known, found) = self.before;
        let count = |points: &[MapPoint]| points.iter().map(|point| u64::from(point.n_found)).sum::<u64>();
        let (now, after) = self
            .slam
            .with_map_points(|points| (count(&points[..known.min(points.len())]), (points.len(), count(points))));
        self.before = after;
        now.saturating_sub(found) as f64
    }
}

/// A pose whose translation is in another unit.
fn scaled(pose: &Pose, scale: f64) -> Pose {
    Pose::from_parts((pose.translation.vector * scale).into(), pose.rotation)
}

fn position(point: &MapPoint) -> Point3<f64> {
    Point3::from(point.position.to_array())
}
