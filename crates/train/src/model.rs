//! All networks as one module, so that one optimiser moves them together.

use crate::batch::SnippetBatch;
use crate::error::TrainError;
use burn::module::{Module, ModuleMapper, Param, ParamId};
use burn::tensor::Tensor;
use endoscape_nets::{AlignNet, Checkpoint, DispNet, DisparityPyramid, Manifest, NetsConfig, PoseMaskNet};
use endoscape_synthesis::warp::depth_from_disparity;
use endoscape_synthesis::{Prediction, source_from_target};

/// The depth and the motion network, and perhaps the alignment network.
#[derive(Module, Debug)]
pub struct DepthMotionModel {
    /// One picture to disparity.
    pub disp: DispNet,
    /// A snippet to motions and reliability.
    pub pose: PoseMaskNet,
    /// What speaks against a motion to what is left of it; only models that have learned from labels have it.
    pub align: Option<AlignNet>,
}

/// What the networks say about a batch, with the parts the trainer looks at.
pub struct Output {
    /// For the objective.
    pub prediction: Prediction,
    /// `[batch, sources, 6]`.
    pub motion: Tensor<3>,
}

impl Output {
    /// Depth of the targets, without a gradient; `[batch, 1, height, width]`.
    pub fn depth(&self) -> Option<Tensor<4>> {
        Some(depth_from_disparity(self.prediction.disparities.first()?.clone().detach()))
    }
}

impl DepthMotionModel {
    /// Takes the networks out of a checkpoint that has both.
    ///
    /// # Errors
    /// [`TrainError::Config`] if one is missing.
    pub fn from_checkpoint(checkpoint: Checkpoint) -> Result<Self, TrainError> {
        let missing = |network: &str| TrainError::config("init", format!("names a checkpoint without a {network}"));
        let disp = checkpoint.disp.ok_or_else(|| missing("depth network"))?;
        let pose = checkpoint.pose.ok_or_else(|| missing("motion network"))?;
        Ok(numbered(Self { disp, pose, align: checkpoint.align }))
    }

    /// A checkpoint of these weights.
    pub fn to_checkpoint(&self, config: NetsConfig, manifest: Manifest) -> Checkpoint {
        let (disp, pose) = (Some(self.disp.clone()), Some(self.pose.clone()));
        Checkpoint { config, disp, pose, align: self.align.clone(), manifest }
    }

    /// Runs both networks.
    ///
    /// Depth of the sources, which triples the work of the depth network, is predicted only where the objective
    /// compares it (`with_source_depth`).
    pub fn predict(&self, batch: &SnippetBatch, with_source_depth: bool) -> Output {
        let (motion_target, motion_sources) = (&batch.motion_inputs[0], &batch.motion_inputs[1..]);
        let pose = self.pose.forward(motion_target.clone(), motion_sources);
        let seen = if with_source_depth { batch.depth_inputs.len() } else { 1 };
        let mut disparities = self.disparities(&batch.depth_inputs[..seen]).into_iter();
        let target = disparities.next().unwrap_or_default();
        let prediction = Prediction {
            disparities: target,
            source_from_target: self.transforms(&pose.motion),
            masks: pose.mask.map_or_else(Vec::new, Vec::from),
            source_disparities: disparities.collect(),
        };
        Output { prediction, motion: pose.motion }
    }

    /// Runs the depth network alone, on the targets of a batch that records gradients, and records none itself: what no
    /// backward step ever visits would stay in memory.
    pub fn predict_depth(&self, batch: &SnippetBatch) -> Output {
        let target = self.disp.valid().forward(batch.depth_inputs[0].clone().inner()).scales;
        let prediction = Prediction {
            disparities: Vec::from(target.map(Tensor::autodiff)),
            source_from_target: Vec::new(),
            masks: Vec::new(),
            source_disparities: Vec::new(),
        };
        Output { prediction, motion: Tensor::zeros([1, 1, 6], &batch.stands.device()) }
    }

    /// Of each source, `[batch, 3, 4]`.
    fn transforms(&self, motion: &Tensor<3>) -> Vec<Tensor<3>> {
        let transform = |source: usize| {
            let motion: Tensor<2> = motion.clone().narrow(1, source, 1).squeeze_dim(1);
            source_from_target(motion, self.pose.rotation())
        };
        (0..self.pose.sources()).map(transform).collect()
    }

    /// Disparities of several pictures in one go, each a list of scales.
    fn disparities(&self, pictures: &[Tensor<4>]) -> Vec<Vec<Tensor<4>>> {
        let batch = pictures[0].dims()[0];
        let DisparityPyramid { scales } = self.disp.forward(Tensor::cat(pictures.to_vec(), 0));
        let part = |index: usize| scales.iter().map(|scale| scale.clone().narrow(0, index * batch, batch)).collect();
        (0..pictures.len()).map(part).collect()
    }
}

/// What the motion network sees where there is nothing to see: the mean over the batch of the absolute motion, all six
/// numbers summed, of snippets whose camera stands still; `[1]`.
///
/// # Shapes
/// - `motion`: `[batch, sources, 6]`
/// - `stands`: `[batch]`, 1 or 0
pub fn standing_motion(motion: Tensor<3>, stands: Tensor<1>) -> Tensor<1> {
    let [batch, sources, _] = motion.dims();
    let length: Tensor<1> = motion.abs().sum_dim(2).sum_dim(1).reshape([batch]) / sources as f64;
    (length * stands).mean()
}

/// Numbers the parameters in the order of the module.
///
/// The optimiser files its state under parameter numbers, which are random by default: a resumed training would not
/// find its state again.
pub(crate) fn numbered<M: Module>(model: M) -> M {
    struct Numbering(u64);
    impl ModuleMapper for Numbering {
        fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
            self.0 += 1;
            let (_, tensor, mapper) = param.consume();
            Param::from_mapped_value(ParamId::from(self.0), tensor, mapper)
        }
    }
    model.map(&mut Numbering(0))
}
