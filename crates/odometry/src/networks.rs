//! The two networks behind plain pictures, depth maps and poses.
//!
//! [`DepthModel`] and [`MotionModel`] are all that [`LearnedOdometry`](crate::LearnedOdometry) knows of a network, so
//! that it can be tested with models that know the truth, and used with others. On the processor the networks run as
//! plans ([`DepthPlan`], [`MotionPlan`]), prepared for the size of the first picture; elsewhere layer by layer.

use crate::OdometryError;
use burn::tensor::{Device, Tensor};
use endoscape_core::{DepthMap, Grid, Image, Pose, Size};
use endoscape_nets::{
    DepthPlan, DispNet, MotionPlan, NetsError, Network, PoseMaskNet, is_processor, network_input, network_values,
};
use std::cell::RefCell;

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
#[derive(Debug)]
pub struct DepthNetwork {
    net: DispNet,
    device: Device,
    plan: Prepared<DepthPlan>,
}

impl DepthNetwork {
    /// Takes the depth network of a checkpoint that lives on `device`.
    ///
    /// # Errors
    /// [`OdometryError::Incomplete`] if there is none.
    pub fn new(net: Option<DispNet>, device: &Device) -> Result<Self, OdometryError> {
        let net = net.ok_or(OdometryError::Incomplete(Network::Disp))?;
        Ok(Self { net, device: device.clone(), plan: Prepared::new(device) })
    }
}

impl DepthModel for DepthNetwork {
    fn depth(&self, image: &Image) -> DepthMap {
        let size = image.size();
        let planned = self.plan.with(
            size,
            |size| DepthPlan::new(&self.net, size),
            |plan| plan.disparity(&network_values(image)).iter().map(|disparity| disparity.recip()).collect(),
        );
        let depth = || self.net.forward(network_input(image, &self.device)).depth(0);
        DepthMap::new(to_grid(size, &planned.unwrap_or_else(|| values(depth()))))
    }
}

/// [`PoseMaskNet`] as a [`MotionModel`].
#[derive(Debug)]
pub struct MotionNetwork {
    net: PoseMaskNet,
    device: Device,
    plan: Prepared<MotionPlan>,
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
        Ok(Self { net, device: device.clone(), plan: Prepared::new(device) })
    }

    /// Motions and, if there is a mask, the reliability against the last source.
    fn seen_by_device(&self, target: &Image, sources: &[&Image]) -> (Vec<[f64; 6]>, Option<Vec<f32>>) {
        let input = |image: &Image| network_input(image, &self.device);
        let seen = self.net.forward(input(target), &sources.iter().map(|image| input(image)).collect::<Vec<_>>());
        let numbers: Vec<f64> = seen.motion.into_data().iter::<f32>().map(f64::from).collect();
        let last = sources.len().saturating_sub(1);
        (numbers.as_chunks().0.to_vec(), seen.mask.map(|[mask, ..]| values(mask.narrow(1, last, 1))))
    }

    /// As [`Self::seen_by_device`], by a plan for snippets.
    fn seen_by_plan(plan: &mut MotionPlan, target: &Image, sources: &[&Image]) -> (Vec<[f64; 6]>, Option<Vec<f32>>) {
        let pictures = std::iter::once(target).chain(sources.iter().copied());
        let motions = plan.motion(&pictures.map(network_values).collect::<Vec<_>>().concat());
        let area = target.size().area();
        (motions, plan.mask().map(|mask| mask[mask.len() - area..].to_vec()))
    }
}

impl MotionModel for MotionNetwork {
    fn side(&self) -> usize {
        self.net.sources() / 2
    }

    fn motions(&self, target: &Image, sources: &[&Image]) -> Motions {
        let planned = self.plan.with(
            target.size(),
            |size| MotionPlan::new(&self.net, size, true),
            |plan| Self::seen_by_plan(plan, target, sources),
        );
        let (motions, reliability) = planned.unwrap_or_else(|| self.seen_by_device(target, sources));
        let rotation = self.net.rotation();
        Motions {
            source_from_target: motions.into_iter().map(|motion| rotation.pose(motion)).collect(),
            reliability: reliability.map(|values| to_grid(target.size(), &values)),
        }
    }
}

/// A network prepared for the size of the last picture, where it runs on the processor.
#[derive(Debug)]
struct Prepared<Plan> {
    on_processor: bool,
    plan: RefCell<Option<(Size, Plan)>>,
}

impl<Plan> Prepared<Plan> {
    fn new(device: &Device) -> Self {
        Self { on_processor: is_processor(device), plan: RefCell::new(None) }
    }

    /// Runs the plan for pictures of a size; `None` where there is none.
    fn with<R>(
        &self,
        size: Size,
        make: impl FnOnce([usize; 2]) -> Result<Plan, NetsError>,
        run: impl FnOnce(&mut Plan) -> R,
    ) -> Option<R> {
        let mut kept = self.plan.borrow_mut();
        if self.on_processor && kept.as_ref().is_none_or(|(of, _)| *of != size) {
            *kept = make([size.height, size.width]).ok().map(|plan| (size, plan));
        }
        kept.as_mut().map(|(_, plan)| run(plan))
    }
}

/// Numbers read back from the device.
fn values(tensor: Tensor<4>) -> Vec<f32> {
    tensor.into_data().iter().collect()
}

/// A single-channel picture.
fn to_grid(size: Size, values: &[f32]) -> Grid<f32> {
    Grid::from_fn(size, |x, y| values.get(y * size.width + x).copied().unwrap_or(f32::NAN))
}

#[cfg(test)]
mod tests;
