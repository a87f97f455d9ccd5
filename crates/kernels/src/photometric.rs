//! How different two pictures look, per pixel: structural similarity and absolute difference in one pass.
//!
//! `weight (1 - SSIM) / 2 + (1 - weight) |a - b|`, averaged over the channels (Godard et al., CVPR 2017), SSIM over
//! windows of 3 x 3 with mirrored borders (Wang et al., TIP 2004, Eq. 13 with the constants of Eq. 7 and 9). Pictures
//! lie in [-1, 1] and are brought to [0, 1] for SSIM. Windows are sums of three rows and then of three columns; the way
//! back sums the same windows the other way round.

use crate::level::Level;
use rayon::prelude::*;

/// (0.01 L)^2 and (0.03 L)^2 with L = 1, the range of values.
const C1: f32 = 0.01 * 0.01;
const C2: f32 = 0.03 * 0.03;
const NINTH: f32 = 1.0 / 9.0;

/// Two batches of pictures to be compared, `[batch, channels, rows, columns]`.
#[derive(Clone, Copy, Debug)]
pub struct Comparison<'a> {
    /// One of them.
    pub a: &'a [f32],
    /// The other.
    pub b: &'a [f32],
    /// Channels.
    pub channels: usize,
    /// Rows and columns.
    pub size: [usize; 2],
    /// Share of the structural part, 0 to 1.
    pub ssim_weight: f32,
}

/// Means over the windows of a row: of `a`, of `b`, of `a b`, of `a^2 + b^2`.
#[derive(Default)]
struct Windows {
    /// Sums of three rows, with a mirrored column at both ends.
    columns: [Vec<f32>; 4],
    means: [Vec<f32>; 4],
}

/// The row or column on the other side of the border, or the border where there is a single one.
fn mirrored(index: isize, length: usize) -> usize {
    if index < 0 {
        1.min(length - 1)
    } else if index as usize >= length {
        length.saturating_sub(2)
    } else {
        index as usize
    }
}

impl Windows {
    #[inline(always)]
    fn fill(&mut self, [a, b]: [&[f32]; 2], [rows, columns]: [usize; 2], row: usize) {
        for values in &mut self.columns {
            values.clear();
            values.resize(columns + 2, 0.0);
        }
        let [sum_a, sum_b, sum_ab, sum_squares] = &mut self.columns;
        for step in -1..=1 {
            let start = mirrored(row as isize + step, rows) * columns;
            let pixels = a[start..start + columns].iter().zip(&b[start..start + columns]);
            let sums = sum_a[1..].iter_mut().zip(&mut sum_b[1..]).zip(&mut sum_ab[1..]).zip(&mut sum_squares[1..]);
            for ((((sum_a, sum_b), sum_ab), sum_squares), (a, b)) in sums.zip(pixels) {
                let (a, b) = (0.5 * a + 0.5, 0.5 * b + 0.5);
                *sum_a += a;
                *sum_b += b;
                *sum_ab += a * b;
                *sum_squares += a * a + b * b;
            }
        }
        for (values, means) in self.columns.iter_mut().zip(&mut self.means) {
            values[0] = values[1 + mirrored(-1, columns)];
            values[columns + 1] = values[1 + mirrored(columns as isize, columns)];
            means.clear();
            means.extend(values.windows(3).map(|window| (window[0] + window[1] + window[2]) * NINTH));
        }
    }
}

/// The quantities SSIM is made of at one window.
struct Similarity {
    numerators: [f32; 2],
    denominators: [f32; 2],
}

impl Similarity {
    #[inline(always)]
    fn new(a: f32, b: f32, ab: f32, squares: f32) -> Self {
        let (product, of_squares) = (a * b, a * a + b * b);
        Self {
            numerators: [2.0 * product + C1, 2.0 * (ab - product) + C2],
            denominators: [of_squares + C1, squares - of_squares + C2],
        }
    }

    #[inline(always)]
    fn value(&self) -> f32 {
        (self.numerators[0] * self.numerators[1]) / (self.denominators[0] * self.denominators[1])
    }

    /// Derivatives by the means of `b`, of `a b` and of `a^2 + b^2`.
    #[inline(always)]
    fn slopes(&self, a: f32, b: f32) -> [f32; 3] {
        let ([n1, n2], [d1, d2]) = (self.numerators, self.denominators);
        let (below, value) = (1.0 / (d1 * d2), self.value());
        [2.0 * a * (n2 - n1) * below - 2.0 * b * value * (1.0 / d1 - 1.0 / d2), 2.0 * n1 * below, -value / d2]
    }
}

