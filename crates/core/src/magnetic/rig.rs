//! What `magnet.toml` says: the magnet, its place on the camera, the sensors and their place in the world.

use super::Dipole;
use crate::{Pose, se3};
use nalgebra::{Point3, UnitVector3, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// How far a written direction may be from unit length before it is refused rather than normalised.
const UNIT_TOLERANCE: f64 = 1e-3;
/// Measurements that five unknowns need at least.
const FEWEST_MEASUREMENTS: usize = 5;

/// Why numbers are no magnet and array.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum MagneticError {
    /// NaN or infinity among the numbers.
    #[error("{name} holds a number that is not finite")]
    NotFinite {
        /// Name as written in `magnet.toml`.
        name: &'static str,
    },
    /// A strength or noise that is zero or negative.
    #[error("{name} is {value}, but it must be above zero")]
    NotPositive {
        /// Name as written in `magnet.toml`.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// A direction that is not of unit length.
    #[error("{name} has a direction of length {length:.4}, but it must be of length 1")]
    NotUnit {
        /// Name as written in `magnet.toml`.
        name: &'static str,
        /// Its length.
        length: f64,
    },
    /// Less measurements than unknowns.
    #[error(
        "the array measures {measurements} values, but position and heading of a magnet need at least {FEWEST_MEASUREMENTS}"
    )]
    TooFew {
        /// Sensors times axes.
        measurements: usize,
    },
    /// A bias for some sensors only.
    #[error("the array has {sensors} sensors but array.bias_tesla has {biases} entries; give one for each or none")]
    Unpaired {
        /// Number of sensors.
        sensors: usize,
        /// Number of biases.
        biases: usize,
    },
    /// The place of the array is no rigid motion.
    #[error("world_from_array: {0}")]
    Pose(#[from] se3::PoseError),
}

/// The magnet of a capsule and where it sits on its camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Magnet {
    /// Strength of its moment in A m^2: remanence times volume over mu_0.
    pub moment_a_m2: f64,
    /// Its centre in the camera's frame, metres.
    #[serde(default)]
    pub position_in_camera_m: [f64; 3],
    /// Unit direction of its moment, south to north, in the camera's frame.
    pub axis_in_camera: [f64; 3],
}

/// An array of equal sensors with parallel axes, in its own frame (see the [module](super) for the frame).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HallArray {
    /// Standard deviation of one component of one reading, tesla.
    pub noise_tesla: f64,
    /// Largest magnitude a component can show; at and beyond it a component is no measurement.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub saturation_tesla: Option<f64>,
    /// Unit directions every sensor measures along: one of a mono-axial sensor, three of a full one.
    pub axes: Vec<[f64; 3]>,
    /// Centres of the sensors, metres.
    pub positions_m: Vec<[f64; 3]>,
    /// What each sensor shows where there is no magnet, tesla: its offset and the field of the room. Readings hold it,
    /// methods subtract it; empty where the readings are free of it or it is unknown.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub bias_tesla: Vec<[f64; 3]>,
}

impl HallArray {
    /// A centred grid of `columns` x `rows` sensors in the plane z = 0, row after row, `pitch_m` apart.
    ///
    /// `axes` are the directions measured, such as `&HallArray::TRIAXIAL`.
    pub fn grid(columns: usize, rows: usize, pitch_m: f64, axes: &[[f64; 3]], noise_tesla: f64) -> Self {
        let place = |index: usize, count: usize| pitch_m * (index as f64 - 0.5 * (count as f64 - 1.0));
        let row = |y| (0..columns).map(move |x| [place(x, columns), place(y, rows), 0.0]);
        let positions_m = (0..rows).flat_map(row).collect();
        Self { noise_tesla, saturation_tesla: None, axes: axes.to_vec(), positions_m, bias_tesla: Vec::new() }
    }

    /// Axes of a sensor that measures the whole vector.
    pub const TRIAXIAL: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

    fn check(&self) -> Result<(), MagneticError> {
        positive("array.noise_tesla", self.noise_tesla)?;
        self.saturation_tesla.map_or(Ok(()), |value| positive("array.saturation_tesla", value))?;
        self.axes.iter().try_for_each(|axis| unit("array.axes", axis).map(drop))?;
        finite("array.positions_m", self.positions_m.as_flattened())?;
        finite("array.bias_tesla", self.bias_tesla.as_flattened())?;
        let (sensors, biases) = (self.positions_m.len(), self.bias_tesla.len());
        if biases != 0 && biases != sensors {
            return Err(MagneticError::Unpaired { sensors, biases });
        }
        let measurements = self.axes.len() * self.positions_m.len();
        if measurements < FEWEST_MEASUREMENTS { Err(MagneticError::TooFew { measurements }) } else { Ok(()) }
    }
}

