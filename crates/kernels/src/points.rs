//! Winograd's minimal filtering: the arithmetic of one dimension.
//!
//! A kernel of `k` taps over `n` input pixels gives `m = n + 1 - k` outputs. Seen as polynomials, outputs are the
//! transpose of a product of polynomials, and a product is known from its values at `n` points (Toom 1963, Cook 1966;
//! for convolutions Winograd 1980, for networks Lavin and Gray 2016). With the points `0`, `±p` for a few `p`, and
//! infinity, and `M(x) = x prod (x^2 - p^2)`:
//!
//! | step | matrix | what |
//! |---|---|---|
//! | [`Points::analyse`] | `B^T` | input pixels: row `q` holds the coefficients of `M(x) / (x - q)`, the last those of `M` |
//! | [`Points::evaluate`] | `V_k` | coefficients to values: row `q` is `1, q, q^2, ..`, the last takes the highest alone |
//! | [`Points::SCALES`] | | kernel values are divided by `M'(q)` |
//! | [`Points::collect`] | `V_m^T` | products of both to outputs |
//!
//! so that `outputs = V_m^T [(SCALES * V_k kernel) * (B^T pixels)]`. Points near one keep rounding small: measured
//! errors are below `2e-6` of the largest output with six points and `1e-5` with eight.

use pulp::Simd;

/// Most points there are.
pub const MAX_POINTS: usize = 8;

/// `PAIRS` points and their negatives, 0 and infinity.
pub struct Points<const PAIRS: usize>;

/// The positive points.
const fn positive<const PAIRS: usize>() -> [f32; PAIRS] {
    let known: [f32; 3] = if PAIRS == 2 { [0.75, 1.5, 0.0] } else { [0.5, 1.0, 1.75] };
    let mut points = [0.0; PAIRS];
    let mut pair = 0;
    while pair < PAIRS {
        points[pair] = known[pair];
        pair += 1;
    }
    points
}

/// Coefficients of `prod (z - p^2)` over all positive points but one, lowest first.
const fn product<const PAIRS: usize>(points: &[f32; PAIRS], without: usize) -> [f32; 4] {
    let (mut coefficients, mut degree, mut pair) = ([1.0, 0.0, 0.0, 0.0], 0, 0);
    while pair < PAIRS {
        if pair != without {
            let square = points[pair] * points[pair];
            degree += 1;
            let mut power = degree;
            while power > 0 {
                coefficients[power] = coefficients[power - 1] - square * coefficients[power];
                power -= 1;
            }
            coefficients[0] *= -square;
        }
        pair += 1;
    }
    coefficients
}

impl<const PAIRS: usize> Points<PAIRS> {
    /// How many points there are.
    pub const COUNT: usize = 2 * PAIRS + 2;
    const POSITIVE: [f32; PAIRS] = positive();
    /// `M(x) / x` in `x^2`.
    const ALL: [f32; 4] = product(&Self::POSITIVE, PAIRS);
    /// `M(x) / (x (x^2 - p^2))` in `x^2`.
    const OTHERS: [[f32; 4]; PAIRS] = {
        let (mut others, mut pair) = ([[0.0; 4]; PAIRS], 0);
        while pair < PAIRS {
            others[pair] = product(&Self::POSITIVE, pair);
            pair += 1;
        }
        others
    };
    /// Powers of the positive points.
    const POWERS: [[f32; MAX_POINTS]; PAIRS] = {
        let (mut powers, mut pair) = ([[1.0; MAX_POINTS]; PAIRS], 0);
        while pair < PAIRS {
            let mut power = 1;
            while power < MAX_POINTS {
                powers[pair][power] = powers[pair][power - 1] * Self::POSITIVE[pair];
                power += 1;
            }
            pair += 1;
        }
        powers
    };
    /// `1 / M'(q)` at each point, 1 at infinity: 0, then each point and its negative, then infinity.
    pub const SCALES: [f32; MAX_POINTS] = {
        let (mut scales, mut pair) = ([1.0; MAX_POINTS], 0);
        scales[0] = 1.0 / Self::ALL[0];
        while pair < PAIRS {
            let square = Self::POSITIVE[pair] * Self::POSITIVE[pair];
            let (mut value, mut power) = (0.0, 4);
            while power > 0 {
                power -= 1;
                value = value * square + Self::OTHERS[pair][power];
            }
            scales[2 * pair + 1] = 1.0 / (2.0 * square * value);
            scales[2 * pair + 2] = scales[2 * pair + 1];
            pair += 1;
        }
        scales
    };

