//! The sizes of a convolution.

/// The sizes of a two-dimensional convolution between a large and a small picture:
///
/// `small[o][y][x] = sum_{i, ky, kx} weights[o][i][ky][kx] * large[i][s y + ky - before_y][s x + kx - before_x]`
///
/// with zeros outside the picture. Weights are `[small channels, large channels, kernel, kernel]`: `[out, in, ..]` of a
/// convolution, `[in, out, ..]` of a transposed one.
///
/// | product | convolution | transposed convolution |
/// |---|---|---|
/// | [`Correlation::to_small`](crate::Correlation::to_small) | forward | data gradient |
/// | [`Correlation::to_large`](crate::Correlation::to_large) | data gradient | forward |
/// | [`WeightGradient`](crate::WeightGradient) | weight gradient | weight gradient |
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Geometry {
    /// Channels of the large picture.
    pub large_channels: usize,
    /// Channels of the small picture.
    pub small_channels: usize,
    /// Rows and columns of the kernel.
    pub kernel: usize,
    /// 1 or 2.
    pub stride: usize,
    /// Rows of zeros above and columns of zeros left of the large picture.
    pub before: [usize; 2],
    /// Rows and columns of the large picture.
    pub large: [usize; 2],
    /// Rows and columns of the small picture; zeros below and right of the large picture follow from it.
    pub small: [usize; 2],
}

impl Geometry {
    /// Pixels of the large picture.
    pub const fn large_area(&self) -> usize {
        self.large[0] * self.large[1]
    }

    /// Pixels of the small picture.
    pub const fn small_area(&self) -> usize {
        self.small[0] * self.small[1]
    }

    /// Entries of the kernel.
    pub const fn taps(&self) -> usize {
        self.kernel * self.kernel
    }

    /// Numbers in the weights.
    pub const fn weights(&self) -> usize {
        self.small_channels * self.large_channels * self.taps()
    }

    /// Multiplications and additions of one product for one picture, counting those with padding.
    pub const fn operations(&self) -> usize {
        2 * self.weights() * self.small_area()
    }
}