impl Comparison<'_> {
    /// The error of each pixel, `[batch, 1, rows, columns]`.
    ///
    /// # Panics
    /// If lengths do not fit together.
    pub fn error(&self) -> Vec<f32> {
        let area = self.area();
        let mut errors = vec![0.0; self.a.len() / self.channels];
        let pictures = errors.par_chunks_mut(area).enumerate();
        pictures.for_each(|(picture, errors)| {
            // A dozen rows are a sensible piece of work.
            errors.par_chunks_mut(self.size[1] * 12).enumerate().for_each(|(piece, errors)| {
                Level::default().run(
                    #[inline(always)]
                    || self.error_of_rows(picture, piece * 12, errors),
                );
            });
        });
        errors
    }

    #[inline(always)]
    fn error_of_rows(&self, picture: usize, first: usize, errors: &mut [f32]) {
        let columns = self.size[1];
        let per_channel = 1.0 / self.channels as f32;
        let (structural, absolute) = (0.5 * self.ssim_weight * per_channel, (1.0 - self.ssim_weight) * per_channel);
        let mut windows = Windows::default();
        for channel in 0..self.channels {
            let [a, b] = self.planes(picture * self.channels + channel);
            for (row, errors) in errors.chunks_exact_mut(columns).enumerate() {
                let start = (first + row) * columns;
                let pixels = a[start..start + columns].iter().zip(&b[start..start + columns]);
                errors.iter_mut().zip(pixels).for_each(|(error, (a, b))| *error += absolute * (a - b).abs());
                if self.ssim_weight == 0.0 {
                    continue;
                }
                windows.fill([a, b], self.size, first + row);
                let [a, b, ab, squares] = &windows.means;
                for ((((error, a), b), ab), squares) in errors.iter_mut().zip(a).zip(b).zip(ab).zip(squares) {
                    *error += structural * (1.0 - Similarity::new(*a, *b, *ab, *squares).value());
                }
            }
        }
    }

    /// The gradient of `b`, shaped like it, from that of the errors.
    ///
    /// The error is symmetric: swap the pictures for the gradient of `a`.
    ///
    /// # Panics
    /// If lengths do not fit together.
    pub fn gradient(&self, gradient: &[f32]) -> Vec<f32> {
        assert_eq!(gradient.len() * self.channels, self.b.len());
        let area = self.area();
        let mut gradients = vec![0.0; self.b.len()];
        gradients.par_chunks_mut(area).enumerate().for_each(|(plane, gradients)| {
            let of_errors = &gradient[plane / self.channels * area..][..area];
            Level::default().run(
                #[inline(always)]
                || self.gradient_of_plane(plane, of_errors, gradients),
            );
        });
        gradients
    }

    #[inline(always)]
    fn gradient_of_plane(&self, plane: usize, of_errors: &[f32], gradients: &mut [f32]) {
        let [a, b] = self.planes(plane);
        let per_channel = 1.0 / self.channels as f32;
        let absolute = (1.0 - self.ssim_weight) * per_channel;
        let pixels = a.iter().zip(b).zip(of_errors);
        for (gradient, ((a, b), of_error)) in gradients.iter_mut().zip(pixels) {
            let sign = if b > a {
                1.0
            } else if b < a {
                -1.0
            } else {
                0.0
            };
            *gradient = absolute * sign * of_error;
        }
        if self.ssim_weight == 0.0 {
            return;
        }
        let slopes = self.slopes_of_plane([a, b], of_errors).map(|map| spread(map, self.size));
        let [of_mean, of_product, of_squares] = &slopes;
        let slopes = of_mean.iter().zip(of_product).zip(of_squares);
        for ((gradient, (a, b)), ((mean, product), squares)) in gradients.iter_mut().zip(a.iter().zip(b)).zip(slopes) {
            let (a, b) = (0.5 * a + 0.5, 0.5 * b + 0.5);
            *gradient += 0.5 * NINTH * (mean + a * product + 2.0 * b * squares);
        }
    }

    /// Derivatives of the whole by the means of each window: of `b`, of `a b` and of `a^2 + b^2`.
    #[inline(always)]
    fn slopes_of_plane(&self, planes: [&[f32]; 2], of_errors: &[f32]) -> [Vec<f32>; 3] {
        let columns = self.size[1];
        let factor = -0.5 * self.ssim_weight / self.channels as f32;
        let mut maps = [(); 3].map(|()| vec![0.0; of_errors.len()]);
        let [of_mean, of_product, of_squares] = &mut maps;
        let mut windows = Windows::default();
        for (row, of_errors) in of_errors.chunks_exact(columns).enumerate() {
            windows.fill(planes, self.size, row);
            let start = row * columns;
            let outputs = of_mean[start..].iter_mut().zip(&mut of_product[start..]).zip(&mut of_squares[start..]);
            let [a, b, ab, squares] = &windows.means;
            let inputs = a.iter().zip(b).zip(ab).zip(squares).zip(of_errors);
            for (((of_mean, of_product), of_squares), ((((a, b), ab), squares), of_error)) in outputs.zip(inputs) {
                let slopes = Similarity::new(*a, *b, *ab, *squares).slopes(*a, *b);
                [*of_mean, *of_product, *of_squares] = slopes.map(|slope| factor * of_error * slope);
            }
        }
        maps
    }

    fn area(&self) -> usize {
        assert_eq!(self.a.len(), self.b.len());
        self.size[0] * self.size[1]
    }

    fn planes(&self, index: usize) -> [&[f32]; 2] {
        let area = self.size[0] * self.size[1];
        [self.a, self.b].map(|pictures| &pictures[index * area..][..area])
    }
}

/// For each pixel, the sum over the windows it is part of, as often as it is part of them.
#[inline(always)]
fn spread(map: Vec<f32>, [rows, columns]: [usize; 2]) -> Vec<f32> {
    let mut along = vec![0.0; map.len()];
    for (from, to) in map.chunks_exact(columns).zip(along.chunks_exact_mut(columns)) {
        add_shifted(to, from);
        to[mirrored(-1, columns)] += from[0];
        to[mirrored(columns as isize, columns)] += from[columns - 1];
    }
    let mut across = map;
    across.copy_from_slice(&along);
    for row in 0..rows {
        let from = &along[row * columns..][..columns];
        for step in [-1, 1] {
            let place = mirrored(row as isize + step, rows);
            let to = &mut across[place * columns..][..columns];
            to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
        }
    }
    across
}

/// Each number with its neighbours.
#[inline(always)]
fn add_shifted(to: &mut [f32], from: &[f32]) {
    to.copy_from_slice(from);
    to[1..].iter_mut().zip(from).for_each(|(to, from)| *to += from);
    to.iter_mut().zip(&from[1..]).for_each(|(to, from)| *to += from);
}
