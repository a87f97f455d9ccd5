//! View synthesis and the losses that train on it.
//!
//! | module | what |
//! |---|---|
//! | [`motion`] | motion vectors to rigid transforms, three parametrisations |
//! | [`camera`] | rays and a differentiable projection for every lens of [`endoscape_core`] |
//! | [`warp`] | [`synthesize`]: the target view painted with a source picture |
//! | [`alignment`] | [`Alignment`]: evidence of what is wrong with a motion |
//! | [`photometric`], [`smoothness`], [`mask_loss`], [`geometry`], [`light`], [`brightness`] | the terms, one function each |
//! | [`pyramid`] | scales of a picture |
//! | [`config`] | [`ObjectiveConfig`]: which terms, how weighted; presets `paper`, `port`, `endo` |
//! | [`objective`](mod@objective) | [`objective()`]: the sum to minimise |
//!
//! Formulae and the names that stand for their symbols: docs/math.md. Tensors are `[batch, channels, height, width]`,
//! pictures RGB in [-1, 1], pixel centres at integer coordinates. No function reads a value back from the device, and
//! all work on whatever device the inputs live. Gradients come from Burn's, or from our own kernels, which have references
//! in tensor operations: `flex.rs` has those for the processor, `cube.rs` those for GPUs, if a feature names one.

pub mod alignment;
pub mod brightness;
pub mod camera;
pub mod config;
#[cfg(feature = "cube")]
mod cube;
mod error;
mod flex;
mod function;
pub mod geometry;
pub mod light;
pub mod mask_loss;
pub mod motion;
pub mod objective;
pub mod photometric;
pub mod pyramid;
pub mod smoothness;
pub mod warp;

pub use alignment::Alignment;
pub use camera::{CameraBatch, CameraPyramid, CameraScaling};
pub use config::ObjectiveConfig;
pub use error::SynthesisError;
pub use motion::{Rotation, source_from_target};
pub use objective::{LossTerms, Prediction, View, ViewBatch, objective};
pub use warp::{OutOfView, Synthesized, synthesize};
