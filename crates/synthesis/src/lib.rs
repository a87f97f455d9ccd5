//! View synthesis and the losses that train on it.
mod camera;
mod error;
pub mod motion;
pub use camera::{CameraBatch, CameraPyramid, CameraScaling, Lens, Projected};
pub use error::SynthesisError;
