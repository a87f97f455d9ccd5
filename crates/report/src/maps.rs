//! Depth and reliability maps on disk: found, numbered, read.

use crate::ReportError;
use endoscape_core::{DepthMap, Grid, Size};
use endoscape_eval::read::numpy;
use endoscape_frames::{Format, FrameEntry, Sequence, natural};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Metres per unit of 16-bit maps whose unit does not matter because they are scaled anyway.
pub const MILLIMETRES: f64 = 1e-3;

/// Maps (png or npy) of a folder in natural order.
///
/// # Errors
/// [`ReportError::File`] if the folder cannot be listed.
pub fn list(folder: &Path) -> Result<Vec<PathBuf>, ReportError> {
    let entries = std::fs::read_dir(folder)
        .map_err(|error| ReportError::file(folder, format!("cannot be listed: {error}"), "give a folder of maps"))?;
    let is_map = |path: &PathBuf| path.extension().is_some_and(|ending| ending == "png" || ending == "npy");
    let mut maps: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).filter(is_map).collect();
    maps.sort_by(|a, b| natural::cmp(&a.to_string_lossy(), &b.to_string_lossy()));
    Ok(maps)
}

/// The maps of a folder whose names hold a number.
///
/// # Errors
/// As [`list`].
pub fn by_number(folder: &Path) -> Result<BTreeMap<usize, PathBuf>, ReportError> {
    Ok(list(folder)?.into_iter().filter_map(|map| Some((number(&map)?, map))).collect())
}

fn number(path: &Path) -> Option<usize> {
    natural::number(&path.file_stem()?.to_string_lossy())
}

/// Maps with the frames they belong to: by number, or by order where there are as many.
///
/// # Errors
/// [`ReportError::File`] for a folder without maps, or with maps of which none belongs to a frame with depth.
pub fn pairs<'a>(estimate: &Path, sequence: &'a Sequence) -> Result<Vec<(PathBuf, &'a FrameEntry)>, ReportError> {
    let folder =
        Some(estimate.join("depth")).filter(|folder| folder.is_dir()).unwrap_or_else(|| estimate.to_path_buf());
    let maps = list(&folder)?;
    if maps.is_empty() {
        return Err(ReportError::file(
            &folder,
            "holds no depth map (png or npy)",
            "give a run folder or a folder of maps",
        ));
    }
    let true_frames: Vec<&FrameEntry> = sequence.frames.iter().filter(|frame| frame.depth.is_some()).collect();
    let numbered: BTreeMap<usize, &PathBuf> = maps.iter().filter_map(|map| Some((number(map)?, map))).collect();
    let by_number: Vec<_> = true_frames
        .iter()
        .filter_map(|frame| numbered.get(&frame.number).map(|map| ((*map).clone(), *frame)))
        .collect();
    if !by_number.is_empty() {
        return Ok(by_number);
    }
    if maps.len() == true_frames.len() {
        return Ok(maps.into_iter().zip(true_frames).collect());
    }
    let (maps, frames) = (maps.len(), true_frames.len());
    let what = format!("none of its {maps} maps has the number of one of the {frames} frames with depth");
    Err(ReportError::file(&folder, what, "name maps after frames"))
}

/// One depth map in metres; 16-bit pictures are multiplied by `metres_per_unit`, arrays hold metres.
///
/// # Errors
/// [`ReportError::File`] for a file that is no depth map.
pub fn read_depth(path: &Path, metres_per_unit: f64) -> Result<DepthMap, ReportError> {
    let bytes = bytes(path)?;
    if path.extension().is_some_and(|ending| ending == "npy") {
        return read_array(path, &bytes);
    }
    let picture = decode(path, &bytes)?;
    let units = match picture {
        image::DynamicImage::ImageLuma16(units) => units,
        image::DynamicImage::ImageLuma8(_) => picture.to_luma16(),
        _ => return Err(ReportError::file(path, "has colours, so it is no depth map", "give single-channel maps")),
    };
    let size = Size::new(units.width() as usize, units.height() as usize);
    let depth_m = units.into_raw().into_iter().map(|unit| (f64::from(unit) * metres_per_unit) as f32).collect();
    grid(path, size, depth_m).map(DepthMap::new)
}

/// A reliability map, 0 to 1, from an 8-bit picture.
///
/// # Errors
/// [`ReportError::File`] for a file that is no picture.
pub fn read_reliability(path: &Path) -> Result<Grid<f32>, ReportError> {
    let picture = decode(path, &bytes(path)?)?.to_luma8();
    let size = Size::new(picture.width() as usize, picture.height() as usize);
    grid(path, size, picture.into_raw().into_iter().map(|value| f32::from(value) / 255.0).collect())
}

fn read_array(path: &Path, bytes: &[u8]) -> Result<DepthMap, ReportError> {
    let array = numpy::array(bytes).map_err(ReportError::evaluation(path.display().to_string()))?;
    let [.., height, width] = array.shape[..] else {
        let what = format!("an array of shape {:?} is no depth map", array.shape);
        return Err(ReportError::file(path, what, "save height x width"));
    };
    let depth_m = array.values.iter().map(|value| *value as f32).collect();
    grid(path, Size::new(width, height), depth_m).map(DepthMap::new)
}

fn bytes(path: &Path) -> Result<Vec<u8>, ReportError> {
    std::fs::read(path).map_err(|error| ReportError::file(path, format!("cannot be read: {error}"), "check the file"))
}

fn decode(path: &Path, bytes: &[u8]) -> Result<image::DynamicImage, ReportError> {
    image::load_from_memory_with_format(bytes, image::ImageFormat::Png)
        .map_err(|error| ReportError::file(path, format!("cannot be read as a map: {error}"), "write it again"))
}

fn grid(path: &Path, size: Size, values: Vec<f32>) -> Result<Grid<f32>, ReportError> {
    Grid::new(size, values).map_err(|error| ReportError::file(path, error.to_string(), "write it again"))
}

/// Ranges of true depth in metres that papers count; elsewhere every known depth counts.
pub const fn usual_range_m(format: Format) -> (f64, f64) {
    match format {
        Format::KittiOdometry | Format::KittiRaw => (1e-3, 80.0),
        Format::Scared => (1e-6, 0.15),
        _ => (1e-6, 1e4),
    }
}
