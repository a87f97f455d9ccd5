//! What the loaders share: listing, reading with a limit, pairing, fitting a camera to its frames.

use crate::sequence::{FrameEntry, ImageLocation};
use crate::{FramesError, natural, picture};
use endoscape_core::{Camera, Size};
use std::io::Read as _;
use std::path::{Path, PathBuf};

/// Largest text file a loader reads, in bytes: ten hours of poses at 60 Hz stay far below it.
const LARGEST_TEXT: u64 = 1 << 30;

/// Files directly in `folder` that `keep` accepts by name, in natural order.
pub fn list(folder: &Path, keep: impl Fn(&str) -> bool) -> Result<Vec<PathBuf>, FramesError> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|error| FramesError::io(folder, "list", error))? {
        let entry = entry.map_err(|error| FramesError::io(folder, "list", error))?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if keep(&name) {
            names.push(name);
        }
    }
    names.sort_by(|a, b| natural::cmp(a, b));
    Ok(names.into_iter().map(|name| folder.join(name)).filter(|path| path.is_file()).collect())
}

/// Whether a file name ends like a picture's.
pub fn is_picture(name: &str) -> bool {
    extension(name).is_some_and(|extension| picture::EXTENSIONS.contains(&extension.as_str()))
}

/// Ending of a file name in lower case, without its dot.
pub fn extension(name: &str) -> Option<String> {
    Path::new(name).extension().map(|extension| extension.to_string_lossy().to_lowercase())
}

/// Reads a whole text file, refusing one that is absurdly large or not text.
pub fn read_text(path: &Path) -> Result<String, FramesError> {
    let bytes = read_bytes(path, LARGEST_TEXT)?;
    String::from_utf8(bytes).map_err(|_| FramesError::file(path, "is not text", "fetch the file again"))
}

/// Reads a whole file of at most `limit` bytes.
pub fn read_bytes(path: &Path, limit: u64) -> Result<Vec<u8>, FramesError> {
    let file = std::fs::File::open(path).map_err(|error| FramesError::io(path, "read", error))?;
    let mut bytes = Vec::new();
    file.take(limit + 1).read_to_end(&mut bytes).map_err(|error| FramesError::io(path, "read", error))?;
    if bytes.len() as u64 > limit {
        let reason = format!("is larger than {} MiB, which no such file is", limit >> 20);
        return Err(FramesError::file(path, reason, "check that it is the right file"));
    }
    Ok(bytes)
}

/// The name a path ends in, for messages and sequence names.
pub fn name_of(path: &Path) -> String {
    let full = path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
    full.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned())
}

/// Frame number in a file name, or `fallback` where it has none.
pub fn number_of(path: &Path, fallback: usize) -> usize {
    path.file_stem().and_then(|stem| natural::number(&stem.to_string_lossy())).unwrap_or(fallback)
}

/// A frame that is a picture of its own and nothing else yet.
pub fn frame_of(path: &Path, number: usize, time_s: f64) -> FrameEntry {
    let image = ImageLocation::File(path.to_path_buf());
    FrameEntry { number, time_s, image, depth: None, mask: None, world_from_camera: None }
}

/// The camera read out at the size the frames have; a warning says so when that is not the calibration's size.
pub fn fit_camera(
    camera: Camera,
    frames: Size,
    warnings: &mut Vec<String>,
) -> Result<Camera, endoscape_core::CameraError> {
    if camera.size() == frames {
        return Ok(camera);
    }
    warnings.push(format!(
        "the frames are {frames} but the calibration is for {}: the intrinsics were scaled to the frames",
        camera.size()
    ));
    camera.scaled_to(frames)
}

/// A sentence on poses and frames that do not pair one to one; `None` when they do.
pub fn pairing_warning(frames: usize, poses: usize, matched: usize) -> Option<String> {
    (frames != matched || poses != matched).then(|| {
        format!(
            "{matched} of {frames} frames have a pose; {} of {poses} poses belong to no frame",
            poses.saturating_sub(matched)
        )
    })
}
