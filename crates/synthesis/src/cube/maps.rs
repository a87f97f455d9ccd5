//! What kernels over the pixels of maps have in common.

use burn::backend::tensor::FloatTensor;
use burn::backend::{Cube, TensorMetadata};
use burn::cubecl;
use burn::tensor::{DType, Shape};
use cubecl::calculate_cube_count_elemwise;
use cubecl::prelude::*;

/// A tensor on a CubeCL device.
pub type CubeTensor = FloatTensor<Cube>;

/// How a kernel is launched that has one unit of the device per pixel.
pub struct Units {
    /// Groups of units.
    pub count: CubeCount,
    /// Units of a group.
    pub dim: CubeDim,
    /// Wide enough for every index into the tensors.
    pub address: AddressType,
}

impl Units {
    /// For every pixel of the maps `like`, `[batch, planes, rows, columns]`, and kernels that touch them and `others`.
    pub fn new(like: &CubeTensor, others: &[&CubeTensor]) -> Self {
        let [batch, _, rows, columns] = like.shape().dims();
        let pixels = batch * rows * columns;
        let dim = CubeDim::new(&like.client, pixels);
        let widest = |address: AddressType, other: &&CubeTensor| address.max(other.required_address_type());
        Self {
            count: calculate_cube_count_elemwise(&like.client, pixels, dim),
            dim,
            address: others.iter().fold(like.required_address_type(), widest),
        }
    }
}

/// Maps of single precision on the device of `like`, not yet written to.
pub fn unwritten(like: &CubeTensor, shape: [usize; 4]) -> CubeTensor {
    let shape = Shape::from(shape);
    let memory = like.client.empty(shape.num_elements() * DType::F32.size());
    CubeTensor::new_contiguous(like.client.clone(), like.device.clone(), shape, memory, DType::F32)
}

/// A table of numbers on the device of `like`.
pub fn table(like: &CubeTensor, numbers: &[f32], shape: [usize; 2]) -> CubeTensor {
    let memory = like.client.create_from_slice(f32::as_bytes(numbers));
    CubeTensor::new_contiguous(like.client.clone(), like.device.clone(), shape.into(), memory, DType::F32)
}

/// A pixel of a batch of maps.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Pixel {
    /// Which of the batch.
    pub item: usize,
    /// Its row.
    pub row: usize,
    /// Its column.
    pub column: usize,
}

/// How many pixels maps have, each counted once for all planes.
#[cube]
pub fn pixels(maps: &Tensor<f32>) -> usize {
    maps.shape(0) * maps.shape(2) * maps.shape(3)
}

/// The pixel of maps that this unit works on.
#[cube]
pub fn own_pixel(maps: &Tensor<f32>) -> Pixel {
    let rows = maps.shape(2);
    let columns = maps.shape(3);
    Pixel { item: ABSOLUTE_POS / (rows * columns), row: ABSOLUTE_POS / columns % rows, column: ABSOLUTE_POS % columns }
}

/// The index of a plane's pixel in the memory of maps.
#[cube]
pub fn index<T: CubePrimitive>(maps: &Tensor<T>, plane: usize, pixel: Pixel) -> usize {
    pixel.item * maps.stride(0) + plane * maps.stride(1) + pixel.row * maps.stride(2) + pixel.column * maps.stride(3)
}

/// Sets a plane's pixel.
#[cube]
pub fn write(maps: &mut Tensor<f32>, plane: usize, pixel: Pixel, value: f32) {
    let place = index(&*maps, plane, pixel);
    maps[place] = value;
}
