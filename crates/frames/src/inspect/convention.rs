//! The convention a loader uses, and the wrong ones people most often mistake it for.

use endoscape_core::camera::{Intrinsics, Omnidirectional, Pinhole};
use endoscape_core::{Camera, CameraModel, Pose};
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Name of the convention under which the camera stands still.
pub const NO_MOTION: &str = "no motion";

/// One way to read the numbers of a data set.
#[derive(Clone, Debug)]
pub struct Convention {
    /// What a report calls it.
    pub name: String,
    pub(super) camera: Camera,
    pub(super) pose: PoseReading,
    /// Metres per metre the loader stated, for translations.
    pub(super) translation_factor: f64,
    pub(super) depth: DepthReading,
}

impl Convention {
    /// The `world_from_camera` this convention makes of what the loader returned.
    pub(super) fn pose(&self, loaded: &Pose) -> Pose {
        let mut pose = self.pose.apply(loaded);
        pose.translation.vector *= self.translation_factor;
        pose
    }

    /// The same reading with translations in another unit.
    pub(super) fn with_translations_times(&self, factor: f64) -> Self {
        Self { translation_factor: self.translation_factor * factor, ..self.clone() }
    }
}

/// How a stored depth is understood.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum DepthReading {
    /// Along the optical axis: the z coordinate.
    AlongAxis,
    /// Along the ray: the distance from the camera.
    AlongRay,
    /// As its reciprocal, scaled so that the median stays.
    Inverse,
}

/// How a stored pose is understood.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum PoseReading {
    /// `world_from_camera`, camera axes x right, y down, z forward.
    AsLoaded,
    /// The stored matrix is `camera_from_world`.
    Inverse,
    /// Camera axes x right, y up, z backward.
    OpenGl,
    /// `camera_from_world` with OpenGL axes.
    InverseOpenGl,
    /// The other handedness, by mirroring the named axis.
    Mirrored(usize),
    /// No motion at all: what is left when poses do not belong to the frames.
    Still,
}

impl PoseReading {
    /// The `world_from_camera` this reading makes of what the loader returned.
    pub(super) fn apply(self, loaded: &Pose) -> Pose {
        match self {
            Self::AsLoaded => *loaded,
            Self::Inverse => loaded.inverse(),
            Self::OpenGl => loaded * half_turn_about_x(),
            Self::InverseOpenGl => loaded.inverse() * half_turn_about_x(),
            Self::Mirrored(axis) => mirrored(loaded, axis),
            Self::Still => Pose::identity(),
        }
    }
}

