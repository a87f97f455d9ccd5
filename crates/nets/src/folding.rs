//! Batch normalisation folded into the convolution before it, for inference.

use burn::nn::BatchNorm;
use burn::tensor::{ExecutionError, Tensor};

/// Weight and bias of a convolution with its normalisation folded in.
pub(crate) struct Kernel {
    pub dims: [usize; 4],
    pub weight: Vec<f32>,
    pub bias: Vec<f32>,
}

/// Batch normalisation at inference is `(y - mean) * scale + shift`, so with `y = w x + b` the folded layer has weight
/// `scale * w` and bias `scale * (b - mean) + shift`. Output channels lie along `axis` of the weight.
///
/// # Errors
/// When the device fails to hand its numbers out.
pub(crate) fn folded(
    weight: Tensor<4>,
    bias: Option<Tensor<1>>,
    norm: Option<&BatchNorm>,
    axis: usize,
) -> Result<Kernel, ExecutionError> {
    let dims = weight.dims();
    let channels = dims[axis];
    let (mut weight, mut bias) = (floats(weight)?, bias.map_or(Ok(vec![0.0; channels]), floats)?);
    if let Some(norm) = norm {
        let (gamma, beta) = (floats(norm.gamma.val())?, floats(norm.beta.val())?);
        let (mean, variance) = (floats(norm.running_mean.value_sync())?, floats(norm.running_var.value_sync())?);
        let scale: Vec<f32> = (0..channels)
            .map(|c| (f64::from(gamma[c]) / (f64::from(variance[c]) + norm.epsilon).sqrt()) as f32)
            .collect();
        for c in 0..channels {
            bias[c] = scale[c] * (bias[c] - mean[c]) + beta[c];
        }
        let block: usize = dims[axis + 1..].iter().product();
        for (index, value) in weight.iter_mut().enumerate() {
            *value *= scale[index / block % channels];
        }
    }
    Ok(Kernel { dims, weight, bias })
}

fn floats<const D: usize>(tensor: Tensor<D>) -> Result<Vec<f32>, ExecutionError> {
    Ok(tensor.try_into_data()?.iter::<f32>().collect())
}
