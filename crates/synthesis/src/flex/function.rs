//! Functions of tensors on Burn's Flex device that know their gradients.

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::NoCheckpointing;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, NodeGuard, Ops, OpsKind};
use burn::backend::flex::FlexTensor;
use burn::backend::{Autodiff, AutodiffBackend, Flex, TensorMetadata};
use burn::tensor::{DType, Tensor, TensorData};
use std::borrow::Cow;
use std::fmt;

type Tracked = Autodiff<Flex>;

/// The numbers of a tensor.
pub struct Numbers(FlexTensor);

impl Numbers {
    /// In their order, copied where they do not lie in that order.
    pub fn get(&self) -> Cow<'_, [f32]> {
        values(&self.0)
    }
}

/// What a function takes.
pub struct Operand {
    numbers: FlexTensor,
    /// Its place in the graph, on a device that keeps one.
    node: Option<NodeGuard>,
}

impl Operand {
    /// The tensor's numbers in their order, copied where they do not lie in that order.
    pub fn numbers(&self) -> Cow<'_, [f32]> {
        values(&self.numbers)
    }

    /// The numbers and their place in the graph.
    fn in_graph(self) -> (FlexTensor, NodeGuard) {
        let Self { numbers, node } = self;
        let node = node.unwrap_or_else(|| Tracked::from_inner(numbers.clone()).into_parts().1);
        (numbers, node)
    }

    /// The numbers alone, for what a function knows from the beginning.
    pub fn detached(self) -> Numbers {
        Numbers(self.numbers)
    }
}

/// A tensor of single precision on the Flex device; `None` for any other.
pub fn operand<const D: usize>(tensor: &Tensor<D>) -> Option<Operand> {
    if tensor.dtype() != DType::F32 {
        return None;
    }
    if !tensor.device().is_autodiff() {
        return Some(Operand { numbers: tensor.clone().try_into_primitive::<Flex>().ok()?, node: None });
    }
    let (numbers, node) = tensor.clone().try_into_primitive::<Tracked>().ok()?.into_parts();
    Some(Operand { numbers, node: Some(node) })
}

/// The result of a function: its numbers, and the gradients it gives its operands (those that are wanted) from the
/// operands' numbers and the gradient of the result.
pub fn function<const N: usize, const D: usize>(
    operands: [Operand; N],
    (numbers, shape): (Vec<f32>, [usize; D]),
    gradients: impl Fn([&[f32]; N], &[f32], [bool; N]) -> [Option<Vec<f32>>; N] + Send + 'static,
) -> Option<Tensor<D>> {
    let result = FlexTensor::from_data(TensorData::new(numbers, shape));
    if operands.iter().all(|operand| operand.node.is_none()) {
        return Some(Tensor::from_primitive::<Flex>(result));
    }
    // Operands of a device without a graph, pictures for example, are constants beside the others.
    let (inputs, nodes): (Vec<_>, Vec<_>) = operands.into_iter().map(Operand::in_graph).unzip();
    let preparation = Step(gradients).prepare::<NoCheckpointing>(nodes.try_into().ok()?);
    let result = match preparation.compute_bound().stateful() {
        OpsKind::Tracked(preparation) => preparation.finish(inputs.try_into().ok()?, result),
        OpsKind::UnTracked(preparation) => preparation.finish(result),
    };
    Some(Tensor::from_primitive::<Tracked>(result))
}

/// Numbers on the device of an operand, without a gradient.
pub fn constant<const D: usize>(numbers: Vec<f32>, shape: [usize; D], like: &Operand) -> Tensor<D> {
    let numbers = FlexTensor::from_data(TensorData::new(numbers, shape));
    match like.node {
        Some(_) => Tensor::from_primitive::<Tracked>(Tracked::from_inner(numbers)),
        None => Tensor::from_primitive::<Flex>(numbers),
    }
}

fn values(tensor: &FlexTensor) -> Cow<'_, [f32]> {
    match tensor.as_slice::<f32>() {
        Some(values) => Cow::Borrowed(values),
        None => Cow::Owned(tensor.to_contiguous().storage::<f32>()[..tensor.shape().num_elements()].to_vec()),
    }
}

/// The backward step of a function.
struct Step<G>(G);

impl<G> fmt::Debug for Step<G> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Step")
    }
}

impl<G, const N: usize> Backward<Flex, N> for Step<G>
where
    G: Fn([&[f32]; N], &[f32], [bool; N]) -> [Option<Vec<f32>>; N] + Send + 'static,
{
    type State = [FlexTensor; N];

    fn backward(self, ops: Ops<Self::State, N>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let of_result = gradients.consume::<Flex>(&ops.node);
        let inputs = ops.state.each_ref().map(values);
        let wanted = ops.parents.each_ref().map(Option::is_some);
        let of_inputs = (self.0)(inputs.each_ref().map(|input| &**input), &values(&of_result), wanted);
        for ((node, gradient), input) in ops.parents.into_iter().zip(of_inputs).zip(&ops.state) {
            if let (Some(node), Some(gradient)) = (node, gradient) {
                let gradient = FlexTensor::from_data(TensorData::new(gradient, input.shape()));
                gradients.register::<Flex>(node.id, gradient);
            }
        }
    }
}