/// Turns OpenGL camera axes into OpenCV's.
fn half_turn_about_x() -> Pose {
    Pose::from_parts(Translation3::identity(), UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
}

/// `S P S` with the reflection `S` of one axis; the reflections cancel, so it is a rigid motion again.
pub(crate) fn mirrored(pose: &Pose, axis: usize) -> Pose {
    let mut mirror = Matrix3::identity();
    mirror[(axis, axis)] = -1.0;
    let rotation = mirror * pose.rotation.to_rotation_matrix().into_inner() * mirror;
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    Pose::from_parts((mirror * pose.translation.vector).into(), rotation)
}

/// The loader's convention first, then the common wrong ones that would differ for this camera.
pub fn conventions(camera: &Camera) -> Vec<Convention> {
    let make = |name: &str, camera: Camera, pose, depth| {
        Convention { name: name.into(), camera, pose, translation_factor: 1.0, depth }
    };
    let poses = [
        ("as loaded", PoseReading::AsLoaded),
        ("inverse pose (camera_from_world)", PoseReading::Inverse),
        ("OpenGL camera axes (y up, z backward)", PoseReading::OpenGl),
        ("inverse pose, OpenGL camera axes", PoseReading::InverseOpenGl),
        ("other handedness, x mirrored", PoseReading::Mirrored(0)),
        ("other handedness, y mirrored", PoseReading::Mirrored(1)),
        ("other handedness, z mirrored", PoseReading::Mirrored(2)),
        (NO_MOTION, PoseReading::Still),
    ];
    let axis = DepthReading::AlongAxis;
    let mut all: Vec<Convention> = poses.iter().map(|(name, pose)| make(name, *camera, *pose, axis)).collect();
    let units = [("1000 times larger", 1e3), ("10 times larger", 10.0), ("10 times smaller", 0.1), ("1000 times smaller", 1e-3)];
    all.extend(units.map(|(name, factor)| {
        make(&format!("translations {name}"), *camera, PoseReading::AsLoaded, axis).with_translations_times(factor)
    }));
    all.push(make("depth along the ray", *camera, PoseReading::AsLoaded, DepthReading::AlongRay));
    all.push(make("inverse depth", *camera, PoseReading::AsLoaded, DepthReading::Inverse));
    for (name, variant) in camera_variants(camera) {
        all.push(make(name, variant, PoseReading::AsLoaded, axis));
    }
    all
}

/// The same camera with its numbers mixed up in the usual ways, as far as that changes anything.
fn camera_variants(camera: &Camera) -> Vec<(&'static str, Camera)> {
    let model = *camera.model();
    let swap_focal = edited(model, |i| Intrinsics { fx: i.fy, fy: i.fx, ..i });
    let swap_centre = edited(model, |i| Intrinsics { cx: i.cy, cy: i.cx, ..i });
    let mut variants = vec![("fx and fy swapped", swap_focal), ("cx and cy swapped", swap_centre)];
    if !matches!(model, CameraModel::Pinhole(_)) {
        variants.push(("pinhole without distortion", Pinhole { intrinsics: intrinsics_of(model) }.into()));
    }
    let differs = |(name, model): (&'static str, CameraModel)| {
        Camera::new(camera.size(), model).ok().filter(|variant| differs_visibly(camera, variant)).map(|c| (name, c))
    };
    variants.into_iter().filter_map(differs).collect()
}

/// Whether two cameras see the same point more than half a pixel apart somewhere near the middle of the picture;
/// closer variants cannot be told apart by depth.
fn differs_visibly(a: &Camera, b: &Camera) -> bool {
    [(0.2, 0.1), (-0.2, 0.2), (0.0, 0.0), (0.3, -0.3)].iter().any(|(x, y)| {
        let point = nalgebra::Point3::new(*x, *y, 1.0);
        match (a.project(&point), b.project(&point)) {
            (Some(a), Some(b)) => (a - b).norm() > 0.5,
            (a, b) => a.is_some() != b.is_some(),
        }
    })
}

/// Focal lengths and principal point of any model, as a pinhole near the axis would have them.
fn intrinsics_of(model: CameraModel) -> Intrinsics {
    match model {
        CameraModel::Pinhole(m) => m.intrinsics,
        CameraModel::RadialTangential(m) => m.intrinsics,
        CameraModel::KannalaBrandt(m) => m.intrinsics,
        CameraModel::Unified(m) => {
            let Intrinsics { fx, fy, .. } = m.intrinsics;
            Intrinsics { fx: fx / (1.0 + m.xi), fy: fy / (1.0 + m.xi), ..m.intrinsics }
        }
        CameraModel::Omnidirectional(Omnidirectional { cx, cy, polynomial, stretch }) => {
            Intrinsics { fx: polynomial[0] * stretch[0][0], fy: polynomial[0] * stretch[1][1], cx, cy, skew: 0.0 }
        }
    }
}

fn edited(mut model: CameraModel, edit: impl Fn(Intrinsics) -> Intrinsics) -> CameraModel {
    match &mut model {
        CameraModel::Pinhole(m) => m.intrinsics = edit(m.intrinsics),
        CameraModel::RadialTangential(m) => m.intrinsics = edit(m.intrinsics),
        CameraModel::KannalaBrandt(m) => m.intrinsics = edit(m.intrinsics),
        CameraModel::Unified(m) => m.intrinsics = edit(m.intrinsics),
        CameraModel::Omnidirectional(m) => {
            let from = intrinsics_of(CameraModel::Omnidirectional(*m));
            let to = edit(from);
            (m.cx, m.cy) = (to.cx, to.cy);
            m.stretch[0] = m.stretch[0].map(|x| x * to.fx / from.fx);
            m.stretch[1] = m.stretch[1].map(|x| x * to.fy / from.fy);
        }
    }
    model
}

#[cfg(test)]
mod tests {
    use super::*;
    use endoscape_core::{Size, se3};
    use nalgebra::Vector6;

    #[test]
    fn readings_that_undo_themselves() {
        let pose = se3::exp(&Vector6::new(0.1, 0.2, -0.3, 0.5, -0.4, 0.3));
        for reading in [PoseReading::Inverse, PoseReading::OpenGl, PoseReading::Mirrored(1)] {
            let twice = reading.apply(&reading.apply(&pose));
            assert!((twice.to_homogeneous() - pose.to_homogeneous()).amax() < 1e-12, "{reading:?}");
        }
    }

    #[test]
    fn mixed_up_cameras_are_tried_only_where_they_differ() {
        let square = Camera::from_field_of_view(Size::new(100, 100), 1.0).unwrap();
        assert!(camera_variants(&square).is_empty());
        let wide = Camera::from_field_of_view(Size::new(200, 100), 1.0).unwrap();
        let names: Vec<_> = camera_variants(&wide).into_iter().map(|(name, _)| name).collect();
        assert_eq!(names, ["cx and cy swapped"]);
    }
}
