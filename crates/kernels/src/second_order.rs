//! How much a map bends, with derivatives.

use crate::level::Level;
use crate::pieces::sum;
use rayon::prelude::*;

/// `mean |d_xx| + 2 mean |d_xy| + mean |d_yy|` of maps, each the mean over the places where the difference exists; zero
/// where it exists nowhere.
#[derive(Clone, Copy, Debug)]
pub struct SecondOrder<'a> {
    /// `[count, rows, columns]`.
    pub maps: &'a [f32],
    /// Rows and columns.
    pub size: [usize; 2],
}

impl SecondOrder<'_> {
    /// The sum of the three means.
    pub fn value(&self) -> f32 {
        let maps = self.maps.par_chunks(self.area()).map(|map| {
            Level::default().run(
                #[inline(always)]
                || self.value_of_map(map),
            )
        });
        maps.collect::<Vec<f32>>().into_iter().sum()
    }

    /// The gradient of the maps from that of the value.
    pub fn gradient(&self, of_value: f32) -> Vec<f32> {
        let mut gradient = vec![0.0; self.maps.len()];
        let maps = gradient.par_chunks_mut(self.area()).zip(self.maps.par_chunks(self.area()));
        maps.for_each(|(gradient, map)| {
            Level::default().run(
                #[inline(always)]
                || self.gradient_of_map(map, of_value, gradient),
            );
        });
        gradient
    }

    fn area(&self) -> usize {
        (self.size[0] * self.size[1]).max(1)
    }

    /// What `|d_xx|`, `|d_xy|` and `|d_yy|` of a place count.
    fn weights(&self) -> [f32; 3] {
        let ([rows, columns], count) = (self.size, self.maps.len() / self.area());
        let less = |length: usize, by: usize| length.saturating_sub(by);
        let weight = |places: usize, times: f32| times / (count * places).max(1) as f32;
        [
            weight(rows * less(columns, 2), 1.0),
            weight(less(rows, 1) * less(columns, 1), 2.0),
            weight(less(rows, 2) * columns, 1.0),
        ]
    }

    #[inline(always)]
    fn value_of_map(&self, map: &[f32]) -> f32 {
        let columns = self.size[1];
        let [along, mixed, across] = self.weights();
        let mut differences = vec![0.0; columns];
        let mut total = 0.0;
        for start in (0..map.len()).step_by(columns.max(1)) {
            let rows = &map[start..];
            total += along * magnitude(d_xx(rows, columns, &mut differences));
            total += mixed * magnitude(d_xy(rows, columns, &mut differences));
            total += across * magnitude(d_yy(rows, columns, &mut differences));
        }
        total
    }

    #[inline(always)]
    fn gradient_of_map(&self, map: &[f32], of_value: f32, gradient: &mut [f32]) {
        let columns = self.size[1];
        let [along, mixed, across] = self.weights().map(|weight| of_value * weight);
        let mut differences = vec![0.0; columns];
        for start in (0..map.len()).step_by(columns.max(1)) {
            let (rows, gradient) = (&map[start..], &mut gradient[start..]);
            let signs = signed(d_xx(rows, columns, &mut differences), along);
            add(gradient, signs, &[(0, 1.0), (1, -2.0), (2, 1.0)]);
            let signs = signed(d_xy(rows, columns, &mut differences), mixed);
            add(gradient, signs, &[(0, 1.0), (1, -1.0), (columns, -1.0), (columns + 1, 1.0)]);
            let signs = signed(d_yy(rows, columns, &mut differences), across);
            add(gradient, signs, &[(0, 1.0), (columns, -2.0), (2 * columns, 1.0)]);
        }
    }
}

/// Second differences along the first of `rows`; none where the map ends.
#[inline(always)]
fn d_xx<'a>(rows: &[f32], columns: usize, differences: &'a mut [f32]) -> &'a mut [f32] {
    let differences = &mut differences[..columns.saturating_sub(2)];
    for (x, difference) in differences.iter_mut().enumerate() {
        *difference = (rows[x + 2] - rows[x + 1]) - (rows[x + 1] - rows[x]);
    }
    differences
}

/// Differences down of differences along, between the first two of `rows`; none where the map ends.
#[inline(always)]
fn d_xy<'a>(rows: &[f32], columns: usize, differences: &'a mut [f32]) -> &'a mut [f32] {
    let count = if rows.len() < 2 * columns { 0 } else { columns.saturating_sub(1) };
    let differences = &mut differences[..count];
    let (first, second) = rows.split_at(columns);
    for (x, difference) in differences.iter_mut().enumerate() {
        *difference = (second[x + 1] - second[x]) - (first[x + 1] - first[x]);
    }
    differences
}

/// Second differences down, over the first three of `rows`; none where the map ends.
#[inline(always)]
fn d_yy<'a>(rows: &[f32], columns: usize, differences: &'a mut [f32]) -> &'a mut [f32] {
    let count = if rows.len() < 3 * columns { 0 } else { columns };
    let differences = &mut differences[..count];
    let (first, others) = rows.split_at(columns);
    for (x, difference) in differences.iter_mut().enumerate() {
        *difference = (others[columns + x] - others[x]) - (others[x] - first[x]);
    }
    differences
}

/// The sum of absolute values.
#[inline(always)]
fn magnitude(differences: &mut [f32]) -> f32 {
    differences.iter_mut().for_each(|difference| *difference = difference.abs());
    sum(differences)
}

/// `weight` with the sign of each difference, 0 for 0.
#[inline(always)]
fn signed(differences: &mut [f32], weight: f32) -> &[f32] {
    for difference in differences.iter_mut() {
        let sign = |holds: bool| if holds { weight } else { 0.0 };
        *difference = sign(*difference > 0.0) - sign(*difference < 0.0);
    }
    differences
}

/// Adds multiples of `values`, each beginning at a place of its own.
#[inline(always)]
fn add(to: &mut [f32], values: &[f32], multiples: &[(usize, f32)]) {
    if values.is_empty() {
        return;
    }
    for (place, times) in multiples {
        to[*place..].iter_mut().zip(values).for_each(|(to, value)| *to += times * value);
    }
}
