//! Convolutions on Burn's Flex device by our kernels, with their gradients.

use super::Activation;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::flex::FlexTensor;
use burn::backend::{Autodiff, Flex, TensorMetadata};
use burn::tensor::{DType, Shape, Tensor, TensorData};
use endoscape_kernels::weight_gradient::GradientWorkspace;
use endoscape_kernels::{Correlation, Epilogue, Geometry, Level, PackedWeights, Workspace};
use endoscape_kernels::{bias_gradient, relu_bias_gradient, weight_gradient};
use std::borrow::Cow;
use std::cell::Cell;

/// Which picture of a [`Geometry`] is made from the other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// A convolution.
    ToSmall,
    /// A transposed convolution.
    ToLarge,
}

impl Direction {
    fn correlation(self, geometry: &Geometry) -> Correlation {
        match self {
            Self::ToSmall => Correlation::to_small(geometry, Level::default()),
            Self::ToLarge => Correlation::to_large(geometry, Level::default()),
        }
    }

    const fn reversed(self) -> Self {
        match self {
            Self::ToSmall => Self::ToLarge,
            Self::ToLarge => Self::ToSmall,
        }
    }
}

/// Memory of a thread that is used again from layer to layer.
#[derive(Default)]
struct Memory {
    packed: PackedWeights,
    pictures: Workspace,
    gradients: GradientWorkspace,
}

/// Lends the thread's memory. A nested call, which a stolen task may be, gets memory of its own.
fn with_memory<R>(work: impl FnOnce(&mut Memory) -> R) -> R {
    thread_local!(static MEMORY: Cell<Option<Box<Memory>>> = const { Cell::new(None) });
    let mut memory = MEMORY.take().unwrap_or_default();
    let result = work(&mut memory);
    MEMORY.set(Some(memory));
    result
}

/// The product of `[input, weight]` plus `bias`; `None` if the tensors are not of single precision on the Flex device.
pub fn product(
    direction: Direction,
    geometry: Geometry,
    [input, weight]: [&Tensor<4>; 2],
    bias: &Tensor<1>,
    activation: Activation,
) -> Option<Tensor<4>> {
    if [input.dtype(), weight.dtype(), bias.dtype()] != [DType::F32; 3] {
        return None;
    }
    let product = Product { direction, geometry, relu: activation == Activation::Relu };
    if input.device().is_autodiff() {
        product.tracked([input, weight], bias)
    } else {
        product.plain([input, weight], bias)
    }
}

/// A convolution of either direction with bias and perhaps ReLU.
#[derive(Debug, Clone, Copy)]
struct Product {
    direction: Direction,
    geometry: Geometry,
    relu: bool,
}

impl Product {
    fn plain(self, [input, weight]: [&Tensor<4>; 2], bias: &Tensor<1>) -> Option<Tensor<4>> {
        let input = input.clone().try_into_primitive::<Flex>().ok()?.to_contiguous();
        let weight = weight.clone().try_into_primitive::<Flex>().ok()?;
        let bias = bias.clone().try_into_primitive::<Flex>().ok()?;
        Some(Tensor::from_primitive::<Flex>(self.forward(&input, &weight, &bias)))
    }

    fn tracked(self, [input, weight]: [&Tensor<4>; 2], bias: &Tensor<1>) -> Option<Tensor<4>> {
        type Tracked = Autodiff<Flex>;
        let (input, input_node) = input.clone().try_into_primitive::<Tracked>().ok()?.into_parts();
        let (weight, weight_node) = weight.clone().try_into_primitive::<Tracked>().ok()?.into_parts();
        let (bias, bias_node) = bias.clone().try_into_primitive::<Tracked>().ok()?.into_parts();
        let input = input.to_contiguous();
        let output = self.forward(&input, &weight, &bias);
        let preparation = self.prepare::<burn::backend::autodiff::checkpoint::strategy::NoCheckpointing>([
            input_node,
            weight_node,
            bias_node,
        ]);
        let output = match preparation.compute_bound().stateful() {
            OpsKind::Tracked(preparation) => {
                let kept = Kept { input, weight, output: self.relu.then(|| output.clone()) };
                preparation.finish(kept, output)
            }
            OpsKind::UnTracked(preparation) => preparation.finish(output),
        };
        Some(Tensor::from_primitive::<Tracked>(output))
    }

