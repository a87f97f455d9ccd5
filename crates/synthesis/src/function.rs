//! Functions of tensors that know their gradients, on any one of Burn's backends.

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::NoCheckpointing;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, NodeGuard, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, AutodiffBackend, Backend, DispatchKindConversion, DispatchTensor};
use burn::tensor::{DType, Tensor};
use std::fmt;

/// What a function takes.
pub struct Operand<B: Backend> {
    tensor: FloatTensor<B>,
    /// Its place in the graph, on a device that keeps one.
    node: Option<NodeGuard>,
}

impl<B: Backend> Operand<B> {
    /// The tensor, as the backend knows it.
    pub const fn tensor(&self) -> &FloatTensor<B> {
        &self.tensor
    }

    /// The tensor alone, for what a function knows from the beginning.
    pub fn detached(self) -> FloatTensor<B> {
        self.tensor
    }

    /// The tensor and its place in the graph.
    fn in_graph(self) -> (FloatTensor<B>, NodeGuard) {
        let Self { tensor, node } = self;
        let node = node.unwrap_or_else(|| Autodiff::<B>::from_inner(tensor.clone()).into_parts().1);
        (tensor, node)
    }
}

/// A tensor of single precision on a device of the backend; `None` for any other.
pub fn operand<B: Backend, const D: usize>(tensor: &Tensor<D>) -> Option<Operand<B>>
where
    DispatchTensor: DispatchKindConversion<B> + DispatchKindConversion<Autodiff<B>>,
{
    if tensor.dtype() != DType::F32 {
        return None;
    }
    if !tensor.device().is_autodiff() {
        return Some(Operand { tensor: tensor.clone().try_into_primitive::<B>().ok()?, node: None });
    }
    let (tensor, node) = tensor.clone().try_into_primitive::<Autodiff<B>>().ok()?.into_parts();
    Some(Operand { tensor, node: Some(node) })
}

/// The result of a function as Burn's tensor, and the gradients it gives its operands (those that are wanted) from the
/// operands and the gradient of the result.
pub fn function<B: Backend, const N: usize, const D: usize>(
    operands: [Operand<B>; N],
    result: FloatTensor<B>,
    gradients: impl Fn([FloatTensor<B>; N], FloatTensor<B>, [bool; N]) -> [Option<FloatTensor<B>>; N] + Send + 'static,
) -> Option<Tensor<D>>
where
    DispatchTensor: DispatchKindConversion<B> + DispatchKindConversion<Autodiff<B>>,
{
    if operands.iter().all(|operand| operand.node.is_none()) {
        return Some(Tensor::from_primitive::<B>(result));
    }
    // Operands of a device without a graph, pictures for example, are constants beside the others.
    let (inputs, nodes): (Vec<_>, Vec<_>) = operands.into_iter().map(Operand::in_graph).unzip();
    let preparation = Step(gradients).prepare::<NoCheckpointing>(nodes.try_into().ok()?);
    let result = match preparation.compute_bound().stateful() {
        OpsKind::Tracked(preparation) => preparation.finish(inputs.try_into().ok()?, result),
        OpsKind::UnTracked(preparation) => preparation.finish(result),
    };
    Some(Tensor::from_primitive::<Autodiff<B>>(result))
}

/// A tensor on the device of an operand, without a gradient.
pub fn constant<B: Backend, const D: usize>(tensor: FloatTensor<B>, like: &Operand<B>) -> Tensor<D>
where
    DispatchTensor: DispatchKindConversion<B> + DispatchKindConversion<Autodiff<B>>,
{
    match like.node {
        Some(_) => Tensor::from_primitive::<Autodiff<B>>(Autodiff::<B>::from_inner(tensor)),
        None => Tensor::from_primitive::<B>(tensor),
    }
}

/// The backward step of a function.
struct Step<G>(G);

impl<G> fmt::Debug for Step<G> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Step")
    }
}

impl<B: Backend, G, const N: usize> Backward<B, N> for Step<G>
where
    G: Fn([FloatTensor<B>; N], FloatTensor<B>, [bool; N]) -> [Option<FloatTensor<B>>; N] + Send + 'static,
{
    type State = [FloatTensor<B>; N];

    fn backward(self, ops: Ops<Self::State, N>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let of_result = gradients.consume::<B>(&ops.node);
        let wanted = ops.parents.each_ref().map(Option::is_some);
        let of_inputs = (self.0)(ops.state, of_result, wanted);
        for (node, gradient) in ops.parents.into_iter().zip(of_inputs) {
            if let (Some(node), Some(gradient)) = (node, gradient) {
                gradients.register::<B>(node.id, gradient);
            }
        }
    }
}
