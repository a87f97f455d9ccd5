//! Do the poses explain how points move from picture to picture? The check for data with poses but without depth.
//!
//! A point seen along `r_a` and `r_b` and the motion between the two cameras must lie in one plane: the angle between
//! `r_b` and the plane through the baseline and `r_a` is 0 (the epipolar constraint; R. Hartley, A. Zisserman, Multiple
//! View Geometry, chapter 9), and the point must lie in front of both cameras.

use super::convention::{Convention, DepthReading, NO_MOTION, conventions};
use crate::tracks::{Track, follow};
use crate::{FramesError, Sequence};
use endoscape_core::Pose;
use nalgebra::Vector3;
use serde::Serialize;

/// Places along the sequence that are looked at.
const PLACES: usize = 6;

/// Largest distance in frames between the two pictures of a pair.
const FARTHEST_FRAMES: usize = 16;

/// Points should move at least this far (median, share of the picture's width) so that noise does not decide.
const ENOUGH_MOTION: f64 = 0.008;

/// A ray may miss its plane by this angle: about 1.5 pixels in a picture 640 wide seen over a radian.
const INLIER_RAD: f64 = 2.5e-3;

/// Fewer followed points say nothing.
const LEAST_TRACKS: usize = 40;

/// How many followed points one convention explains.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MotionScore {
    /// What it assumes.
    pub name: String,
    /// Share of the followed points that lie in their epipolar plane and in front of both cameras.
    pub explained: f64,
}

/// Scores of all conventions, the loader's first, and what follows from them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MotionCheck {
    /// One score per convention; empty where there was nothing to follow.
    pub scores: Vec<MotionScore>,
    /// Sentences for the user.
    pub warnings: Vec<String>,
}

/// Checks poses and calibration against the motion of points in the pictures.
///
/// # Errors
/// [`FramesError`] if a picture cannot be read.
pub fn check(sequence: &Sequence) -> Result<MotionCheck, FramesError> {
    let Some(camera) = &sequence.camera else { return Ok(MotionCheck::default()) };
    let mut pairs = Vec::new();
    for place in 0..PLACES {
        pairs.extend(pair_at(sequence, place * sequence.frames.len() / PLACES)?);
    }
    let tracks: usize = pairs.iter().map(|pair| pair.tracks.len()).sum();
    if tracks < LEAST_TRACKS {
        return Ok(MotionCheck::default());
    }
    let about_motion = |convention: &Convention| {
        convention.depth == DepthReading::AlongAxis && !convention.name.starts_with("translations")
    };
    let scores: Vec<MotionScore> = conventions(camera)
        .into_iter()
        .filter(about_motion)
        .map(|convention| MotionScore { explained: explained(&pairs, &convention), name: convention.name })
        .collect();
    let warnings = warning(&scores).into_iter().collect();
    Ok(MotionCheck { scores, warnings })
}

/// Two frames with poses and the points followed between them.
struct Pair {
    first: Pose,
    second: Pose,
    tracks: Vec<Track>,
}

/// A pair starting at a position, its second frame far enough away for points to have moved.
fn pair_at(sequence: &Sequence, start: usize) -> Result<Option<Pair>, FramesError> {
    let pose = |position: usize| sequence.frames.get(position).and_then(|frame| frame.world_from_camera);
    let Some(first) = pose(start) else { return Ok(None) };
    let mut gaps = Vec::new();
    let mut gap = 1;
    while gap <= FARTHEST_FRAMES && pose(start + gap).is_some() {
        gaps.push(gap);
        gap *= 2;
    }
    let positions: Vec<usize> = std::iter::once(start).chain(gaps.iter().map(|gap| start + gap)).collect();
    let images = sequence.read_images(&positions)?;
    let Some((image, later)) = images.split_first() else { return Ok(None) };
    let followed = gaps.iter().zip(later).map(|(gap, second)| (start + gap, follow(image, second)));
    let enough = ENOUGH_MOTION * image.size().width as f64;
    let moved = followed.into_iter().find(|(_, tracks)| median_motion(tracks) >= enough);
    Ok(moved.and_then(|(position, tracks)| Some(Pair { first, second: pose(position)?, tracks })))
}

fn median_motion(tracks: &[Track]) -> f64 {
    let mut motions: Vec<f64> = tracks.iter().map(|track| (track.second - track.first).norm()).collect();
    motions.sort_by(f64::total_cmp);
    motions.get(motions.len() / 2).copied().unwrap_or(0.0)
}

fn explained(pairs: &[Pair], convention: &Convention) -> f64 {
    let (mut inliers, mut all) = (0_usize, 0_usize);
    for pair in pairs {
        let second_from_first = convention.pose(&pair.second).inverse() * convention.pose(&pair.first);
        let rays = pair.tracks.iter().filter_map(|track| {
            Some((convention.camera.unproject(&track.first)?, convention.camera.unproject(&track.second)?))
        });
        inliers += rays.filter(|(a, b)| is_explained(&second_from_first, a, b)).count();
        all += pair.tracks.len();
    }
    inliers as f64 / all.max(1) as f64
}

