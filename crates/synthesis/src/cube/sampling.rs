//! Reading a picture between its pixels: one unit of the device per position, which visits all channels.
//!
//! The counterpart of `endoscape_kernels::Sampling`: positions beyond the outermost pixel centres take the border's
//! value and have no gradient; one that is not a number gives a colour that is none. Whatever the position, indices
//! stay inside the picture. The gradient of the positions is a gather. That of the picture is a scatter, in which units
//! add to the same pixel in whatever order they come: its last digits may differ from one run to the next.

use super::maps::{CubeTensor, Pixel, Units, index, own_pixel, pixels, unwritten, write};
use burn::backend::ops::FloatTensorOps;
use burn::backend::{Cube, TensorMetadata};
use burn::cubecl;
use burn::tensor::FloatDType;
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

/// The gradient of the pictures, shaped like them, from that of the colours.
pub fn picture_gradient(pictures: &CubeTensor, positions: CubeTensor, of_colours: CubeTensor) -> CubeTensor {
    let of_pictures = Cube::float_zeros(pictures.shape(), &pictures.device, FloatDType::F32);
    let units = Units::new(&positions, &[&of_colours, &of_pictures]);
    picture_gradient_kernel::launch(
        &of_pictures.client,
        units.count,
        units.dim,
        units.address,
        positions.into_tensor_arg(),
        of_colours.into_tensor_arg(),
        of_pictures.clone().into_tensor_arg(),
    );
    of_pictures
}

#[cube(launch, address_type = "dynamic")]
fn read_kernel(pictures: &Tensor<f32>, positions: &Tensor<f32>, colours: &mut Tensor<f32>) {
    if ABSOLUTE_POS >= pixels(positions) {
        terminate!();
    }
    let pixel = own_pixel(positions);
    let cell = enclose(positions, pixel, pictures.shape(2), pictures.shape(3));
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
    let cell = enclose(positions, pixel, pictures.shape(2), pictures.shape(3));
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

/// Pictures are numbers of single precision as their bits: not every device adds numbers themselves atomically.
#[cube(launch, address_type = "dynamic")]
fn picture_gradient_kernel(positions: &Tensor<f32>, of_colours: &Tensor<f32>, of_pictures: &mut Tensor<Atomic<u32>>) {
    if ABSOLUTE_POS >= pixels(positions) {
        terminate!();
    }
    let pixel = own_pixel(positions);
    let cell = enclose(positions, pixel, of_pictures.shape(2), of_pictures.shape(3));
    for channel in 0..of_pictures.shape(1) {
        let of_colour = of_colours[index(of_colours, channel, pixel)];
        let lower = of_colour * cell.down.share;
        let upper = of_colour - lower;
        let right_of_upper = upper * cell.across.share;
        let right_of_lower = lower * cell.across.share;
        let (item, top, bottom) = (pixel.item, cell.down.first, cell.down.second);
        add(of_pictures, channel, Pixel { item, row: top, column: cell.across.first }, upper - right_of_upper);
        add(of_pictures, channel, Pixel { item, row: top, column: cell.across.second }, right_of_upper);
        add(of_pictures, channel, Pixel { item, row: bottom, column: cell.across.first }, lower - right_of_lower);
        add(of_pictures, channel, Pixel { item, row: bottom, column: cell.across.second }, right_of_lower);
    }
}

/// Adds to a plane's pixel that other units add to as well: takes the number that is there and puts the sum back. What
/// another unit has put there meanwhile is added in turn, until nothing has.
#[cube]
fn add(maps: &mut Tensor<Atomic<u32>>, plane: usize, pixel: Pixel, value: f32) {
    let place = index(&*maps, plane, pixel);
    let mut rest = value;
    while rest != 0.0 {
        let taken = f32::from_bits(maps[place].exchange(0));
        rest = f32::from_bits(maps[place].exchange((taken + rest).to_bits()));
    }
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

/// Where the position of `pixel` lies in a picture of `rows` and `columns`.
#[cube]
fn enclose(positions: &Tensor<f32>, pixel: Pixel, rows: usize, columns: usize) -> Cell {
    Cell {
        across: pair(positions[index(positions, 0, pixel)], columns),
        down: pair(positions[index(positions, 1, pixel)], rows),
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
