//! Inner loops of the networks for the processor: convolutions forward and backward, with nothing but slices.
//!
//! | module | what |
//! |---|---|
//! | [`geometry`] | [`Geometry`]: the sizes of a convolution, and what its three products are called |
//! | [`correlation`] | [`Correlation`]: the forward product and the gradient of the data, bias and ReLU included |
//! | [`correspondence`], [`lens`] | where the pixels of one view lie in another, forward and backward |
//! | [`sampling`] | pictures read between their pixels, forward and backward |
//! | [`photometric`] | structural and absolute difference of pictures, forward and backward |
//! | [`WeightedMean`], [`CrossEntropy`], [`SecondOrder`] | maps that become one number, forward and backward |
//! | [`Pointwise`] | functions of single numbers, forward and backward |
//! | [`enlarge()`], [`enlarge_gradient`] | pictures of twice the size |
//! | [`awake()`] | many small parallel parts one after the other, without waking the threads for each |
//! | [`AdamStep`] | the optimiser in one pass |
//! | [`WeightGradient`] | the gradient of the weights |
//! | [`bias_gradient`], [`relu_bias_gradient`] | the gradient of the bias, and of a ReLU in the same pass |
//! | [`level`] | [`Level`]: which vector instructions are used |
//!
//! Pictures are `[batch, channels, height, width]`, `f32`, contiguous. A transposed convolution is the data gradient
//! of a convolution, so it needs no code of its own. Vector instructions are chosen at run time (AVX-512, AVX2, NEON,
//! scalar) by `pulp`; there is no unsafe code here. Sums are taken in an order that depends on the sizes alone, so
//! results are the same to the last bit for any number of threads.

mod activation;
mod adam;
mod awake;
pub mod correlation;
pub mod correspondence;
mod enlarge;
pub mod geometry;
pub mod lens;
pub mod level;
mod memory;
pub mod photometric;
mod pieces;
mod planes;
mod points;
mod pointwise;
mod reduction;
pub mod sampling;
mod second_order;
mod share;
#[cfg(test)]
mod tests;
mod tile;
mod transpose;
mod weight_gradient;

pub use activation::{bias_gradient, relu_bias_gradient};
pub use adam::AdamStep;
pub use awake::awake;
pub use correlation::{Correlation, Epilogue, Method, PackedWeights, Workspace};
pub use correspondence::Correspondence;
pub use enlarge::{enlarge, enlarge_gradient, interpolation};
pub use geometry::Geometry;
pub use lens::Lens;
pub use level::Level;
pub use photometric::Comparison;
pub use pointwise::Pointwise;
pub use reduction::{CrossEntropy, Divisor, WeightedMean};
pub use sampling::Sampling;
pub use second_order::SecondOrder;
pub use weight_gradient::{GradientWorkspace, WeightGradient};
