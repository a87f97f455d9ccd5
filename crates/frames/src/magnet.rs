//! Magnetic readings beside the frames of a sequence folder: `magnet.toml` and `magnet.csv`.
//!
//! The contents of both files are [`endoscape_core::magnetic`]'s; here they meet the disk.

use crate::formats::common;
use crate::{FramesError, Malformed};
use endoscape_core::MagneticReading;
use endoscape_core::magnetic::{self, MagneticRig, READINGS_FILE, RIG_FILE};
use std::path::Path;

/// Reads the magnet, its array and all readings of a sequence folder, in time order; `None` where it has none.
///
/// # Errors
/// [`FramesError`] with file and line for one file without the other, or content that cannot be right.
pub fn read(folder: &Path) -> Result<Option<(MagneticRig, Vec<MagneticReading>)>, FramesError> {
    let (rig_file, readings_file) = (folder.join(RIG_FILE), folder.join(READINGS_FILE));
    if !rig_file.exists() && !readings_file.exists() {
        return Ok(None);
    }
    let rig: MagneticRig = common::read_toml(&rig_file)?;
    let text = common::read_text(&readings_file)?;
    let readings = magnetic::parse_csv(&text, rig.array().positions_m.len());
    let readings = readings.map_err(|error| Malformed::from(error).at(&readings_file))?;
    Ok(Some((rig, readings)))
}

/// `magnet.toml` as text, for [`crate::sequence_folder::Writer::write_file`].
///
/// # Errors
/// [`FramesError`] for a rig that TOML cannot hold.
pub fn rig_to_toml(rig: &MagneticRig) -> Result<String, FramesError> {
    toml::to_string(rig).map_err(|error| FramesError::file(Path::new(RIG_FILE), error.to_string(), "correct the value"))
}

#[cfg(test)]
mod tests;
