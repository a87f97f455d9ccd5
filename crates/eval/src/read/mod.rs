//! Trajectories from the contents of files, told apart by what they hold.
//!
//! | format | contents |
//! |---|---|
//! | `tum` | lines `time tx ty tz qx qy qz qw` |
//! | `kitti` | lines of 12 numbers, or 13 with the number of the frame in front |
//! | `euroc` | lines `time_ns, px, py, pz, qw, qx, qy, qz, ...` |
//! | `csv` | a header line that names the columns |
//! | `npy`, `npz` | an array of poses, see [`numpy`] |

pub mod numpy;
mod text;

use crate::EvalError;
use crate::poses::{Duplicates, Poses};
use std::fmt;
use std::str::FromStr;

/// The file formats trajectories are read from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrajectoryFormat {
    /// TUM RGB-D.
    Tum,
    /// KITTI odometry.
    Kitti,
    /// EuRoC MAV ground truth.
    Euroc,
    /// Comma-separated with a header.
    Csv,
    /// One NumPy array.
    Npy,
    /// Several NumPy arrays in one archive.
    Npz,
}

const NAMES: [(TrajectoryFormat, &str); 6] = [
    (TrajectoryFormat::Tum, "tum"),
    (TrajectoryFormat::Kitti, "kitti"),
    (TrajectoryFormat::Euroc, "euroc"),
    (TrajectoryFormat::Csv, "csv"),
    (TrajectoryFormat::Npy, "npy"),
    (TrajectoryFormat::Npz, "npz"),
];

impl fmt::Display for TrajectoryFormat {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = NAMES.iter().find(|(format, _)| format == self).map_or("unknown", |(_, name)| name);
        formatter.write_str(name)
    }
}

impl FromStr for TrajectoryFormat {
    type Err = EvalError;

    fn from_str(text: &str) -> Result<Self, EvalError> {
        NAMES.iter().find(|(_, name)| *name == text).map(|(format, _)| *format).ok_or_else(|| EvalError::Setting {
            what: format!("`{text}` is no trajectory format"),
            remedy: "choose one of tum, kitti, euroc, csv, npy, npz",
        })
    }
}

/// Reads the poses a file holds; without `format` the contents decide.
///
/// # Errors
/// [`EvalError`] with the first line that is wrong, or the reason why the whole is no trajectory.
pub fn poses(bytes: &[u8], format: Option<TrajectoryFormat>, duplicates: Duplicates) -> Result<Poses, EvalError> {
    match format.map_or_else(|| detect(bytes), Ok)? {
        TrajectoryFormat::Npy => numpy::poses_of_npy(bytes, duplicates),
        TrajectoryFormat::Npz => numpy::poses_of_npz(bytes, duplicates),
        TrajectoryFormat::Tum => text::tum(as_text(bytes)?, duplicates),
        TrajectoryFormat::Kitti => text::kitti(as_text(bytes)?, duplicates),
        TrajectoryFormat::Euroc => text::euroc(as_text(bytes)?, duplicates),
        TrajectoryFormat::Csv => text::csv(as_text(bytes)?, duplicates),
    }
}

/// Names the format of a file by its first bytes and its first line of data.
///
/// # Errors
/// [`EvalError::NoTrajectory`] or [`EvalError::Empty`].
pub fn detect(bytes: &[u8]) -> Result<TrajectoryFormat, EvalError> {
    if bytes.starts_with(numpy::NPY_MAGIC) {
        return Ok(TrajectoryFormat::Npy);
    }
    if bytes.starts_with(b"PK\x03\x04") {
        return Ok(TrajectoryFormat::Npz);
    }
    text::detect(as_text(bytes)?)
}

fn as_text(bytes: &[u8]) -> Result<&str, EvalError> {
    let text = std::str::from_utf8(bytes)
        .map_err(|_| EvalError::NoTrajectory { reason: "neither text nor a NumPy array".into() })?;
    Ok(text.strip_prefix('\u{feff}').unwrap_or(text))
}

#[cfg(test)]
mod tests;
