//! What stands between convolutions, on Burn's Flex device by our kernels, with gradients.

use super::memory::{tensor, values};
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::NoCheckpointing;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::flex::FlexTensor;
use burn::backend::{Autodiff, Flex};
use burn::tensor::{DType, Tensor};
use endoscape_kernels::{Pointwise, enlarge, enlarge_gradient};
use std::fmt::Debug;

/// `scale / (1 + exp(-x)) + offset`; `None` if the numbers are not of single precision on the Flex device.
pub fn logistic(input: &Tensor<4>, scale: f64, offset: f64) -> Option<Tensor<4>> {
    let kernel = Pointwise::Logistic { scale: scale as f32, offset: offset as f32 };
    apply(Logistic { kernel, shape: input.dims() }, input)
}

/// Twice the size, cut to `size`; `None` as above.
pub fn doubled(picture: &Tensor<4>, size: [usize; 2]) -> Option<Tensor<4>> {
    apply(Doubled { shape: picture.dims(), size }, picture)
}

/// A function of a tensor that knows its gradient.
trait Unary: Copy + Debug + Send + 'static {
    fn value(&self, input: &[f32]) -> FlexTensor;

    /// The gradient of the input from that of the value.
    fn gradient(&self, input: &[f32], of_value: &[f32]) -> FlexTensor;
}

fn apply(function: impl Unary, input: &Tensor<4>) -> Option<Tensor<4>> {
    type Tracked = Autodiff<Flex>;
    if input.dtype() != DType::F32 {
        return None;
    }
    if !input.device().is_autodiff() {
        let input = input.clone().try_into_primitive::<Flex>().ok()?;
        return Some(Tensor::from_primitive::<Flex>(function.value(&values(&input))));
    }
    let (input, node) = input.clone().try_into_primitive::<Tracked>().ok()?.into_parts();
    let value = function.value(&values(&input));
    let preparation = Step(function).prepare::<NoCheckpointing>([node]);
    let value = match preparation.compute_bound().stateful() {
        OpsKind::Tracked(preparation) => preparation.finish(input, value),
        OpsKind::UnTracked(preparation) => preparation.finish(value),
    };
    Some(Tensor::from_primitive::<Tracked>(value))
}

/// The backward step of a function.
#[derive(Debug)]
struct Step<F>(F);

impl<F: Unary> Backward<Flex, 1> for Step<F> {
    type State = FlexTensor;

    fn backward(self, ops: Ops<FlexTensor, 1>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let of_value = gradients.consume::<Flex>(&ops.node);
        let [node] = ops.parents;
        if let Some(node) = node {
            gradients.register::<Flex>(node.id, self.0.gradient(&values(&ops.state), &values(&of_value)));
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Logistic {
    kernel: Pointwise,
    shape: [usize; 4],
}

impl Unary for Logistic {
    fn value(&self, input: &[f32]) -> FlexTensor {
        tensor(self.kernel.values(input), self.shape)
    }

    fn gradient(&self, input: &[f32], of_value: &[f32]) -> FlexTensor {
        tensor(self.kernel.gradient(input, of_value), self.shape)
    }
}

#[derive(Clone, Copy, Debug)]
struct Doubled {
    shape: [usize; 4],
    /// Rows and columns of the result.
    size: [usize; 2],
}

impl Unary for Doubled {
    fn value(&self, input: &[f32]) -> FlexTensor {
        let ([batch, channels, rows, columns], size) = (self.shape, self.size);
        let mut enlarged = vec![0.0; batch * channels * size[0] * size[1]];
        enlarge(input, [rows, columns], &mut enlarged, size);
        tensor(enlarged, [batch, channels, size[0], size[1]])
    }

    fn gradient(&self, _: &[f32], of_value: &[f32]) -> FlexTensor {
        let [_, _, rows, columns] = self.shape;
        let mut gradient = vec![0.0; self.shape.iter().product()];
        enlarge_gradient(of_value, self.size, &mut gradient, [rows, columns]);
        tensor(gradient, self.shape)
    }
}
