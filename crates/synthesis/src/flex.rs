//! Our kernels on Burn's Flex device (the processor), with gradients.
//!
//! Each function here is `None` where tensors are of another precision or on another device. It stands beside a
//! reference in plain tensor operations, which is used there, and with which the tests compare it.

mod function;

use crate::camera::CameraBatch;
use crate::photometric::Average;
use crate::warp::Correspondence;
use burn::tensor::Tensor;
use endoscape_kernels::correspondence::{Limits, OfFound};
use endoscape_kernels::{Comparison, CrossEntropy, Divisor, Lens, Pointwise, Sampling, SecondOrder, WeightedMean};
use function::{Numbers, Operand, constant, function, operand};
use std::sync::Arc;

/// [`crate::warp::correspond`] by our kernel.
pub fn correspond(
    depth: &Tensor<4>,
    motion: &Tensor<3>,
    cameras: &CameraBatch,
    limits: Limits,
) -> Option<Correspondence> {
    let [batch, _, height, width] = depth.dims();
    let views = Arc::new(Views {
        rays: operand(&cameras.rays())?.detached(),
        seen: operand(&cameras.seen())?.detached(),
        lenses: cameras.lenses(),
        size: [height, width],
        limits,
    });
    let operands = || Some([operand(depth)?, operand(motion)?]);
    let [depth, motion] = operands()?;
    let found = views.with_kernel([&depth.numbers(), &motion.numbers()], |kernel| kernel.find());
    let shape = |planes: usize| [batch, planes, height, width];
    Some(Correspondence {
        pixels: views.found(operands()?, (found.positions, shape(2)), |gradient| OfFound::Positions(gradient))?,
        depth: views.found(operands()?, (found.depth, shape(1)), |gradient| OfFound::Depth(gradient))?,
        defined: constant(found.defined, shape(1), &depth),
        in_view: constant(found.in_view, shape(1), &depth),
    })
}

/// What two views of a scene share.
struct Views {
    rays: Numbers,
    seen: Numbers,
    lenses: Arc<[Lens]>,
    size: [usize; 2],
    limits: Limits,
}

