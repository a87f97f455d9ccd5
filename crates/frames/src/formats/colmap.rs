//! COLMAP's binary reconstruction: `cameras.bin` and `images.bin`.
//!
//! Little endian, as described in COLMAP's documentation ("Output format") with the parameter order of its camera
//! models. COLMAP stores `camera_from_world` and counts pixels from the corner of the picture; both are turned into
//! ours here. `points3D.bin` holds nothing a sequence needs.

use crate::malformed::Malformed;
use endoscape_core::camera::{Intrinsics, KannalaBrandt, Pinhole, RadialTangential};
use endoscape_core::{Camera, CameraModel, Pose, Size, se3};

/// A picture of the reconstruction.
#[derive(Clone, Debug, PartialEq)]
pub struct ColmapImage {
    /// File name as given to COLMAP.
    pub name: String,
    /// Number of its camera.
    pub camera: u32,
    /// Its pose, in the reconstruction's own unit of length.
    pub world_from_camera: Pose,
}

/// Longest file name accepted, in bytes.
const LONGEST_NAME: usize = 4096;
/// Bytes of one observed point: two `f64` and one `u64`.
const POINT_BYTES: u64 = 24;

/// Reads `cameras.bin`: camera numbers and the cameras.
///
/// # Errors
/// [`Malformed`] if the bytes end early, name an unsupported camera model, or the numbers are no camera.
pub fn parse_cameras(bytes: &[u8]) -> Result<Vec<(u32, Camera)>, Malformed> {
    let mut cursor = Cursor { rest: bytes };
    // Growing one by one keeps memory below the file's size, whatever count it claims.
    (0..cursor.u64()?).map(|_| camera(&mut cursor)).collect()
}

fn camera(cursor: &mut Cursor<'_>) -> Result<(u32, Camera), Malformed> {
    let number = cursor.u32()?;
    let kind = cursor.u32()?;
    let (width, height) = (cursor.u64()?, cursor.u64()?);
    if width > 65_535 || height > 65_535 {
        return Err(Malformed::whole(format!("states a camera of {width}x{height} pixels")));
    }
    let model = camera_model(kind, cursor)?;
    let camera = Camera::new(Size::new(width as usize, height as usize), model);
    Ok((number, camera.map_err(|error| Malformed::whole(format!("camera {number}: {error}")))?))
}

/// Models by the numbers of COLMAP's `sensor/models.h`.
fn camera_model(kind: u32, cursor: &mut Cursor<'_>) -> Result<CameraModel, Malformed> {
    let radial =
        |(intrinsics, distortion): (Intrinsics, &[f64])| RadialTangential::from_opencv(intrinsics, distortion).into();
    Ok(match kind {
        0 => Pinhole { intrinsics: one_focal(&cursor.f64s::<3>()?) }.into(),
        1 => Pinhole { intrinsics: two_focal(&cursor.f64s::<4>()?) }.into(),
        2 => cursor.f64s::<4>().map(|p| radial((one_focal(&p), &p[3..])))?,
        3 => cursor.f64s::<5>().map(|p| radial((one_focal(&p), &p[3..])))?,
        4 => cursor.f64s::<8>().map(|p| radial((two_focal(&p), &p[4..])))?,
        5 => cursor.f64s::<8>().map(|p| fisheye(two_focal(&p), &p[4..]))?,
        6 => cursor.f64s::<12>().map(|p| radial((two_focal(&p), &p[4..])))?,
        8 => cursor.f64s::<4>().map(|p| fisheye(one_focal(&p), &p[3..]))?,
        9 => cursor.f64s::<5>().map(|p| fisheye(one_focal(&p), &p[3..]))?,
        _ => return Err(Malformed::whole(format!("holds COLMAP camera model {kind}, which is not supported"))),
    })
}

fn fisheye(intrinsics: Intrinsics, distortion: &[f64]) -> CameraModel {
    let k = |index: usize| distortion.get(index).copied().unwrap_or(0.0);
    KannalaBrandt { intrinsics, k1: k(0), k2: k(1), k3: k(2), k4: k(3) }.into()
}

/// `f, cx, cy, ...`; COLMAP's first pixel has its centre at (0.5, 0.5).
fn one_focal(p: &[f64]) -> Intrinsics {
    Intrinsics { fx: p[0], fy: p[0], cx: p[1] - 0.5, cy: p[2] - 0.5, skew: 0.0 }
}

