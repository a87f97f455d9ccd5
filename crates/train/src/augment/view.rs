//! Changes of the view that the camera takes part in: enlarging with a crop, and mirroring.
//!
//! A crop of an enlarged picture is what a longer lens would have seen, and a mirrored picture is what the mirrored
//! lens would have seen of a mirrored patient. Both are exact: the camera is changed with the pixels, so the geometry
//! a network learns from stays true.

use super::planes::Planes;
use crate::error::TrainError;
use endoscape_core::camera::Intrinsics;
use endoscape_core::{Camera, CameraError, CameraModel, Image, Mask, Rect, Size};

/// An enlargement, a crop back to the size before, and perhaps a mirroring, in this order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewChange {
    /// Size before and after.
    size: Size,
    /// Size in between.
    enlarged: Size,
    /// First column and row of the crop.
    corner: [usize; 2],
    mirrored: bool,
}

impl ViewChange {
    /// Enlarges by `scale`, at least 1, and crops at `place` (0 to 1 of the way from the left or upper to the right or
    /// lower end).
    pub fn new(size: Size, scale: [f64; 2], place: [f64; 2], mirrored: bool) -> Self {
        let grown = |extent: usize, scale: f64| ((extent as f64 * scale.max(1.0)).round() as usize).max(extent);
        let enlarged = Size::new(grown(size.width, scale[0]), grown(size.height, scale[1]));
        let start = |larger: usize, extent: usize, place: f64| {
            let free = larger - extent;
            ((place.clamp(0.0, 1.0) * (free + 1) as f64) as usize).min(free)
        };
        let corner = [start(enlarged.width, size.width, place[0]), start(enlarged.height, size.height, place[1])];
        Self { size, enlarged, corner, mirrored }
    }

    /// The camera that takes the changed picture.
    ///
    /// # Errors
    /// [`TrainError::Camera`] if `camera` is not of the size of the change.
    pub fn camera(&self, camera: &Camera) -> Result<Camera, TrainError> {
        let rect = Rect { x: self.corner[0], y: self.corner[1], size: self.size };
        let camera = camera.scaled_to(self.enlarged)?.cropped(rect)?;
        Ok(if self.mirrored { mirrored(&camera)? } else { camera })
    }

    /// The changed picture.
    pub fn picture(&self, image: &Image) -> Planes {
        let planes = Planes::new(image);
        if self.is_identity() {
            return planes;
        }
        Planes::from_fn(self.size, |x, y| {
            let [x, y] = self.source(x, y);
            planes.sample(x, y)
        })
    }

    /// The changed mask, 1 where all pixels that are mixed into one are usable, else 0; row after row.
    pub fn mask(&self, mask: &Mask) -> Vec<f32> {
        let usable = |x: usize, y: usize| {
            let [x, y] = self.source(x, y);
            let (columns, rows) = (around(x, self.size.width), around(y, self.size.height));
            let all = rows.iter().all(|y| columns.iter().all(|x| mask.get(*x, *y).is_some_and(|usable| *usable)));
            f32::from(u8::from(all))
        };
        (0..self.size.area()).map(|pixel| usable(pixel % self.size.width, pixel / self.size.width)).collect()
    }

    fn is_identity(&self) -> bool {
        self.enlarged == self.size && !self.mirrored
    }

    /// Place in the picture before the change that shows at a pixel after it.
    fn source(&self, x: usize, y: usize) -> [f32; 2] {
        let x = if self.mirrored { self.size.width - 1 - x } else { x };
        // Edges map to edges, as in `Camera::scaled_to`.
        let before = |at: usize, corner: usize, larger: usize, extent: usize| {
            (((at + corner) as f64 + 0.5) * extent as f64 / larger as f64 - 0.5) as f32
        };
        [
            before(x, self.corner[0], self.enlarged.width, self.size.width),
            before(y, self.corner[1], self.enlarged.height, self.size.height),
        ]
    }
}

/// The one or two pixels that bilinear sampling mixes along an axis.
fn around(at: f32, extent: usize) -> [usize; 2] {
    let last = extent - 1;
    let at = at.clamp(0.0, last as f32);
    [at.floor() as usize, (at.ceil() as usize).min(last)]
}

/// The camera that sees the world mirrored left to right: it images `(-x, y, z)` at column `W - 1 - u` wherever the
/// camera images `(x, y, z)` at column `u`.
///
/// # Errors
/// [`CameraError`] as [`Camera::new`]; a camera that exists has a mirror image.
pub fn mirrored(camera: &Camera) -> Result<Camera, CameraError> {
    let last = camera.size().width as f64 - 1.0;
    let flip = |lens: Intrinsics| Intrinsics { cx: last - lens.cx, skew: -lens.skew, ..lens };
    let mut model = *camera.model();
    match &mut model {
        CameraModel::Pinhole(lens) => lens.intrinsics = flip(lens.intrinsics),
        CameraModel::KannalaBrandt(lens) => lens.intrinsics = flip(lens.intrinsics),
        CameraModel::Unified(lens) => lens.intrinsics = flip(lens.intrinsics),
        CameraModel::RadialTangential(lens) => {
            lens.intrinsics = flip(lens.intrinsics);
            // The decentring towards the sides changes its direction, that towards top and bottom does not.
            lens.p2 = -lens.p2;
        }
        CameraModel::Omnidirectional(lens) => {
            let [[c, d], [e, f]] = lens.stretch;
            (lens.cx, lens.stretch) = (last - lens.cx, [[c, -d], [-e, f]]);
        }
    }
    Camera::new(camera.size(), model)
}

