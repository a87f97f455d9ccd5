//! With models that know the truth the trajectory is the truth: conventions, chaining, windows and scale hold together.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "test helpers fail by panicking and say what they skip"
)]

use endoscape_core::{Camera, DepthMap, Frame, Grid, Image, Observation, Odometry, Pose, Size, Tracked, se3};
use endoscape_odometry::networks::{DepthModel, MotionModel, Motions};
use endoscape_odometry::refine::Refiner;
use endoscape_odometry::{LearnedOdometry, OdometryConfig};
use nalgebra::{Point2, Vector3, Vector6};
use std::sync::Arc;

const SIZE: Size = Size::new(96, 64);

/// A painted wall, slanted and wavy-coloured, seen along a known path; the models' unit changes from frame to frame.
struct World {
    camera: Camera,
    poses: Vec<Pose>,
    images: Vec<Image>,
    depths: Vec<DepthMap>,
    /// Length of the models' unit at each frame.
    units: Vec<f64>,
    /// Stretches what the motion model says, forward and backward alike.
    bias: f64,
}

impl World {
    /// A walk along the wall.
    fn new(count: usize, step: f64, unit: impl Fn(usize) -> f64) -> Self {
        let twist = |t: f64| [0.5 * t, 0.1 * (2.0 * t).sin(), 0.2 * t, 0.02 * t, -0.05 * t, 0.1 * t.sin()];
        Self::along(|index| se3::exp(&Vector6::from(twist(step * index as f64))), wall, count, unit)
    }

    fn along(pose: impl Fn(usize) -> Pose, surface: Surface, count: usize, unit: impl Fn(usize) -> f64) -> Self {
        let camera = Camera::from_field_of_view(SIZE, 80_f64.to_radians()).unwrap();
        let poses: Vec<Pose> = (0..count).map(pose).collect();
        let views: Vec<_> = poses.iter().map(|pose| render(&camera, surface, pose)).collect();
        let (images, depths) = views.into_iter().unzip();
        Self { camera, poses, images, depths, units: (0..count).map(unit).collect(), bias: 1.0 }
    }

    fn index(&self, image: &Image) -> usize {
        self.images.iter().position(|known| known == image).unwrap()
    }

    /// The truth in the unit of the first frame.
    fn expected(&self, index: usize) -> Pose {
        let mut pose = self.poses[0].inverse() * self.poses[index];
        pose.translation.vector /= self.units[0];
        pose
    }
}

/// How far a ray of unit length goes from an origin before it meets the surface.
type Surface = fn(&Vector3<f64>, &Vector3<f64>) -> f64;

/// The wall `z = 2 + x / 4`.
fn wall(origin: &Vector3<f64>, direction: &Vector3<f64>) -> f64 {
    let normal = Vector3::new(-0.25, 0.0, 1.0);
    (2.0 - normal.dot(origin)) / normal.dot(direction)
}

/// A tunnel of radius 1 around the axis, closed at `z = 6`.
fn tunnel(origin: &Vector3<f64>, direction: &Vector3<f64>) -> f64 {
    let (from, along) = (origin.xy(), direction.xy());
    let (square, half) = (along.norm_squared(), from.dot(&along));
    let side = ((half * half + square * (1.0 - from.norm_squared())).sqrt() - half) / square;
    let end = (6.0 - origin.z) / direction.z;
    if side < end { side } else { end }
}

/// The colours of a surface where rays meet it, and the depth along the axis.
fn render(camera: &Camera, surface: Surface, world_from_camera: &Pose) -> (Image, DepthMap) {
    let hit = |x: usize, y: usize| {
        let ray = camera.unproject(&Point2::new(x as f64, y as f64)).unwrap();
        let (origin, direction) = (world_from_camera.translation.vector, world_from_camera.rotation * ray);
        let length = surface(&origin, &direction);
        (origin + direction * length, (length * ray.z) as f32)
    };
    let colour = |p: Vector3<f64>| {
        let wave =
            |a: f64, b: f64, phase: f64| (a * p.x + b * p.y - a * b / 9.0 * (p.z - 2.0 - p.x / 4.0) + phase).sin();
        let sum = wave(7.1, 3.7, 0.3) + wave(-4.9, 8.3, 1.1) + wave(11.3, -9.1, 2.0) + wave(2.3, 5.1, 0.7);
        (127.0 + 28.0 * sum) as u8
    };
    (Image::from_fn(SIZE, |x, y| [colour(hit(x, y).0); 3]), DepthMap::new(Grid::from_fn(SIZE, |x, y| hit(x, y).1)))
}

