//! The few entries of a EuRoC `sensor.yaml` that describe a camera.
//!
//! Only what these files use of YAML is understood: `key: value`, numbers in brackets that may run over several lines,
//! and comments. Keys are taken by name wherever they stand.

use endoscape_core::camera::{Intrinsics, KannalaBrandt, RadialTangential};
use endoscape_core::trajectory::{TextError, numbers};
use endoscape_core::{Camera, CameraError, CameraModel, Pose, Size, se3};
use nalgebra::{Matrix3, Vector3};

/// A camera on a body.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensor {
    /// Size of its pictures in pixels.
    pub size: Size,
    /// Its lens.
    pub model: CameraModel,
    /// `T_BS`: maps camera points to the body, metres.
    pub body_from_camera: Pose,
    /// Frames per second, if stated.
    pub rate_hz: Option<f64>,
}

impl Sensor {
    /// The lens with its picture size.
    ///
    /// # Errors
    /// As [`Camera::new`].
    pub fn camera(&self) -> Result<Camera, CameraError> {
        Camera::new(self.size, self.model)
    }
}

/// Reads `sensor.yaml` of a camera: `resolution`, `intrinsics`, `distortion_model`, `distortion_coefficients` and the
/// `data` of `T_BS`.
///
/// # Errors
/// [`TextError`] at the first entry that is missing (at the last line), holds other than its numbers, or names another lens than
/// `radial-tangential` or `equidistant`.
pub fn parse_sensor(text: &str) -> Result<Sensor, TextError> {
    let entries = entries(text);
    let [width, height]: [f64; 2] = values(&entries, "resolution")?;
    let [fx, fy, cx, cy] = values(&entries, "intrinsics")?;
    let intrinsics = Intrinsics { fx, fy, cx, cy, skew: 0.0 };
    let distortion: [f64; 4] = values(&entries, "distortion_coefficients")?;
    let [k1, k2, k3, k4] = distortion;
    let lens = entry(&entries, "distortion_model")?;
    let model = match lens.value.trim().trim_matches(['"', '\'']) {
        "radial-tangential" | "radtan" => RadialTangential::from_opencv(intrinsics, &distortion).into(),
        "equidistant" => KannalaBrandt { intrinsics, k1, k2, k3, k4 }.into(),
        _ => {
            let reason = "the distortion model is neither radial-tangential nor equidistant".into();
            return Err(TextError { line: lens.line, reason });
        }
    };
    // Saturates: a size that is no size ends as an empty camera, which is refused.
    let size = Size::new(width as usize, height as usize);
    let rate_hz = values(&entries, "rate_hz").ok().map(|[rate_hz]: [f64; 1]| rate_hz).filter(|rate_hz| *rate_hz > 0.0);
    Ok(Sensor { size, model, body_from_camera: body_from_camera(&entries)?, rate_hz })
}

fn body_from_camera(entries: &[Entry<'_>]) -> Result<Pose, TextError> {
    // `T_BS` itself has no value; its matrix is the `data` after it.
    let after = entries.iter().position(|entry| entry.key == "T_BS").unwrap_or(0);
    let n: [f64; 16] = values(&entries[after..], "data")?;
    let rotation = Matrix3::new(n[0], n[1], n[2], n[4], n[5], n[6], n[8], n[9], n[10]);
    se3::from_matrix(&rotation, &Vector3::new(n[3], n[7], n[11])).map_err(|error| TextError {
        line: entry(&entries[after..], "data").map_or(1, |entry| entry.line),
        reason: format!("T_BS: {error}"),
    })
}

/// A `key: value`, with the lines its brackets run over.
struct Entry<'a> {
    line: usize,
    key: &'a str,
    value: String,
}

fn entries(text: &str) -> Vec<Entry<'_>> {
    let mut entries: Vec<Entry<'_>> = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let content = line.split('#').next().unwrap_or(line);
        match entries.last_mut().filter(|entry| entry.value.contains('[') && !entry.value.contains(']')) {
            Some(open) => open.value.push_str(content),
            None => entries.extend(content.split_once(':').map(|(key, value)| Entry {
                line: index + 1,
                key: key.trim(),
                value: value.to_owned(),
            })),
        }
    }
    entries
}

fn entry<'a>(entries: &'a [Entry<'a>], key: &str) -> Result<&'a Entry<'a>, TextError> {
    let last_line = entries.last().map_or(1, |entry| entry.line);
    let missing = || TextError { line: last_line, reason: format!("the file ends without an entry {key}") };
    entries.iter().find(|entry| entry.key == key).ok_or_else(missing)
}

/// The `N` numbers of an entry, in brackets unless there is one.
fn values<const N: usize>(entries: &[Entry<'_>], key: &str) -> Result<[f64; N], TextError> {
    let Entry { line, value, .. } = entry(entries, key)?;
    let separates = |c: char| c.is_whitespace() || "[],".contains(c);
    numbers(*line, value.split(separates).filter(|field| !field.is_empty()), key)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A camera turned by a quarter about z, at (0.1, 0.2, 0.3) of its body.
    pub const SENSOR: &str = "\
# Sensor
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [0, -1, 0, 0.1,
         1, 0, 0, 0.2,
         0, 0, 1, 0.3,
         0, 0, 0, 1]
rate_hz: 20
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458.6, 457.3, 367.2, 248.4] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28, 0.07, 0.0002, 1.8e-05]
";

    #[test]
    fn both_lenses_are_read() {
        let sensor = parse_sensor(SENSOR).unwrap();
        assert_eq!((sensor.size, sensor.rate_hz), (Size::new(752, 480), Some(20.0)));
        assert_eq!(sensor.model.name(), "radial-tangential");
        assert_eq!(sensor.body_from_camera.translation.vector, Vector3::new(0.1, 0.2, 0.3));
        let fisheye = parse_sensor(&SENSOR.replace("radial-tangential", "equidistant")).unwrap();
        assert_eq!(fisheye.model.name(), "kannala-brandt");
    }

    #[test]
    fn errors_name_the_line() {
        let error = |from: &str, to: &str| parse_sensor(&SENSOR.replace(from, to)).unwrap_err();
        assert_eq!(error("752, 480", "752").line, 11);
        assert_eq!(error("radial-tangential", "magic").line, 14);
        assert_eq!(error("0, -1, 0, 0.1", "5, -1, 0, 0.1").line, 6);
        assert_eq!(error("intrinsics", "other").to_string(), "line 15: the file ends without an entry intrinsics");
        let sizeless = parse_sensor(&SENSOR.replace("752", "-3")).unwrap();
        assert!(sizeless.camera().is_err());
    }

    proptest! {
        #[test]
        fn any_text_is_answered(text in "[-0-9.,:#\\[\\] \nadtT_BSresolution]{0,200}") {
            let _ = parse_sensor(&text);
        }
    }
}
