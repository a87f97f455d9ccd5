//! Paths, poses, errors, confidence and warnings of a scene.

use super::layout::{Scene, rgb};
use super::moment::Moment;
use super::{Log, optics};
use crate::ReportError;
use crate::figure::Ink;
use crate::study::{MethodStudy, MotionStudy};
use endoscape_eval::MatrixPose;
use endoscape_eval::align::Similarity;
use nalgebra::Vector3;
use re_sdk::EntityPath;
use re_sdk_types::archetypes::{LineStrips3D, Scalars, SeriesLines, TextLog, Transform3D};
use re_sdk_types::components::{Color, Radius};

/// Length of a frustum as a share of the extent of the paths.
const FRUSTUM: f64 = 0.08;

/// Width of paths on the screen.
const PATH_WIDTH: f32 = 1.2;

/// Rows between two flushes.
const ROWS: usize = 4096;

/// Records what does not need pictures.
pub(super) fn record(scene: &Scene<'_>, log: &Log<'_>) -> Result<(), ReportError> {
    let frustum = FRUSTUM * extent(scene);
    truth(scene, log, frustum)?;
    for (index, method) in scene.study.methods.iter().enumerate() {
        path_and_poses(scene, log, (index, method), frustum)?;
        series(scene, log, (index, method))?;
        warnings(scene, log, method)?;
    }
    log.flush()
}

/// Diagonal of the box around all paths, metres.
fn extent(scene: &Scene<'_>) -> f64 {
    let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    let paths = scene.study.methods.iter().flat_map(MethodStudy::path).filter(|at| at[0].is_finite());
    for position in paths.map(Vector3::from) {
        (low, high) = (low.inf(&position), high.sup(&position));
    }
    if low.x <= high.x { (high - low).norm() } else { 0.0 }
}

/// The true path and camera, of the method that has most of it.
fn truth(scene: &Scene<'_>, log: &Log<'_>, frustum: f64) -> Result<(), ReportError> {
    let judged = scene.study.methods.iter().filter_map(|method| method.motion.as_ref());
    let Some(MotionStudy { trace, .. }) = judged.max_by_key(|motion| motion.trace.truth.len()) else { return Ok(()) };
    let entity = scene.truth();
    path(log, &entity, trace.truth.iter().map(position), Ink::Truth)?;
    let camera = entity.join(&"camera".into());
    lens(scene, log, &camera, Ink::Truth, frustum)?;
    poses(log, &camera, scene.clock.of_trace(trace).into_iter().zip(&trace.truth))
}

fn path_and_poses(
    scene: &Scene<'_>,
    log: &Log<'_>,
    (index, method): (usize, &MethodStudy),
    frustum: f64,
) -> Result<(), ReportError> {
    let Some(estimate) = &method.poses else { return Ok(()) };
    let world = aligned(method).apply_all(estimate.world_from_camera());
    let (entity, ink) = (scene.method(method), Ink::Method(index));
    path(log, &entity, world.iter().map(position), ink)?;
    let camera = entity.join(&"camera".into());
    lens(scene, log, &camera.join(&"picture".into()), ink, frustum)?;
    poses(log, &camera, scene.clock.of_poses(estimate).into_iter().zip(&world))
}

/// From the method's frame and unit to those of the truth; nothing changes where that is not known.
pub(super) fn aligned(method: &MethodStudy) -> Similarity {
    method.motion.as_ref().map_or_else(Similarity::identity, |motion| motion.trace.truth_from_estimate)
}

fn position(pose: &MatrixPose) -> [f64; 3] {
    pose.translation.vector.into()
}

fn path(
    log: &Log<'_>,
    entity: &EntityPath,
    positions: impl Iterator<Item = [f64; 3]>,
    ink: Ink,
) -> Result<(), ReportError> {
    let line = LineStrips3D::new([positions.collect::<Vec<_>>()])
        .with_colors([rgb(ink)])
        .with_radii([Radius::new_ui_points(PATH_WIDTH)]);
    log.put_static(&entity.join(&"path".into()), &line)
}

/// The frustum, where the camera is known.
fn lens(scene: &Scene<'_>, log: &Log<'_>, entity: &EntityPath, ink: Ink, frustum: f64) -> Result<(), ReportError> {
    let Some(mut pinhole) = scene.picture_camera().as_ref().and_then(optics::pinhole) else { return Ok(()) };
    if frustum > 0.0 {
        pinhole = pinhole.with_image_plane_distance(frustum as f32);
    }
    log.put_static(entity, &pinhole.with_color(rgb(ink)))
}

fn poses<'a>(
    log: &Log<'_>,
    entity: &EntityPath,
    poses: impl Iterator<Item = (Moment, &'a MatrixPose)>,
) -> Result<(), ReportError> {
    for (row, (moment, pose)) in poses.enumerate() {
        log.at(moment);
        let column = |index: usize| [0, 1, 2].map(|row| pose.rotation.matrix()[(row, index)] as f32);
        let rotation = [column(0), column(1), column(2)];
        log.put(entity, &Transform3D::from_translation_mat3x3(position(pose), rotation))?;
        if row % ROWS == ROWS - 1 {
            log.flush()?;
        }
    }
    Ok(())
}

/// Confidence of each frame, and the distance of each aligned position from the truth.
fn series(scene: &Scene<'_>, log: &Log<'_>, (index, method): (usize, &MethodStudy)) -> Result<(), ReportError> {
    let color = rgb(Ink::Method(index));
    let frames = method.run.iter().flat_map(|run| &run.frames);
    let confident = frames
        .filter_map(|frame| Some((Moment { frame: Some(frame.index), time_s: Some(frame.time_s) }, frame.confidence?)));
    scalars(log, &scene.confidence(method), (&method.name, color), confident)?;
    let Some(MotionStudy { trace, .. }) = &method.motion else { return Ok(()) };
    let errors_mm = trace.absolute.translation_m.iter().map(|error_m| 1e3 * error_m);
    scalars(log, &scene.error(method), (&method.name, color), scene.clock.of_trace(trace).into_iter().zip(errors_mm))
}

fn scalars(
    log: &Log<'_>,
    entity: &EntityPath,
    (name, color): (&str, Color),
    values: impl Iterator<Item = (Moment, f64)>,
) -> Result<(), ReportError> {
    let mut values = values.enumerate().peekable();
    if values.peek().is_some() {
        log.put_static(entity, &SeriesLines::new().with_names([name]).with_colors([color]))?;
    }
    for (row, (moment, value)) in values {
        log.at(moment);
        log.put(entity, &Scalars::new([value]))?;
        if row % ROWS == ROWS - 1 {
            log.flush()?;
        }
    }
    Ok(())
}

/// What the method said about its frames.
fn warnings(scene: &Scene<'_>, log: &Log<'_>, method: &MethodStudy) -> Result<(), ReportError> {
    let entity = scene.method(method).join(&"log".into());
    for frame in method.run.iter().flat_map(|run| &run.frames) {
        let Some(warning) = frame.warning.as_deref().filter(|warning| !warning.is_empty()) else { continue };
        log.at(Moment { frame: Some(frame.index), time_s: Some(frame.time_s) });
        log.put(&entity, &TextLog::new(warning).with_level("WARN"))?;
    }
    Ok(())
}
