//! Functions of the numbers of tensors on Burn's Flex device.

use crate::function;
use burn::backend::flex::FlexTensor;
use burn::backend::{Flex, TensorMetadata};
use burn::tensor::{Tensor, TensorData};
use std::borrow::Cow;

/// What a function takes.
pub struct Operand(function::Operand<Flex>);

impl Operand {
    /// The tensor's numbers in their order, copied where they do not lie in that order.
    pub fn numbers(&self) -> Cow<'_, [f32]> {
        values(self.0.tensor())
    }

    /// The numbers alone, for what a function knows from the beginning.
    pub fn detached(self) -> Numbers {
        Numbers(self.0.detached())
    }
}

/// The numbers of a tensor.
pub struct Numbers(FlexTensor);

impl Numbers {
    /// In their order, copied where they do not lie in that order.
    pub fn get(&self) -> Cow<'_, [f32]> {
        values(&self.0)
    }
}

/// A tensor of single precision on the Flex device; `None` for any other.
pub fn operand<const D: usize>(tensor: &Tensor<D>) -> Option<Operand> {
    function::operand(tensor).map(Operand)
}

/// The result of a function: its numbers, and the gradients it gives its operands (those that are wanted) from the
/// operands' numbers and the gradient of the result.
pub fn function<const N: usize, const D: usize>(
    operands: [Operand; N],
    (numbers, shape): (Vec<f32>, [usize; D]),
    gradients: impl Fn([&[f32]; N], &[f32], [bool; N]) -> [Option<Vec<f32>>; N] + Send + 'static,
) -> Option<Tensor<D>> {
    let result = FlexTensor::from_data(TensorData::new(numbers, shape));
    function::function(operands.map(|operand| operand.0), result, move |inputs, of_result, wanted| {
        let numbers = inputs.each_ref().map(values);
        let of_inputs = gradients(numbers.each_ref().map(|input| &**input), &values(&of_result), wanted);
        let mut shapes = inputs.iter().map(TensorMetadata::shape);
        of_inputs.map(|gradient| {
            let shape = shapes.next()?;
            gradient.map(|gradient| FlexTensor::from_data(TensorData::new(gradient, shape)))
        })
    })
}

/// Numbers on the device of an operand, without a gradient.
pub fn constant<const D: usize>(numbers: Vec<f32>, shape: [usize; D], like: &Operand) -> Tensor<D> {
    function::constant(FlexTensor::from_data(TensorData::new(numbers, shape)), &like.0)
}

fn values(tensor: &FlexTensor) -> Cow<'_, [f32]> {
    match tensor.as_slice::<f32>() {
        Some(values) => Cow::Borrowed(values),
        None => Cow::Owned(tensor.to_contiguous().storage::<f32>()[..tensor.shape().num_elements()].to_vec()),
    }
}
