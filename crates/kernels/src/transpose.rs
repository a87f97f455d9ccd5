//! Matrices turned over.

/// Rows and columns that are turned over at once, in registers.
pub const BLOCK: usize = 8;
/// Columns whose rows are all turned over before the next ones: those of whole cache lines, which are then read once.
const STRIP: usize = 16;

/// `to[column * to_stride + row] = from[row * from_stride + column]` for `rows` rows of `columns` numbers.
pub fn transpose(from: &[f32], from_stride: usize, [rows, columns]: [usize; 2], to: &mut [f32], to_stride: usize) {
    for strip in (0..columns).step_by(STRIP) {
        let strip = strip..(strip + STRIP).min(columns);
        for row in (0..rows).step_by(BLOCK) {
            let height = BLOCK.min(rows - row);
            for column in strip.clone().step_by(BLOCK) {
                let width = BLOCK.min(strip.end - column);
                let from = &from[row * from_stride + column..];
                let to = &mut to[column * to_stride + row..];
                block(from, from_stride, [height, width], to, to_stride);
            }
        }
    }
}

#[inline]
fn block(from: &[f32], from_stride: usize, [height, width]: [usize; 2], to: &mut [f32], to_stride: usize) {
    if height == BLOCK && width == BLOCK {
        return whole_block(from, from_stride, to, to_stride);
    }
    for (row, column) in (0..height * width).map(|index| (index / width, index % width)) {
        to[column * to_stride + row] = from[row * from_stride + column];
    }
}

#[inline]
fn whole_block(from: &[f32], from_stride: usize, to: &mut [f32], to_stride: usize) {
    let mut block = [[0.0; BLOCK]; BLOCK];
    for (row, line) in block.iter_mut().enumerate() {
        line.copy_from_slice(&from[row * from_stride..][..BLOCK]);
    }
    for column in 0..BLOCK {
        let line = block.map(|line| line[column]);
        to[column * to_stride..][..BLOCK].copy_from_slice(&line);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_finds_its_place() {
        for [rows, columns] in [[1, 1], [3, 20], [8, 8], [9, 17], [16, 24]] {
            let (from_stride, to_stride) = (columns + 3, rows + 2);
            let from: Vec<f32> = (0..rows * from_stride).map(|index| index as f32).collect();
            let mut to = vec![-1.0; columns * to_stride];
            transpose(&from, from_stride, [rows, columns], &mut to, to_stride);
            for (index, value) in to.iter().enumerate() {
                let (column, row) = (index / to_stride, index % to_stride);
                let expected = if row < rows { (row * from_stride + column) as f32 } else { -1.0 };
                assert_eq!(*value, expected, "row {row}, column {column} of {rows}x{columns}");
            }
        }
    }
}
