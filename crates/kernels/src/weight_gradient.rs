//! The gradient of a convolution's weights.
//!
//! `d weights[o][i][ky][kx] = sum_{batch, y, x} d small[o][y][x] * large[i][s y + ky - before_y][s x + kx - before_x]`,
//!
//! either product by product (`direct.rs`) or by Winograd's filtering (`winograd.rs`), whichever is estimated to take
//! less time. Both have the channels of the pictures side by side (`interleaved.rs`), because vectors run over
//! channels.

mod direct;
mod interleaved;
mod winograd;

use crate::correlation::Method;
use crate::geometry::Geometry;
use crate::level::Level;

/// Memory that is used again from call to call.
#[derive(Clone, Debug, Default)]
pub struct GradientWorkspace {
    large: Vec<f32>,
    small: Vec<f32>,
    sums: Vec<f32>,
}

/// The gradient of the weights of a convolution, prepared for its sizes.
#[derive(Clone, Debug)]
pub struct WeightGradient {
    geometry: Geometry,
    level: Level,
    batch: usize,
    winograd: Option<winograd::Plan>,
    method: Method,
}

impl WeightGradient {
    /// For batches of `batch` pictures.
    pub fn new(geometry: &Geometry, level: Level, batch: usize) -> Self {
        let direct = Self { geometry: *geometry, level, batch, winograd: None, method: Method::Direct };
        let mut least = direct::cost(geometry, batch, level);
        let mut fastest = direct.clone();
        for method in [Method::Winograd6, Method::Winograd8] {
            let other = direct.clone().by(method);
            let cost = other.winograd.as_ref().map_or(f64::INFINITY, |plan| plan.cost(geometry));
            if cost < least {
                (least, fastest) = (cost, other);
            }
        }
        fastest
    }

    /// The same by another method; product by product where tiles are too small for the kernel.
    #[must_use]
    pub fn by(self, method: Method) -> Self {
        let winograd = winograd::Plan::new(&self.geometry, method, self.level, self.batch);
        let method = if winograd.is_some() { method } else { Method::Direct };
        Self { winograd, method, ..self }
    }

    /// How it is computed.
    pub fn method(&self) -> Method {
        self.method
    }

    /// Computes the gradient of the weights, `[small channels, large channels, kernel, kernel]`.
    ///
    /// # Shapes
    /// - `large`: `[batch, large channels, height, width]`, the picture on the large side
    /// - `small`: `[batch, small channels, height, width]`, the one on the small side; either may be the gradient
    /// - `weights`: all of it is written
    ///
    /// # Panics
    /// If lengths do not fit the geometry and the batch.
    pub fn run(&self, large: &[f32], small: &[f32], weights: &mut [f32], workspace: &mut GradientWorkspace) {
        let Self { geometry, level, batch, .. } = self;
        assert_eq!(small.len(), batch * geometry.small_channels * geometry.small_area(), "small of {geometry:?}");
        assert_eq!(large.len(), batch * geometry.large_channels * geometry.large_area(), "large of {geometry:?}");
        assert_eq!(weights.len(), geometry.weights(), "weights of {geometry:?}");
        match &self.winograd {
            Some(plan) => plan.run(geometry, [large, small], weights, workspace),
            None => direct::run(geometry, *level, [large, small], weights, workspace),
        }
    }
}
