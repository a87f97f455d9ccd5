//! The text formats.

use super::TrajectoryFormat;
use crate::EvalError;
use crate::poses::{Duplicates, MatrixPose, Poses, Stamps};
use endoscape_core::{se3, trajectory};
use nalgebra::{Matrix3, Rotation3, Translation3, Vector3};

/// Times above this many are nanoseconds: as seconds they would lie 30,000 years ahead.
const SMALLEST_TIME_NS: f64 = 1e12;

pub fn tum(text: &str, duplicates: Duplicates) -> Result<Poses, EvalError> {
    Poses::from_timed(&trajectory::parse_tum(text)?, duplicates)
}

pub fn euroc(text: &str, duplicates: Duplicates) -> Result<Poses, EvalError> {
    Poses::from_timed(&trajectory::parse_euroc(text)?, duplicates)
}

/// 12 numbers a line, or 13 with the number of the frame first, as kitti-odom-eval writes them.
pub fn kitti(text: &str, duplicates: Duplicates) -> Result<Poses, EvalError> {
    let (mut frames, mut poses) = (Vec::new(), Vec::new());
    for (line, record) in records(text) {
        let numbers = numbers(line, record)?;
        let pose = match numbers.as_slice() {
            [frame, pose @ ..] if pose.len() == 12 => {
                frames.push(frame_number(*frame).ok_or_else(|| at(line, format!("{frame} is no frame number")))?);
                pose
            }
            pose if pose.len() == 12 => pose,
            other => return Err(at(line, format!("found {} numbers where a 3x4 matrix has 12", other.len()))),
        };
        poses.push(matrix_pose(pose).map_err(|reason| at(line, reason))?);
    }
    let stamps = if frames.is_empty() { Stamps::Order } else { Stamps::Frames(frames) };
    Poses::new(stamps, poses, duplicates)
}

/// A pose from the 12 numbers of a 3x4 matrix, row by row; they must form a rotation but are kept as they are.
pub(super) fn matrix_pose(n: &[f64]) -> Result<MatrixPose, String> {
    let [a, b, c, x, d, e, f, y, g, h, i, z] = n else {
        return Err(format!("found {} numbers where a 3x4 matrix has 12", n.len()));
    };
    let rotation = Matrix3::new(*a, *b, *c, *d, *e, *f, *g, *h, *i);
    let translation_m = Vector3::new(*x, *y, *z);
    se3::from_matrix(&rotation, &translation_m).map_err(|error| error.to_string())?;
    Ok(MatrixPose::from_parts(Translation3::from(translation_m), Rotation3::from_matrix_unchecked(rotation)))
}

fn frame_number(number: f64) -> Option<u64> {
    // Whole numbers up to 2^53 are exact.
    (number >= 0.0 && number.fract() == 0.0 && number < 9e15).then_some(number as u64)
}

/// Columns by name: a time (seconds, or nanoseconds for names with `ns`), a position in metres and a quaternion.
pub fn csv(text: &str, duplicates: Duplicates) -> Result<Poses, EvalError> {
    let mut reader = csv::ReaderBuilder::new().comment(None).trim(csv::Trim::All).from_reader(text.as_bytes());
    let header: Vec<String> = match reader.headers() {
        Ok(header) => header.iter().map(|name| name.trim_start_matches('#').trim().to_lowercase()).collect(),
        Err(error) => return Err(at(1, error.to_string())),
    };
    let column = |names: &[&str]| {
        header.iter().position(|name| names.contains(&name.as_str())).ok_or_else(|| {
            at(
                1,
                format!(
                    "the header names no column {}",
                    names.iter().take(3).copied().collect::<Vec<_>>().join(" or ")
                ),
            )
        })
    };
    let time =
        column(&["time_s", "time", "timestamp", "timestamp_s", "t", "time_ns", "timestamp_ns", "timestamp [ns]"])?;
    let unit_s = if header[time].contains("ns") { 1e-9 } else { 1.0 };
    let columns = [
        time,
        column(&["tx", "x", "px", "x_m", "tx_m", "position_x"])?,
        column(&["ty", "y", "py", "y_m", "ty_m", "position_y"])?,
        column(&["tz", "z", "pz", "z_m", "tz_m", "position_z"])?,
        column(&["qx", "quaternion_x", "orientation_x"])?,
        column(&["qy", "quaternion_y", "orientation_y"])?,
        column(&["qz", "quaternion_z", "orientation_z"])?,
        column(&["qw", "quaternion_w", "orientation_w"])?,
    ];
    let mut timed = Vec::new();
    for (index, record) in reader.records().enumerate() {
        let line = index + 2;
        let record = record.map_err(|error| at(line, error.to_string()))?;
        timed.push(csv_pose(line, &record, &columns, unit_s)?);
    }
    Poses::from_timed(&timed, duplicates)
}

