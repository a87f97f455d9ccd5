//! Calibrations from files of other tools, told apart by content.
//!
//! | content | written by |
//! |---|---|
//! | `model = "pinhole"`, `width = 320`, ... | us (`camera.toml`; the same keys as JSON) |
//! | `%YAML:1.0` or `<opencv_storage>` with `camera_matrix`, `K` or `M1`, ... | OpenCV, ROS, SCARED |
//! | `intrinsics: [fx, fy, cx, cy]`, `distortion_model`, `resolution` | Kalibr, EuRoC `sensor.yaml` |
//! | `Camera.fx: ...` | ORB-SLAM settings |
//! | `P2: ...` or `P_rect_02: ...` | KITTI |
//! | `<camera_model type="calibu_...">` | Calibu, EndoMapper |
//! | `{"fl_x": ..., "camera_model": "OPENCV"}` | nerfstudio |
//! | nine numbers (a 3x3 matrix) or twelve (3x4) | EndoSLAM, Hamlyn, hand |

mod calibu;
mod fields;
mod interpret;

use crate::FramesError;
use crate::formats::common;
use crate::malformed::{Malformed, finite};
use endoscape_core::camera::{Intrinsics, Pinhole};
use endoscape_core::{Camera, CameraModel, Size};
use fields::Fields;
use std::path::Path;

/// Largest camera file read, in bytes; real ones have a few thousand.
const LARGEST: u64 = 1 << 20;

/// A lens, with the size of the picture it was calibrated on where the file states it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    /// Size of the calibration's pictures.
    pub size: Option<Size>,
    /// The projection model in pixels of those pictures.
    pub model: CameraModel,
}

impl Calibration {
    /// The camera at the stated size, or at `frames` where none is stated.
    ///
    /// # Errors
    /// [`Malformed`] if neither size is known or the numbers are no camera.
    pub fn camera(&self, frames: Option<Size>) -> Result<Camera, Malformed> {
        let size = self.size.or(frames).ok_or_else(|| {
            Malformed::whole("does not state the picture size (width and height) and no frames are there to tell it")
        })?;
        Camera::new(size, self.model).map_err(|error| Malformed::whole(error.to_string()))
    }
}

/// Reads a camera from any of the files in the table above.
///
/// The camera has the size its file states; files that state none are taken to be for pictures of size `frames`.
///
/// # Errors
/// [`FramesError`] naming the file (and the line where there is one) if it is missing, of no known kind, or its
/// numbers are no camera.
pub fn read_camera(path: &Path, frames: Option<Size>) -> Result<Camera, FramesError> {
    read_calibration(path)?.camera(frames).map_err(|error| error.at(path))
}

/// Reads a camera from a file and fits it to its frames; a warning says so where the sizes differ.
pub(crate) fn read_fitted(path: &Path, frames: Size, warnings: &mut Vec<String>) -> Result<Camera, FramesError> {
    let camera = read_camera(path, Some(frames))?;
    common::fit_camera(camera, frames, warnings).map_err(|error| common::camera_error(path, &error))
}

/// Reads a calibration without settling its size.
pub(crate) fn read_calibration(path: &Path) -> Result<Calibration, FramesError> {
    let bytes = common::read_bytes(path, LARGEST)?;
    let text = String::from_utf8(bytes).map_err(|_| {
        FramesError::file(path, "is not text", "give a camera file (camera.toml, YAML, XML, JSON or 3x3)")
    })?;
    parse(&text).map_err(|error| error.at(path))
}

/// Reads a calibration from the content of a file.
///
/// # Errors
/// [`Malformed`] with the line where there is one.
pub fn parse(text: &str) -> Result<Calibration, Malformed> {
    let text = text.trim_start_matches('\u{feff}');
    let first = text.lines().map(str::trim).find(|line| !line.is_empty() && !line.starts_with('#')).unwrap_or("");
    match first.chars().next() {
        None => Err(Malformed::whole("is empty where a camera was expected")),
        Some('<') => parse_xml(text),
        Some('{') => parse_json(text),
        Some(c) if c.is_ascii_digit() || "+-.[".contains(c) && first != "---" => parse_matrix(text),
        Some(_) if is_toml(first) => parse_toml(text),
        Some(_) => interpret::calibration(&Fields::from_yaml(text)?),
    }
}

