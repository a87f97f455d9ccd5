//! What a product computes, whichever way it does.

use crate::geometry::Geometry;

/// A product as sums over taps: at every position of a grid, `spread * spread` output pixels.
#[derive(Clone, Debug)]
pub struct Shape {
    pub geometry: Geometry,
    towards_large: bool,
    /// Channels of the input, its rows and columns, and the zeros before them.
    pub inputs: usize,
    pub from: [usize; 2],
    pub before: [usize; 2],
    /// Input pixels from a position to the next in each direction: 1, or 2 from the large picture of a stride of 2.
    pub step: usize,
    /// Channels of the output, and its rows and columns.
    pub outputs: usize,
    pub size: [usize; 2],
    /// Output pixels per position and direction: 1, or 2 towards the large picture of a stride of 2.
    pub spread: usize,
    /// Positions: rows and columns.
    pub grid: [usize; 2],
    /// For each of the output pixels of a position, which taps it sees.
    pub passes: Vec<Vec<Tap>>,
}

/// A tap: its place in the kernel, and the pixel of the padded input it sees from the first position.
#[derive(Clone, Copy, Debug)]
pub struct Tap {
    pub index: usize,
    pub row: usize,
    pub column: usize,
}

impl Shape {
    /// From the large to the small picture.
    pub fn to_small(geometry: &Geometry) -> Self {
        let Geometry { kernel, stride, before, large, small, large_channels, small_channels } = *geometry;
        let tap = |index: usize| Tap { index, row: index / kernel, column: index % kernel };
        Self {
            geometry: *geometry,
            towards_large: false,
            inputs: large_channels,
            from: large,
            before,
            step: stride,
            outputs: small_channels,
            size: small,
            spread: 1,
            grid: small,
            passes: vec![(0..geometry.taps()).map(tap).collect()],
        }
    }

    /// From the small to the large picture.
    pub fn to_large(geometry: &Geometry) -> Self {
        let Geometry { kernel, stride, before, large, small, large_channels, small_channels } = *geometry;
        // `large[s q + r]` sees `small[q + d]` through the tap `r + before - s d`.
        let lowest = before.map(|before| (kernel - 1).saturating_sub(before).div_ceil(stride));
        let step = |axis: usize, phase: usize, tap: usize| {
            let ahead = (phase + before[axis] + stride * lowest[axis]).checked_sub(tap)?;
            ahead.is_multiple_of(stride).then_some(ahead / stride)
        };
        let tap = |phase: [usize; 2], index: usize| {
            let (row, column) = (step(0, phase[0], index / kernel)?, step(1, phase[1], index % kernel)?);
            Some(Tap { index, row, column })
        };
        let seen = |pass: usize| {
            let phase = [pass / stride, pass % stride];
            (0..geometry.taps()).filter_map(|index| tap(phase, index)).collect()
        };
        Self {
            geometry: *geometry,
            towards_large: true,
            inputs: small_channels,
            from: small,
            before: lowest,
            step: 1,
            outputs: large_channels,
            size: large,
            spread: stride,
            grid: large.map(|length| length.div_ceil(stride)),
            passes: (0..stride * stride).map(seen).collect(),
        }
    }

    /// How many rows and columns of positions a position sees beyond itself.
    pub fn reach(&self) -> [usize; 2] {
        let farthest = |steps: fn(&Tap) -> usize| self.passes.iter().flatten().map(steps).max().unwrap_or(0);
        [farthest(|tap| tap.row), farthest(|tap| tap.column)].map(|pixels| pixels / self.step)
    }

    /// Index of a weight.
    pub fn weight(&self, output: usize, input: usize, tap: usize) -> usize {
        let large = self.geometry.large_channels;
        let pair = if self.towards_large { input * large + output } else { output * large + input };
        pair * self.geometry.taps() + tap
    }

    /// Numbers of a picture that comes in.
    pub fn input_length(&self) -> usize {
        self.inputs * self.from[0] * self.from[1]
    }

    /// Numbers of a picture that goes out.
    pub fn output_length(&self) -> usize {
        self.outputs * self.size[0] * self.size[1]
    }
}
