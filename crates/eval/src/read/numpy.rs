//! NumPy arrays: `.npy`, and `.npz` archives of them.
//!
//! The header is read here and not by a library because the libraries at hand allocate whatever a header claims; a
//! header may claim anything. Format: NumPy Enhancement Proposal 1 and `numpy.lib.format`.
//!
//! Poses are arrays of shape `(N, 4, 4)`, `(N, 3, 4)` or `(N, 12)` (matrices), `(N, 7)` (`tx ty tz qx qy qz qw`) or
//! `(N, 8)` (the same with the time in seconds in front). An archive may hold the times as an array of shape `(N,)`
//! named `times`, `timestamps` or `time_s`.

use super::text::matrix_pose;
use crate::EvalError;
use crate::poses::{Duplicates, MatrixPose, Poses, Stamps};
use endoscape_core::{TimedPose, se3};
use std::io::Read as _;

/// How every `.npy` file begins.
pub const NPY_MAGIC: &[u8] = b"\x93NUMPY";

/// Largest array read out of an archive, in bytes, so that a small file cannot unpack without end.
const LARGEST_ENTRY: u64 = 1 << 30;

/// Numbers with their shape, the last axis running fastest.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Extent of each axis.
    pub shape: Vec<usize>,
    /// All numbers.
    pub values: Vec<f64>,
}

/// Reads one array of floating-point or whole numbers.
///
/// # Errors
/// [`EvalError::NoTrajectory`] with what is wrong in the file.
pub fn array(bytes: &[u8]) -> Result<Array, EvalError> {
    let (header, data) = split(bytes).ok_or_else(|| wrong("its NumPy header is cut short"))?;
    let descr = value_of(header, "descr").ok_or_else(|| wrong("its NumPy header names no type"))?;
    let decode = decoder(descr.trim_matches(['\'', '"', ' ']))
        .ok_or_else(|| wrong(&format!("NumPy type {descr} is not among f4, f8, u1, u2, i2, i4, i8")))?;
    if value_of(header, "fortran_order").is_none_or(|order| order.trim() != "False") {
        return Err(wrong("the array is in Fortran order, save numpy.ascontiguousarray(array)"));
    }
    let shape = shape_of(header).ok_or_else(|| wrong("its NumPy header names no shape"))?;
    let count = shape.iter().try_fold(1_usize, |product, extent| product.checked_mul(*extent));
    if count.and_then(|count| count.checked_mul(decode.width)) != Some(data.len()) {
        return Err(wrong(&format!("the array should be {shape:?} but has {} bytes", data.len())));
    }
    Ok(Array { shape, values: data.chunks_exact(decode.width).map(decode.value).collect() })
}

/// Header text and data; `None` if the file ends before them.
fn split(bytes: &[u8]) -> Option<(&str, &[u8])> {
    let rest = bytes.strip_prefix(NPY_MAGIC)?;
    let (version, rest) = rest.split_at_checked(2)?;
    let (length, rest) = if version[0] == 1 {
        let (length, rest) = rest.split_first_chunk::<2>()?;
        (usize::from(u16::from_le_bytes(*length)), rest)
    } else {
        let (length, rest) = rest.split_first_chunk::<4>()?;
        (usize::try_from(u32::from_le_bytes(*length)).ok()?, rest)
    };
    let (header, data) = rest.split_at_checked(length)?;
    Some((std::str::from_utf8(header).ok()?, data))
}

/// The text after `'key':` up to the next comma outside brackets.
fn value_of<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let start = header.find(&format!("'{key}':"))? + key.len() + 3;
    let rest = header.get(start..)?;
    rest.get(..rest.find([',', '}'])?).map(str::trim)
}

fn shape_of(header: &str) -> Option<Vec<usize>> {
    let rest = header.get(header.find("'shape':")?..)?;
    let inside = rest.get(rest.find('(')? + 1..rest.find(')')?)?;
    inside.split(',').map(str::trim).filter(|extent| !extent.is_empty()).map(|extent| extent.parse().ok()).collect()
}

/// How one stored number becomes f64.
struct Decoder {
    width: usize,
    value: fn(&[u8]) -> f64,
}

