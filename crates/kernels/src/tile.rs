//! The innermost loops: a few channels times a few vectors of pixels, summed in registers.
//!
//! A tile keeps `M * N` vectors of sums. Each step loads `N` vectors and multiplies them by `M` single numbers, so
//! that a load feeds `M` multiplications. `M` and `N` are chosen for 32 registers (8 by 3) or 16 (4 by 3).

use pulp::Simd;

/// Most channels of a tile.
pub const MAX_CHANNELS: usize = 8;
/// Most pixels of a tile, whatever the vectors' width.
pub const MAX_PIXELS: usize = 128;

/// Sums of `M` channels by `N` vectors.
pub type Sums<S, const M: usize, const N: usize> = [[<S as Simd>::f32s; N]; M];

/// `N` vectors that begin at `values[at]`.
#[inline(always)]
pub fn load<S: Simd, const N: usize>(simd: S, values: &[f32], at: usize) -> [S::f32s; N] {
    let (vectors, _) = S::as_simd_f32s(&values[at..][..N * S::F32_LANES]);
    let mut loaded = [simd.splat_f32s(0.0); N];
    loaded.copy_from_slice(&vectors[..N]);
    loaded
}

/// Stores a vector where `place` begins.
#[inline(always)]
pub fn store<S: Simd>(place: &mut [f32], vector: S::f32s) {
    let (vectors, _) = S::as_mut_simd_f32s(&mut place[..S::F32_LANES]);
    vectors[0] = vector;
}

/// No sums yet.
#[inline(always)]
pub fn zero<S: Simd, const M: usize, const N: usize>(simd: S) -> Sums<S, M, N> {
    [[simd.splat_f32s(0.0); N]; M]
}

#[inline(always)]
fn add_products<S: Simd, const M: usize, const N: usize>(
    simd: S,
    sums: &mut Sums<S, M, N>,
    factors: &[f32; M],
    vectors: [S::f32s; N],
) {
    for (row, factor) in sums.iter_mut().zip(factors) {
        let factor = simd.splat_f32s(*factor);
        for (sum, vector) in row.iter_mut().zip(vectors) {
            *sum = simd.mul_add_e_f32s(factor, vector, *sum);
        }
    }
}

/// `sums[m][p] = sum_{channel, tap} weights[channel][tap][m] * source[channel * stride + taps[tap] + p]`.
#[inline(always)]
pub fn correlate<S: Simd, const M: usize, const N: usize>(
    simd: S,
    source: &[f32],
    channel_stride: usize,
    taps: &[usize],
    weights: &[[f32; M]],
) -> Sums<S, M, N> {
    let mut sums = zero::<S, M, N>(simd);
    for (channel, weights) in weights.chunks_exact(taps.len().max(1)).enumerate() {
        let plane = &source[channel * channel_stride..];
        for (&tap, weights) in taps.iter().zip(weights) {
            let pixels = load(simd, plane, tap);
            add_products(simd, &mut sums, weights, pixels);
        }
    }
    sums
}

/// `sums[m][p] = sum_channel weights[channel][m] * source[channel][p]`, with `N` vectors in each channel.
#[inline(always)]
pub fn multiply<S: Simd, const M: usize, const N: usize>(
    simd: S,
    source: &[f32],
    weights: &[[f32; M]],
) -> Sums<S, M, N> {
    let mut sums = zero::<S, M, N>(simd);
    for (channel, weights) in source.chunks_exact(N * S::F32_LANES).zip(weights) {
        let pixels = load(simd, channel, 0);
        add_products(simd, &mut sums, weights, pixels);
    }
    sums
}

/// As [`multiply`], with `stride` numbers from the weights of a channel to those of the next, and added to sums that
/// are passed by value because they are to stay in registers.
#[inline(always)]
pub fn add_product<S: Simd, const M: usize, const N: usize>(
    simd: S,
    before: Sums<S, M, N>,
    source: &[f32],
    weights: &[f32],
    stride: usize,
) -> Sums<S, M, N> {
    let mut sums = before;
    for (channel, weights) in source.chunks_exact(N * S::F32_LANES).zip(weights.chunks(stride)) {
        if let Some(weights) = weights.first_chunk::<M>() {
            let pixels = load(simd, channel, 0);
            add_products(simd, &mut sums, weights, pixels);
        }
    }
    sums
}

/// A rectangle of pixels whose channels lie side by side.
#[derive(Clone, Copy)]
pub struct Lines {
    /// Rows of the rectangle.
    pub rows: usize,
    /// Pixels in a row.
    pub columns: usize,
    /// Numbers from a row to the next.
    pub row_stride: usize,
    /// Numbers from a pixel to the next.
    pub column_stride: usize,
}

/// Adds `sum_{row, column} gradients[row][column][m] * source[row * row_stride + column * column_stride + j]` to
/// `sums[m][j]`, which are passed by value because they are to stay in registers.
#[inline(always)]
pub fn add_outer<S: Simd, const M: usize, const N: usize>(
    simd: S,
    before: Sums<S, M, N>,
    source: &[f32],
    lines: Lines,
    gradients: &[[f32; M]],
) -> Sums<S, M, N> {
    let mut sums = before;
    for (row, gradients) in gradients.chunks_exact(lines.columns).take(lines.rows).enumerate() {
        let line = &source[row * lines.row_stride..];
        for (column, gradients) in gradients.iter().enumerate() {
            let vectors = load(simd, line, column * lines.column_stride);
            add_products(simd, &mut sums, gradients, vectors);
        }
    }
    sums
}
