//! Pictures of twice the size.

/// Doubles planes bilinearly and cuts them to a size: pixel areas are aligned, so that a pixel's two halves lie a
/// quarter of it to the left and right of its centre; beyond the border the border repeats.
///
/// # Shapes
/// - `planes`: `[count, rows, columns]`
/// - `enlarged`: `[count, new rows, new columns]`, at most twice as many; all of it is written
pub fn enlarge(planes: &[f32], [rows, columns]: [usize; 2], enlarged: &mut [f32], size: [usize; 2]) {
    let planes = planes.chunks_exact(rows * columns);
    for (plane, enlarged) in planes.zip(enlarged.chunks_exact_mut(size[0] * size[1])) {
        for (y, line) in enlarged.chunks_exact_mut(size[1]).enumerate() {
            let (near, far) = neighbours(y, rows);
            let row = |row: usize| &plane[row * columns..][..columns];
            let (near, far) = (row(near), row(far));
            let mixed = |x: usize| 0.75 * near[x] + 0.25 * far[x];
            for (x, value) in line.iter_mut().enumerate() {
                let (near, far) = neighbours(x, columns);
                *value = 0.75 * mixed(near) + 0.25 * mixed(far);
            }
        }
    }
}

/// The old pixel that covers a new one, and the one on the other side of the new one's centre.
fn neighbours(new: usize, length: usize) -> (usize, usize) {
    let near = new / 2;
    let far = if new.is_multiple_of(2) { near.saturating_sub(1) } else { (near + 1).min(length - 1) };
    (near, far)
}