/// `None` for types that are no plain little-endian numbers.
fn decoder(descr: &str) -> Option<Decoder> {
    macro_rules! of {
        ($kind:ty) => {
            Decoder {
                width: size_of::<$kind>(),
                // The chunk has that width; an empty answer cannot occur.
                value: |chunk| chunk.try_into().map_or(f64::NAN, |bytes| <$kind>::from_le_bytes(bytes) as f64),
            }
        };
    }
    Some(match descr {
        "<f8" => of!(f64),
        "<f4" => of!(f32),
        "|u1" => of!(u8),
        "<u2" => of!(u16),
        "<i2" => of!(i16),
        "<i4" => of!(i32),
        "<i8" => of!(i64),
        _ => return None,
    })
}

/// Poses from one array.
pub(super) fn poses_of_npy(bytes: &[u8], duplicates: Duplicates) -> Result<Poses, EvalError> {
    let array = array(bytes)?;
    if array.shape.len() == 2 && array.shape[1] == 8 {
        let timed: Result<Vec<_>, _> = array.values.chunks_exact(8).enumerate().map(timed).collect();
        return Poses::from_timed(&timed?, duplicates);
    }
    Poses::new(Stamps::Order, matrices(&array)?, duplicates)
}

/// Poses from the first array of an archive that holds poses, times from the one named so.
pub(super) fn poses_of_npz(bytes: &[u8], duplicates: Duplicates) -> Result<Poses, EvalError> {
    let mut archive =
        zip::ZipArchive::new(std::io::Cursor::new(bytes)).map_err(|error| wrong(&format!("as an archive: {error}")))?;
    let (mut times_s, mut poses) = (None, None);
    for index in 0..archive.len() {
        let entry = archive.by_index(index).map_err(|error| wrong(&format!("as an archive: {error}")))?;
        let name = entry.name().map_err(|error| wrong(&format!("as an archive: {error}")))?;
        let name = name.trim_end_matches(".npy").to_lowercase();
        let mut unpacked = Vec::new();
        let read = entry.take(LARGEST_ENTRY + 1).read_to_end(&mut unpacked);
        if read.is_err() || unpacked.len() as u64 > LARGEST_ENTRY {
            return Err(wrong(&format!("its array `{name}` cannot be unpacked")));
        }
        if matches!(name.as_str(), "times" | "timestamps" | "time_s" | "time") {
            times_s = Some(array(&unpacked)?.values);
        } else if poses.is_none() {
            poses = array(&unpacked).ok().filter(holds_poses).map(|array| (array, unpacked));
        }
    }
    let (array, unpacked) = poses.ok_or_else(|| wrong("no array in it has the shape of poses"))?;
    match times_s {
        Some(times_s) => Poses::new(Stamps::Seconds(times_s), matrices(&array)?, duplicates),
        None => poses_of_npy(&unpacked, duplicates),
    }
}

fn holds_poses(array: &Array) -> bool {
    matches!(array.shape.as_slice(), [_, 4 | 3, 4] | [_, 12 | 7 | 8])
}

/// Makes a pose of the numbers of one row.
type PoseReader = fn(&[f64]) -> Result<MatrixPose, String>;

fn matrices(array: &Array) -> Result<Vec<MatrixPose>, EvalError> {
    let (width, pose): (usize, PoseReader) = match array.shape.as_slice() {
        [_, 4, 4] => (16, |n| matrix_pose(&n[..12])),
        [_, 3, 4] | [_, 12] => (12, matrix_pose),
        [_, 7] => (7, quaternion_pose),
        shape => return Err(wrong(&format!("an array of shape {shape:?} holds no poses"))),
    };
    let numbered = array.values.chunks_exact(width).enumerate();
    numbered.map(|(index, n)| pose(n).map_err(|reason| wrong(&format!("pose {index}: {reason}")))).collect()
}

fn quaternion_pose(n: &[f64]) -> Result<MatrixPose, String> {
    let [tx, ty, tz, qx, qy, qz, qw] = n else { return Err("a pose has seven numbers".into()) };
    let pose = se3::from_quaternion([*tx, *ty, *tz], [*qx, *qy, *qz, *qw]).map_err(|error| error.to_string())?;
    Ok(nalgebra::convert(pose))
}

fn timed((index, n): (usize, &[f64])) -> Result<TimedPose, EvalError> {
    let world_from_camera = se3::from_quaternion([n[1], n[2], n[3]], [n[4], n[5], n[6], n[7]])
        .map_err(|error| wrong(&format!("pose {index}: {error}")))?;
    Ok(TimedPose { time_s: n[0], world_from_camera })
}

fn wrong(reason: &str) -> EvalError {
    EvalError::NoTrajectory { reason: reason.into() }
}
