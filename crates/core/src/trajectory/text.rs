//! The three text formats trajectories are exchanged in, as pure functions on strings.
//!
//! | format | line | separator |
//! |---|---|---|
//! | TUM RGB-D | `time tx ty tz qx qy qz qw` (seconds, metres), `#` starts a comment | spaces |
//! | KITTI odometry | 12 numbers, the upper 3x4 of `world_from_camera` row by row; no times | spaces |
//! | EuRoC ground truth | `time_ns, px, py, pz, qw, qx, qy, qz, ...`, `#` starts a comment | commas |

use super::TimedPose;
use crate::{Pose, se3};
use nalgebra::{Matrix3, Vector3};
use std::fmt::Write as _;
use thiserror::Error;

/// What is wrong in a text, and where.
#[derive(Debug, Error, Clone, PartialEq)]
#[error("line {line}: {reason}")]
pub struct TextError {
    /// Line number counted from 1.
    pub line: usize,
    /// What is wrong there and what was expected.
    pub reason: String,
}

/// Reads a TUM RGB-D trajectory. The order of lines is kept; it is for the caller to judge.
///
/// # Errors
/// [`TextError`] at the first line that does not hold eight finite numbers with a quaternion of norm near 1.
pub fn parse_tum(text: &str) -> Result<Vec<TimedPose>, TextError> {
    records(text)
        .map(|(line, record)| {
            let n: [f64; 8] = numbers(line, record.split_whitespace(), "time tx ty tz qx qy qz qw")?;
            let pose = se3::from_quaternion([n[1], n[2], n[3]], [n[4], n[5], n[6], n[7]]);
            timed(line, n[0], pose)
        })
        .collect()
}

/// Reads a KITTI odometry pose file.
///
/// # Errors
/// [`TextError`] at the first line that does not hold twelve finite numbers forming a rigid motion.
pub fn parse_kitti(text: &str) -> Result<Vec<Pose>, TextError> {
    records(text)
        .map(|(line, record)| {
            let n: [f64; 12] = numbers(line, record.split_whitespace(), "the 12 numbers of a 3x4 matrix")?;
            let rotation = Matrix3::new(n[0], n[1], n[2], n[4], n[5], n[6], n[8], n[9], n[10]);
            se3::from_matrix(&rotation, &Vector3::new(n[3], n[7], n[11]))
                .map_err(|error| TextError { line, reason: error.to_string() })
        })
        .collect()
}

/// Reads EuRoC ground truth (`state_groundtruth_estimate0/data.csv`): the first eight columns, times in nanoseconds.
///
/// # Errors
/// [`TextError`] at the first line with fewer than eight finite numbers or no quaternion.
pub fn parse_euroc(text: &str) -> Result<Vec<TimedPose>, TextError> {
    records(text)
        .map(|(line, record)| {
            let fields = record.split(',').map(str::trim).take(8);
            let n: [f64; 8] = numbers(line, fields, "time_ns, px, py, pz, qw, qx, qy, qz")?;
            let pose = se3::from_quaternion([n[1], n[2], n[3]], [n[5], n[6], n[7], n[4]]);
            timed(line, n[0] * 1e-9, pose)
        })
        .collect()
}

/// Writes poses in the TUM RGB-D format, with digits enough to read back the same numbers.
pub fn to_tum(poses: &[TimedPose]) -> String {
    let mut text = String::new();
    for TimedPose { time_s, world_from_camera } in poses {
        let (t, q) = (world_from_camera.translation.vector, world_from_camera.rotation.coords);
        // Writing to a String cannot fail.
        writeln!(text, "{time_s} {} {} {} {} {} {} {}", t.x, t.y, t.z, q.x, q.y, q.z, q.w).ok();
    }
    text
}

