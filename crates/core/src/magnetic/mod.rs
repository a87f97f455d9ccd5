//! A small magnet in the capsule and an array of Hall sensors outside the patient.
//!
//! | file in a sequence folder | what | here |
//! |---|---|---|
//! | [`RIG_FILE`] `magnet.toml` | the magnet, where it sits on the camera, the array and where it stands | [`MagneticRig`] |
//! | [`READINGS_FILE`] `magnet.csv` | one line per reading | [`parse_csv`], [`to_csv`], [`csv_header`], [`csv_row`] |
//!
//! The array's frame: sensors near the plane z = 0, the magnet on the side of positive z. That side is part of the
//! definition, because sensors that measure only along z cannot tell a magnet from its mirror image behind the plane.
//!
//! [`MagneticReading::field_tesla`](crate::MagneticReading::field_tesla) has one entry per sensor, in the order of
//! [`HallArray::positions_m`]. Of an entry only the components along [`HallArray::axes`] are measurements; whatever
//! else stands there is ignored, and so is a component that is not finite.

mod dipole;
mod rig;
mod text;

pub use dipole::{Dipole, MU_0_OVER_4_PI};
pub use rig::{HallArray, Magnet, MagneticError, MagneticRig};
pub use text::{csv_header, csv_row, parse_csv, to_csv};

/// Name of the file of readings in a sequence folder.
pub const READINGS_FILE: &str = "magnet.csv";
/// Name of the file that describes magnet and array in a sequence folder.
pub const RIG_FILE: &str = "magnet.toml";

#[cfg(test)]
mod tests;