struct TrueDepth(Arc<World>);

impl DepthModel for TrueDepth {
    fn depth(&self, image: &Image) -> DepthMap {
        let index = self.0.index(image);
        self.0.depths[index].scaled((1.0 / self.0.units[index]) as f32)
    }
}

struct TrueMotion {
    world: Arc<World>,
    side: usize,
}

impl MotionModel for TrueMotion {
    fn side(&self) -> usize {
        self.side
    }

    fn motions(&self, target: &Image, sources: &[&Image]) -> Motions {
        assert_eq!(sources.len(), 2 * self.side);
        let World { poses, units, bias, .. } = self.world.as_ref();
        let target = self.world.index(target);
        let motion = |source: &&Image| {
            let source = self.world.index(source);
            let truth = poses[source].inverse() * poses[target];
            let mut motion = se3::exp(&(se3::log(&truth) * if source > target { *bias } else { 2.0 - bias }));
            motion.translation.vector /= units[target];
            motion
        };
        let reliability = Some(Grid::from_fn(SIZE, |x, _| x as f32 / SIZE.width as f32));
        Motions { source_from_target: sources.iter().map(motion).collect(), reliability }
    }
}

fn config(fixed_gap: usize) -> OdometryConfig {
    let least_displacement = 0.02;
    OdometryConfig { size: SIZE, fixed_gap, least_displacement, scale_memory: 1.0, refine: false, lost_below: 0.1 }
}

fn odometry(world: &Arc<World>, side: usize, fixed_gap: usize) -> LearnedOdometry {
    let motion = TrueMotion { world: world.clone(), side };
    LearnedOdometry::from_models(Box::new(TrueDepth(world.clone())), Box::new(motion), config(fixed_gap)).unwrap()
}

fn frame(index: usize, image: Image, camera: Option<Camera>) -> Observation {
    let time_s = index as f64;
    Observation::Frame(Frame { index, time_s, image: Arc::new(image), camera: camera.map(Arc::new), usable: None })
}

fn track_all(world: &Arc<World>, odometry: &mut LearnedOdometry, camera: Option<Camera>) -> Vec<Tracked> {
    let images = world.images.iter().enumerate();
    images.map(|(index, image)| odometry.track(&frame(index, image.clone(), camera)).unwrap()).collect()
}

/// Largest difference of positions, as a share of the path's length, and of rotations, radians.
fn errors(world: &World, tracked: &[Tracked]) -> (f64, f64) {
    let length: f64 = (1..world.poses.len())
        .map(|i| (world.expected(i).translation.vector - world.expected(i - 1).translation.vector).norm())
        .sum();
    let pairs = tracked.iter().enumerate().map(|(index, tracked)| {
        let difference = world.expected(index).inverse() * tracked.world_from_camera.unwrap();
        (difference.translation.vector.norm() / length, difference.rotation.angle())
    });
    pairs.fold((0.0, 0.0), |(a, b), (c, d)| (f64::max(a, c), f64::max(b, d)))
}

#[test]
fn the_truth_comes_out_whatever_window_and_gap() {
    let world = Arc::new(World::new(40, 0.02, |_| 0.7));
    for (side, fixed_gap) in [(1, 1), (1, 3), (1, 0), (2, 1), (2, 2), (3, 1), (2, 0)] {
        let tracked = track_all(&world, &mut odometry(&world, side, fixed_gap), Some(world.camera));
        let (position, rotation) = errors(&world, &tracked);
        // Frames that have moved by less than half a pixel stand still: here two frames, a twentieth of the path.
        let tolerance = if fixed_gap > 0 { 5e-3 } else { 0.08 };
        assert!(position < tolerance && rotation < 0.1 * tolerance, "{side}, {fixed_gap}: {position}, {rotation}");
        assert!(tracked.iter().all(|frame| frame.confidence > 0.8 && frame.warning.is_none()));
    }
}

