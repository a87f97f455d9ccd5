//! Adam with the gradient's length limited.
//!
//! On the processor a step is one pass of our kernel over parameters, gradient and moments; elsewhere, and for the
//! first step, it is Burn's. State and files are those of Burn's Adam.

use burn::backend::Flex;
use burn::backend::flex::FlexTensor;
use burn::module::{Module, ModuleVisitor, Param};
use burn::optim::{Adam, AdamConfig, AdamState, GradientsParams, LearningRate, ModuleOptimizer, Optimizer};
use burn::tensor::{DType, Device, Tensor};
use endoscape_kernels::AdamStep;

const BETA_1: f32 = 0.9;
const BETA_2: f32 = 0.999;
/// PyTorch's.
const EPSILON: f32 = 1e-8;

/// Adam as the paper and SfMLearner use it (beta 0.9 and 0.999, no weight decay), with PyTorch's epsilon.
pub fn adam() -> ModuleOptimizer {
    FusedAdam { reference: reference() }.into()
}

fn reference() -> Adam {
    AdamConfig::new().with_beta_1(BETA_1).with_beta_2(BETA_2).with_epsilon(EPSILON).build()
}

/// Adam that uses our kernel where it can.
#[derive(Clone)]
struct FusedAdam {
    reference: Adam,
}

impl Optimizer for FusedAdam {
    type State<const D: usize> = AdamState<D>;

    fn step<const D: usize>(
        &self,
        rate: LearningRate,
        parameters: Tensor<D>,
        gradient: Tensor<D>,
        state: Option<AdamState<D>>,
    ) -> (Tensor<D>, Option<AdamState<D>>) {
        match state {
            Some(state) if on_processor(&parameters) && on_processor(&gradient) => {
                let (parameters, state) = fused_step(rate, parameters, gradient, state);
                (parameters, Some(state))
            }
            state => self.reference.step(rate, parameters, gradient, state),
        }
    }

    fn to_device<const D: usize>(state: AdamState<D>, device: &Device) -> AdamState<D> {
        Adam::to_device(state, device)
    }
}

fn on_processor<const D: usize>(tensor: &Tensor<D>) -> bool {
    tensor.dtype() == DType::F32 && tensor.clone().try_into_primitive::<Flex>().is_ok()
}

/// The numbers of a tensor of the Flex device in their order, and nothing else in its memory.
///
/// # Panics
/// If the tensor is elsewhere.
fn contiguous<const D: usize>(tensor: Tensor<D>) -> FlexTensor {
    match tensor.try_into_primitive::<Flex>() {
        // Returned as it is where it is in order already, so that the only owner may write to it.
        Ok(tensor) => tensor.to_contiguous(),
        Err(error) => unreachable!("asked before whether the tensor is on the processor: {error:?}"),
    }
}

/// One step on the Flex device.
///
/// # Panics
/// If the tensors are not there.
fn fused_step<const D: usize>(
    rate: LearningRate,
    parameters: Tensor<D>,
    gradient: Tensor<D>,
    mut state: AdamState<D>,
) -> (Tensor<D>, AdamState<D>) {
    state.momentum.time += 1;
    let step = AdamStep {
        beta_1: BETA_1,
        beta_2: BETA_2,
        epsilon: EPSILON,
        learning_rate: rate as f32,
        time: state.momentum.time,
    };
    let (parameters, mut updated) = (contiguous(parameters), contiguous(gradient));
    let (mut means, mut squares) = (contiguous(state.momentum.moment_1), contiguous(state.momentum.moment_2));
    let moments = [means.storage_mut::<f32>(), squares.storage_mut::<f32>()];
    // The new parameters take the gradient's memory, which nobody else has any more.
    step.apply(parameters.storage::<f32>(), updated.storage_mut::<f32>(), moments);
    state.momentum.moment_1 = Tensor::from_primitive::<Flex>(means);
    state.momentum.moment_2 = Tensor::from_primitive::<Flex>(squares);
    (Tensor::from_primitive::<Flex>(updated), state)
}

/// Shortens the gradient over all parameters together to at most `longest`, without reading it back.
///
/// One factor for everything keeps the direction; limiting each parameter by itself would not.
pub fn limit_gradient(gradients: GradientsParams, model: &impl Module, longest: f64) -> GradientsParams {
    let mut squares = SumOfSquares { gradients: &gradients, sum: None };
    model.visit(&mut squares);
    let Some(sum) = squares.sum else { return gradients };
    let factor = (sum.sqrt() + 1e-12).recip().mul_scalar(longest).clamp_max(1.0);
    let mut scaling = Scaling { gradients, factor };
    model.visit(&mut scaling);
    scaling.gradients
}

struct SumOfSquares<'a> {
    gradients: &'a GradientsParams,
    sum: Option<Tensor<1>>,
}

impl ModuleVisitor for SumOfSquares<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        if let Some(gradient) = self.gradients.get::<D>(param.id) {
            let square = gradient.square().sum();
            self.sum = Some(self.sum.take().map_or(square.clone(), |sum| sum + square));
        }
    }
}

struct Scaling {
    gradients: GradientsParams,
    factor: Tensor<1>,
}

impl ModuleVisitor for Scaling {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        if let Some(gradient) = self.gradients.remove::<D>(param.id) {
            let factor = self.factor.clone().reshape([1; D]);
            self.gradients.register::<D>(param.id, gradient * factor);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::Distribution;

    #[test]
    fn the_kernel_takes_the_steps_of_burns_adam() {
        let device = Device::flex();
        let noise = || Tensor::<2>::random([37, 1001], Distribution::Uniform(-1.0, 1.0), &device);
        let (fused, reference) = (FusedAdam { reference: reference() }, reference());
        let start = noise();
        let (mut ours, mut theirs) = ((start.clone(), None), (start, None));
        for _ in 0..5 {
            let gradient = noise();
            ours = fused.step(1e-2, ours.0, gradient.clone(), ours.1);
            theirs = reference.step(1e-2, theirs.0, gradient, theirs.1);
        }
        let difference = (ours.0 - theirs.0).abs().max().into_scalar::<f32>();
        assert!(difference < 1e-6, "{difference}");
        let [ours, theirs] = [ours.1, theirs.1].map(|state| state.unwrap().momentum);
        assert_eq!(ours.time, theirs.time);
        assert!((ours.moment_2 - theirs.moment_2).abs().max().into_scalar::<f32>() < 1e-6);
    }
}