/// Whether a line assigns with `=`, as TOML does, before any colon.
fn is_toml(line: &str) -> bool {
    line.find(['=', ':']).is_some_and(|at| line[at..].starts_with('='))
}

fn parse_toml(text: &str) -> Result<Calibration, Malformed> {
    let refused = |error: toml::de::Error| {
        let line = error.span().map(|span| 1 + text.bytes().take(span.start).filter(|byte| *byte == b'\n').count());
        Malformed { line, reason: format!("is no camera ({})", one_line(error.message())) }
    };
    let table: serde_json::Value = toml::from_str(text).map_err(refused)?;
    if table.get("model").is_none() {
        return interpret::calibration(&Fields::from_json(&table)?);
    }
    toml::from_str::<Camera>(text).map(Calibration::from).map_err(refused)
}

fn parse_json(text: &str) -> Result<Calibration, Malformed> {
    let value: serde_json::Value =
        serde_json::from_str(text).map_err(|error| Malformed::line(error.line(), format!("is no JSON ({error})")))?;
    if value.get("model").is_some_and(serde_json::Value::is_string) {
        let camera: Camera =
            serde_json::from_value(value).map_err(|error| Malformed::whole(format!("is no camera ({error})")))?;
        return Ok(camera.into());
    }
    interpret::calibration(&Fields::from_json(&value)?)
}

fn parse_xml(text: &str) -> Result<Calibration, Malformed> {
    let document = fields::xml(text)?;
    match document.descendants().find(|node| node.has_tag_name("camera_model")) {
        Some(model) => calibu::calibration(model),
        None => interpret::calibration(&Fields::from_xml(&document)?),
    }
}

/// Four numbers are fx fy cx cy, nine a 3x3 camera matrix, twelve a 3x4 one, in rows or (as some tools write) in columns.
fn parse_matrix(text: &str) -> Result<Calibration, Malformed> {
    let separators = |c: char| c.is_whitespace() || ",;[]".contains(c);
    let mut numbers = Vec::new();
    for (index, line) in text.lines().enumerate().filter(|(_, line)| !line.trim_start().starts_with('#')) {
        for field in line.split(separators).filter(|field| !field.is_empty()) {
            let value = finite(field, "an entry of the camera matrix");
            numbers.push(value.map_err(|reason| Malformed::line(index + 1, reason))?);
        }
    }
    let intrinsics = match *numbers {
        [fx, fy, cx, cy] => Intrinsics { fx, fy, cx, cy, skew: 0.0 },
        _ => intrinsics_of_matrix(&numbers)?,
    };
    Ok(Calibration { size: None, model: Pinhole { intrinsics }.into() })
}

/// The intrinsics in a 3x3 or 3x4 camera matrix given row by row, or in the transpose of a 3x3 one.
pub(crate) fn intrinsics_of_matrix(numbers: &[f64]) -> Result<Intrinsics, Malformed> {
    let k: [f64; 9] = match *numbers {
        [a, b, c, d, e, f, g, h, i] => [a, b, c, d, e, f, g, h, i],
        // The fourth column of a projection matrix places the camera, which is not the lens's business.
        [a, b, c, _, d, e, f, _, g, h, i, _] => [a, b, c, d, e, f, g, h, i],
        _ => {
            let reason = format!("holds {} numbers where a 3x3 (or 3x4) camera matrix was expected", numbers.len());
            return Err(Malformed::whole(reason));
        }
    };
    match k {
        [fx, skew, cx, zero, fy, cy, 0.0, 0.0, 1.0] if zero == 0.0 => Ok(Intrinsics { fx, fy, cx, cy, skew }),
        [fx, zero, 0.0, skew, fy, 0.0, cx, cy, 1.0] if zero == 0.0 => Ok(Intrinsics { fx, fy, cx, cy, skew }),
        _ => Err(Malformed::whole(
            "holds a matrix that is no camera matrix (expected fx s cx, 0 fy cy, 0 0 1, or its transpose)",
        )),
    }
}

/// A message of another crate without its line breaks.
fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}

impl From<Camera> for Calibration {
    fn from(camera: Camera) -> Self {
        Self { size: Some(camera.size()), model: *camera.model() }
    }
}

#[cfg(test)]
mod tests;
