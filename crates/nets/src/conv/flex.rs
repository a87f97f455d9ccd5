//! Convolutions on Burn's Flex device by our kernels, with their gradients.

use super::Activation;
use super::memory::{Memory, give_back, tensor, unused, values, with_memory};
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::flex::FlexTensor;
use burn::backend::{Autodiff, Flex};
use burn::tensor::{DType, Tensor};
use endoscape_kernels::{Correlation, Epilogue, Geometry, Level};
use endoscape_kernels::{WeightGradient, awake, bias_gradient, relu_bias_gradient};

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
        awake(|| self.picture(self.direction, &values(input), &values(weight), epilogue))
    }

    /// One picture from the other.
    fn picture(&self, direction: Direction, input: &[f32], weight: &[f32], epilogue: Epilogue<'_>) -> FlexTensor {
        let extents = self.extents();
        let [from, to] = if direction == self.direction { extents } else { [extents[1], extents[0]] };
        let batch = input.len() / from.iter().product::<usize>();
        let mut output = unused([batch, to[0], to[1], to[2]]);
        let correlation = direction.correlation(&self.geometry);
        with_memory(|Memory { packed, pictures, .. }| {
            correlation.pack_into(weight, packed);
            correlation.run(input, packed, epilogue, output.storage_mut(), pictures);
        });
        output
    }

    fn weight_gradient(&self, input: &[f32], gradient: &[f32]) -> FlexTensor {
        let Geometry { small_channels, large_channels, kernel, .. } = self.geometry;
        let [large, small] = match self.direction {
            Direction::ToSmall => [input, gradient],
            Direction::ToLarge => [gradient, input],
        };
        let mut weights = unused([small_channels, large_channels, kernel, kernel]);
        let batch = small.len() / (small_channels * self.geometry.small_area());
        let product = WeightGradient::new(&self.geometry, Level::default(), batch);
        with_memory(|memory| product.run(large, small, weights.storage_mut(), &mut memory.gradients));
        weights
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
        // Of concatenated features this may be a part, which does not lie together.
        let mut gradient = gradients.consume::<Flex>(&ops.node).to_contiguous();
        let Kept { input, weight, output } = ops.state;
        let [input_node, weight_node, bias_node] = ops.parents;
        let wanted = [&input_node, &weight_node].map(Option::is_some);
        let [of_input, of_weight, of_bias] = awake(|| {
            let of_bias = self.bias_gradient(&mut gradient, output.as_ref());
            let gradient = values(&gradient);
            let back = || self.picture(self.direction.reversed(), &gradient, &values(&weight), Epilogue::default());
            let of_input = wanted[0].then(back);
            let of_weight = wanted[1].then(|| self.weight_gradient(&values(&input), &gradient));
            [of_input, of_weight, Some(of_bias)]
        });
        for (node, gradient) in [(input_node, of_input), (weight_node, of_weight), (bias_node, of_bias)] {
            if let (Some(node), Some(gradient)) = (node, gradient) {
                gradients.register::<Flex>(node.id, gradient);
            }
        }
        // Layers before this one need memory of that size next.
        [Some(gradient), Some(input), output].into_iter().flatten().for_each(give_back);
    }
}
