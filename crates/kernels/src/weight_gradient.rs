//! The gradient of a convolution's weights and bias.
//!
//! `d weights[o][i][ky][kx] = sum_{batch, y, x} d small[o][y][x] * large[i][s y + ky - before_y][s x + kx - before_x]`.
//!
//! Summed product by product (`direct.rs`) or by Winograd's filtering (`winograd.rs`), which pays where pictures are
//! large and weights few.

mod direct;
mod interleaved;
mod winograd;

use crate::correlation::Method;
use crate::geometry::Geometry;
use crate::level::Level;
use rayon::prelude::*;

/// Memory that is used again from call to call.
#[derive(Clone, Debug, Default)]
pub struct GradientWorkspace {
    large: Vec<f32>,
    small: Vec<f32>,
    sums: Vec<f32>,
}

/// The gradient of a convolution's weights, prepared for its sizes.
#[derive(Clone, Copy, Debug)]
pub struct WeightGradient {
    geometry: Geometry,
    level: Level,
    /// How it is computed; chosen by the batch where it is `None`.
    method: Option<Method>,
}

impl WeightGradient {
    /// By the method that is fastest for the batch.
    pub fn new(geometry: &Geometry, level: Level) -> Self {
        Self { geometry: *geometry, level, method: None }
    }

    /// By the method given; where it cannot, directly.
    pub fn by(self, method: Method) -> Self {
        Self { method: Some(method), ..self }
    }

    /// Computes the gradient, `[small channels, large channels, kernel, kernel]`.
    ///
    /// # Shapes
    /// - `large`: `[batch, large channels, height, width]`, the picture on the large side
    /// - `small`: `[batch, small channels, height, width]`, the one on the small side; either may be the gradient
    /// - `weights`: all of it is written
    ///
    /// # Panics
    /// If lengths do not fit the geometry.
    pub fn run(&self, large: &[f32], small: &[f32], weights: &mut [f32], workspace: &mut GradientWorkspace) {
        let geometry = &self.geometry;
        let batch = small.len() / (geometry.small_channels * geometry.small_area()).max(1);
        assert_eq!(small.len(), batch * geometry.small_channels * geometry.small_area(), "small of {geometry:?}");
        assert_eq!(large.len(), batch * geometry.large_channels * geometry.large_area(), "large of {geometry:?}");
        assert_eq!(weights.len(), geometry.weights(), "weights of {geometry:?}");
        match self.plan(batch) {
            Some(plan) => plan.run(self.level, [large, small], weights, workspace),
            None => direct::weight_gradient(geometry, self.level, [large, small], weights, workspace),
        }
    }

    /// How it is computed for a batch.
    pub fn method(&self, batch: usize) -> Method {
        self.plan(batch).map_or(Method::Direct, |plan| plan.method())
    }

    /// Winograd's filtering, where it can and shall be used.
    fn plan(&self, batch: usize) -> Option<winograd::Plan> {
        let plan = |method: Method| winograd::Plan::new(&self.geometry, self.level, batch, method);
        if let Some(method) = self.method {
            return plan(method);
        }
        let plans = [Method::Winograd6, Method::Winograd8].into_iter().filter_map(plan);
        let fastest = plans.min_by(|a, b| a.cost().total_cmp(&b.cost()))?;
        let direct = (batch * self.geometry.operations() / 2) as f64;
        (fastest.cost() < direct).then_some(fastest)
    }
}

/// The gradient of the bias: the sum of each channel over the batch and all pixels, added to nothing else.
///
/// # Shapes
/// - `gradient`: `[batch, channels, area]`
/// - `bias`: `[channels]`, all of it is written
pub fn bias_gradient(gradient: &[f32], area: usize, bias: &mut [f32]) {
    let channels = bias.len();
    bias.par_iter_mut().enumerate().for_each(|(channel, bias)| {
        let planes = gradient.chunks_exact(area).skip(channel).step_by(channels);
        *bias = planes.map(sum).sum();
    });
}

/// A sum in several lanes, which vectors can compute and which loses fewer digits than one lane.
fn sum(values: &[f32]) -> f32 {
    let (lanes, rest) = values.as_chunks::<16>();
    let mut sums = [0.0_f32; 16];
    for values in lanes {
        sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
    }
    sums.iter().chain(rest).sum()
}
