//! Depth maps as the data sets store them, turned into metres along the optical axis.

use std::path::PathBuf;

/// A file that holds the depth of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthFile {
    /// The file.
    pub path: PathBuf,
    /// How its numbers are to be understood.
    pub encoding: DepthEncoding,
}

/// How stored numbers become metres.
#[derive(Clone, Debug, PartialEq)]
pub enum DepthEncoding {
    /// A single-channel integer picture (PNG or TIFF): metres = value x `metres_per_unit`; values of 0 and above
    /// `largest` are unknown.
    Linear {
        /// Metres per stored unit.
        metres_per_unit: f64,
        /// Largest value that is a measurement.
        largest: u16,
    },
    /// Brighter is nearer, on a scale nobody states (EndoSLAM UnityCam): metres = `metres_per_unit` x 255 / value,
    /// fit for comparisons up to scale only.
    InverseLike {
        /// Metres at the brightest value.
        metres_per_unit: f64,
    },
    /// Three-channel float TIFF of camera-frame points in millimetres (SCARED); the third channel is the depth, rows
    /// from `first_row` for `rows` rows.
    PointsTiff {
        /// First row of the left camera's part.
        first_row: usize,
        /// Rows of that part.
        rows: usize,
    },
    /// OpenEXR with depth in its R channel (EndoMapper simulated).
    Exr {
        /// Metres per stored unit.
        metres_per_unit: f64,
    },
    /// Velodyne scan (binary f32 x, y, z, reflectance) to be projected into the camera.
    Velodyne {
        /// Maps laser points to the (rectified) camera frame, metres.
        camera_from_velodyne: endoscape_core::Pose,
    },
}
