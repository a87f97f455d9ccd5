//! Pictures of twice the size, and the gradients of that.

use rayon::prelude::*;

/// Doubles planes bilinearly and cuts them to a size: pixel areas are aligned, so that a pixel's two halves lie a
/// quarter of it to the left and right of its centre; beyond the border the border repeats.
///
/// # Shapes
/// - `planes`: `[count, rows, columns]`
/// - `enlarged`: `[count, new rows, new columns]`, at most twice as many; all of it is written
pub fn enlarge(planes: &[f32], [rows, columns]: [usize; 2], enlarged: &mut [f32], size: [usize; 2]) {
    let planes = planes.par_chunks_exact(rows * columns);
    planes.zip(enlarged.par_chunks_exact_mut(size[0] * size[1])).for_each(|(plane, enlarged)| {
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
    });
}

/// The gradient of the planes from that of the enlarged ones.
///
/// # Shapes
/// - `of_enlarged`: `[count, new rows, new columns]`
/// - `of_planes`: `[count, rows, columns]`; all of it is written
pub fn enlarge_gradient(of_enlarged: &[f32], size: [usize; 2], of_planes: &mut [f32], [rows, columns]: [usize; 2]) {
    let planes = of_planes.par_chunks_exact_mut(rows * columns);
    planes.zip(of_enlarged.par_chunks_exact(size[0] * size[1])).for_each(|(plane, of_enlarged)| {
        plane.fill(0.0);
        let mut of_line = vec![0.0; columns];
        for (y, enlarged) in of_enlarged.chunks_exact(size[1]).enumerate() {
            of_line.fill(0.0);
            for (x, value) in enlarged.iter().enumerate() {
                let (near, far) = neighbours(x, columns);
                of_line[near] += 0.75 * value;
                of_line[far] += 0.25 * value;
            }
            let (near, far) = neighbours(y, rows);
            for (row, share) in [(near, 0.75), (far, 0.25)] {
                let line = plane[row * columns..].iter_mut();
                line.zip(&of_line).for_each(|(to, from)| *to += share * from);
            }
        }
    });
}

/// The old pixel that covers a new one, and the one on the other side of the new one's centre.
fn neighbours(new: usize, length: usize) -> (usize, usize) {
    let near = new / 2;
    let far = if new.is_multiple_of(2) { near.saturating_sub(1) } else { (near + 1).min(length - 1) };
    (near, far)
}

/// The matrix that enlarges a line bilinearly, `scale` new numbers for each old one: pixel areas are aligned, so that new
/// number `i` lies at `(i + 0.5) / scale - 0.5`; beyond the border the border repeats.
///
/// # Shapes
/// - returns: `[to, from]`
pub fn interpolation(from: usize, to: usize, scale: f64) -> Vec<f64> {
    let mut matrix = vec![0.0; to * from];
    for (i, line) in matrix.chunks_exact_mut(from.max(1)).enumerate() {
        let place = ((i as f64 + 0.5) / scale - 0.5).clamp(0.0, (from - 1) as f64);
        let low = place.floor() as usize;
        line[low] += 1.0 - place.fract();
        line[(low + 1).min(from - 1)] += place.fract();
    }
    matrix
}