#[test]
fn a_unit_that_drifts_and_jumps_is_straightened_out() {
    let wander = |index: usize| {
        0.5 * (1.0 + 0.5 * (0.2 * index as f64).sin()) * if index.is_multiple_of(3) { 1.15 } else { 1.0 }
    };
    let world = Arc::new(World::new(40, 0.02, wander));
    let tracked = track_all(&world, &mut odometry(&world, 1, 1), Some(world.camera));
    let (position, rotation) = errors(&world, &tracked);
    assert!(position < 0.02 && rotation < 1e-6, "{position}, {rotation}");
    for (index, tracked) in tracked.iter().enumerate() {
        let (depth, truth) = (tracked.depth.as_ref().unwrap(), &world.depths[index]);
        let ratio = f64::from(depth.median_m().unwrap() / truth.median_m().unwrap()) * world.units[0];
        assert!((ratio - 1.0).abs() < 0.03, "frame {index}: {ratio}");
    }
    // Without a camera nothing can be compared, so the wandering unit shows.
    let (uncorrected, _) = errors(&world, &track_all(&world, &mut odometry(&world, 1, 1), None));
    assert!(uncorrected > 3.0 * position, "{uncorrected}");
}

#[test]
fn opposite_biases_of_both_directions_cancel() {
    let straight = World::new(30, 0.02, |_| 1.0);
    let world = Arc::new(World { bias: 1.2, ..straight });
    let tracked = track_all(&world, &mut odometry(&world, 1, 1), Some(world.camera));
    let (position, _) = errors(&world, &tracked);
    // Only the latest link, a thirtieth of the path, is not yet corrected.
    assert!(position < 0.2 * 2.0 / 29.0, "{position}");
    assert!(tracked[10].confidence < 0.95);
}

#[test]
fn pictures_bring_pixels_together_from_a_poor_guess() {
    let world = World::new(13, 0.02, |_| 1.0);
    let refiner = Refiner::new(&world.camera).unwrap();
    let pictures = [0, 12].map(|index: usize| refiner.contrast(&world.images[index]).unwrap());
    let mut reference = refiner.reference(&pictures[0], world.depths[0].grid());
    let truth = world.poses[12].inverse() * world.poses[0];
    let found = refiner.refined(&mut reference, &pictures[1], &[Pose::identity()]);
    let distance = |motion: &Pose| {
        let place = |motion: &Pose, x: usize, y: usize| {
            let depth = f64::from(world.depths[0].get(x, y).unwrap());
            let point = world.camera.unproject_to_depth(&Point2::new(x as f64, y as f64), depth).unwrap();
            world.camera.project(&(motion * point)).unwrap()
        };
        let pixels: Vec<_> = (8..56).step_by(8).flat_map(|y| (8..88).step_by(8).map(move |x| (x, y))).collect();
        let apart = |&(x, y): &(usize, usize)| (place(motion, x, y) - place(&truth, x, y)).norm();
        pixels.iter().map(apart).sum::<f64>() / pixels.len() as f64
    };
    let (before, after) = (distance(&Pose::identity()), distance(&found.unwrap()));
    // Half a pixel: these pictures are 96 pixels wide, and contrast is taken over nine of them.
    assert!(before > 3.0 && after < 0.5, "{before} pixels became {after}");
}

/// Depth with too little relief: nearly the same everywhere, as networks answer before scenes they do not know.
struct FlatDepth(Arc<World>);

impl DepthModel for FlatDepth {
    fn depth(&self, image: &Image) -> DepthMap {
        let truth = &self.0.depths[self.0.index(image)];
        DepthMap::new(truth.grid().map(|depth| 2.0 * (depth / 2.0).sqrt()))
    }
}

