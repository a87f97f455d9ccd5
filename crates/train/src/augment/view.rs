//! Changes of the view that the camera takes part in: enlarging with a crop, mirroring, and turning a source.
//!
//! A crop of an enlarged picture is what a longer lens would have seen, a mirrored picture is what the mirrored
//! lens would have seen of a mirrored patient, and a turned one ([`Turn`]) what the camera would have seen had it looked
//! elsewhere from where it was. All are exact: camera and motion are changed with the pixels, so the geometry
//! a network learns from stays true.

use super::planes::Planes;
use super::turn::Turn;
use crate::error::TrainError;
use endoscape_core::camera::Intrinsics;
use endoscape_core::{Camera, CameraError, CameraModel, DepthMap, Image, Mask, Pose, Rect, Size};
use nalgebra::Vector3;

/// An enlargement, a crop back to the size before, and perhaps mirrorings, in this order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewChange {
    /// Size before and after.
    size: Size,
    /// Size in between.
    enlarged: Size,
    /// First column and row of the crop.
    corner: [usize; 2],
    /// Left to right, and upside down.
    mirrored: [bool; 2],
}

impl ViewChange {
    /// Enlarges by `scale`, at least 1, and crops at `place` (0 to 1 of the way from the left or upper to the right or
    /// lower end).
    pub fn new(size: Size, scale: [f64; 2], place: [f64; 2], mirrored: [bool; 2]) -> Self {
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
        Ok(mirrored(&camera, self.mirrored)?)
    }

    /// How many pixels lie hidden beyond the left, right, upper and lower edge of the changed picture.
    pub fn hidden(&self) -> [f64; 4] {
        let beyond = |axis: usize, larger: usize, extent: usize| {
            let (before, after) = (self.corner[axis], larger - extent - self.corner[axis]);
            if self.mirrored[axis] { [after, before] } else { [before, after] }
        };
        let [left, right] = beyond(0, self.enlarged.width, self.size.width);
        let [upper, lower] = beyond(1, self.enlarged.height, self.size.height);
        [left, right, upper, lower].map(|pixels| pixels as f64)
    }

    /// The changed picture, of a turned camera if there is a turn.
    pub fn picture(&self, image: &Image, turn: Option<&Turn>) -> Planes {
        let planes = Planes::new(image);
        if self.is_identity() && turn.is_none() {
            return planes;
        }
        Planes::from_fn(self.size, |x, y| {
            let [x, y] = self.source(place(x, y, turn));
            planes.sample(x, y)
        })
    }

    /// The changed mask, 1 where all pixels that are mixed into one exist and are usable, else 0; row after row.
    pub fn mask(&self, mask: &Mask, turn: Option<&Turn>) -> Vec<f32> {
        // Half a pixel beyond the outermost centres is the edge of the picture.
        let exists = |at: f32, extent: usize| (-0.5..=extent as f32 - 0.5).contains(&at);
        let usable = |x: usize, y: usize| {
            let [x, y] = self.source(place(x, y, turn));
            if !(exists(x, self.size.width) && exists(y, self.size.height)) {
                return 0.0;
            }
            let (columns, rows) = (around(x, self.size.width), around(y, self.size.height));
            let all = rows.iter().all(|y| columns.iter().all(|x| mask.get(*x, *y).is_some_and(|usable| *usable)));
            f32::from(u8::from(all))
        };
        (0..self.size.area()).map(|pixel| usable(pixel % self.size.width, pixel / self.size.width)).collect()
    }

    /// The changed depth map, 0 where one of the depths that are mixed into a pixel is unknown; row after row.
    ///
    /// Depth along the axis is what it was: neither a longer lens nor a mirror changes it.
    pub fn depth(&self, depth: &DepthMap) -> Vec<f32> {
        let mixed = |pixel: usize| {
            let [x, y] = self.source(place(pixel % self.size.width, pixel / self.size.width, None));
            let ([left, right], [top, bottom]) = (around(x, self.size.width), around(y, self.size.height));
            let at = |x: usize, y: usize| depth.get(x, y).filter(|depth| *depth > 0.0);
            let (u, v) = ((x - left as f32).clamp(0.0, 1.0), (y - top as f32).clamp(0.0, 1.0));
            let row = |y: usize| Some(at(left, y)? * (1.0 - u) + at(right, y)? * u);
            Some(row(top)? * (1.0 - v) + row(bottom)? * v)
        };
        (0..self.size.area()).map(|pixel| mixed(pixel).unwrap_or(0.0)).collect()
    }

