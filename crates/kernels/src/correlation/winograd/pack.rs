//! Weights at the points.

use super::super::pieces::Panel;
use super::{Plan, Shape};
use crate::points::{self, MAX_POINTS, Points};
use crate::tile;
use pulp::{Simd, WithSimd};

/// Brings the weights of a panel into their order: for each pass, `[point][input channel][channel]`.
pub struct Pack<'a> {
    pub plan: &'a Plan,
    pub shape: &'a Shape,
    pub weights: &'a [f32],
    pub panel: &'a Panel,
    pub values: &'a mut [f32],
}

/// A tap of a kernel of one pass and phase: its index, and where it lies in the small kernel.
type Place = (usize, usize);

impl WithSimd for Pack<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        match self.plan.pairs {
            2 => self.run::<S, 2>(simd),
            _ => self.run::<S, 3>(simd),
        }
    }
}

impl Pack<'_> {
    #[inline(always)]
    fn run<S: Simd, const PAIRS: usize>(&mut self, simd: S) {
        let taps = self.plan.kernel * self.plan.kernel;
        let mut kernels = vec![0.0; taps * S::F32_LANES];
        // Channels and outputs run on without a gap, so a vector may hold outputs of several channels.
        let all = self.plan.channels * self.panel.width;
        for pass in 0..self.shape.passes.len() {
            let places = self.places(pass);
            for first in (0..all).step_by(S::F32_LANES) {
                let count = S::F32_LANES.min(all - first);
                self.gather(&places, first..first + count, &mut kernels);
                self.transform::<S, PAIRS>(simd, &kernels, pass * self.plan.pixels() * all + first, count);
            }
        }
    }

    /// For each phase of the input, the taps of a pass.
    fn places(&self, pass: usize) -> Vec<Vec<Place>> {
        let step = self.shape.step;
        let mut places = vec![Vec::new(); step * step];
        for tap in &self.shape.passes[pass] {
            let phase = tap.row % step * step + tap.column % step;
            places[phase].push((tap.index, tap.row / step * self.plan.kernel + tap.column / step));
        }
        places
    }

    /// Kernels side by side, `[tap][lane]`.
    fn gather(&self, places: &[Vec<Place>], lanes: std::ops::Range<usize>, kernels: &mut [f32]) {
        kernels.fill(0.0);
        let width = kernels.len() / (self.plan.kernel * self.plan.kernel);
        for (lane, index) in lanes.enumerate() {
            let (channel, output) = (index / self.panel.width, index % self.panel.width);
            if output >= self.panel.channels.len() {
                continue;
            }
            let (input, phase) = (channel / places.len(), channel % places.len());
            let first = self.shape.weight(self.panel.channels.start + output, input, 0);
            for (tap, place) in &places[phase] {
                kernels[place * width + lane] = self.weights[first + tap];
            }
        }
    }

    #[inline(always)]
    fn transform<S: Simd, const PAIRS: usize>(&mut self, simd: S, kernels: &[f32], first: usize, count: usize) {
        let (taps, points) = (self.plan.kernel, self.plan.points);
        let all = self.plan.channels * self.panel.width;
        let mut tile = points::empty(simd);
        for (row, line) in tile.iter_mut().enumerate().take(taps) {
            let mut kernel = [simd.splat_f32s(0.0); MAX_POINTS];
            for (column, value) in kernel.iter_mut().enumerate().take(taps) {
                [*value] = tile::load::<S, 1>(simd, kernels, (row * taps + column) * S::F32_LANES);
            }
            *line = scaled::<S, PAIRS>(simd, &kernel, taps);
        }
        for column in 0..points {
            let values = scaled::<S, PAIRS>(simd, &points::column::<S>(simd, &tile, column, taps), taps);
            for (row, value) in values.iter().enumerate().take(points) {
                let place = &mut self.values[first + (row * points + column) * all..][..count];
                simd.partial_store_f32s(place, *value);
            }
        }
    }
}

/// A kernel at the points.
#[inline(always)]
fn scaled<S: Simd, const PAIRS: usize>(simd: S, kernel: &[S::f32s; MAX_POINTS], taps: usize) -> [S::f32s; MAX_POINTS] {
    let mut values = Points::<PAIRS>::evaluate(simd, kernel, taps);
    for (value, scale) in values.iter_mut().zip(Points::<PAIRS>::SCALES) {
        *value = simd.mul_f32s(*value, simd.splat_f32s(scale));
    }
    values
}