#[test]
fn pictures_give_back_the_relief_that_the_depth_network_lacks() {
    let inwards = |index: usize| Pose::translation(0.004 * index as f64, 0.0, 0.03 * index as f64);
    let world = Arc::new(World::along(inwards, tunnel, 40, |_| 1.0));
    let deviation = |refine: bool| {
        // Keyframes far enough apart for parallax.
        let config = OdometryConfig { refine, ..config(8) };
        let motion = TrueMotion { world: world.clone(), side: 1 };
        let mut odometry =
            LearnedOdometry::from_models(Box::new(FlatDepth(world.clone())), Box::new(motion), config).unwrap();
        let tracked = track_all(&world, &mut odometry, Some(world.camera));
        let error = |(tracked, truth): (&Tracked, &DepthMap)| {
            let depth = tracked.depth.as_ref().unwrap();
            let ratios = depth.grid().values().iter().zip(truth.grid().values()).map(|(a, b)| f64::from(a / b).ln());
            let (sum, squares) =
                ratios.clone().fold((0.0, 0.0), |(sum, squares), log| (sum + log, squares + log * log));
            let count = ratios.count() as f64;
            (squares / count - (sum / count).powi(2)).sqrt()
        };
        tracked.iter().zip(&world.depths).skip(20).map(error).sum::<f64>() / 20.0
    };
    let (predicted, measured) = (deviation(false), deviation(true));
    assert!(measured < 0.75 * predicted, "relief is off by {measured}, without pictures by {predicted}");
}

#[test]
fn pictures_of_something_else_are_refused() {
    let world = World::new(1, 0.02, |_| 1.0);
    let noise = |x: usize, y: usize| [(((x * 7919 + y * 104_729) ^ (x * y * 31)) % 251) as u8; 3];
    let refiner = Refiner::new(&world.camera).unwrap();
    let known = refiner.contrast(&world.images[0]).unwrap();
    let other = refiner.contrast(&Image::from_fn(SIZE, noise)).unwrap();
    let mut reference = refiner.reference(&known, world.depths[0].grid());
    let found = refiner.refined(&mut reference, &other, &[Pose::identity()]);
    assert!(found.is_none(), "{found:?}");
}

#[test]
fn spoilt_frames_are_bridged() {
    let world = Arc::new(World::new(30, 0.02, |_| 1.0));
    let mut odometry = odometry(&world, 1, 1);
    let flat = |value: u8| Image::from_fn(SIZE, |_, _| [value; 3]);
    for (index, image) in world.images.iter().enumerate() {
        let spoilt = match index {
            0 | 10 | 11 => Some(flat(0)),
            15 => Some(flat(255)),
            20 => Some(flat(90)),
            _ => None,
        };
        let shown = spoilt.clone().unwrap_or_else(|| image.clone());
        let tracked = odometry.track(&frame(index, shown, Some(world.camera))).unwrap();
        let pose = tracked.world_from_camera.unwrap();
        assert!(pose.translation.vector.iter().all(|value| value.is_finite()));
        assert_eq!((tracked.confidence < 0.1, tracked.warning.is_some()), (spoilt.is_some(), spoilt.is_some()));
        if index > 0 {
            let expected = world.poses[1].inverse() * world.poses[index];
            let off = (expected.translation.vector - pose.translation.vector).norm();
            assert!(off < 0.01, "frame {index} is off by {off}");
        }
    }
}

#[test]
fn other_sizes_cameras_and_observations_are_taken_or_refused() {
    let world = Arc::new(World::new(3, 0.02, |_| 1.0));
    let mut odometry = odometry(&world, 1, 1);
    let reading = endoscape_core::MagneticReading { index: 0, time_s: 0.0, field_tesla: Vec::new() };
    let sentence = odometry.track(&Observation::Magnetic(reading)).unwrap_err().to_string();
    assert!(sentence.contains("it is no picture"), "{sentence}");
    let empty = Image::from_fn(Size::new(0, 0), |_, _| [0; 3]);
    assert!(odometry.track(&frame(0, empty, None)).is_err());
    assert!(odometry.track(&frame(0, world.images[0].clone(), None)).is_ok());
    assert_eq!(odometry.name(), "learned");
    assert!(odometry.stage_times().iter().any(|(stage, _)| *stage == "depth"));
}
