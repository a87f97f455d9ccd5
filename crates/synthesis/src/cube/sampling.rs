//! Reading a picture between its pixels: one unit of the device per position, which visits all channels.
//!
//! The counterpart of `endoscape_kernels::Sampling`: positions beyond the outermost pixel centres take the border's
//! value and have no gradient; one that is not a number gives a colour that is none. Whatever the position, indices stay
//! inside the picture.

use super::maps::{CubeTensor, Pixel, Units, index, own_pixel, pixels, unwritten, write};
use burn::backend::TensorMetadata;
use burn::cubecl;
use cubecl::prelude::*;

/// The colours at positions.
///
/// # Shapes
/// - `pictures`: `[batch, channels, height, width]`
/// - `positions`: `[batch, 2, rows, columns]`: column, then row
/// - returns: `[batch, channels, rows, columns]`
pub fn read(pictures: CubeTensor, positions: CubeTensor) -> CubeTensor {
    let ([batch, channels, _, _], [_, _, rows, columns]) = (pictures.shape().dims(), positions.shape().dims());
    let colours = unwritten(&positions, [batch, channels, rows, columns]);
    let units = Units::new(&positions, &[&pictures, &colours]);
    read_kernel::launch(
        &colours.client,
        units.count,
        units.dim,
        units.address,
        pictures.into_tensor_arg(),
        positions.into_tensor_arg(),
        colours.clone().into_tensor_arg(),
    );
    colours
}

/// The gradient of the positions, shaped like them, from that of the colours.
pub fn position_gradient(pictures: CubeTensor, positions: CubeTensor, of_colours: CubeTensor) -> CubeTensor {
    let of_positions = unwritten(&positions, positions.shape().dims());
    let units = Units::new(&positions, &[&pictures, &of_colours]);
    position_gradient_kernel::launch(
        &of_positions.client,
        units.count,
        units.dim,
        units.address,
        pictures.into_tensor_arg(),
        positions.into_tensor_arg(),
        of_colours.into_tensor_arg(),
        of_positions.clone().into_tensor_arg(),
    );
    of_positions
}

#[cube(launch, address_type = "dynamic")]
fn read_kernel(pictures: &Tensor<f32>, positions: &Tensor<f32>, colours: &mut Tensor<f32>) {
    if ABSOLUTE_POS >= pixels(positions) {
        terminate!();
    }
    let pixel = own_pixel(positions);
    let cell = enclose(pictures, positions, pixel);
    for channel in 0..pictures.shape(1) {
        let corners = corners(pictures, channel, pixel.item, cell);
        let upper = corners.a + (corners.b - corners.a) * cell.across.share;
        let lower = corners.c + (corners.d - corners.c) * cell.across.share;
        write(colours, channel, pixel, upper + (lower - upper) * cell.down.share);
    }
}

#[cube(launch, address_type = "dynamic")]
fn position_gradient_kernel(
    pictures: &Tensor<f32>,
    positions: &Tensor<f32>,
    of_colours: &Tensor<f32>,
    of_positions: &mut Tensor<f32>,
) {
    if ABSOLUTE_POS >= pixels(positions) {
        terminate!();
    }
    let pixel = own_pixel(positions);
    let cell = enclose(pictures, positions, pixel);
    let mut of_column = 0.0f32;
    let mut of_row = 0.0f32;
    for channel in 0..pictures.shape(1) {
        let Corners { a, b, c, d } = corners(pictures, channel, pixel.item, cell);
        let of_colour = of_colours[index(of_colours, channel, pixel)];
        of_column += of_colour * ((b - a) * (1.0 - cell.down.share) + (d - c) * cell.down.share);
        of_row += of_colour * ((c - a) * (1.0 - cell.across.share) + (d - b) * cell.across.share);
    }
    write(of_positions, 0, pixel, select(cell.across.free, of_column, 0.0));
    write(of_positions, 1, pixel, select(cell.down.free, of_row, 0.0));
}

/// The four pixels around a position.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Cell {
    across: Pair,
    down: Pair,
}

/// The two pixels that enclose a coordinate along an axis.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Pair {
    first: usize,
    second: usize,
    /// Share of the second.
    share: f32,
    /// Whether moving the coordinate changes anything.
    free: bool,
}

/// Where in its picture the position of `pixel` lies.
#[cube]
fn enclose(pictures: &Tensor<f32>, positions: &Tensor<f32>, pixel: Pixel) -> Cell {
    Cell {
        across: pair(positions[index(positions, 0, pixel)], pictures.shape(3)),
        down: pair(positions[index(positions, 1, pixel)], pictures.shape(2)),
    }
}

/// The pair around a coordinate on an axis of `length` pixels. An axis of one pixel has no second: it is the first
/// again, and its share 0.
#[cube]
fn pair(coordinate: f32, length: usize) -> Pair {
    let last = f32::cast_from(length - 1);
    let clamped = clamp_nan(coordinate, 0.0f32, last);
    // Nothing is negative here, so cutting off the fraction rounds down.
    let first = min(usize::cast_from(clamped), max(length, 2) - 2);
    Pair {
        first,
        second: min(first + 1, length - 1),
        share: clamped - f32::cast_from(first),
        free: coordinate >= 0.0 && coordinate <= last,
    }
}

/// The colours of a cell: of its upper left, upper right, lower left and lower right pixel.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Corners {
    a: f32,
    b: f32,
    c: f32,
    d: f32,
}

/// The colours of a cell in a channel.
#[cube]
fn corners(pictures: &Tensor<f32>, channel: usize, item: usize, cell: Cell) -> Corners {
    Corners {
        a: colour(pictures, channel, item, cell.down.first, cell.across.first),
        b: colour(pictures, channel, item, cell.down.first, cell.across.second),
        c: colour(pictures, channel, item, cell.down.second, cell.across.first),
        d: colour(pictures, channel, item, cell.down.second, cell.across.second),
    }
}

#[cube]
fn colour(pictures: &Tensor<f32>, channel: usize, item: usize, row: usize, column: usize) -> f32 {
    pictures[index(pictures, channel, Pixel { item, row, column })]
}
