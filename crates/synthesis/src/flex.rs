//! Our kernels on Burn's Flex device (the processor), with gradients.
//!
//! A kernel is a [`Binary`] function of two tensors' numbers with its derivatives. It stands beside a reference in plain
//! tensor operations, which every other device and precision uses, and with which the tests compare it.

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::NoCheckpointing;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::flex::FlexTensor;
use burn::backend::{Autodiff, Flex, TensorMetadata};
use burn::tensor::{DType, Tensor, TensorData};
use endoscape_kernels::{Comparison, Sampling};
use std::borrow::Cow;
use std::fmt::Debug;

/// A function of two tensors that knows its derivatives.
trait Binary: Copy + Debug + Send + 'static {
    /// The result and its shape.
    fn value(&self, inputs: [&[f32]; 2]) -> (Vec<f32>, [usize; 4]);

    /// The gradient of one of the inputs, from that of the result.
    fn gradient(&self, inputs: [&[f32]; 2], of_value: &[f32], input: usize) -> Vec<f32>;
}

/// [`crate::warp::sample_bilinear`] by our kernel, where the tensors allow it.
pub fn sample_bilinear(picture: &Tensor<4>, pixels: &Tensor<4>) -> Option<Tensor<4>> {
    apply(Sample { picture: picture.dims(), pixels: pixels.dims() }, [picture, pixels])
}

/// [`crate::photometric::photometric_error`] by our kernel, where the tensors allow it.
pub fn photometric_error(a: &Tensor<4>, b: &Tensor<4>, ssim_weight: f64) -> Option<Tensor<4>> {
    apply(Compare { shape: a.dims(), ssim_weight: ssim_weight as f32 }, [a, b])
}

/// The function of two tensors of single precision on the Flex device; `None` for any others.
fn apply<F: Binary>(function: F, [a, b]: [&Tensor<4>; 2]) -> Option<Tensor<4>> {
    type Tracked = Autodiff<Flex>;
    if [a.dtype(), b.dtype()] != [DType::F32; 2] {
        return None;
    }
    if !a.device().is_autodiff() {
        let (a, b) = (a.clone().try_into_primitive::<Flex>().ok()?, b.clone().try_into_primitive::<Flex>().ok()?);
        return Some(Tensor::from_primitive::<Flex>(value_of(&function, [&a, &b])));
    }
    let (a, a_node) = a.clone().try_into_primitive::<Tracked>().ok()?.into_parts();
    let (b, b_node) = b.clone().try_into_primitive::<Tracked>().ok()?.into_parts();
    let value = value_of(&function, [&a, &b]);
    let preparation = Step(function).prepare::<NoCheckpointing>([a_node, b_node]);
    let value = match preparation.compute_bound().stateful() {
        OpsKind::Tracked(preparation) => preparation.finish([a, b], value),
        OpsKind::UnTracked(preparation) => preparation.finish(value),
    };
    Some(Tensor::from_primitive::<Tracked>(value))
}

fn value_of(function: &impl Binary, [a, b]: [&FlexTensor; 2]) -> FlexTensor {
    let (value, shape) = function.value([&values(a), &values(b)]);
    FlexTensor::from_data(TensorData::new(value, shape))
}

/// The numbers of a tensor in their order, copied where they do not lie in that order.
fn values(tensor: &FlexTensor) -> Cow<'_, [f32]> {
    match tensor.as_slice::<f32>() {
        Some(values) => Cow::Borrowed(values),
        None => Cow::Owned(tensor.to_contiguous().storage::<f32>()[..tensor.shape().num_elements()].to_vec()),
    }
}

/// The backward step of a function.
#[derive(Debug)]
struct Step<F>(F);

impl<F: Binary> Backward<Flex, 2> for Step<F> {
    type State = [FlexTensor; 2];

    fn backward(self, ops: Ops<Self::State, 2>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let of_value = gradients.consume::<Flex>(&ops.node);
        let [a, b] = &ops.state;
        for (input, node) in ops.parents.into_iter().enumerate() {
            let Some(node) = node else { continue };
            let gradient = self.0.gradient([&values(a), &values(b)], &values(&of_value), input);
            let data = TensorData::new(gradient, ops.state[input].shape());
            gradients.register::<Flex>(node.id, FlexTensor::from_data(data));
        }
    }
}

/// Reads a picture at positions; the inputs are both.
#[derive(Clone, Copy, Debug)]
struct Sample {
    picture: [usize; 4],
    pixels: [usize; 4],
}

impl Sample {
    fn kernel<'a>(&self, [pictures, positions]: [&'a [f32]; 2]) -> Sampling<'a> {
        let [_, channels, height, width] = self.picture;
        let area = self.pixels[2] * self.pixels[3];
        Sampling { pictures, channels, size: [height, width], positions, area }
    }
}

impl Binary for Sample {
    fn value(&self, inputs: [&[f32]; 2]) -> (Vec<f32>, [usize; 4]) {
        let ([batch, channels, ..], [_, _, rows, columns]) = (self.picture, self.pixels);
        (self.kernel(inputs).read(), [batch, channels, rows, columns])
    }

    fn gradient(&self, inputs: [&[f32]; 2], of_value: &[f32], input: usize) -> Vec<f32> {
        let kernel = self.kernel(inputs);
        if input == 0 { kernel.picture_gradient(of_value) } else { kernel.position_gradient(of_value) }
    }
}

/// Compares two pictures.
#[derive(Clone, Copy, Debug)]
struct Compare {
    shape: [usize; 4],
    ssim_weight: f32,
}

impl Compare {
    fn kernel<'a>(&self, [a, b]: [&'a [f32]; 2]) -> Comparison<'a> {
        let [_, channels, height, width] = self.shape;
        Comparison { a, b, channels, size: [height, width], ssim_weight: self.ssim_weight }
    }
}

impl Binary for Compare {
    fn value(&self, inputs: [&[f32]; 2]) -> (Vec<f32>, [usize; 4]) {
        let [batch, _, height, width] = self.shape;
        (self.kernel(inputs).error(), [batch, 1, height, width])
    }

    fn gradient(&self, [a, b]: [&[f32]; 2], of_value: &[f32], input: usize) -> Vec<f32> {
        let order = if input == 0 { [b, a] } else { [a, b] };
        self.kernel(order).gradient(of_value)
    }
}

#[cfg(test)]
mod tests;
