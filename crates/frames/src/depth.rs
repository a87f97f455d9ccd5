//! Depth maps as the data sets store them, turned into metres along the optical axis.

use crate::formats::common::read_bytes;
use crate::{FramesError, picture};
use endoscape_core::{Camera, DepthMap, Grid, Pose, Size};
use exr::prelude::{FlatSamples, MetaData};
use image::DynamicImage;
use nalgebra::Point3;
use std::path::{Path, PathBuf};

/// Largest laser scan in bytes; a turn of the sensor used with KITTI is 2 MB.
const LARGEST_SCAN: u64 = 256 << 20;
/// What to do about a depth file that cannot be used.
const REMEDY: &str = "fetch the file again or leave the depth away";

/// A file that holds the depth of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthFile {
    /// The file.
    pub path: PathBuf,
    /// How its numbers are to be understood.
    pub encoding: DepthEncoding,
}

impl DepthEncoding {
    /// Whether the depths are right up to an unknown factor only.
    pub const fn is_scale_free(&self) -> bool {
        matches!(self, Self::InverseLike { .. })
    }
}

/// How stored numbers become metres.
#[derive(Clone, Debug, PartialEq)]
pub enum DepthEncoding {
    /// A single-channel integer picture (PNG or TIFF): metres = value x `metres_per_unit`; values of 0 and above
    /// `largest` are unknown.
    Linear {
        /// Metres per stored unit.
        metres_per_unit: f64,
        /// Largest value that is a measurement.
        largest: u16,
    },
    /// Brighter is nearer, on a scale nobody states (EndoSLAM UnityCam): metres = `metres_per_unit` x 255 / value,
    /// fit for comparisons up to scale only.
    InverseLike {
        /// Metres at the brightest value.
        metres_per_unit: f64,
    },
    /// Three-channel float TIFF of camera-frame points in millimetres (SCARED); the third channel is the depth, rows
    /// from `first_row` for `rows` rows.
    PointsTiff {
        /// First row of the left camera's part.
        first_row: usize,
        /// Rows of that part.
        rows: usize,
    },
    /// OpenEXR with depth in its R channel (EndoMapper simulated), or in Z or Y where there is no R.
    Exr {
        /// Metres per stored unit.
        metres_per_unit: f64,
    },
    /// Velodyne scan (binary f32 x, y, z, reflectance) to be projected into the camera.
    Velodyne {
        /// Maps laser points to the (rectified) camera frame, metres.
        camera_from_velodyne: Pose,
    },
}

impl DepthFile {
    /// The depth of a frame of `size`, in metres along the optical axis.
    ///
    /// `camera` is needed for laser scans only, which are points in space rather than pictures.
    ///
    /// # Errors
    /// [`FramesError`] for a file that is missing, damaged, of another size than the frame or of another kind than
    /// its encoding says, and for a laser scan without a camera.
    pub fn read(&self, camera: Option<&Camera>, size: Size) -> Result<DepthMap, FramesError> {
        let path = &self.path;
        match &self.encoding {
            DepthEncoding::Linear { metres_per_unit, largest } => {
                integers(path, size, |value| if value <= *largest { f64::from(value) * metres_per_unit } else { 0.0 })
            }
            // Division by zero gives infinity, which is unknown, as it should be.
            DepthEncoding::InverseLike { metres_per_unit } => {
                integers(path, size, |value| metres_per_unit * 255.0 / f64::from(value))
            }
            DepthEncoding::PointsTiff { first_row, rows } => points(path, size, *first_row, *rows),
            DepthEncoding::Exr { metres_per_unit } => open_exr(path, size, *metres_per_unit),
            DepthEncoding::Velodyne { camera_from_velodyne } => match camera {
                Some(camera) => scan(path, size, camera, camera_from_velodyne),
                None => Err(FramesError::Request {
                    what: format!("{}: a laser scan cannot become a depth map without a camera", path.display()),
                    remedy: "give the calibration with --camera".into(),
                }),
            },
        }
    }
}

/// Refuses a depth map of another size than its frame.
fn check_size(path: &Path, got: Size, frame: Size) -> Result<(), FramesError> {
    if got == frame {
        return Ok(());
    }
    Err(FramesError::file(path, format!("the depth map is {got} but its frame is {frame}"), REMEDY))
}

fn wrong_kind(path: &Path, reason: impl Into<String>) -> FramesError {
    FramesError::file(path, reason, REMEDY)
}

/// Takes row-major depths in metres; `f64` until here, so that only one rounding happens.
fn map_from(path: &Path, size: Size, depth_m: impl Iterator<Item = f64>) -> Result<DepthMap, FramesError> {
    let values = depth_m.map(|value| value as f32).collect();
    Grid::new(size, values).map(DepthMap::new).map_err(|error| wrong_kind(path, error.to_string()))
}

