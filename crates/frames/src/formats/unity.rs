//! Poses exported from the Unity renderer behind EndoSLAM UnityCam and EndoMapper's simulated colon (VR-Caps).
//!
//! The file is a table `tX tY tZ rX rY rZ rW time(s)`, comma- or semicolon-separated, one row per rendered frame.
//! Unity's world and cameras are left-handed: x right, y up, z forward.

use crate::malformed::{Malformed, finite};
use endoscape_core::{Pose, se3};

/// Frames per second both data sets were rendered at.
pub const FPS: f64 = 30.0;

/// Metres per Unity unit, where a file does not state it.
///
/// EndoMapper's `info.txt` calls the unit a decimetre and VR-Caps' colon mesh, 5 x 8 x 5 units, is of human size only
/// then; neither data set publishes a check, so loaders say that it is an assumption.
pub const METRES_PER_UNIT: f64 = 0.1;

/// The table's rows in order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UnityPoses {
    /// `world_from_camera` in metres, OpenCV axes; row `i` belongs to the frame of number `i`.
    pub world_from_camera: Vec<Pose>,
    /// Line of a last row that breaks off, which was dropped.
    pub broken_off: Option<usize>,
}

/// Reads the table.
///
/// A last row with too few values is a known fault of the published files and is dropped.
///
/// # Errors
/// [`Malformed`] with the line of the first row that does not hold eight finite numbers and a rotation.
pub fn parse_poses(text: &str, separator: char, metres_per_unit: f64) -> Result<UnityPoses, Malformed> {
    let mut poses = UnityPoses::default();
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()).peekable();
    lines.next_if(|(_, line)| line.trim_start().starts_with(|c: char| c.is_alphabetic()));
    while let Some((index, line)) = lines.next() {
        if lines.peek().is_none() && line.split(separator).count() < 8 {
            poses.broken_off = Some(index + 1);
            break;
        }
        let pose = parse_row(line, separator, metres_per_unit).map_err(|reason| Malformed::line(index + 1, reason))?;
        poses.world_from_camera.push(pose);
    }
    Ok(poses)
}

fn parse_row(line: &str, separator: char, metres_per_unit: f64) -> Result<Pose, String> {
    const NAMES: [&str; 8] = ["tX", "tY", "tZ", "rX", "rY", "rZ", "rW", "time(s)"];
    let count = line.split(separator).count();
    if count != NAMES.len() {
        return Err(format!("found {count} values where 8 were expected ({})", NAMES.join(" ")));
    }
    let mut n = [0.0; 8];
    for ((number, name), field) in n.iter_mut().zip(NAMES).zip(line.split(separator)) {
        *number = finite(field, name)?;
    }
    let position_m = [n[0], n[1], n[2]].map(|value| value * metres_per_unit);
    from_left_handed(position_m, [n[3], n[4], n[5], n[6]])
}

/// A left-handed pose with y up as a right-handed one with y down: `M P M` with `M = diag(1, -1, 1, 1)`.
///
/// Mirroring y in the world and in the camera at once keeps the motion rigid and makes the camera's axes OpenCV's
/// (x right, y down, z forward). A mirrored rotation axis keeps its y and flips the rest. EndoGSLAM mirrors z instead,
/// which describes the same motion with OpenGL's axes.
fn from_left_handed([x, y, z]: [f64; 3], [qx, qy, qz, qw]: [f64; 4]) -> Result<Pose, String> {
    se3::from_quaternion([x, -y, z], [-qx, qy, -qz, qw]).map_err(|error| error.to_string())
}

impl UnityPoses {
    /// What the user should know about the table itself.
    pub fn warnings(&self, file: &str) -> Vec<String> {
        let mut warnings = Vec::new();
        if let Some(line) = self.broken_off {
            warnings.push(format!("{file}, line {line}: the last row breaks off and was dropped"));
        }
        let rotations = || self.world_from_camera.iter().map(|pose| pose.rotation);
        if self.world_from_camera.len() > 2 && rotations().zip(rotations().skip(1)).all(|(a, b)| a == b) {
            warnings.push(format!("{file}: all rotations are the same, so only the positions mean something"));
        }
        warnings
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix4, Vector4};

    const HEADER: &str = "tX,tY,tZ,rX,rY,rZ,rW,time(s)\n";

    #[test]
    fn the_mirror_is_the_matrix_product() {
        let q = nalgebra::UnitQuaternion::from_euler_angles(0.3, -0.7, 1.1);
        let unity = Pose::from_parts(nalgebra::Translation3::new(1.0, 2.0, 3.0), q);
        let c = q.coords;
        let text = format!("{HEADER}1,2,3,{},{},{},{},0\n", c.x, c.y, c.z, c.w);
        let ours = parse_poses(&text, ',', 1.0).unwrap().world_from_camera[0];
        let mirror = Matrix4::from_diagonal(&Vector4::new(1.0, -1.0, 1.0, 1.0));
        let expected = mirror * unity.to_homogeneous() * mirror;
        assert!((ours.to_homogeneous() - expected).amax() < 1e-12);
    }

    #[test]
    fn a_broken_last_row_is_dropped_and_any_other_refused() {
        let text = format!("{HEADER}0,0,0,0,0,0,1,0\n0,0,1,0,0,0,1,0.03\n0,0,2,0");
        let poses = parse_poses(&text, ',', METRES_PER_UNIT).unwrap();
        assert_eq!((poses.world_from_camera.len(), poses.broken_off), (2, Some(4)));
        assert_eq!(poses.world_from_camera[1].translation.z, 0.1);
        let text = format!("{HEADER}0,0,0,0,0,0,1,0\n0,0,2,0\n0,0,0,0,0,0,1,0\n");
        let error = parse_poses(&text, ',', 1.0).unwrap_err();
        assert_eq!(error.line, Some(3));
        assert!(error.reason.starts_with("found 4 values where 8 were expected"), "{error}");
    }

    #[test]
    fn nan_and_fifteen_columns_are_refused_with_their_line() {
        let error = parse_poses(&format!("{HEADER}0,0,nan,0,0,0,1,0\n"), ',', 1.0).unwrap_err();
        assert_eq!((error.line, error.reason.as_str()), (Some(2), "tZ is `nan` where a finite number was expected"));
        let wide = format!("{HEADER}{}\n", ["0"; 15].join(","));
        assert!(parse_poses(&wide, ',', 1.0).unwrap_err().reason.contains("found 15 values"));
        assert!(parse_poses("0;0;0;0;0;0;0;0\n", ';', 1.0).unwrap_err().reason.contains("norm"));
    }

    #[test]
    fn equal_rotations_are_told() {
        let text = format!("{HEADER}{}", "0,0,0,0,0,0,1,0\n".repeat(3));
        assert_eq!(parse_poses(&text, ',', 1.0).unwrap().warnings("p.csv").len(), 1);
    }
}
