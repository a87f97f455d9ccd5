//! The networks prepared for one picture size on the processor.
//!
//! What the device does layer by layer with new memory each time is decided once here: normalisation is folded into
//! the convolutions, weights lie in the order in which they are read, buffers are allocated once and shared by what is
//! concatenated. Outputs are those of [`DispNet::forward`] and [`PoseMaskNet::forward`] at inference, to rounding.

mod graph;
#[cfg(test)]
mod tests;

use crate::checkpoint::Checkpoint;
use crate::disp_net::{DispNet, FIRST_HEAD};
use crate::error::NetsError;
use crate::pose_mask_net::{MOTION_SCALE, MaskDecoder, MaskHead, PoseMaskNet};
use endoscape_core::Rotation;
use endoscape_kernels::awake;
pub use graph::StepTime;
use graph::{Graph, Value};

/// Both networks of a checkpoint, as far as it has them.
#[derive(Debug)]
pub struct InferencePlan {
    /// The depth network.
    pub depth: Option<DepthPlan>,
    /// The motion network.
    pub motion: Option<MotionPlan>,
}

impl InferencePlan {
    /// Prepares the networks of a checkpoint for pictures of `size` (rows, columns); masks only on demand, because
    /// they take longer than the motion.
    ///
    /// # Errors
    /// As [`DepthPlan::new`].
    pub fn new(checkpoint: &Checkpoint, size: [usize; 2], with_mask: bool) -> Result<Self, NetsError> {
        let depth = checkpoint.disp.as_ref().map(|net| DepthPlan::new(net, size)).transpose()?;
        let motion = checkpoint.pose.as_ref().map(|net| MotionPlan::new(net, size, with_mask)).transpose()?;
        Ok(Self { depth, motion })
    }

    /// Runs both networks side by side: the disparity of the snippet's target, and its motions. Either is empty if the
    /// checkpoint lacks the network.
    ///
    /// # Shapes
    /// - `snippet`: `[3 * (sources + 1), height, width]`, RGB in [-1, 1], target first, then sources in time order
    /// - returns: as [`DepthPlan::disparity`] and [`MotionPlan::motion`]
    ///
    /// # Panics
    /// If the snippet's length is not the plan's.
    pub fn depth_and_motion(&mut self, snippet: &[f32]) -> (&[f32], Vec<[f64; 6]>) {
        let Self { depth, motion } = self;
        let area = depth.as_ref().map_or(0, |plan| plan.image.size[0] * plan.image.size[1]);
        awake(|| {
            rayon::join(
                || depth.as_mut().map_or(&[] as &[f32], |plan| plan.disparity(&snippet[..3 * area])),
                || motion.as_mut().map_or_else(Vec::new, |plan| plan.motion(snippet)),
            )
        })
    }
}

/// The depth network, one picture at a time.
#[derive(Debug)]
pub struct DepthPlan {
    graph: Graph,
    image: Value,
    disparity: Value,
}

impl DepthPlan {
    /// Prepares the network for pictures of `size`, rows and columns.
    ///
    /// # Errors
    /// [`NetsError::Config`] for a size without pixels, or weights their device does not hand out.
    pub fn new(net: &DispNet, size: [usize; 2]) -> Result<Self, NetsError> {
        check_size(size)?;
        let mut graph = Graph::default();
        let image = graph.input(3, size);
        let disparity = disp_net(&mut graph, net, image)?;
        Ok(Self { graph, image, disparity })
    }

    /// Disparity of a picture at full size; depth is its inverse.
    ///
    /// # Shapes
    /// - `image`: `[3, height, width]`, RGB in [-1, 1]
    /// - returns: `[height, width]`, valid until the next call
    ///
    /// # Panics
    /// If the picture's length is not the plan's.
    pub fn disparity(&mut self, image: &[f32]) -> &[f32] {
        self.graph.run(self.image, image);
        self.graph.values(self.disparity)
    }

    /// Runs the network on a picture, as [`Self::disparity`] does, and says how long each step took.
    ///
    /// # Panics
    /// If the picture's length is not the plan's.
    pub fn profile(&mut self, image: &[f32]) -> Vec<StepTime> {
        self.graph.profile(self.image, image)
    }
}

/// The motion network, one snippet at a time.
#[derive(Debug)]
pub struct MotionPlan {
    graph: Graph,
    snippet: Value,
    head: Value,
    mask: Option<Value>,
    rotation: Rotation,
}

impl MotionPlan {
    /// Prepares the network for pictures of `size`, rows and columns; with its finest mask if asked for and there.
    ///
    /// # Errors
    /// As [`DepthPlan::new`].
    pub fn new(net: &PoseMaskNet, size: [usize; 2], with_mask: bool) -> Result<Self, NetsError> {
        check_size(size)?;
        let mut graph = Graph::default();
        let snippet = graph.input(3 * (net.sources + 1), size);
        let mut stages = vec![snippet];
        for block in &net.encoder {
            stages.push(halve(&mut graph, block, stages[stages.len() - 1])?);
        }
        let mut features = stages[5];
        for block in &net.motion {
            features = halve(&mut graph, block, features)?;
        }
        let head = graph.buffer(6 * net.sources, features.size);
        graph.conv(&net.motion_head, features, head)?;
        let decoder = net.mask.as_ref().filter(|_| with_mask);
        let mask = decoder.map(|decoder| finest_mask(&mut graph, decoder, &stages)).transpose()?;
        Ok(Self { graph, snippet, head, mask, rotation: net.rotation })
    }