/// Writes poses in the KITTI odometry format, with digits enough to read back the same numbers.
pub fn to_kitti(poses: &[Pose]) -> String {
    let mut text = String::new();
    for pose in poses {
        let m = pose.to_homogeneous();
        let row = |r: usize| format!("{} {} {} {}", m[(r, 0)], m[(r, 1)], m[(r, 2)], m[(r, 3)]);
        writeln!(text, "{} {} {}", row(0), row(1), row(2)).ok();
    }
    text
}

/// Lines that hold something, numbered from 1; comments and blank lines are passed over.
pub fn records(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let numbered = text.lines().enumerate().map(|(index, line)| (index + 1, line.trim()));
    numbered.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
}

fn timed(line: usize, time_s: f64, pose: Result<Pose, se3::PoseError>) -> Result<TimedPose, TextError> {
    let world_from_camera = pose.map_err(|error| TextError { line, reason: error.to_string() })?;
    Ok(TimedPose { time_s, world_from_camera })
}

/// Exactly `N` finite numbers from the fields of a line, `expected` naming them in messages.
///
/// # Errors
/// [`TextError`] with the number of fields found, or the first field that is no finite number.
pub fn numbers<'a, const N: usize>(
    line: usize,
    fields: impl Iterator<Item = &'a str>,
    expected: &str,
) -> Result<[f64; N], TextError> {
    let fields: Vec<&str> = fields.collect();
    if fields.len() != N {
        let reason = format!("found {} values where {N} were expected ({expected})", fields.len());
        return Err(TextError { line, reason });
    }
    let mut numbers = [0.0; N];
    for (number, field) in numbers.iter_mut().zip(fields) {
        *number = field.parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(|| TextError {
            line,
            reason: format!("`{}` is not a finite number ({expected})", field.chars().take(32).collect::<String>()),
        })?;
    }
    Ok(numbers)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;
    use proptest::prelude::*;

    #[test]
    fn errors_name_the_line() {
        let text = "# header\n0 0 0 0 0 0 0 1\n\n1 0 0 0 0 0 0\n";
        let error = parse_tum(text).unwrap_err();
        assert_eq!(error.to_string(), "line 4: found 7 values where 8 were expected (time tx ty tz qx qy qz qw)");
        assert_eq!(parse_tum("0 0 0 nan 0 0 0 1").unwrap_err().line, 1);
        assert!(parse_tum("0 0 0 0 0 0 0 0").unwrap_err().reason.contains("norm"));
        assert!(parse_kitti("2 0 0 0 0 1 0 0 0 0 1 0").unwrap_err().reason.contains("not a rotation"));
    }

    #[test]
    fn euroc_orders_its_quaternion_w_first() {
        let poses = parse_euroc("#t,p..\n2000000000,1,2,3,0,1,0,0,9,9,9").unwrap();
        assert_eq!(poses[0].time_s, 2.0);
        assert_eq!(poses[0].world_from_camera.rotation.coords.as_slice(), [1.0, 0.0, 0.0, 0.0]);
    }

    proptest! {
        #[test]
        fn what_is_written_reads_back_the_same(twist in prop::array::uniform6(-2.0..2.0), time_s in 0.0..1e10) {
            let world_from_camera = se3::exp(&Vector6::from(twist));
            let poses = vec![TimedPose { time_s, world_from_camera }];
            let again = parse_tum(&to_tum(&poses)).unwrap();
            prop_assert_eq!(again[0].time_s, time_s);
            let difference = again[0].world_from_camera.to_homogeneous() - world_from_camera.to_homogeneous();
            prop_assert!(difference.amax() < 1e-15);
            let again = parse_kitti(&to_kitti(&[world_from_camera])).unwrap();
            prop_assert!((again[0].to_homogeneous() - world_from_camera.to_homogeneous()).amax() < 1e-14);
        }

        #[test]
        fn any_text_is_answered(text in "[-0-9eE.,# \nna]{0,200}") {
            // A result either way; the property is that none of them panics.
            let _ = (parse_tum(&text), parse_kitti(&text), parse_euroc(&text));
        }
    }
}
