//! The camera behind named values, whatever tool named them.

use super::fields::Fields;
use super::{Calibration, intrinsics_of_matrix};
use crate::malformed::Malformed;
use endoscape_core::camera::{Intrinsics, KannalaBrandt, Pinhole, RadialTangential};
use endoscape_core::{CameraModel, Size};

/// Names of a 3x3 matrix: OpenCV and ROS, the stereo calibration of SCARED, plain.
const MATRIX: &[&str] = &["camera_matrix", "M1", "K", "K1", "intrinsic_matrix", "cameraMatrix"];
/// Names of a list of distortion coefficients.
const DISTORTION: &[&str] =
    &["distortion_coefficients", "distortion_coeffs", "D1", "D", "dist_coeffs", "distCoeffs", "distortion"];
/// KITTI's projection matrices, the left colour camera first.
const KITTI: &[(&str, &str)] =
    &[("P2", "S_02"), ("P_rect_02", "S_rect_02"), ("P0", "S_00"), ("P_rect_00", "S_rect_00")];

/// How the lens bends rays.
#[derive(Clone, Copy, PartialEq)]
enum Lens {
    Straight,
    RadialTangential,
    Fisheye,
}

/// Puts the camera together.
pub fn calibration(fields: &Fields) -> Result<Calibration, Malformed> {
    for (projection, size) in KITTI {
        if let Some(numbers) = fields.numbers(&[projection])? {
            let model = Pinhole { intrinsics: intrinsics_of_matrix(&numbers)? }.into();
            return Ok(Calibration { size: pair_as_size(fields.numbers(&[size])?)?, model });
        }
    }
    let intrinsics = intrinsics(fields)?;
    let distortion = distortion(fields)?;
    Ok(Calibration { size: size(fields)?, model: model(lens(fields)?, intrinsics, &distortion)? })
}

fn model(lens: Option<Lens>, intrinsics: Intrinsics, distortion: &[f64]) -> Result<CameraModel, Malformed> {
    let bent = distortion.iter().any(|coefficient| *coefficient != 0.0);
    match lens {
        Some(Lens::Fisheye) if distortion.len() > 4 => Err(Malformed::whole(format!(
            "holds {} distortion coefficients where a fisheye lens has four",
            distortion.len()
        ))),
        Some(Lens::Fisheye) => {
            let k = |index: usize| distortion.get(index).copied().unwrap_or(0.0);
            Ok(KannalaBrandt { intrinsics, k1: k(0), k2: k(1), k3: k(2), k4: k(3) }.into())
        }
        Some(Lens::Straight) => Ok(Pinhole { intrinsics }.into()),
        _ if distortion.len() > 8 && distortion[8..].iter().any(|coefficient| *coefficient != 0.0) => {
            Err(Malformed::whole("uses OpenCV's thin-prism or tilt distortion, which is not supported"))
        }
        _ if bent => Ok(RadialTangential::from_opencv(intrinsics, distortion).into()),
        _ => Ok(Pinhole { intrinsics }.into()),
    }
}

fn intrinsics(fields: &Fields) -> Result<Intrinsics, Malformed> {
    if let Some(numbers) = fields.numbers(MATRIX)? {
        return intrinsics_of_matrix(&numbers);
    }
    if let Some(numbers) = fields.numbers(&["intrinsics"])? {
        return match *numbers {
            [fx, fy, cx, cy] => Ok(Intrinsics { fx, fy, cx, cy, skew: 0.0 }),
            _ => intrinsics_of_matrix(&numbers),
        };
    }
    // nerfstudio and COLMAP count pixels from the corner of the picture, not from the centre of the first pixel.
    if let Some(fx) = fields.number(&["fl_x"])? {
        let fy = fields.number(&["fl_y"])?.unwrap_or(fx);
        let (cx, cy) = (required(fields, &["cx"])? - 0.5, required(fields, &["cy"])? - 0.5);
        return Ok(Intrinsics { fx, fy, cx, cy, skew: 0.0 });
    }
    let fx = fields.number(&["fx"])?.ok_or_else(|| {
        Malformed::whole("names no focal length (expected camera_matrix, K, M1, intrinsics, P2, fx or fl_x)")
    })?;
    let skew = fields.number(&["skew"])?.unwrap_or(0.0);
    let (fy, cx, cy) = (required(fields, &["fy"])?, required(fields, &["cx"])?, required(fields, &["cy"])?);
    Ok(Intrinsics { fx, fy, cx, cy, skew })
}

/// Distortion coefficients in OpenCV's order: a list, or `k1`, `k2`, ... one by one.
fn distortion(fields: &Fields) -> Result<Vec<f64>, Malformed> {
    if let Some(numbers) = fields.numbers(DISTORTION)? {
        return Ok(numbers);
    }
    let names = if lens(fields)? == Some(Lens::Fisheye) {
        &["k1", "k2", "k3", "k4"][..]
    } else {
        &["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"][..]
    };
    names.iter().map(|name| Ok(fields.number(&[name])?.unwrap_or(0.0))).collect()
}

/// What the file calls its lens, if it does. The distortion's name says more than the camera's: Kalibr calls a
/// fisheye a `pinhole` with `equidistant` distortion.
fn lens(fields: &Fields) -> Result<Option<Lens>, Malformed> {
    let Some(name) = fields.text(&["distortion_model"]).or_else(|| fields.text(&["camera_model", "type"])) else {
        return Ok(None);
    };
    match name.to_ascii_lowercase().as_str() {
        "equidistant" | "equi" | "fisheye" | "opencv_fisheye" | "kannalabrandt8" | "kannala_brandt" => {
            Ok(Some(Lens::Fisheye))
        }
        "plumb_bob"
        | "rational_polynomial"
        | "radtan"
        | "radial-tangential"
        | "opencv"
        | "full_opencv"
        | "pinhole"
        | "perspective"
        | "camera" => Ok(Some(Lens::RadialTangential)),
        "none" | "simple_pinhole" => Ok(Some(Lens::Straight)),
        other => {
            let shown: String = other.chars().take(32).collect();
            Err(Malformed::whole(format!(
                "names the lens model `{shown}`, which is not supported (pinhole, radial-tangential and fisheye are)"
            )))
        }
    }
}

fn size(fields: &Fields) -> Result<Option<Size>, Malformed> {
    if let Some(pair) = fields.numbers(&["resolution", "image_size"])? {
        return pair_as_size(Some(pair));
    }
    let width = fields.number(&["image_width", "width", "w"])?;
    let height = fields.number(&["image_height", "height", "h"])?;
    pair_as_size(width.zip(height).map(|(width, height)| vec![width, height]))
}

fn pair_as_size(pair: Option<Vec<f64>>) -> Result<Option<Size>, Malformed> {
    let Some(pair) = pair else { return Ok(None) };
    let extent = |value: f64| (1.0..=65_535.0).contains(&value).then_some(value as usize);
    match *pair {
        [width, height] => match (extent(width), extent(height)) {
            (Some(width), Some(height)) => Ok(Some(Size::new(width, height))),
            _ => Err(Malformed::whole(format!("states a picture of {width} by {height} pixels"))),
        },
        _ => Err(Malformed::whole(format!("states a picture size with {} numbers instead of two", pair.len()))),
    }
}

fn required(fields: &Fields, names: &[&str]) -> Result<f64, Malformed> {
    fields.number(names)?.ok_or_else(|| Malformed::whole(format!("has no {} beside its focal length", names[0])))
}
