//! What cameras see: pictures, depth, reliability and points, frame by frame.

use super::layout::Scene;
use super::motion::aligned;
use super::{Log, optics, unwritten};
use crate::study::MethodStudy;
use crate::{ReportError, RunFolder, maps};
use endoscape_core::{Camera, DepthMap, Frame, Image, Size};
use endoscape_frames::FrameSource;
use endoscape_frames::preprocess::resize;
use nalgebra::{Point2, Point3};
use re_sdk::EntityPath;
use re_sdk_types::archetypes::{DepthImage, EncodedImage, Points3D};
use re_sdk_types::components::{Color, Colormap, MediaType, Radius};
use std::collections::BTreeSet;
use std::sync::Arc;

/// Points of a frame; more hide the path.
const POINTS: usize = 6000;

/// Size of a point on the screen.
const POINT_SIZE: f32 = 1.5;

/// Largest value of a 16-bit map.
const LARGEST_STEP: f32 = u16::MAX as f32;

/// Frames between two flushes.
const FRAMES: usize = 32;

/// Records what does need pictures.
pub(super) fn record(scene: &Scene<'_>, log: &Log<'_>) -> Result<(), ReportError> {
    let numbers = numbers(scene);
    let mut pictures = Pictures::open(scene, &numbers)?;
    for (row, number) in numbers.into_iter().enumerate() {
        log.at(scene.clock.at_number(number));
        let picture = pictures.as_mut().and_then(|pictures| pictures.take(number));
        for (index, method) in scene.study.methods.iter().enumerate() {
            let camera = scene.method(method).join(&"camera".into());
            if let (0, Some(picture)) = (index, &picture) {
                show(log, &camera.join(&"picture".into()), picture)?;
            }
            let Some(run) = &method.run else { continue };
            depth(scene, log, (&camera, method, run), number, picture.as_deref())?;
            reliability(log, &camera, run, number)?;
        }
        if row % FRAMES == FRAMES - 1 {
            log.flush()?;
        }
    }
    Ok(())
}

/// Numbers of the frames that methods ran on.
fn numbers(scene: &Scene<'_>) -> BTreeSet<usize> {
    let mut numbers = BTreeSet::new();
    for method in &scene.study.methods {
        if let Some(run) = &method.run {
            numbers.extend(run.frames.iter().map(|frame| frame.index));
            numbers.extend(run.depth.keys().chain(run.reliability.keys()));
        }
        if let Some(poses) = &method.poses {
            numbers.extend(scene.clock.of_poses(poses).iter().filter_map(|moment| moment.frame));
        }
    }
    numbers
}

/// Pictures of the frames in order, one at a time.
struct Pictures<'a> {
    scene: &'a Scene<'a>,
    source: Box<dyn FrameSource>,
    /// The frame after the last one taken.
    ahead: Option<Frame>,
    /// How often the source may still fail: one that failed more often than it has frames would fail for ever.
    failures_left: usize,
}

impl<'a> Pictures<'a> {
    /// Opens the frames from the first to the last of `numbers`; `None` where there are no frames.
    fn open(scene: &'a Scene<'a>, numbers: &BTreeSet<usize>) -> Result<Option<Self>, ReportError> {
        let Some((sequence, (first, last))) = scene.sequence.zip(numbers.first().zip(numbers.last())) else {
            return Ok(None);
        };
        let position = |number: usize| sequence.frames.partition_point(|frame| frame.number < number);
        let range = position(*first)..position(last + 1);
        if range.is_empty() {
            return Ok(None);
        }
        let failures_left = range.len();
        Ok(Some(Self { scene, source: sequence.open_frames(range)?, ahead: None, failures_left }))
    }

    /// The picture of a frame; `None` if there is no such frame or it does not decode, about which the run has warned.
    fn take(&mut self, number: usize) -> Option<Arc<Image>> {
        loop {
            let frame = self.ahead.take().or_else(|| self.next())?;
            let found = self.scene.sequence?.frames.get(frame.index)?.number;
            if found == number {
                return Some(frame.image);
            }
            if found > number {
                self.ahead = Some(frame);
                return None;
            }
        }
    }