    /// Channels, rows and columns of the pictures that come in and go out.
    fn extents(&self) -> [[usize; 3]; 2] {
        let Geometry { large_channels, small_channels, large, small, .. } = self.geometry;
        let (large, small) = ([large_channels, large[0], large[1]], [small_channels, small[0], small[1]]);
        match self.direction {
            Direction::ToSmall => [large, small],
            Direction::ToLarge => [small, large],
        }
    }

    fn forward(&self, input: &FlexTensor, weight: &FlexTensor, bias: &FlexTensor) -> FlexTensor {
        let bias = values(bias);
        let epilogue = Epilogue { bias: Some(&bias), relu: self.relu };
        self.picture(self.direction, &values(input), &values(weight), epilogue)
    }

    /// One picture from the other.
    fn picture(&self, direction: Direction, input: &[f32], weight: &[f32], epilogue: Epilogue<'_>) -> FlexTensor {
        let extents = self.extents();
        let [from, to] = if direction == self.direction { extents } else { [extents[1], extents[0]] };
        let batch = input.len() / from.iter().product::<usize>();
        let mut output = vec![0.0; batch * to.iter().product::<usize>()];
        let correlation = direction.correlation(&self.geometry);
        with_memory(|Memory { packed, pictures, .. }| {
            correlation.pack_into(weight, packed);
            correlation.run(input, packed, epilogue, &mut output, pictures);
        });
        tensor(output, [batch, to[0], to[1], to[2]])
    }

    fn weight_gradient(&self, input: &[f32], gradient: &[f32]) -> FlexTensor {
        let Geometry { small_channels, large_channels, kernel, .. } = self.geometry;
        let [large, small] = match self.direction {
            Direction::ToSmall => [input, gradient],
            Direction::ToLarge => [gradient, input],
        };
        let mut weights = vec![0.0; self.geometry.weights()];
        with_memory(|memory| {
            let workspace = &mut memory.gradients;
            weight_gradient(&self.geometry, Level::default(), large, small, &mut weights, workspace);
        });
        tensor(weights, [small_channels, large_channels, kernel, kernel])
    }

    /// Takes the gradient back through the ReLU, if there is one, and sums it up for the bias.
    fn bias_gradient(&self, gradient: &mut FlexTensor, output: Option<&FlexTensor>) -> FlexTensor {
        let [_, [channels, height, width]] = self.extents();
        let (area, mut bias) = (height * width, vec![0.0; channels]);
        match (output, gradient.layout().contiguous_offsets()) {
            (Some(output), Some((start, end))) => {
                let gradient = &mut gradient.storage_mut::<f32>()[start..end];
                relu_bias_gradient(gradient, &values(output), area, &mut bias);
            }
            _ => bias_gradient(&values(gradient), area, &mut bias),
        }
        tensor(bias, [channels])
    }
}

/// What the backward step needs.
#[derive(Debug, Clone)]
struct Kept {
    input: FlexTensor,
    weight: FlexTensor,
    /// Under a ReLU, to know where it let through.
    output: Option<FlexTensor>,
}

impl Backward<Flex, 3> for Product {
    type State = Kept;

    fn backward(self, ops: Ops<Kept, 3>, gradients: &mut Gradients, _: &mut Checkpointer) {
        // Of concatenated features this is a part, which does not lie together.
        let mut gradient = gradients.consume::<Flex>(&ops.node).to_contiguous();
        let Kept { input, weight, output } = ops.state;
        let bias = self.bias_gradient(&mut gradient, output.as_ref());
        let gradient = values(&gradient);
        let [input_node, weight_node, bias_node] = ops.parents;
        if let Some(node) = input_node {
            let back = self.direction.reversed();
            gradients.register::<Flex>(node.id, self.picture(back, &gradient, &values(&weight), Epilogue::default()));
        }
        if let Some(node) = weight_node {
            gradients.register::<Flex>(node.id, self.weight_gradient(&values(&input), &gradient));
        }
        if let Some(node) = bias_node {
            gradients.register::<Flex>(node.id, bias);
        }
    }
}

/// The numbers of a tensor in their order, copied where they do not lie in that order.
fn values(tensor: &FlexTensor) -> Cow<'_, [f32]> {
    match tensor.as_slice::<f32>() {
        Some(values) => Cow::Borrowed(values),
        None => Cow::Owned(tensor.to_contiguous().storage::<f32>()[..tensor.shape().num_elements()].to_vec()),
    }
}

fn tensor(values: Vec<f32>, shape: impl Into<Shape>) -> FlexTensor {
    FlexTensor::from_data(TensorData::new(values, shape))
}
