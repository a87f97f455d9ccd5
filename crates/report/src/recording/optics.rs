//! Cameras as the viewer knows them: pinholes alone.

use endoscape_core::{Camera, Image, Size};
use nalgebra::{Point2, Point3};
use re_sdk_types::archetypes::Pinhole;
use re_sdk_types::components::{PinholeProjection, ViewCoordinates};

/// Tangent of the angle off the axis at which the focal length is measured.
const NEAR_AXIS: f64 = 1e-3;

/// Longest side of a recorded picture, pixels: enough to look at, small enough for hours.
const LONGEST_SIDE: usize = 640;

/// Quality of recorded pictures, of 100.
const JPEG_QUALITY: u8 = 85;

/// The pinhole that agrees with a lens near its axis. A frustum cannot show distortion; points are recorded as the lens
/// itself sees them.
///
/// The viewer's pixels cover `0..1`, ours are centred at integers, hence the half pixel. `None` where the lens sees
/// nothing along its axis.
pub(super) fn pinhole(camera: &Camera) -> Option<Pinhole> {
    let pixel = |x: f64, y: f64| camera.project(&Point3::new(x, y, 1.0));
    let (centre, right, down) = (pixel(0.0, 0.0)?, pixel(NEAR_AXIS, 0.0)?, pixel(0.0, NEAR_AXIS)?);
    let focal = [(right.x - centre.x) / NEAR_AXIS, (down.y - centre.y) / NEAR_AXIS].map(|focal| focal as f32);
    let principal = [centre.x + 0.5, centre.y + 0.5].map(|coordinate| coordinate as f32);
    let size = camera.size();
    let projection = PinholeProjection::from_focal_length_and_principal_point(focal, principal);
    Some(
        Pinhole::new(projection)
            .with_resolution([size.width as f32, size.height as f32])
            .with_camera_xyz(ViewCoordinates::RDF),
    )
}

/// Size at which a picture is recorded.
pub(super) fn recorded_size(size: Size) -> Size {
    let longest = size.width.max(size.height).max(LONGEST_SIDE);
    let shrunk = |side: usize| (side * LONGEST_SIDE / longest).max(1);
    Size::new(shrunk(size.width), shrunk(size.height))
}

/// A picture as JPEG.
///
/// # Errors
/// What the encoder says, about pictures no side of which a JPEG can have.
pub(super) fn jpeg(picture: &Image) -> Result<Vec<u8>, image::ImageError> {
    let mut bytes = Vec::new();
    let size = picture.size();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY).encode(
        picture.rgb(),
        size.width as u32,
        size.height as u32,
        image::ExtendedColorType::Rgb8,
    )?;
    Ok(bytes)
}

/// Points of a depth map in the camera's axes, and the pixels they come from; evenly thinned to about `most`.
pub(super) fn points(
    depth: &endoscape_core::DepthMap,
    camera: &Camera,
    most: usize,
) -> Vec<(Point2<f64>, Point3<f64>)> {
    let size = depth.size();
    let known: Vec<usize> = (0..size.area()).filter(|pixel| depth.grid().values()[*pixel] > 0.0).collect();
    let point = |pixel: &usize| {
        let place = Point2::new((pixel % size.width) as f64, (pixel / size.width) as f64);
        let point = camera.unproject_to_depth(&place, f64::from(depth.grid().values()[*pixel]))?;
        Some((place, point))
    };
    known.iter().step_by(known.len().div_ceil(most).max(1)).filter_map(point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use endoscape_core::{DepthMap, Grid};

    #[test]
    fn pictures_only_shrink() {
        assert_eq!(recorded_size(Size::new(320, 256)), Size::new(320, 256));
        assert_eq!(recorded_size(Size::new(1350, 1080)), Size::new(640, 512));
        assert_eq!(recorded_size(Size::new(1080, 1350)), Size::new(512, 640));
        assert_eq!(recorded_size(Size::new(100_000, 1)), Size::new(640, 1));
    }

    #[test]
    fn points_lie_where_the_depth_says() {
        let camera = Camera::from_field_of_view(Size::new(8, 6), 1.2).unwrap();
        let depth = DepthMap::new(Grid::from_fn(Size::new(8, 6), |x, _| if x < 4 { 0.0 } else { 0.05 }));
        let points = points(&depth, &camera, 1000);
        assert_eq!(points.len(), 24);
        for (pixel, point) in points {
            assert!((point.z - 0.05).abs() < 1e-9 && (camera.project(&point).unwrap() - pixel).norm() < 1e-6);
        }
        assert!(super::points(&depth, &camera, 5).len() <= 5);
    }

    #[test]
    fn a_picture_survives_as_jpeg() {
        let picture = Image::from_fn(Size::new(20, 10), |x, _| [10 * x as u8, 0, 0]);
        let decoded = image::load_from_memory(&jpeg(&picture).unwrap()).unwrap().to_rgb8();
        assert_eq!(decoded.dimensions(), (20, 10));
    }
}