    /// `source_from_target` motions, one per source in time order; see [`PoseMask::motion`](crate::PoseMask::motion).
    ///
    /// # Shapes
    /// - `snippet`: `[3 * (sources + 1), height, width]`, RGB in [-1, 1], target first, then sources in time order
    ///
    /// # Panics
    /// If the snippet's length is not the plan's.
    pub fn motion(&mut self, snippet: &[f32]) -> Vec<[f64; 6]> {
        self.graph.run(self.snippet, snippet);
        let area = self.head.size[0] * self.head.size[1];
        let mean = |plane: &[f32]| MOTION_SCALE * f64::from(plane.iter().sum::<f32>()) / area as f64;
        let numbers: Vec<f64> = self.graph.values(self.head).chunks_exact(area).map(mean).collect();
        numbers.as_chunks::<6>().0.to_vec()
    }

    /// Runs the network on a snippet, as [`Self::motion`] does, and says how long each step took.
    ///
    /// # Panics
    /// If the snippet's length is not the plan's.
    pub fn profile(&mut self, snippet: &[f32]) -> Vec<StepTime> {
        self.graph.profile(self.snippet, snippet)
    }

    /// Reliability of the last snippet's target, `[sources, height, width]`, if the plan was made with a mask.
    pub fn mask(&self) -> Option<&[f32]> {
        self.mask.map(|mask| self.graph.values(mask))
    }

    /// What the last three numbers of a motion mean.
    pub fn rotation(&self) -> Rotation {
        self.rotation
    }
}

fn check_size(size: [usize; 2]) -> Result<(), NetsError> {
    if size.contains(&0) {
        return Err(NetsError::config("size", format!("is {}x{} but needs at least one pixel", size[1], size[0])));
    }
    Ok(())
}

fn half(size: [usize; 2]) -> [usize; 2] {
    size.map(|length| length.div_ceil(2))
}

/// A block of stride 2 into a buffer of its own.
fn halve(graph: &mut Graph, block: &crate::layers::ConvBlock, from: Value) -> Result<Value, NetsError> {
    let to = graph.buffer(block.conv.weight.dims()[0], half(from.size));
    graph.block(block, from, to)?;
    Ok(to)
}

/// The finest disparity; mirrors [`DispNet::forward`].
fn disp_net(graph: &mut Graph, net: &DispNet, image: Value) -> Result<Value, NetsError> {
    // What each decoder stage reads: the enlarged features, the skip, the coarser disparity.
    let joined = decoder_inputs(graph, net, image.size);
    let mut features = image;
    for (index, stage) in net.encoder.iter().enumerate() {
        let halved = halve(graph, &stage.halve, features)?;
        let channels = stage.refine.conv.weight.dims()[0];
        features = match joined.get(5_usize.wrapping_sub(index)) {
            Some(joined) => {
                let up = net.decoder[5 - index].up.conv.weight.dims()[1];
                joined.channels(up..up + channels)
            }
            None => graph.buffer(channels, halved.size),
        };
        graph.block(&stage.refine, halved, features)?;
    }
    let mut disparity = None;
    for (index, (stage, joined)) in net.decoder.iter().zip(&joined).enumerate() {
        graph.up_block(&stage.up, features, joined.channels(0..stage.up.conv.weight.dims()[1]))?;
        if let Some(coarser) = disparity {
            graph.enlarge(coarser, joined.channels(joined.channels - 1..joined.channels));
        }
        features = graph.buffer(stage.fuse.conv.weight.dims()[0], joined.size);
        graph.block(&stage.fuse, *joined, features)?;
        if index >= FIRST_HEAD {
            let finer = graph.buffer(1, joined.size);
            graph.conv(&net.heads[index - FIRST_HEAD], features, finer)?;
            graph.squash(finer, net.alpha, net.beta);
            disparity = Some(finer);
        }
    }
    Ok(disparity.unwrap_or(features))
}

fn decoder_inputs(graph: &mut Graph, net: &DispNet, full: [usize; 2]) -> Vec<Value> {
    let mut sizes: Vec<[usize; 2]> = std::iter::successors(Some(full), |size| Some(half(*size))).take(7).collect();
    sizes.reverse();
    let stages = net.decoder.iter().zip(sizes);
    stages.map(|(stage, size)| graph.buffer(stage.fuse.conv.weight.dims()[1], size)).collect()
}

/// Reliability at full size; `stages` are the snippet and the features after each shared stage.
fn finest_mask(graph: &mut Graph, decoder: &MaskDecoder, stages: &[Value]) -> Result<Value, NetsError> {
    let [coarser @ .., deepest] = stages else { unreachable!("a network has stages") };
    let mut features = *deepest;
    for (block, like) in decoder.ups.iter().zip(coarser.iter().rev()) {
        let to = graph.buffer(block.conv.weight.dims()[1], like.size);
        graph.up_block(block, features, to)?;
        features = to;
    }
    let [.., head] = &decoder.heads;
    let logits = graph.buffer(head.weight.dims()[0], features.size);
    graph.conv(head, features, logits)?;
    if decoder.kind != MaskHead::Softmax {
        graph.squash(logits, 1.0, 0.0);
        return Ok(logits);
    }
    let reliable = graph.buffer(logits.channels / 2, features.size);
    graph.subtract_pairs(logits, reliable);
    graph.squash(reliable, 1.0, 0.0);
    Ok(reliable)
}
