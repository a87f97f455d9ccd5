//! Poses of SCARED: one JSON file per frame, usually in a compressed archive.

use crate::malformed::Malformed;
use crate::natural;
use endoscape_core::{Pose, se3};
use flate2::read::GzDecoder;
use nalgebra::{Matrix3, Vector3};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

/// Largest JSON file read, in bytes; real ones have about a kilobyte.
pub const LARGEST_JSON: u64 = 1 << 20;
/// Most bytes an archive may unpack to.
const LARGEST_UNPACKED: u64 = 1 << 30;

#[derive(Deserialize)]
struct FrameData {
    #[serde(rename = "camera-pose")]
    camera_from_keyframe: [[f64; 4]; 4],
}

/// Reads the pose in one JSON file, as `world_from_camera` in metres; the world is the keyframe's left camera.
///
/// # Errors
/// [`Malformed`] with the line if it is no such JSON, or if the matrix is no rigid motion.
pub fn parse_frame_data(bytes: &[u8]) -> Result<Pose, Malformed> {
    let data: FrameData = serde_json::from_slice(bytes)
        .map_err(|error| Malformed::line(error.line().max(1), format!("holds no 4x4 camera-pose ({error})")))?;
    let m = data.camera_from_keyframe;
    let rotation = Matrix3::from_fn(|row, column| m[row][column]);
    let translation_m = Vector3::from_fn(|row, _| 1e-3 * m[row][3]);
    let camera_from_keyframe = se3::from_matrix(&rotation, &translation_m)
        .map_err(|error| Malformed::whole(format!("camera-pose: {error}")))?;
    Ok(camera_from_keyframe.inverse())
}

/// Reads every `frame_data*.json` of a `.tar.gz`, by the number in its name.
///
/// # Errors
/// [`Malformed`] if it is no such archive, unpacks to absurd sizes, or with the name of the first bad file in it.
pub fn parse_archive(bytes: &[u8]) -> Result<BTreeMap<usize, Pose>, Malformed> {
    let unreadable = |error: std::io::Error| Malformed::whole(format!("is no readable .tar.gz archive ({error})"));
    let mut archive = tar::Archive::new(Bounded { inner: GzDecoder::new(bytes), left: LARGEST_UNPACKED });
    let mut poses = BTreeMap::new();
    for entry in archive.entries().map_err(unreadable)? {
        let entry = entry.map_err(unreadable)?;
        let path = entry.path().map_err(unreadable)?.into_owned();
        let Some(number) = frame_number(&path) else { continue };
        let mut json = Vec::new();
        entry.take(LARGEST_JSON).read_to_end(&mut json).map_err(unreadable)?;
        let pose = parse_frame_data(&json)
            .map_err(|error| Malformed::whole(format!("{} in it {}", path.display(), error.reason)))?;
        poses.insert(number, pose);
    }
    Ok(poses)
}

fn frame_number(path: &Path) -> Option<usize> {
    let name = path.file_name()?.to_str()?;
    natural::number(name.strip_prefix("frame_data")?.strip_suffix(".json")?)
}

/// Fails instead of unpacking without end.
struct Bounded<R> {
    inner: R,
    left: u64,
}

impl<R: Read> Read for Bounded<R> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let read = self.inner.read(buffer)?;
        self.left = self
            .left
            .checked_sub(read as u64)
            .ok_or_else(|| std::io::Error::other(format!("it unpacks to more than {} MiB", LARGEST_UNPACKED >> 20)))?;
        Ok(read)
    }
}