    /// The same motion as the changed camera sees it: in a mirrored world a mirrored one.
    pub fn motion(&self, motion: &Pose) -> Pose {
        if self.mirrored == [false; 2] {
            return *motion;
        }
        let [x, y] = self.mirrored.map(|mirrored| if mirrored { -1.0 } else { 1.0 });
        let (t, w) = (motion.translation.vector, motion.rotation.scaled_axis());
        // A mirror turns vectors along its normal round, and axes of rotation along the other two.
        Pose::new(Vector3::new(x * t.x, y * t.y, t.z), Vector3::new(y * w.x, x * w.y, x * y * w.z))
    }

    fn is_identity(&self) -> bool {
        self.enlarged == self.size && self.mirrored == [false; 2]
    }

    /// Place in the picture before the change that shows at a place after it.
    fn source(&self, place: [f64; 2]) -> [f32; 2] {
        // Edges map to edges, as in `Camera::scaled_to`.
        let before = |axis: usize, larger: usize, extent: usize| {
            let at = if self.mirrored[axis] { extent as f64 - 1.0 - place[axis] } else { place[axis] };
            ((at + self.corner[axis] as f64 + 0.5) * extent as f64 / larger as f64 - 0.5) as f32
        };
        [before(0, self.enlarged.width, self.size.width), before(1, self.enlarged.height, self.size.height)]
    }
}

/// Where in the picture of the camera before its turn a pixel shows what is there.
fn place(x: usize, y: usize, turn: Option<&Turn>) -> [f64; 2] {
    turn.map_or([x as f64, y as f64], |turn| turn.place(x, y))
}

/// The one or two pixels that bilinear sampling mixes along an axis.
fn around(at: f32, extent: usize) -> [usize; 2] {
    let last = extent - 1;
    let at = at.clamp(0.0, last as f32);
    [at.floor() as usize, (at.ceil() as usize).min(last)]
}

/// The camera that sees the world mirrored left to right, upside down or both: left to right it images `(-x, y, z)` at
/// column `W - 1 - u` wherever the camera images `(x, y, z)` at column `u`.
///
/// # Errors
/// [`CameraError`] as [`Camera::new`]; a camera that exists has a mirror image.
pub fn mirrored(camera: &Camera, [x, y]: [bool; 2]) -> Result<Camera, CameraError> {
    let Size { width, height } = camera.size();
    let across = |mirrored: bool, centre: f64, extent: usize| {
        if mirrored { extent as f64 - 1.0 - centre } else { centre }
    };
    // What mixes both axes changes its sign unless both are mirrored; what points along one, with that one.
    let sign = |changes: bool| if changes { -1.0 } else { 1.0 };
    let mixed = sign(x != y);
    let flip = |lens: Intrinsics| Intrinsics {
        cx: across(x, lens.cx, width),
        cy: across(y, lens.cy, height),
        skew: mixed * lens.skew,
        ..lens
    };
    let mut model = *camera.model();
    match &mut model {
        CameraModel::Pinhole(lens) => lens.intrinsics = flip(lens.intrinsics),
        CameraModel::KannalaBrandt(lens) => lens.intrinsics = flip(lens.intrinsics),
        CameraModel::Unified(lens) => lens.intrinsics = flip(lens.intrinsics),
        CameraModel::RadialTangential(lens) => {
            lens.intrinsics = flip(lens.intrinsics);
            // Decentring towards the sides changes its direction with them, that towards top and bottom with those.
            (lens.p1, lens.p2) = (sign(y) * lens.p1, sign(x) * lens.p2);
        }
        CameraModel::Omnidirectional(lens) => {
            let [[c, d], [e, f]] = lens.stretch;
            (lens.cx, lens.cy) = (across(x, lens.cx, width), across(y, lens.cy, height));
            lens.stretch = [[c, mixed * d], [mixed * e, f]];
        }
    }
    Camera::new(camera.size(), model)
}

#[cfg(test)]
mod tests {
    use super::*;
    use endoscape_core::Grid;
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
        fn a_mirrored_camera_images_the_mirrored_point(x in -0.5..0.5, y in -0.4..0.4, z in 0.8..2.0, axes in any::<[bool; 2]>()) {
            let flip = |mirrored: bool, at: f64| if mirrored { -at } else { at };
            let across = |mirrored: bool, at: f64, last: f64| if mirrored { last - at } else { at };
            for camera in lenses() {
                let pixel = camera.project(&Point3::new(x, y, z)).unwrap();
                let point = Point3::new(flip(axes[0], x), flip(axes[1], y), z);
                let reflected = mirrored(&camera, axes).unwrap().project(&point).unwrap();
                prop_assert!((reflected.x - across(axes[0], pixel.x, 63.0)).abs() < 1e-9, "{camera:?}");
                prop_assert!((reflected.y - across(axes[1], pixel.y, 47.0)).abs() < 1e-9, "{camera:?}");
            }
        }