#[cfg(test)]
mod tests {
    use super::*;
    use endoscape_core::camera::{KannalaBrandt, Omnidirectional, Pinhole, RadialTangential, Unified};
    use nalgebra::Point3;
    use proptest::prelude::*;

    const SIZE: Size = Size::new(64, 48);

    fn lenses() -> Vec<Camera> {
        let intrinsics = Intrinsics { fx: 40.0, fy: 42.0, cx: 29.0, cy: 25.5, skew: 0.7 };
        let models: [CameraModel; 5] = [
            Pinhole { intrinsics }.into(),
            RadialTangential::from_opencv(intrinsics, &[-0.1, 0.02, 0.003, -0.004, 0.001]).into(),
            KannalaBrandt { intrinsics, k1: 0.02, k2: -0.01, k3: 0.003, k4: 0.0 }.into(),
            Unified { intrinsics, xi: 0.9, k1: -0.05, k2: 0.01 }.into(),
            Omnidirectional {
                cx: 30.0,
                cy: 25.0,
                polynomial: [32.0, 0.0, -0.006, 1e-5, -1e-7],
                stretch: [[1.01, 0.02], [-0.01, 1.0]],
            }
            .into(),
        ];
        models.into_iter().map(|model| Camera::new(SIZE, model).unwrap()).collect()
    }

    proptest! {
        #[test]
        fn a_mirrored_camera_images_the_mirrored_point(x in -0.5..0.5, y in -0.4..0.4, z in 0.8..2.0) {
            for camera in lenses() {
                let pixel = camera.project(&Point3::new(x, y, z)).unwrap();
                let reflected = mirrored(&camera).unwrap().project(&Point3::new(-x, y, z)).unwrap();
                prop_assert!((reflected.x - (63.0 - pixel.x)).abs() < 1e-9, "{camera:?}");
                prop_assert!((reflected.y - pixel.y).abs() < 1e-9, "{camera:?}");
            }
        }

        /// The law of the whole module: where the changed camera sees a point, the changed picture shows it.
        #[test]
        fn camera_and_picture_change_together(
            x in -0.3..0.3_f64, y in -0.2..0.2_f64, scale in prop::array::uniform2(1.0..1.3), place in prop::array::uniform2(0.0..1.0),
            mirror in any::<bool>(),
        ) {
            let change = ViewChange::new(SIZE, scale, place, mirror);
            for camera in lenses() {
                let seen = change.camera(&camera).unwrap();
                let point = Point3::new(if mirror { -x } else { x }, y, 1.0);
                let after = seen.project(&point).unwrap();
                let before = camera.project(&Point3::new(x, y, 1.0)).unwrap();
                // A picture whose red is its column and green its row tells where each pixel came from.
                let column = if mirror { 63.0 - after.x } else { after.x };
                let source = |at: f64, corner: usize, larger: usize, extent: usize| (at + corner as f64 + 0.5) * extent as f64 / larger as f64 - 0.5;
                prop_assert!((source(column, change.corner[0], change.enlarged.width, 64) - before.x).abs() < 1e-9);
                prop_assert!((source(after.y, change.corner[1], change.enlarged.height, 48) - before.y).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn pictures_and_masks_follow_the_same_map() {
        let image = Image::from_fn(SIZE, |x, y| [4 * x as u8, 5 * y as u8, 0]);
        let change = ViewChange::new(SIZE, [1.15, 1.1], [1.0, 0.5], true);
        let planes = change.picture(&image);
        for (x, y) in [(0, 0), (10, 20), (63, 47)] {
            let [u, v] = change.source(x, y);
            let at = y * 64 + x;
            assert!((planes.values()[at] - 4.0 * u.clamp(0.0, 63.0) / 255.0).abs() < 1e-5);
            assert!((planes.values()[SIZE.area() + at] - 5.0 * v.clamp(0.0, 47.0) / 255.0).abs() < 1e-5);
        }
        let bad = Mask::from_fn(SIZE, |x, _| x < 32);
        let moved = change.mask(&bad);
        for (pixel, usable) in moved.iter().enumerate() {
            let [u, _] = change.source(pixel % 64, pixel / 64);
            assert_eq!(*usable == 1.0, u.ceil() < 32.0, "pixel {pixel}");
        }
    }

    #[test]
    fn no_change_changes_nothing() {
        let image = Image::from_fn(SIZE, |x, y| [x as u8, y as u8, 7]);
        let change = ViewChange::new(SIZE, [1.0, 1.0], [0.3, 0.9], false);
        assert_eq!(change.picture(&image), Planes::new(&image));
        let camera = lenses()[1];
        assert_eq!(change.camera(&camera).unwrap(), camera);
    }
}