fn csv_pose(
    line: usize,
    record: &csv::StringRecord,
    columns: &[usize; 8],
    unit_s: f64,
) -> Result<endoscape_core::TimedPose, EvalError> {
    let mut n = [0.0; 8];
    for (number, column) in n.iter_mut().zip(columns) {
        let field = record.get(*column).unwrap_or_default();
        *number = finite(field).ok_or_else(|| at(line, not_a_number(field)))?;
    }
    let world_from_camera = se3::from_quaternion([n[1], n[2], n[3]], [n[4], n[5], n[6], n[7]])
        .map_err(|error| at(line, error.to_string()))?;
    Ok(endoscape_core::TimedPose { time_s: n[0] * unit_s, world_from_camera })
}

/// Judges by the first line that is no comment.
pub fn detect(text: &str) -> Result<TrajectoryFormat, EvalError> {
    // A header may itself look like a comment.
    let header = text.lines().next().unwrap_or_default().to_lowercase();
    let Some((_, record)) = records(text).next() else { return Err(EvalError::Empty) };
    if record.contains(',') {
        return detect_commas(&header, record);
    }
    // NaN counts as a number here, so that the reader can name the line it stands in.
    match record.split_whitespace().map(|field| field.parse().ok()).collect::<Option<Vec<f64>>>().map(|row| row.len()) {
        Some(8) => Ok(TrajectoryFormat::Tum),
        Some(12 | 13) => Ok(TrajectoryFormat::Kitti),
        Some(count) => {
            Err(EvalError::NoTrajectory { reason: format!("its first line has {count} numbers, not 8, 12 or 13") })
        }
        None => Err(EvalError::NoTrajectory { reason: format!("its first line reads `{}`", short(record)) }),
    }
}

fn detect_commas(header: &str, record: &str) -> Result<TrajectoryFormat, EvalError> {
    let fields: Vec<Option<f64>> = record.split(',').map(|field| finite(field.trim())).collect();
    match fields.as_slice() {
        [Some(time), rest @ ..] if rest.len() >= 7 && *time > SMALLEST_TIME_NS && !header.contains("qw") => {
            Ok(TrajectoryFormat::Euroc)
        }
        _ if header.contains("qw") => Ok(TrajectoryFormat::Csv),
        _ => Err(EvalError::NoTrajectory {
            reason: format!("its first line `{}` has commas but no header names the columns", short(record)),
        }),
    }
}

fn records(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let numbered = text.lines().enumerate().map(|(index, line)| (index + 1, line.trim()));
    numbered.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
}

fn numbers(line: usize, record: &str) -> Result<Vec<f64>, EvalError> {
    record.split_whitespace().map(|field| finite(field).ok_or_else(|| at(line, not_a_number(field)))).collect()
}

fn finite(field: &str) -> Option<f64> {
    field.parse().ok().filter(|value: &f64| value.is_finite())
}

fn not_a_number(field: &str) -> String {
    format!("`{}` is not a finite number", short(field))
}

fn short(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(40).collect()
}

const fn at(line: usize, reason: String) -> EvalError {
    EvalError::Line { line, reason }
}
