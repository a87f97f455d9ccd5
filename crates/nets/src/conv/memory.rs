//! Memory of the processor's layers that is used again from step to step.
//!
//! A training step makes and forgets the same large tensors every time. Asking the system for their memory means to have
//! it filled with zeros, page by page, before anything is written there.

use burn::backend::TensorMetadata;
use burn::backend::flex::FlexTensor;
use burn::tensor::{Shape, TensorData};
use endoscape_kernels::weight_gradient::GradientWorkspace;
use endoscape_kernels::{PackedWeights, Workspace};
use std::borrow::Cow;
use std::sync::{Mutex, PoisonError};

/// Smaller tensors are left to the allocator.
const WORTH_KEEPING: usize = 1 << 15;
/// Most tensors that wait to be used again, and most numbers in them (half a gibibyte).
const MOST_TENSORS: usize = 64;
const MOST_NUMBERS: usize = 1 << 27;

static UNUSED: Mutex<Vec<FlexTensor>> = Mutex::new(Vec::new());

/// A tensor nobody else looks at, in order, whose numbers are left over from earlier uses.
pub fn unused(shape: [usize; 4]) -> FlexTensor {
    let numbers = shape.iter().product();
    let mut tensors = UNUSED.lock().unwrap_or_else(PoisonError::into_inner);
    let place = tensors.iter().position(|tensor| tensor.shape().num_elements() == numbers);
    let used = place.map(|place| tensors.remove(place));
    drop(tensors);
    used.map_or_else(|| tensor(vec![0.0; numbers], shape), |used| used.reshape(Shape::from(shape)))
}

/// Keeps the memory of a tensor for a later [`unused`] one, if nobody else looks at it.
pub fn give_back(tensor: FlexTensor) {
    let numbers = tensor.as_slice::<f32>().map_or(0, <[f32]>::len);
    if numbers < WORTH_KEEPING || !tensor.is_unique() || tensor.bytes().len() != numbers * size_of::<f32>() {
        return;
    }
    let mut tensors = UNUSED.lock().unwrap_or_else(PoisonError::into_inner);
    tensors.push(tensor);
    // The oldest belong to sizes that are no longer asked for.
    let kept = |tensors: &[FlexTensor]| tensors.iter().map(|tensor| tensor.shape().num_elements()).sum::<usize>();
    while tensors.len() > MOST_TENSORS || kept(&tensors) > MOST_NUMBERS {
        tensors.remove(0);
    }
}

/// What the kernels want to have at hand.
#[derive(Default)]
pub struct Memory {
    pub packed: PackedWeights,
    pub pictures: Workspace,
    pub gradients: GradientWorkspace,
}

/// Lends memory; layers that are computed at the same time get one each.
pub fn with_memory<R>(work: impl FnOnce(&mut Memory) -> R) -> R {
    static MEMORIES: Mutex<Vec<Memory>> = Mutex::new(Vec::new());
    let memories = || MEMORIES.lock().unwrap_or_else(PoisonError::into_inner);
    let mut memory = memories().pop().unwrap_or_default();
    let result = work(&mut memory);
    memories().push(memory);
    result
}

/// The numbers of a tensor in their order, copied where they do not lie in that order.
pub fn values(tensor: &FlexTensor) -> Cow<'_, [f32]> {
    match tensor.as_slice::<f32>() {
        Some(values) => Cow::Borrowed(values),
        None => Cow::Owned(tensor.to_contiguous().storage::<f32>()[..tensor.shape().num_elements()].to_vec()),
    }
}

/// A tensor of these numbers.
pub fn tensor(values: Vec<f32>, shape: impl Into<Shape>) -> FlexTensor {
    FlexTensor::from_data(TensorData::new(values, shape))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_comes_back_unless_somebody_looks_at_it() {
        // No other test has tensors of such a length.
        let shape = [1, 3, WORTH_KEEPING, 7];
        let first = unused(shape);
        let place = first.bytes().as_ptr();
        let seen = first.clone();
        give_back(first);
        assert_ne!(unused(shape).bytes().as_ptr(), place);
        give_back(seen);
        let again = unused([7, WORTH_KEEPING, 1, 3]);
        assert_eq!(again.bytes().as_ptr(), place);
        assert!(again.is_unique());
    }
}
