//! The two networks behind plain pictures, depth maps and poses.

use crate::OdometryError;
use burn::tensor::{Device, Tensor};
use endoscape_core::{DepthMap, Grid, Image, Pose, Size};
use endoscape_nets::{DispNet, Network, PoseMaskNet, network_input};

/// Sees depth in a single picture.
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

    /// Depth of every pixel in the networks' unit, of the picture's size; what is not finite becomes unknown.
    pub fn depth(&self, image: &Image) -> DepthMap {
        let depth = self.net.forward(network_input(image, &self.device)).depth(0);
        DepthMap::new(to_grid(image.size(), depth))
    }
}

/// Sees motion between pictures.
#[derive(Clone, Debug)]
pub struct MotionNetwork {
    net: PoseMaskNet,
    device: Device,
}

/// What [`MotionNetwork`] says about a window.
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

    /// Sources on each side of the target.
    pub fn side(&self) -> usize {
        self.net.sources() / 2
    }

    /// Motions of a window: the target, then its sources in time order, all of one size.
    ///
    /// # Panics
    /// If the number of pictures is not that of the network's snippets.
    pub fn motions(&self, target: &Image, sources: &[&Image]) -> Motions {
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