    fn next(&mut self) -> Option<Frame> {
        loop {
            match self.source.next_frame() {
                Ok(frame) => return frame,
                Err(_) if self.failures_left == 0 => return None,
                Err(_) => self.failures_left -= 1,
            }
        }
    }
}

fn show(log: &Log<'_>, entity: &EntityPath, picture: &Image) -> Result<(), ReportError> {
    let shrunk = resize::image(picture, optics::recorded_size(picture.size()))?;
    let bytes = optics::jpeg(&shrunk).map_err(|error| unwritten(log.path, &error))?;
    log.put(entity, &EncodedImage::from_file_contents(bytes).with_media_type(MediaType::jpeg()))
}

/// Depth and points of one frame of one method, in the scale of the truth where that is known.
fn depth(
    scene: &Scene<'_>,
    log: &Log<'_>,
    (entity, method, run): (&EntityPath, &MethodStudy, &RunFolder),
    number: usize,
    picture: Option<&Image>,
) -> Result<(), ReportError> {
    let Some(path) = run.depth.get(&number) else { return Ok(()) };
    let map = maps::read_depth(path, run.depth_unit())?.scaled(aligned(method).scale as f32);
    let camera = scene.map_camera(run, map.size());
    let place = entity.join(&"depth".into());
    if let Some(pinhole) = camera.as_ref().and_then(optics::pinhole) {
        log.put(&place, &pinhole)?;
    }
    log.put(&place, &depth_image(&map))?;
    match camera {
        Some(camera) => log.put(&entity.join(&"points".into()), &cloud(&map, &camera, picture)),
        None => Ok(()),
    }
}

/// Depth in 16 bits, as fine as the farthest point of the frame allows.
fn depth_image(map: &DepthMap) -> DepthImage {
    let farthest = map.grid().values().iter().copied().fold(f32::MIN_POSITIVE, f32::max);
    let step = |depth: &f32| (depth / farthest * LARGEST_STEP).round() as u16;
    let bytes: Vec<u8> = map.grid().values().iter().flat_map(|depth| step(depth).to_le_bytes()).collect();
    DepthImage::from_gray16(bytes, resolution(map.size()))
        .with_meter(LARGEST_STEP / farthest)
        .with_colormap(Colormap::Magma)
}

/// The points of a depth map in the colours of the picture, or white.
fn cloud(map: &DepthMap, camera: &Camera, picture: Option<&Image>) -> Points3D {
    let color = |pixel: &Point2<f64>| {
        let seen = picture.and_then(|picture| {
            let scale = |at: f64, from: usize, to: usize| ((at + 0.5) * to as f64 / from as f64) as usize;
            let (from, to) = (map.size(), picture.size());
            picture.get(scale(pixel.x, from.width, to.width), scale(pixel.y, from.height, to.height))
        });
        let [r, g, b] = seen.unwrap_or([255; 3]);
        Color::from_rgb(r, g, b)
    };
    let coordinates = |point: &Point3<f64>| -> [f64; 3] { point.coords.into() };
    let points = optics::points(map, camera, POINTS);
    Points3D::new(points.iter().map(|(_, point)| coordinates(point)))
        .with_colors(points.iter().map(|(pixel, _)| color(pixel)))
        .with_radii([Radius::new_ui_points(POINT_SIZE)])
}

fn reliability(log: &Log<'_>, entity: &EntityPath, run: &RunFolder, number: usize) -> Result<(), ReportError> {
    let Some(path) = run.reliability.get(&number) else { return Ok(()) };
    let map = maps::read_reliability(path)?;
    let bytes: Vec<u8> = map.values().iter().map(|trust| (255.0 * trust).round() as u8).collect();
    let image = re_sdk_types::archetypes::Image::from_l8(bytes, resolution(map.size()));
    log.put(&entity.join(&"reliability".into()), &image)
}

fn resolution(size: Size) -> [u32; 2] {
    [size.width as u32, size.height as u32]
}
