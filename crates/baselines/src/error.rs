//! Why a method could not be set up.

use endoscape_core::CameraError;
#[cfg(feature = "orb")]
use endoscape_frames::preprocess::rectify::RectifyError;
use thiserror::Error;

/// What cannot be, and what would.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum BaselineError {
    /// A setting outside its range.
    #[error("the setting {name} is {value}; give {expected}")]
    Config {
        /// Name of the setting.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        expected: &'static str,
    },
    /// A camera that cannot be reduced to the sizes the method works at.
    #[error("the camera cannot be used by this method: {0}; give the camera of these frames")]
    Camera(#[from] CameraError),
    /// A lens that no pinhole stands for.
    #[cfg(feature = "orb")]
    #[error("{0}")]
    Lens(#[from] RectifyError),
}