impl Views {
    fn with_kernel<R>(
        &self,
        [depth, motion]: [&[f32]; 2],
        work: impl FnOnce(endoscape_kernels::Correspondence<'_>) -> R,
    ) -> R {
        work(endoscape_kernels::Correspondence {
            rays: &self.rays.get(),
            seen: &self.seen.get(),
            lenses: &self.lenses,
            size: self.size,
            depth,
            motion,
            limits: self.limits,
        })
    }

    /// A part of what was found, as a function of depth and motion.
    fn found<const D: usize>(
        self: &Arc<Self>,
        operands: [Operand; 2],
        value: (Vec<f32>, [usize; D]),
        part: fn(&[f32]) -> OfFound<'_>,
    ) -> Option<Tensor<D>> {
        let views = Arc::clone(self);
        function(operands, value, move |inputs, of_value, _| {
            let (of_depth, of_motion) = views.with_kernel(inputs, |kernel| kernel.gradients(part(of_value)));
            [Some(of_depth), Some(of_motion)]
        })
    }
}

/// [`crate::warp::sample_bilinear`] by our kernel, colours multiplied by `shown`, `[batch, 1, rows, columns]`, where that
/// is given.
pub fn sample_bilinear(picture: &Tensor<4>, pixels: &Tensor<4>, shown: Option<&Tensor<4>>) -> Option<Tensor<4>> {
    let ([batch, channels, height, width], [_, _, rows, columns]) = (picture.dims(), pixels.dims());
    let shown = match shown {
        Some(shown) => Some(operand(shown)?.detached()),
        None => None,
    };
    let sample = Sample { channels, size: [height, width], area: rows * columns, shown };
    let operands = [operand(picture)?, operand(pixels)?];
    let read = {
        let [picture, pixels] = operands.each_ref().map(Operand::numbers);
        sample.with_kernel([&picture, &pixels], |kernel| kernel.read())
    };
    function(operands, (read, [batch, channels, rows, columns]), move |inputs, of_read, [of_picture, of_pixels]| {
        sample.with_kernel(inputs, |kernel| {
            [of_picture.then(|| kernel.picture_gradient(of_read)), of_pixels.then(|| kernel.position_gradient(of_read))]
        })
    })
}

/// How pictures are read.
struct Sample {
    channels: usize,
    size: [usize; 2],
    area: usize,
    shown: Option<Numbers>,
}

impl Sample {
    fn with_kernel<R>(&self, [pictures, positions]: [&[f32]; 2], work: impl FnOnce(Sampling<'_>) -> R) -> R {
        let Self { channels, size, area, .. } = *self;
        let shown = self.shown.as_ref().map(Numbers::get);
        work(Sampling { pictures, channels, size, positions, shown: shown.as_deref(), area })
    }
}

/// [`crate::photometric::photometric_error`] by our kernel.
pub fn photometric_error(a: &Tensor<4>, b: &Tensor<4>, ssim_weight: f64) -> Option<Tensor<4>> {
    let [batch, channels, height, width] = a.dims();
    let (size, ssim_weight) = ([height, width], ssim_weight as f32);
    let operands = [operand(a)?, operand(b)?];
    let error = {
        let [a, b] = operands.each_ref().map(Operand::numbers);
        Comparison { a: &a, b: &b, channels, size, ssim_weight }.error()
    };
    function(operands, (error, [batch, 1, height, width]), move |[a, b], of_error, [of_a, of_b]| {
        let gradient = |a, b| Comparison { a, b, channels, size, ssim_weight }.gradient(of_error);
        // The error is symmetric.
        [of_a.then(|| gradient(b, a)), of_b.then(|| gradient(a, b))]
    })
}

/// [`crate::photometric::average`] by our kernel.
pub fn average(values: &Tensor<4>, weights: &Tensor<4>, by: Average) -> Option<Tensor<1>> {
    let divisor = match by {
        Average::ValidPixels => Divisor::Weights,
        Average::AllPixels => Divisor::Count,
    };
    if values.dims() != weights.dims() {
        return None;
    }
    let operands = [operand(values)?, operand(weights)?];
    let mean = {
        let [values, weights] = operands.each_ref().map(Operand::numbers);
        WeightedMean { values: &values, weights: &weights, divisor }.value()
    };
    function(operands, (vec![mean], [1]), move |[values, weights], of_mean, _| {
        [Some(WeightedMean { values, weights, divisor }.gradient(of_mean[0])), None]
    })
}

/// Mean of `-ln(max(values, smallest))` by our kernel.
pub fn cross_entropy(values: &Tensor<4>, smallest: f64) -> Option<Tensor<1>> {
    let (operand, kernel) = (operand(values)?, CrossEntropy { smallest: smallest as f32 });
    let mean = kernel.value(&operand.numbers());
    function([operand], (vec![mean], [1]), move |[values], of_mean, _| [Some(kernel.gradient(values, of_mean[0]))])
}

/// [`crate::smoothness::second_order`] by our kernel.
pub fn second_order(map: &Tensor<4>) -> Option<Tensor<1>> {
    let ([_, _, height, width], operand) = (map.dims(), operand(map)?);
    let size = [height, width];
    let value = SecondOrder { maps: &operand.numbers(), size }.value();
    function([operand], (vec![value], [1]), move |[maps], of_value, _| {
        [Some(SecondOrder { maps, size }.gradient(of_value[0]))]
    })
}

/// The numbers between two others, the lower one in the place of others, NaN included.
pub fn within(map: &Tensor<4>, [low, high]: [f64; 2]) -> Option<Tensor<4>> {
    pointwise(map, Pointwise::Within([low as f32, high as f32]))
}

/// One over [`within`].
pub fn inverse_within(map: &Tensor<4>, [low, high]: [f64; 2]) -> Option<Tensor<4>> {
    pointwise(map, Pointwise::InverseWithin([low as f32, high as f32]))
}

fn pointwise(map: &Tensor<4>, kernel: Pointwise) -> Option<Tensor<4>> {
    let operand = operand(map)?;
    let values = kernel.values(&operand.numbers());
    function([operand], (values, map.dims()), move |[inputs], of_values, _| [Some(kernel.gradient(inputs, of_values))])
}

#[cfg(test)]
mod tests;