        /// The law of the whole module: where the changed camera sees a point, the changed picture shows it.
        #[test]
        fn camera_and_picture_change_together(
            x in -0.3..0.3_f64, y in -0.2..0.2_f64, scale in prop::array::uniform2(1.0..1.3), place in prop::array::uniform2(0.0..1.0),
            mirror in any::<[bool; 2]>(),
        ) {
            let change = ViewChange::new(SIZE, scale, place, mirror);
            for camera in lenses() {
                let seen = change.camera(&camera).unwrap();
                let point = Point3::new(if mirror[0] { -x } else { x }, if mirror[1] { -y } else { y }, 1.0);
                let after = seen.project(&point).unwrap();
                let before = camera.project(&Point3::new(x, y, 1.0)).unwrap();
                // A picture whose red is its column and green its row tells where each pixel came from.
                let [column, row] = change.source([after.x, after.y]);
                prop_assert!((f64::from(column) - before.x).abs() < 1e-4);
                prop_assert!((f64::from(row) - before.y).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn pictures_and_masks_follow_the_same_map() {
        let image = Image::from_fn(SIZE, |x, y| [4 * x as u8, 5 * y as u8, 0]);
        let change = ViewChange::new(SIZE, [1.15, 1.1], [1.0, 0.5], [true, false]);
        let planes = change.picture(&image, None);
        for (x, y) in [(0, 0), (10, 20), (63, 47)] {
            let [u, v] = change.source([x as f64, y as f64]);
            let at = y * 64 + x;
            assert!((planes.values()[at] - 4.0 * u.clamp(0.0, 63.0) / 255.0).abs() < 1e-5);
            assert!((planes.values()[SIZE.area() + at] - 5.0 * v.clamp(0.0, 47.0) / 255.0).abs() < 1e-5);
        }
        let bad = Mask::from_fn(SIZE, |x, _| x < 32);
        let moved = change.mask(&bad, None);
        for (pixel, usable) in moved.iter().enumerate() {
            let [u, _] = change.source([(pixel % 64) as f64, (pixel / 64) as f64]);
            assert_eq!(*usable == 1.0, u.ceil() < 32.0, "pixel {pixel}");
        }
    }

    proptest! {
        #[test]
        fn a_mirrored_motion_moves_mirrored_points(twist in prop::array::uniform6(-0.5..0.5), point in prop::array::uniform3(-1.0..1.0), axes in any::<[bool; 2]>()) {
            let [x, y, z, a, b, c] = twist;
            let motion = Pose::new(Vector3::new(x, y, z), Vector3::new(a, b, c));
            let [a, b] = axes.map(|mirrored| if mirrored { -1.0 } else { 1.0 });
            let flip = |p: Point3<f64>| Point3::new(a * p.x, b * p.y, p.z);
            let seen = ViewChange::new(SIZE, [1.0, 1.0], [0.0, 0.0], axes).motion(&motion);
            let point = Point3::from(point);
            prop_assert!((flip(motion * point) - seen * flip(point)).norm() < 1e-12);
            prop_assert_eq!(ViewChange::new(SIZE, [1.2, 1.1], [0.3, 0.9], [false; 2]).motion(&motion), motion);
        }
    }

    #[test]
    fn depth_follows_the_picture() {
        let change = ViewChange::new(SIZE, [1.15, 1.1], [1.0, 0.5], [true, false]);
        let depth = DepthMap::new(Grid::from_fn(SIZE, |x, y| if x == 30 { 0.0 } else { (1 + x + 2 * y) as f32 }));
        for (pixel, depth) in change.depth(&depth).into_iter().enumerate() {
            let [u, v] = change.source([(pixel % 64) as f64, (pixel / 64) as f64]);
            let expected = 1.0 + u.clamp(0.0, 63.0) + 2.0 * v.clamp(0.0, 47.0);
            let unknown = around(u, 64).contains(&30);
            assert!(
                if unknown { depth == 0.0 } else { (depth - expected).abs() < 1e-3 },
                "{pixel}: {depth}, {expected}"
            );
        }
    }

    #[test]
    fn no_change_changes_nothing() {
        let image = Image::from_fn(SIZE, |x, y| [x as u8, y as u8, 7]);
        let change = ViewChange::new(SIZE, [1.0, 1.0], [0.3, 0.9], [false; 2]);
        assert_eq!(change.picture(&image, None), Planes::new(&image));
        let camera = lenses()[1];
        assert_eq!(change.camera(&camera).unwrap(), camera);
    }
}
