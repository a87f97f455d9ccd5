//! The networks of the method, the recurrent one of its rival, their checkpoints, and weights in and out.
//!
//! | module | what |
//! |---|---|
//! | [`disp_net`] | [`DispNet`]: one picture to a [`DisparityPyramid`] |
//! | [`pose_mask_net`] | [`PoseMaskNet`]: a snippet to a [`PoseMask`] of motions and reliability |
//! | [`align_net`] | [`AlignNet`]: evidence against a motion to the motion that is left |
//! | [`recurrent_vo`] | [`RecurrentVo`]: pairs of frames to motions, with a memory; its [`RecurrentCheckpoint`] |
//! | [`config`] | [`NetsConfig`] and its presets |
//! | [`input`] | pictures as the networks see them |
//! | [`checkpoint`] | [`Checkpoint`]: the folder a trained model lives in |
//! | [`import`] | weights of PyTorch and safetensors files |
//! | [`plan`] | [`InferencePlan`]: the networks prepared for one picture size on the processor |
//! | [`onnx`] | export for other programs |
//! | [`layers`] | the blocks they are made of |
//!
//! Pictures are `[batch, 3, height, width]`, RGB in [-1, 1], of any size. The device decides between training and
//! inference: on an autodiff device gradients are recorded and batch normalisation uses the batch's statistics.

pub mod align_net;
pub mod checkpoint;
pub mod config;
mod conv;
pub mod disp_net;
pub mod error;
mod files;
mod folding;
pub mod import;
pub mod input;
pub mod layers;
pub mod onnx;
pub mod plan;
pub mod pose_mask_net;
pub mod recurrent_checkpoint;
pub mod recurrent_vo;
#[cfg(test)]
mod tests;
mod weights;

pub use align_net::{AlignNet, AlignNetConfig, EVIDENCE_CHANNELS};
pub use checkpoint::{Checkpoint, DataSource, Manifest, ModelKind, TrainedInput};
pub use config::NetsConfig;
pub use conv::recycle;
pub use disp_net::{DispNet, DispNetConfig, DisparityPyramid, SCALES};
pub use endoscape_core::Rotation;
pub use error::NetsError;
pub use import::Network;
pub use input::{is_processor, network_input, network_values};
pub use layers::Padding;
pub use onnx::OnnxOptions;
pub use plan::{DepthPlan, InferencePlan, MotionPlan, StepTime};
pub use pose_mask_net::{MaskHead, PoseMask, PoseMaskNet, PoseMaskNetConfig};
pub use recurrent_checkpoint::RecurrentCheckpoint;
pub use recurrent_vo::{Memory, RecurrentVo, RecurrentVoConfig};
pub use weights::ImportReport;
