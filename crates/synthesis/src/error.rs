//! What can be wrong with the inputs of view synthesis.

use endoscape_core::CameraError;
use thiserror::Error;

/// Why cameras or a configuration cannot be used.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum SynthesisError {
    /// A batch without pictures.
    #[error("a batch needs one camera per picture, but none was given")]
    NoCamera,
    /// A pyramid without scales.
    #[error("an image pyramid needs at least one scale, but none was given")]
    NoScale,
    /// A camera that cannot be read out at the size of a scale.
    #[error("the camera does not fit the size of the pictures: {0}")]
    Camera(#[from] CameraError),
    /// A field of the objective outside its range.
    #[error("objective.{field} is {value}, but it must be {allowed}; correct it in the configuration")]
    Config {
        /// Name of the field as written in the configuration.
        field: &'static str,
        /// Its value.
        value: f64,
        /// The range in words.
        allowed: &'static str,
    },
}
