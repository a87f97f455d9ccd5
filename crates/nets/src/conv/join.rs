//! Channels side by side on Burn's Flex device: all threads copy, and gradients of the parts lie together again.

use super::memory::{give_back, unused, values};
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::NoCheckpointing;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops};
use burn::backend::flex::FlexTensor;
use burn::backend::{Autodiff, Flex};
use burn::tensor::{DType, Tensor};
use rayon::prelude::*;

/// The channels of two or three tensors side by side; `None` for other numbers of tensors, and if they are not of single
/// precision on the Flex device.
pub fn concatenate(tensors: &[Tensor<4>]) -> Option<Tensor<4>> {
    match tensors {
        [a, b] => join([a, b]),
        [a, b, c] => join([a, b, c]),
        _ => None,
    }
}

fn join<const N: usize>(tensors: [&Tensor<4>; N]) -> Option<Tensor<4>> {
    if tensors.iter().any(|tensor| tensor.dtype() != DType::F32) {
        return None;
    }
    let [batch, _, height, width] = tensors[0].dims();
    let channels = tensors.map(|tensor| tensor.dims()[1]);
    let join = Join { shape: [batch, height, width], channels };
    let sizes = join.sizes();
    let joined = |parts: &[FlexTensor]| {
        let parts: Vec<_> = parts.iter().map(values).collect();
        let mut whole = unused([batch, channels.iter().sum(), height, width]);
        copies(whole.storage_mut(), &parts.iter().map(|part| &part[..]).zip(sizes)).into_par_iter().for_each(
            |(to, from)| {
                to.copy_from_slice(from);
            },
        );
        whole
    };
    if !tensors[0].device().is_autodiff() {
        let parts = tensors.iter().map(|tensor| (*tensor).clone().try_into_primitive::<Flex>().ok());
        return Some(Tensor::from_primitive::<Flex>(joined(&parts.collect::<Option<Vec<_>>>()?)));
    }
    let tracked = tensors.iter().map(|tensor| (*tensor).clone().try_into_primitive::<Autodiff<Flex>>().ok());
    let (parts, nodes): (Vec<_>, Vec<_>) =
        tracked.collect::<Option<Vec<_>>>()?.into_iter().map(|tensor| tensor.into_parts()).unzip();
    let preparation = join.prepare::<NoCheckpointing>(nodes.try_into().ok()?);
    Some(Tensor::from_primitive::<Autodiff<Flex>>(preparation.compute_bound().stateless(joined(&parts))))
}

/// The pieces of a whole, `[batch, parts]`, each with the piece of the part it comes from.
fn copies<'a>(
    whole: &'a mut [f32],
    parts: &(impl Iterator<Item = (&'a [f32], usize)> + Clone),
) -> Vec<(&'a mut [f32], &'a [f32])> {
    let mut rest = whole;
    let mut pieces = Vec::new();
    for picture in 0.. {
        if rest.is_empty() {
            break;
        }
        for (part, size) in parts.clone() {
            let (to, after) = std::mem::take(&mut rest).split_at_mut(size);
            pieces.push((to, &part[picture * size..][..size]));
            rest = after;
        }
    }
    pieces
}

/// Parts with so many channels each.
#[derive(Debug)]
struct Join<const N: usize> {
    /// Pictures, and rows and columns of each.
    shape: [usize; 3],
    channels: [usize; N],
}

impl<const N: usize> Join<N> {
    /// Numbers of a picture in each part.
    fn sizes(&self) -> [usize; N] {
        self.channels.map(|channels| channels * self.shape[1] * self.shape[2])
    }
}

impl<const N: usize> Backward<Flex, N> for Join<N> {
    type State = ();

    fn backward(self, ops: Ops<(), N>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let whole = gradients.consume::<Flex>(&ops.node);
        let numbers = values(&whole);
        let [batch, height, width] = self.shape;
        let of_a_picture: usize = self.sizes().iter().sum();
        let mut before = 0;
        for ((node, size), channels) in ops.parents.into_iter().zip(self.sizes()).zip(self.channels) {
            if let Some(node) = node {
                let mut part = unused([batch, channels, height, width]);
                let pictures = part.storage_mut::<f32>().par_chunks_mut(size).zip(numbers.par_chunks(of_a_picture));
                pictures.for_each(|(part, whole)| part.copy_from_slice(&whole[before..][..size]));
                gradients.register::<Flex>(node.id, part);
            }
            before += size;
        }
        drop(numbers);
        give_back(whole);
    }
}