/// Whether two rays can see one point in front of both cameras.
fn is_explained(second_from_first: &Pose, ray_first: &Vector3<f64>, ray_second: &Vector3<f64>) -> bool {
    let turned = second_from_first.rotation * ray_first;
    let baseline = second_from_first.translation.vector;
    let Some(direction) = baseline.try_normalize(1e-12) else {
        return turned.cross(ray_second).norm() < INLIER_RAD;
    };
    let plane = direction.cross(&turned);
    if plane.norm() < INLIER_RAD {
        // Seen along the baseline: the plane is undefined, the direction is not.
        return turned.cross(ray_second).norm() < INLIER_RAD;
    }
    let out_of_plane = ray_second.dot(&plane.normalize()).abs();
    out_of_plane < INLIER_RAD && meets_in_front(&turned, &baseline, ray_second)
}

/// Whether `along_a * a + baseline` and `along_b * b` come nearest for positive lengths, or the rays are parallel.
fn meets_in_front(a: &Vector3<f64>, baseline: &Vector3<f64>, b: &Vector3<f64>) -> bool {
    let cosine = a.dot(b);
    let determinant = 1.0 - cosine * cosine;
    if determinant < 1e-8 {
        return true;
    }
    let along_a = (b.dot(baseline) * cosine - a.dot(baseline)) / determinant;
    let along_b = (b.dot(baseline) - a.dot(baseline) * cosine) / determinant;
    along_a > 0.0 && along_b > 0.0
}

fn warning(scores: &[MotionScore]) -> Option<String> {
    let (loaded, others) = scores.split_first()?;
    let best = others.iter().max_by(|a, b| a.explained.total_cmp(&b.explained))?;
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    let best_moving = scores.iter().filter(|score| score.name != NO_MOTION).map(|score| score.explained).fold(0.0, f64::max);
    let still = scores.iter().find(|score| score.name == NO_MOTION).map_or(0.0, |score| score.explained);
    if best_moving < 0.3 || still > best_moving {
        return Some(format!(
            "the poses do not seem to belong to these frames: no reading of them explains more than {} of the points followed from picture to picture; check that pose file and frames are of the same recording",
            percent(best_moving)
        ));
    }
    // A tie is no evidence: many mistakes cannot be told apart on a straight path.
    (best.explained > loaded.explained + 0.15).then(|| {
        format!(
            "the motion of points agrees better under another convention, `{}` ({} of the points against {} as loaded); correct the data set or its calibration before you trust its poses",
            best.name,
            percent(best.explained),
            percent(loaded.explained)
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use endoscape_core::{Camera, Size, se3};
    use nalgebra::{Point3, Vector6};

    fn pairs(motion: Pose) -> (Camera, Vec<Pair>) {
        let camera = Camera::from_field_of_view(Size::new(640, 480), 1.2).unwrap();
        let first = se3::exp(&Vector6::new(0.1, 0.2, -0.1, 0.3, -0.2, 0.5));
        let second = first * motion;
        let points = (0..400).map(|i| {
            let (u, v) = (f64::from(i % 20) / 19.0 - 0.5, f64::from(i / 20) / 19.0 - 0.5);
            Point3::new(u, v, 1.0 + 0.5 * (7.0 * u).sin() * (5.0 * v).cos())
        });
        let tracks = points.filter_map(|point| {
            Some(Track { first: camera.project(&point)?, second: camera.project(&(motion.inverse() * point))? })
        });
        (camera, vec![Pair { first, second, tracks: tracks.collect() }])
    }

    fn scores(motion: Pose, mistake: impl Fn(&Pose) -> Pose) -> Vec<MotionScore> {
        let (camera, mut pairs) = pairs(motion);
        for pair in &mut pairs {
            (pair.first, pair.second) = (mistake(&pair.first), mistake(&pair.second));
        }
        let score = |convention: Convention| MotionScore { explained: explained(&pairs, &convention), name: convention.name };
        conventions(&camera).into_iter().map(score).collect()
    }

    #[test]
    fn true_poses_explain_the_motion_of_every_point() {
        let motion = se3::exp(&Vector6::new(0.05, -0.02, 0.08, 0.03, -0.06, 0.04));
        let scores = scores(motion, |pose| *pose);
        assert!(scores[0].explained > 0.99);
        assert_eq!(warning(&scores), None);
    }

    #[test]
    fn inverted_poses_are_named() {
        let motion = se3::exp(&Vector6::new(0.05, -0.02, 0.08, 0.03, -0.06, 0.04));
        let sentence = warning(&scores(motion, Pose::inverse)).unwrap();
        assert!(sentence.contains("inverse pose"), "{sentence}");
    }

    #[test]
    fn foreign_poses_are_named() {
        let motion = se3::exp(&Vector6::new(0.05, -0.02, 0.08, 0.03, -0.06, 0.04));
        let foreign = |pose: &Pose| se3::exp(&(se3::log(pose) * 3.0));
        assert!(warning(&scores(motion, foreign)).is_some());
    }
}
