//! What a method sees at one moment.

use crate::{Camera, Image, Mask};
use nalgebra::Vector3;
use std::sync::Arc;

/// One picture of a video with everything known about it before any estimation.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Position in its source, counted from 0.
    pub index: usize,
    /// Time since the source's own zero, in seconds.
    pub time_s: f64,
    /// The pixels.
    pub image: Arc<Image>,
    /// The camera that took it, of the same size as the picture; `None` where no calibration is known.
    pub camera: Option<Arc<Camera>>,
    /// Usable pixels (inside the field of view, not saturated); `None` when all are.
    pub usable: Option<Arc<Mask>>,
}

/// One reading of an array of magnetic field sensors, which a [`MagneticRig`](crate::MagneticRig) describes.
#[derive(Clone, Debug, PartialEq)]
pub struct MagneticReading {
    /// Position in its source, counted from 0.
    pub index: usize,
    /// Time on the same clock as the frames beside it, in seconds.
    pub time_s: f64,
    /// Magnetic flux density in tesla at each sensor, in the array's frame and the order of its sensors; `None` for a
    /// sensor that gave nothing. Only components along the array's axes are measurements.
    pub field_tesla: Vec<Option<Vector3<f64>>>,
}

/// Input of an [`Odometry`](crate::Odometry): cameras and magnetic arrays stream alike.
#[derive(Clone, Debug)]
pub enum Observation {
    /// A picture.
    Frame(Frame),
    /// A magnetic reading.
    Magnetic(MagneticReading),
}

impl Observation {
    /// Time in seconds.
    pub const fn time_s(&self) -> f64 {
        match self {
            Self::Frame(frame) => frame.time_s,
            Self::Magnetic(reading) => reading.time_s,
        }
    }
}
