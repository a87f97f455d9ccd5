//! Our kernels on Burn's CubeCL devices (CUDA, ROCm, Metal, Vulkan), with gradients.
//!
//! As in `flex.rs`, each function is `None` where tensors are of another precision or on another device, and stands
//! beside a reference in plain tensor operations. Kernels are written once, in Rust; CubeCL compiles them for the
//! device that tensors live on, when they are first launched there (docs/decisions/009).

mod correspondence;
mod dual;
mod lens;
mod maps;
mod sampling;

use crate::camera::CameraBatch;
use crate::function::{constant, function, operand};
use crate::warp::Correspondence;
use burn::backend::Cube;
use burn::tensor::Tensor;
use correspondence::{Part, Views};
use endoscape_kernels::correspondence::Limits;
use maps::CubeTensor;

/// [`crate::warp::correspond`] by our kernel, for cameras of one model.
pub fn correspond(
    depth: &Tensor<4>,
    motion: &Tensor<3>,
    cameras: &CameraBatch,
    limits: Limits,
) -> Option<Correspondence> {
    let operands = || Some([operand::<Cube, 4>(depth)?, operand::<Cube, 3>(motion)?]);
    let views = views(cameras, depth, limits)?;
    let [depth, motion] = operands()?;
    let found = views.find(depth.tensor().clone(), motion.tensor().clone());
    let tracked = |value: CubeTensor, part: Part| {
        let views = views.clone();
        function(operands()?, value, move |[depth, motion], of_part, [of_depth, of_motion]| {
            let slopes = views.differentiate(depth, motion, part, of_part);
            [of_depth.then(|| slopes.of_depth()), of_motion.then(|| slopes.of_motion())]
        })
    };
    Some(Correspondence {
        pixels: tracked(found.positions(), Part::Positions)?,
        depth: tracked(found.depth(), Part::Depth)?,
        defined: constant(found.defined(), &depth),
        in_view: constant(found.in_view(), &depth),
    })
}

/// The views whose first has that depth; `None` if the cameras are not for it.
fn views(cameras: &CameraBatch, depth: &Tensor<4>, limits: Limits) -> Option<Views> {
    let [batch, _, height, width] = depth.dims();
    let [views, _, rows, columns] = cameras.rays().dims();
    if [height, width] != [rows, columns] || ![1, batch].contains(&views) || batch == 0 {
        return None;
    }
    let [rays, seen] = [cameras.rays(), cameras.seen()].map(|maps| Some(operand::<Cube, 4>(&maps)?.detached()));
    let (rays, seen) = (rays?, seen?);
    let (model, lenses) = lens::lenses(&cameras.lenses(), &rays)?;
    Some(Views { rays, seen, lenses, model, limits })
}

/// [`crate::warp::sample_bilinear`] by our kernel.
pub fn sample_bilinear(picture: &Tensor<4>, pixels: &Tensor<4>) -> Option<Tensor<4>> {
    let operands = [operand::<Cube, 4>(picture)?, operand::<Cube, 4>(pixels)?];
    let [of_picture, of_pixels] = [picture, pixels].map(Tensor::dims);
    if of_picture[0] != of_pixels[0] || of_picture.contains(&0) || of_pixels.contains(&0) {
        return None;
    }
    let [picture, pixels] = operands.each_ref().map(|operand| operand.tensor().clone());
    let read = sampling::read(picture, pixels);
    function(operands, read, |[picture, pixels], of_read, [of_picture, of_pixels]| {
        let scatter = || sampling::picture_gradient(&picture, pixels.clone(), of_read.clone());
        let of_picture = of_picture.then(scatter);
        [of_picture, of_pixels.then(|| sampling::position_gradient(picture, pixels, of_read))]
    })
}