/// An integer picture: grey, or colour whose channels are all alike.
fn integers(path: &Path, size: Size, metres: impl Fn(u16) -> f64) -> Result<DepthMap, FramesError> {
    let decoded = picture::decode(path)?;
    check_size(path, Size::new(decoded.width() as usize, decoded.height() as usize), size)?;
    let (channels, colours) =
        (usize::from(decoded.color().channel_count()), if decoded.color().has_color() { 3 } else { 1 });
    let values: Vec<u16> = match decoded {
        DynamicImage::ImageLuma16(picture) => picture.into_raw(),
        DynamicImage::ImageLumaA16(picture) => picture.into_raw(),
        DynamicImage::ImageRgb16(picture) => picture.into_raw(),
        DynamicImage::ImageRgba16(picture) => picture.into_raw(),
        DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_) => {
            return Err(wrong_kind(path, "holds floating-point numbers where integer depth was expected"));
        }
        bytes => bytes.into_bytes().into_iter().map(u16::from).collect(),
    };
    let pixels = values.chunks_exact(channels);
    if pixels.clone().any(|pixel| pixel[..colours].iter().any(|value| *value != pixel[0])) {
        return Err(wrong_kind(path, "is a colour picture, not a depth map"));
    }
    map_from(path, size, pixels.map(|pixel| metres(pixel[0])))
}

/// The part of a three-channel float TIFF of points in millimetres that belongs to one camera.
fn points(path: &Path, size: Size, first_row: usize, rows: usize) -> Result<DepthMap, FramesError> {
    let DynamicImage::ImageRgb32F(points) = picture::decode(path)? else {
        return Err(wrong_kind(path, "does not hold three floating-point numbers per pixel"));
    };
    let (width, height) = (points.width() as usize, points.height() as usize);
    check_size(path, Size::new(width, rows), size)?;
    if first_row.checked_add(rows).is_none_or(|end| end > height) {
        let reason =
            format!("has {height} rows but rows {first_row} to {} were expected", first_row.saturating_add(rows));
        return Err(wrong_kind(path, reason));
    }
    let part = &points.as_raw()[3 * width * first_row..3 * width * (first_row + rows)];
    map_from(path, size, part.chunks_exact(3).map(|point| 1e-3 * f64::from(point[2])))
}

fn open_exr(path: &Path, size: Size, metres_per_unit: f64) -> Result<DepthMap, FramesError> {
    let damaged = |error: exr::error::Error| wrong_kind(path, format!("is no readable OpenEXR file ({error})"));
    std::fs::File::open(path).map_err(|error| FramesError::io(path, "read", error))?;
    // The header first: pixels are decoded only once their number is known to be that of the frame.
    let header = MetaData::read_from_file(path, false).map_err(damaged)?;
    let layer = header.headers.first().ok_or_else(|| wrong_kind(path, "has no layer"))?;
    check_size(path, Size::new(layer.layer_size.width(), layer.layer_size.height()), size)?;
    let image = exr::prelude::read_first_flat_layer_from_file(path).map_err(damaged)?;
    let channels = image.layer_data.channel_data.list;
    let found = ["R", "Z", "Y"].iter().find_map(|name| channels.iter().find(|channel| channel.name.eq(name)));
    let samples = found.ok_or_else(|| wrong_kind(path, "has none of the channels R, Z and Y"))?;
    let values: Vec<f64> = match &samples.sample_data {
        FlatSamples::F16(values) => values.iter().map(|value| value.to_f64()).collect(),
        FlatSamples::F32(values) => values.iter().map(|value| f64::from(*value)).collect(),
        FlatSamples::U32(values) => values.iter().map(|value| f64::from(*value)).collect(),
    };
    map_from(path, size, values.into_iter().map(|value| value * metres_per_unit))
}

/// Projects laser points into the camera; of several on one pixel the nearest is the one seen.
fn scan(path: &Path, size: Size, camera: &Camera, camera_from_velodyne: &Pose) -> Result<DepthMap, FramesError> {
    check_size(path, camera.size(), size)?;
    let bytes = read_bytes(path, LARGEST_SCAN)?;
    let (records, rest) = bytes.as_chunks::<16>();
    if !rest.is_empty() {
        return Err(wrong_kind(path, "ends in the middle of a point (16 bytes each)"));
    }
    let mut depth = Grid::filled(size, DepthMap::UNKNOWN);
    for record in records {
        let coordinate =
            |at: usize| f64::from(f32::from_le_bytes([record[at], record[at + 1], record[at + 2], record[at + 3]]));
        let point = camera_from_velodyne * Point3::new(coordinate(0), coordinate(4), coordinate(8));
        let Some(pixel) = camera.project(&point).filter(|pixel| camera.contains(pixel) && point.z > 0.0) else {
            continue;
        };
        // Inside the picture, so rounding gives a pixel; the far edge itself may round one beyond it.
        let (x, y) = (pixel.x.round().max(0.0) as usize, pixel.y.round().max(0.0) as usize);
        let at = y.min(size.height - 1) * size.width + x.min(size.width - 1);
        let seen = &mut depth.values_mut()[at];
        if *seen == DepthMap::UNKNOWN || (point.z as f32) < *seen {
            *seen = point.z as f32;
        }
    }
    Ok(DepthMap::new(depth))
}

#[cfg(test)]
mod tests;