    /// `sum_j coefficients[j] values[first + 2 j]` for `count` terms, the last coefficient being 1.
    #[inline(always)]
    fn every_other<S: Simd>(
        simd: S,
        coefficients: &[f32; 4],
        count: usize,
        values: &[S::f32s; MAX_POINTS],
        first: usize,
    ) -> S::f32s {
        let mut sum = values[first + 2 * (count - 1)];
        for term in 0..count - 1 {
            sum = simd.mul_add_e_f32s(simd.splat_f32s(coefficients[term]), values[first + 2 * term], sum);
        }
        sum
    }

    /// Input pixels at the points.
    #[inline(always)]
    pub fn analyse<S: Simd>(simd: S, pixels: &[S::f32s; MAX_POINTS]) -> [S::f32s; MAX_POINTS] {
        let mut values = [simd.splat_f32s(0.0); MAX_POINTS];
        values[0] = Self::every_other(simd, &Self::ALL, PAIRS + 1, pixels, 0);
        values[2 * PAIRS + 1] = Self::every_other(simd, &Self::ALL, PAIRS + 1, pixels, 1);
        for pair in 0..PAIRS {
            let even = Self::every_other(simd, &Self::OTHERS[pair], PAIRS, pixels, 2);
            let odd = Self::every_other(simd, &Self::OTHERS[pair], PAIRS, pixels, 1);
            let point = Self::POSITIVE[pair];
            values[2 * pair + 1] = simd.mul_add_e_f32s(simd.splat_f32s(point), odd, even);
            values[2 * pair + 2] = simd.mul_add_e_f32s(simd.splat_f32s(-point), odd, even);
        }
        values
    }

    /// The first `count` numbers as coefficients of a polynomial: its values at the points.
    #[inline(always)]
    #[allow(clippy::needless_range_loop, reason = "plain indices are unrolled into registers")]
    pub fn evaluate<S: Simd>(simd: S, coefficients: &[S::f32s; MAX_POINTS], count: usize) -> [S::f32s; MAX_POINTS] {
        let mut values = [simd.splat_f32s(0.0); MAX_POINTS];
        values[0] = coefficients[0];
        values[2 * PAIRS + 1] = coefficients[count - 1];
        for pair in 0..PAIRS {
            let (mut even, mut odd) = (coefficients[0], simd.splat_f32s(0.0));
            for power in 1..count {
                let factor = simd.splat_f32s(Self::POWERS[pair][power]);
                let sum = if power % 2 == 0 { &mut even } else { &mut odd };
                *sum = simd.mul_add_e_f32s(factor, coefficients[power], *sum);
            }
            values[2 * pair + 1] = simd.add_f32s(even, odd);
            values[2 * pair + 2] = simd.sub_f32s(even, odd);
        }
        values
    }

    /// The transpose of [`Self::evaluate`]: the first `count` numbers of the result.
    #[inline(always)]
    #[allow(clippy::needless_range_loop, reason = "plain indices are unrolled into registers")]
    pub fn collect<S: Simd>(simd: S, values: &[S::f32s; MAX_POINTS], count: usize) -> [S::f32s; MAX_POINTS] {
        let mut outputs = [simd.splat_f32s(0.0); MAX_POINTS];
        outputs[0] = values[0];
        for pair in 0..PAIRS {
            let [positive, negative] = [values[2 * pair + 1], values[2 * pair + 2]];
            let (sum, difference) = (simd.add_f32s(positive, negative), simd.sub_f32s(positive, negative));
            outputs[0] = simd.add_f32s(outputs[0], sum);
            for power in 1..count {
                let factor = simd.splat_f32s(Self::POWERS[pair][power]);
                let term = if power % 2 == 0 { sum } else { difference };
                outputs[power] = simd.mul_add_e_f32s(factor, term, outputs[power]);
            }
        }
        outputs[count - 1] = simd.add_f32s(outputs[count - 1], values[2 * PAIRS + 1]);
        outputs
    }
}

/// Numbers of a tile, row by row.
pub type Tile<S> = [[<S as Simd>::f32s; MAX_POINTS]; MAX_POINTS];

/// A tile of zeros.
#[inline(always)]
pub fn empty<S: Simd>(simd: S) -> Tile<S> {
    [[simd.splat_f32s(0.0); MAX_POINTS]; MAX_POINTS]
}

/// The first `rows` numbers of a column of a tile.
#[inline(always)]
#[allow(clippy::needless_range_loop, reason = "plain indices are unrolled into registers")]
pub fn column<S: Simd>(simd: S, tile: &Tile<S>, column: usize, rows: usize) -> [S::f32s; MAX_POINTS] {
    let mut values = [simd.splat_f32s(0.0); MAX_POINTS];
    for row in 0..rows {
        values[row] = tile[row][column];
    }
    values
}

#[cfg(test)]
mod tests;
