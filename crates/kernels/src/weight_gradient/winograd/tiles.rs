//! Pixels and gradients of tiles to points.

use super::{Interleaved, Plan};
use crate::points::{self, MAX_POINTS, Points, Tile};
use crate::tile;
use pulp::{Simd, WithSimd};
use std::ops::Range;

/// The tiles of a batch, to be transformed with the widest vectors.
pub struct Transform<'a> {
    pub plan: &'a Plan,
    /// Large and small pictures.
    pub lines: [&'a [f32]; 2],
    pub tiles: Range<usize>,
    pub values: &'a mut [f32],
}

/// Where a tile lies.
#[derive(Clone, Copy)]
struct Place {
    picture: usize,
    row: usize,
    column: usize,
}

impl WithSimd for Transform<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        match self.plan.pairs {
            2 => self.run::<S, 2>(simd),
            _ => self.run::<S, 3>(simd),
        }
    }
}

impl Transform<'_> {
    #[inline(always)]
    fn run<S: Simd, const PAIRS: usize>(&mut self, simd: S) {
        let [rows, columns] = self.plan.tiles;
        for (index, tile) in self.tiles.clone().enumerate() {
            let place = Place { picture: tile / (rows * columns), row: tile / columns % rows, column: tile % columns };
            self.inputs::<S, PAIRS>(simd, place, index);
            match self.plan.outputs {
                2 => self.gradients::<S, PAIRS, 2>(simd, place, index),
                3 => self.gradients::<S, PAIRS, 3>(simd, place, index),
                4 => self.gradients::<S, PAIRS, 4>(simd, place, index),
                5 => self.gradients::<S, PAIRS, 5>(simd, place, index),
                6 => self.gradients::<S, PAIRS, 6>(simd, place, index),
                _ => self.gradients::<S, PAIRS, 7>(simd, place, index),
            }
        }
    }

    /// Pixels of the large picture under a tile.
    #[inline(always)]
    fn inputs<S: Simd, const PAIRS: usize>(&mut self, simd: S, place: Place, index: usize) {
        let Plan { blocks, step, outputs, large, .. } = self.plan;
        let points = Points::<PAIRS>::COUNT;
        for block in blocks {
            let (row, column) =
                (step * place.row * outputs + block.phase / step, step * place.column * outputs + block.phase % step);
            let pixels = &self.lines[0][start(large, place.picture, row, column) + block.channels.start..];
            let width = block.vectors * S::F32_LANES;
            let [first, of_a_point] = self.plan.place_of_inputs(block);
            let values = &mut self.values[first + index * width..];
            for vector in (0..width).step_by(S::F32_LANES) {
                let mut tile = points::empty(simd);
                for (row, line) in tile.iter_mut().enumerate().take(points) {
                    let mut numbers = [simd.splat_f32s(0.0); MAX_POINTS];
                    for (column, number) in numbers.iter_mut().enumerate().take(points) {
                        let at = step * (row * large.row_stride + column * large.column_stride) + vector;
                        [*number] = tile::load::<S, 1>(simd, pixels, at);
                    }
                    *line = Points::<PAIRS>::analyse(simd, &numbers);
                }
                for column in 0..points {
                    let numbers = Points::<PAIRS>::analyse(simd, &points::column::<S>(simd, &tile, column, points));
                    for (row, number) in numbers.iter().enumerate().take(points) {
                        tile::store::<S>(&mut values[(row * points + column) * of_a_point + vector..], *number);
                    }
                }
            }
        }
    }

    /// Gradients of the small picture in a tile.
    #[inline(always)]
    fn gradients<S: Simd, const PAIRS: usize, const OUTPUTS: usize>(&mut self, simd: S, place: Place, index: usize) {
        let Plan { small, panel, panels, group, .. } = self.plan;
        let points = Points::<PAIRS>::COUNT;
        let pixels = &self.lines[1][start(small, place.picture, place.row * OUTPUTS, place.column * OUTPUTS)..];
        let (_, values) = self.values.split_at_mut(self.plan.lengths()[0]);
        for channel in (0..(panel * panels).min(small.column_stride)).step_by(S::F32_LANES) {
            let [first, of_a_point] = self.plan.place_of_gradients(channel);
            let values = &mut values[first + index * group..];
            let mut tile: Tile<S> = points::empty(simd);
            for (row, line) in tile.iter_mut().enumerate().take(OUTPUTS) {
                let mut numbers = [simd.splat_f32s(0.0); MAX_POINTS];
                for (column, number) in numbers.iter_mut().enumerate().take(OUTPUTS) {
                    let at = row * small.row_stride + column * small.column_stride + channel;
                    [*number] = tile::load::<S, 1>(simd, pixels, at);
                }
                *line = Points::<PAIRS>::evaluate(simd, &numbers, OUTPUTS);
            }
            for column in 0..points {
                let numbers = points::column::<S>(simd, &tile, column, OUTPUTS);
                let numbers = Points::<PAIRS>::evaluate(simd, &numbers, OUTPUTS);
                for (row, number) in numbers.iter().enumerate().take(points) {
                    tile::store::<S>(&mut values[(row * points + column) * of_a_point..], *number);
                }
            }
        }
    }
}

/// Where a pixel's numbers begin.
fn start(pictures: &Interleaved, picture: usize, row: usize, column: usize) -> usize {
    (picture * pictures.rows + row) * pictures.row_stride + column * pictures.column_stride
}