/// `fx, fy, cx, cy, ...`.
fn two_focal(p: &[f64]) -> Intrinsics {
    Intrinsics { fx: p[0], fy: p[1], cx: p[2] - 0.5, cy: p[3] - 0.5, skew: 0.0 }
}

/// Reads `images.bin`: the registered pictures in the file's order.
///
/// # Errors
/// [`Malformed`] if the bytes end early or a picture has no name or no rotation.
pub fn parse_images(bytes: &[u8]) -> Result<Vec<ColmapImage>, Malformed> {
    let mut cursor = Cursor { rest: bytes };
    (0..cursor.u64()?).map(|_| image(&mut cursor)).collect()
}

fn image(cursor: &mut Cursor<'_>) -> Result<ColmapImage, Malformed> {
    let number = cursor.u32()?;
    let [qw, qx, qy, qz, tx, ty, tz] = cursor.f64s()?;
    let camera = cursor.u32()?;
    let name = cursor.text()?;
    cursor.skip(cursor.peek_u64()?.saturating_mul(POINT_BYTES).saturating_add(8))?;
    let camera_from_world = se3::from_quaternion([tx, ty, tz], [qx, qy, qz, qw])
        .map_err(|error| Malformed::whole(format!("image {number}: {error}")))?;
    Ok(ColmapImage { name, camera, world_from_camera: camera_from_world.inverse() })
}

/// What is left to read.
struct Cursor<'a> {
    rest: &'a [u8],
}

impl<'a> Cursor<'a> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], Malformed> {
        let (head, rest) = self.rest.split_first_chunk::<N>().ok_or_else(ends_early)?;
        self.rest = rest;
        Ok(*head)
    }

    fn u32(&mut self) -> Result<u32, Malformed> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, Malformed> {
        self.take().map(u64::from_le_bytes)
    }

    fn peek_u64(&self) -> Result<u64, Malformed> {
        Cursor { rest: self.rest }.u64()
    }

    fn f64s<const N: usize>(&mut self) -> Result<[f64; N], Malformed> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = f64::from_le_bytes(self.take()?);
        }
        Ok(values)
    }

    /// Text up to a zero byte.
    fn text(&mut self) -> Result<String, Malformed> {
        let end = self.rest.iter().take(LONGEST_NAME).position(|byte| *byte == 0).ok_or_else(ends_early)?;
        let (text, rest): (&'a [u8], _) = self.rest.split_at(end);
        self.rest = &rest[1..];
        Ok(String::from_utf8_lossy(text).into_owned())
    }

    fn skip(&mut self, bytes: u64) -> Result<(), Malformed> {
        let bytes = usize::try_from(bytes).map_err(|_| ends_early())?;
        self.rest = self.rest.get(bytes..).ok_or_else(ends_early)?;
        Ok(())
    }
}

fn ends_early() -> Malformed {
    Malformed::whole("is no COLMAP file or ends early")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cameras_file(kind: u32, parameters: &[f64]) -> Vec<u8> {
        let mut bytes = 1_u64.to_le_bytes().to_vec();
        bytes.extend(7_u32.to_le_bytes());
        bytes.extend(kind.to_le_bytes());
        bytes.extend(1440_u64.to_le_bytes());
        bytes.extend(1080_u64.to_le_bytes());
        bytes.extend(parameters.iter().flat_map(|value| value.to_le_bytes()));
        bytes
    }

    #[test]
    fn cameras_lose_half_a_pixel() {
        let bytes = cameras_file(5, &[717.0, 718.0, 735.5, 552.5, -0.1, 0.0, 0.0, 0.0]);
        let cameras = parse_cameras(&bytes).unwrap();
        let CameraModel::KannalaBrandt(model) = cameras[0].1.model() else { panic!("{cameras:?}") };
        assert_eq!((cameras[0].0, model.intrinsics.cx, model.k1), (7, 735.0, -0.1));
        assert!(parse_cameras(&bytes[..bytes.len() - 1]).unwrap_err().reason.contains("ends early"));
        let error = parse_cameras(&cameras_file(7, &[0.0; 5])).unwrap_err();
        assert_eq!(error.reason, "holds COLMAP camera model 7, which is not supported");
        let error = parse_cameras(&cameras_file(1, &[0.0, 718.0, 735.5, 552.5])).unwrap_err();
        assert_eq!(error.reason, "camera 7: camera parameter fx is 0, but it must be above zero");
    }

    #[test]
    fn a_count_without_data_costs_nothing() {
        assert!(parse_images(&u64::MAX.to_le_bytes()).is_err());
        assert!(parse_cameras(&u64::MAX.to_le_bytes()).is_err());
    }
}
