//! The two networks behind plain pictures, depth maps and poses.
//!
//! [`DepthModel`] and [`MotionModel`] are all that [`LearnedOdometry`](crate::LearnedOdometry) knows of a network, so
//! that it can be tested with models that know the truth, and used with others.

use crate::OdometryError;
use burn::tensor::{Device, Tensor};
use endoscape_core::{DepthMap, Grid, Image, Pose, Size};
use endoscape_nets::{DispNet, Network, PoseMaskNet, network_input};

/// Sees depth in a single picture.
pub trait DepthModel {
    /// Depth of every pixel along the optical axis, in the model's unit for this picture, of the picture's size.
    fn depth(&self, image: &Image) -> DepthMap;
}

/// Sees motion between pictures.
pub trait MotionModel {
    /// Sources on each side of the target.
    fn side(&self) -> usize;

    /// Motions of a window: the target, then twice [`MotionModel::side`] sources in time order, all of one size.
    ///
    /// # Panics
    /// If the number of sources is another.
    fn motions(&self, target: &Image, sources: &[&Image]) -> Motions;
}

/// [`DispNet`] as a [`DepthModel`].
#[derive(Clone, Debug)]
pub struct DepthNetwork {
    net: DispNet,
    device: Device,
}

impl DepthNetwork {
    /// Takes the depth network of a checkpoint that lives on `device`.
    ///
    /// # Errors
    /// [`OdometryError::Incomplete`] if there is none.
    pub fn new(net: Option<DispNet>, device: &Device) -> Result<Self, OdometryError> {
        let net = net.ok_or(OdometryError::Incomplete(Network::Disp))?;
        Ok(Self { net, device: device.clone() })
    }
}

impl DepthModel for DepthNetwork {
    fn depth(&self, image: &Image) -> DepthMap {
        let depth = self.net.forward(network_input(image, &self.device)).depth(0);
        DepthMap::new(to_grid(image.size(), depth))
    }
}

/// [`PoseMaskNet`] as a [`MotionModel`].
#[derive(Clone, Debug)]
pub struct MotionNetwork {
    net: PoseMaskNet,
    device: Device,
}

/// What a [`MotionModel`] says about a window.
#[derive(Clone, Debug)]
pub struct Motions {
    /// Of each source in time order; translation in the unit of the target's depth.
    pub source_from_target: Vec<Pose>,
    /// Reliability of the target's pixels, 0 to 1, against the last source; `None` without a mask head.
    pub reliability: Option<Grid<f32>>,
}

impl MotionNetwork {
    /// Takes the motion network of a checkpoint that lives on `device`.
    ///
    /// # Errors
    /// [`OdometryError::Incomplete`] if there is none.
    pub fn new(net: Option<PoseMaskNet>, device: &Device) -> Result<Self, OdometryError> {
        let net = net.ok_or(OdometryError::Incomplete(Network::Pose))?;
        Ok(Self { net, device: device.clone() })
    }
}

impl MotionModel for MotionNetwork {
    fn side(&self) -> usize {
        self.net.sources() / 2
    }

    fn motions(&self, target: &Image, sources: &[&Image]) -> Motions {
        let input = |image: &Image| network_input(image, &self.device);
        let seen = self.net.forward(input(target), &sources.iter().map(|image| input(image)).collect::<Vec<_>>());
        let numbers: Vec<f64> = seen.motion.into_data().iter::<f32>().map(f64::from).collect();
        let (motions, _) = numbers.as_chunks::<6>();
        let last = sources.len().saturating_sub(1);
        let reliability = seen.mask.map(|[mask, ..]| to_grid(target.size(), mask.narrow(1, last, 1)));
        Motions { source_from_target: motions.iter().map(|motion| seen.rotation.pose(*motion)).collect(), reliability }
    }
}

/// A single-channel picture read back from the device.
fn to_grid(size: Size, values: Tensor<4>) -> Grid<f32> {
    let values: Vec<f32> = values.into_data().iter().collect();
    Grid::from_fn(size, |x, y| values.get(y * size.width + x).copied().unwrap_or(f32::NAN))
}
