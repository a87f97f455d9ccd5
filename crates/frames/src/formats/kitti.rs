//! What the two KITTI layouts share: calibration files of `KEY: numbers` lines, and what they say about a camera.
//!
//! A. Geiger, P. Lenz, C. Stiller, R. Urtasun, "Vision meets robotics: the KITTI dataset", IJRR 32 (2013), names the
//! matrices; all are row by row.

use super::common;
use crate::FramesError;
use endoscape_core::camera::{Intrinsics, Pinhole};
use endoscape_core::trajectory::{TextError, numbers, records};
use endoscape_core::{Camera, CameraError, Pose, Size, se3};
use nalgebra::{Matrix3, Vector3};
use std::path::Path;

/// Frames per second of the synchronised recordings.
pub const FPS: f64 = 10.0;

/// Licence the data set states.
pub const LICENSE: &str = "CC BY-NC-SA 3.0";

/// Endings of the numbered frames; the originals are PNG.
pub const PICTURES: &[&str] = &[".png", ".jpg", ".jpeg"];

/// The lines of a calibration file; numbers are read when they are asked for, because some lines hold dates.
pub struct Calibration<'a> {
    entries: Vec<(usize, &'a str, &'a str)>,
    /// The line a missing entry is reported at.
    last_line: usize,
}

/// Splits a calibration file into its `KEY: values` lines.
///
/// # Errors
/// [`TextError`] at the first line without a colon.
pub fn parse_calibration(text: &str) -> Result<Calibration<'_>, TextError> {
    let entries = records(text).map(|(line, record)| match record.split_once(':') {
        Some((key, values)) => Ok((line, key.trim(), values.trim())),
        None => Err(TextError { line, reason: "expected `KEY: numbers`".into() }),
    });
    let entries = entries.collect::<Result<_, _>>()?;
    Ok(Calibration { entries, last_line: text.lines().count().max(1) })
}

impl Calibration<'_> {
    /// The `N` numbers of `key`.
    ///
    /// # Errors
    /// [`TextError`] if the key is missing (at the last line) or its line does not hold `N` finite numbers.
    pub fn values<const N: usize>(&self, key: &str) -> Result<[f64; N], TextError> {
        let (line, _, values) = self.entry(key)?;
        numbers(line, values.split_whitespace(), key)
    }

    /// The rigid motion with the rotation `rotation_key` (9 numbers) and the translation `translation_key` (3), metres.
    ///
    /// # Errors
    /// As [`Calibration::values`], or if the 9 numbers are no rotation.
    pub fn rigid(&self, rotation_key: &str, translation_key: &str) -> Result<Pose, TextError> {
        let translation_m: [f64; 3] = self.values(translation_key)?;
        self.rotation(rotation_key, Vector3::from(translation_m))
    }

    /// The rotation `key` (9 numbers) as a motion that moves the origin by `translation_m`.
    ///
    /// # Errors
    /// As [`Calibration::rigid`].
    pub fn rotation(&self, key: &str, translation_m: Vector3<f64>) -> Result<Pose, TextError> {
        let rotation: [f64; 9] = self.values(key)?;
        se3::from_matrix(&Matrix3::from_row_slice(&rotation), &translation_m)
            .map_err(|error| TextError { line: self.line(key), reason: format!("{key}: {error}") })
    }

    /// The rectified camera `key`.
    ///
    /// # Errors
    /// As [`Calibration::values`], or if the numbers are no projection.
    pub fn projection(&self, key: &str) -> Result<Projection, TextError> {
        let refused = |reason: &str| TextError { line: self.line(key), reason: format!("{key}: {reason}") };
        let p: [f64; 12] = self.values(key)?;
        let matrix = Matrix3::new(p[0], p[1], p[2], p[4], p[5], p[6], p[8], p[9], p[10]);
        if [p[4], p[8], p[9], p[10] - 1.0].iter().any(|value| value.abs() > 1e-9) {
            return Err(refused("the left 3x3 part is not a camera matrix"));
        }
        let inverse = matrix.try_inverse().ok_or_else(|| refused("its focal lengths are zero"))?;
        let intrinsics = Intrinsics { fx: p[0], fy: p[5], cx: p[2], cy: p[6], skew: p[1] };
        let shift_m = inverse * Vector3::new(p[3], p[7], p[11]);
        Ok(Projection {
            intrinsics,
            camera_from_first: Pose::from_parts(shift_m.into(), nalgebra::UnitQuaternion::identity()),
        })
    }

    fn entry(&self, key: &str) -> Result<(usize, &str, &str), TextError> {
        let found = self.entries.iter().find(|(_, name, _)| *name == key).copied();
        found.ok_or_else(|| TextError { line: self.last_line, reason: format!("the file ends without an entry {key}") })
    }

    fn line(&self, key: &str) -> usize {
        self.entry(key).map_or(self.last_line, |(line, ..)| line)
    }
}

/// A 3x4 projection `K [I | b]` of points in the frame of rectified camera 0.
pub struct Projection {
    /// `K`.
    pub intrinsics: Intrinsics,
    /// The shift by `b`: maps points of rectified camera 0 to this camera, metres.
    pub camera_from_first: Pose,
}

impl Projection {
    /// The pinhole of pictures of `size`.
    ///
    /// # Errors
    /// As [`Camera::new`].
    pub fn camera(&self, size: Size) -> Result<Camera, CameraError> {
        Camera::new(size, Pinhole { intrinsics: self.intrinsics }.into())
    }
}

/// Reads a calibration file and hands its entries to `read`, so that errors name the file.
///
/// # Errors
/// [`FramesError`] if the file is unreadable, or what `read` refused.
pub fn with_calibration<T>(
    file: &Path,
    read: impl FnOnce(&Calibration<'_>) -> Result<T, TextError>,
) -> Result<T, FramesError> {
    let text = common::read_text(file)?;
    parse_calibration(&text).and_then(|calibration| read(&calibration)).map_err(|error| (file, error).into())
}
