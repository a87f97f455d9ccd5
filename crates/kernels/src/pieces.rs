//! Pictures cut into pieces for the threads.

/// Pixels of a piece.
pub const PIECE: usize = 2048;

/// The same pixels of several planes of a picture.
pub struct Piece<'a, const N: usize> {
    /// Which picture.
    pub picture: usize,
    /// The first of the pixels.
    pub first: usize,
    /// The pixels of each plane.
    pub planes: [&'a mut [f32]; N],
}

/// Cuts a picture's planes, which are of one length, into pieces in their order.
pub fn pieces<const N: usize>(picture: usize, planes: [&mut [f32]; N]) -> impl Iterator<Item = Piece<'_, N>> {
    let length = planes.first().map_or(0, |plane| plane.len());
    let mut chunks = planes.map(|plane| plane.chunks_mut(PIECE));
    (0..length).step_by(PIECE).map(move |first| {
        let planes = chunks.each_mut().map(|chunks| chunks.next().unwrap_or_default());
        Piece { picture, first, planes }
    })
}

/// The sum of products, in several lanes, which vectors can compute and which lose fewer digits than one lane.
#[inline(always)]
pub fn dot(a: &[f32], b: &[f32]) -> f32 {
    let ((a, rest_a), (b, rest_b)) = (a.as_chunks::<16>(), b.as_chunks::<16>());
    let mut sums = [0.0_f32; 16];
    for (a, b) in a.iter().zip(b) {
        for lane in 0..16 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    let rest: f32 = rest_a.iter().zip(rest_b).map(|(a, b)| a * b).sum();
    sums.iter().sum::<f32>() + rest
}

/// The sum, in several lanes.
#[inline(always)]
pub fn sum(values: &[f32]) -> f32 {
    let (lanes, rest) = values.as_chunks::<16>();
    let mut sums = [0.0_f32; 16];
    for values in lanes {
        sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
    }
    sums.iter().chain(rest).sum()
}
