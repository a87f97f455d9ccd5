//! Memory of the processor's layers that is used again from step to step.
//!
//! A training step makes and forgets the same large tensors every time. Asking the system for their memory means to have
//! it filled with zeros, page by page, before anything is written there.

use burn::backend::flex::FlexTensor;
use burn::backend::{Flex, TensorMetadata};
use burn::module::{Module, ModuleMapper, Param};
use burn::tensor::{Shape, Tensor, TensorData};
use endoscape_kernels::GradientWorkspace;
use endoscape_kernels::{PackedWeights, Workspace};
use std::borrow::Cow;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Smaller tensors are left to the allocator.
const WORTH_KEEPING: usize = 1 << 15;
/// Most tensors that wait to be used again, and most numbers in them (half a gibibyte).
const MOST_TENSORS: usize = 192;
const MOST_NUMBERS: usize = 1 << 27;

static UNUSED: Mutex<Pool> = Mutex::new(Pool { tensors: Vec::new() });

/// Tensors that wait to be used again, the longest waiting first.
struct Pool {
    tensors: Vec<FlexTensor>,
}

impl Pool {
    /// A tensor of as many numbers, whatever they are.
    fn take(&mut self, numbers: usize) -> Option<FlexTensor> {
        let place = self.tensors.iter().position(|tensor| tensor.shape().num_elements() == numbers)?;
        Some(self.tensors.remove(place))
    }

    /// Keeps the memory of a tensor, if it is worth it and nobody else looks at it.
    fn keep(&mut self, tensor: FlexTensor) {
        let numbers = tensor.as_slice::<f32>().map_or(0, <[f32]>::len);
        if numbers < WORTH_KEEPING || !tensor.is_unique() || tensor.bytes().len() != numbers * size_of::<f32>() {
            return;
        }
        self.tensors.push(tensor);
        // The oldest belong to sizes that are no longer asked for.
        while self.tensors.len() > MOST_TENSORS || self.numbers() > MOST_NUMBERS {
            self.tensors.remove(0);
        }
    }

    fn numbers(&self) -> usize {
        self.tensors.iter().map(|tensor| tensor.shape().num_elements()).sum()
    }
}

fn pool() -> MutexGuard<'static, Pool> {
    UNUSED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A tensor nobody else looks at, in order, whose numbers are left over from earlier uses.
pub fn unused(shape: [usize; 4]) -> FlexTensor {
    let numbers = shape.iter().product();
    let used = pool().take(numbers);
    used.map_or_else(|| tensor(vec![0.0; numbers], shape), |used| used.reshape(Shape::from(shape)))
}

/// Keeps the memory of a tensor for a later [`unused`] one, if nobody else looks at it.
pub fn give_back(tensor: FlexTensor) {
    pool().keep(tensor);
}

/// Keeps the memory of a module's parameters, which nobody needs any more, for the gradients to come. Statistics of
/// batch normalisation stay: a module shares them with its clones and successors.
pub fn recycle(module: impl Module) {
    struct Recycling;
    impl ModuleMapper for Recycling {
        fn map_float<const D: usize>(&mut self, parameter: Param<Tensor<D>>) -> Param<Tensor<D>> {
            if !parameter.val().is_require_grad() {
                return parameter;
            }
            let (id, tensor, mapper) = parameter.consume();
            let nothing = Tensor::zeros([0; D], &tensor.device());
            if let Ok(tensor) = tensor.inner().try_into_primitive::<Flex>() {
                give_back(tensor);
            }
            Param::from_mapped_value(id, nothing, mapper)
        }
    }
    module.map(&mut Recycling);
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
        let mut pool = Pool { tensors: Vec::new() };
        let first = tensor(vec![0.0; WORTH_KEEPING], [1, 8, WORTH_KEEPING / 8]);
        let place = first.bytes().as_ptr();
        let seen = first.clone();
        pool.keep(first);
        assert!(pool.take(WORTH_KEEPING).is_none());
        pool.keep(seen);
        assert!(pool.take(WORTH_KEEPING - 1).is_none());
        let again = pool.take(WORTH_KEEPING).unwrap();
        assert_eq!(again.bytes().as_ptr(), place);
        assert!(again.is_unique() && pool.take(WORTH_KEEPING).is_none());
    }

    #[test]
    fn what_waits_is_bounded() {
        let mut pool = Pool { tensors: Vec::new() };
        for _ in 0..2 * MOST_TENSORS {
            pool.keep(tensor(vec![0.0; WORTH_KEEPING], [WORTH_KEEPING]));
        }
        assert_eq!(pool.tensors.len(), MOST_TENSORS);
        pool.keep(tensor(vec![0.0; WORTH_KEEPING - 1], [WORTH_KEEPING - 1]));
        assert!(pool.take(WORTH_KEEPING - 1).is_none());
    }
}
