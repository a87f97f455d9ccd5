//! The nouns every part of endoscape shares.
//!
//! | module | nouns |
//! |---|---|
//! | [`raster`] | [`Size`], [`Rect`], [`Image`], [`Grid`], [`DepthMap`], [`Mask`] |
//! | [`camera`] | [`Camera`] and its five projection models |
//! | [`se3`] | [`Pose`] with exponential, logarithm and adjoint |
//! | [`motion`] | [`Rotation`]: what the last three of the six numbers of a motion mean |
//! | [`trajectory`] | [`Trajectory`] of timed `world_from_camera` poses and its text formats |
//! | [`magnetic`] | the field of a [`Dipole`](magnetic::Dipole), the Hall array and magnet of a [`MagneticRig`] |
//! | [`observation`] | [`Observation`]: a [`Frame`] or a [`MagneticReading`] |
//! | [`odometry`] | the [`Odometry`] and [`DepthEstimator`] traits every method implements |
//! | [`event`] | [`Event`] and [`EventSink`]: how libraries report without printing |
//!
//! Conventions (see CONVENTIONS.md): metres, seconds, radians; cameras look along +z with x right and y down
//! (OpenCV axes); poses are `world_from_camera`; pixel centres lie at integer coordinates, so a picture of width `W`
//! covers `-0.5 ..= W - 0.5`. This crate does no I/O and knows no tensor.

pub mod camera;
pub mod event;
pub mod magnetic;
pub mod motion;
pub mod observation;
pub mod odometry;
pub mod raster;
pub mod se3;
pub mod trajectory;

pub use camera::{Camera, CameraError, CameraModel};
pub use event::{Event, EventSink};
pub use magnetic::MagneticRig;
pub use motion::Rotation;
pub use observation::{Frame, MagneticReading, Observation};
pub use odometry::{DepthEstimator, Odometry, TrackError, Tracked};
pub use raster::{DepthMap, Grid, Image, Mask, RasterError, Rect, Size};
pub use se3::Pose;
pub use trajectory::{TimedPose, Trajectory, TrajectoryError};