/// Magnet and array as they stand to each other and to the world.
///
/// ```
/// use endoscape_core::magnetic::{HallArray, Magnet, MagneticRig};
/// let magnet = Magnet { moment_a_m2: 0.2, position_in_camera_m: [0.0, 0.0, -0.01], axis_in_camera: [0.0, 0.0, 1.0] };
/// let array = HallArray::grid(8, 8, 0.03, &HallArray::TRIAXIAL, 5e-7);
/// let rig = MagneticRig::new(magnet, array, nalgebra::Isometry3::identity())?;
/// let field = rig.field_tesla(&nalgebra::Isometry3::translation(0.0, 0.0, 0.1));
/// assert_eq!(field.len(), 64);
/// # Ok::<(), endoscape_core::magnetic::MagneticError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RigFile", into = "RigFile")]
pub struct MagneticRig {
    magnet: Magnet,
    array: HallArray,
    world_from_array: Pose,
}

impl MagneticRig {
    /// Checks the numbers and normalises directions.
    ///
    /// # Errors
    /// [`MagneticError`] for the first number that cannot be right.
    pub fn new(mut magnet: Magnet, mut array: HallArray, world_from_array: Pose) -> Result<Self, MagneticError> {
        positive("magnet.moment_a_m2", magnet.moment_a_m2)?;
        finite("magnet.position_in_camera_m", &magnet.position_in_camera_m)?;
        magnet.axis_in_camera = unit("magnet.axis_in_camera", &magnet.axis_in_camera)?;
        array.check()?;
        for axis in &mut array.axes {
            *axis = unit("array.axes", axis)?;
        }
        Ok(Self { magnet, array, world_from_array })
    }

    /// The magnet.
    pub const fn magnet(&self) -> &Magnet {
        &self.magnet
    }

    /// The array.
    pub const fn array(&self) -> &HallArray {
        &self.array
    }

    /// Where the array stands: maps its points to the world the camera's poses are in.
    pub const fn world_from_array(&self) -> &Pose {
        &self.world_from_array
    }

    /// Direction of the magnet's moment in the camera's frame.
    pub fn axis_in_camera(&self) -> UnitVector3<f64> {
        UnitVector3::new_normalize(Vector3::from(self.magnet.axis_in_camera))
    }

    /// The magnet, in the array's frame, of a capsule whose camera is at `world_from_camera`.
    pub fn dipole_in_array(&self, world_from_camera: &Pose) -> Dipole {
        let array_from_camera = self.world_from_array.inverse() * world_from_camera;
        let moment_in_camera = self.axis_in_camera().into_inner() * self.magnet.moment_a_m2;
        Dipole {
            position_m: array_from_camera * Point3::from(self.magnet.position_in_camera_m),
            moment_a_m2: array_from_camera * moment_in_camera,
        }
    }

    /// What sensors without noise and bias see of a capsule whose camera is at `world_from_camera`: flux density in
    /// tesla at each sensor, in the array's frame.
    pub fn field_tesla(&self, world_from_camera: &Pose) -> Vec<Vector3<f64>> {
        let dipole = self.dipole_in_array(world_from_camera);
        self.array.positions_m.iter().map(|at_m| dipole.field_tesla(&Point3::from(*at_m))).collect()
    }
}

/// The rig as it stands in `magnet.toml`.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RigFile {
    #[serde(default)]
    world_from_array: PoseFile,
    magnet: Magnet,
    array: HallArray,
}

/// A pose in numbers a person can write.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseFile {
    translation_m: [f64; 3],
    quaternion_xyzw: [f64; 4],
}

impl Default for PoseFile {
    fn default() -> Self {
        Self { translation_m: [0.0; 3], quaternion_xyzw: [0.0, 0.0, 0.0, 1.0] }
    }
}

impl TryFrom<RigFile> for MagneticRig {
    type Error = MagneticError;

    fn try_from(file: RigFile) -> Result<Self, MagneticError> {
        let PoseFile { translation_m, quaternion_xyzw } = file.world_from_array;
        Self::new(file.magnet, file.array, se3::from_quaternion(translation_m, quaternion_xyzw)?)
    }
}

impl From<MagneticRig> for RigFile {
    fn from(rig: MagneticRig) -> Self {
        let world_from_array = PoseFile {
            translation_m: rig.world_from_array.translation.vector.into(),
            quaternion_xyzw: rig.world_from_array.rotation.coords.into(),
        };
        Self { world_from_array, magnet: rig.magnet, array: rig.array }
    }
}

fn finite(name: &'static str, values: &[f64]) -> Result<(), MagneticError> {
    if values.iter().all(|value| value.is_finite()) { Ok(()) } else { Err(MagneticError::NotFinite { name }) }
}

fn positive(name: &'static str, value: f64) -> Result<(), MagneticError> {
    finite(name, &[value])?;
    if value > 0.0 { Ok(()) } else { Err(MagneticError::NotPositive { name, value }) }
}

fn unit(name: &'static str, direction: &[f64; 3]) -> Result<[f64; 3], MagneticError> {
    finite(name, direction)?;
    let direction = Vector3::from(*direction);
    let length = direction.norm();
    if (length - 1.0).abs() > UNIT_TOLERANCE {
        return Err(MagneticError::NotUnit { name, length });
    }
    // A direction already normal to the last bit stays as it is, so that writing and reading a file is the identity.
    let exact = (length - 1.0).abs() < 4.0 * f64::EPSILON;
    Ok(if exact { direction } else { direction / length }.into())
}
