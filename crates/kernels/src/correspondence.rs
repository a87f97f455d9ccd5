//! Where the pixels of one view lie in another, with derivatives, in one pass over the pixels.
//!
//! A pixel's ray times its depth is a point `P`; moved, `Q = R P + t`, and projected it lies at a position in the other
//! picture (Eq. 2 of docs/math.md). Pixels without a sane depth are treated as if theirs was 1, points that the lens
//! does not image as if they lay on its axis: their gradients are zero, and everything stays finite.

use crate::lens::{Dual, Lens, Projection, Visitor};
use crate::level::Level;
use crate::pieces::{PIECE, Piece, dot, pieces, sum};
use rayon::prelude::*;

/// What counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Sane depths lie between these two.
    pub depth: [f32; 2],
    /// Smallest distance from the lens of the other view, as a share of the depth.
    pub nearest: f32,
    /// Positions may pass the outermost pixel centres by this share of the picture.
    pub border_slack: f32,
}

/// Two views and what lies between them.
///
/// # Shapes
/// - `rays`: `[cameras, 3, rows, columns]`, the third plane is 1
/// - `seen`: `[cameras, 1, rows, columns]`, 1 where there is a ray, else 0
/// - `lenses`: one per camera; there are as many cameras as pictures, or one
/// - `depth`: `[batch, 1, rows, columns]`, along the axis
/// - `motion`: `[batch, 3, 4]`, the matrix `[R | t]`
#[derive(Clone, Copy, Debug)]
pub struct Correspondence<'a> {
    /// Directions of the pixels.
    pub rays: &'a [f32],
    /// Which pixels have one.
    pub seen: &'a [f32],
    /// Both views' cameras.
    pub lenses: &'a [Lens],
    /// Rows and columns of both views.
    pub size: [usize; 2],
    /// Depth of the first view.
    pub depth: &'a [f32],
    /// From the first camera's frame to the second's.
    pub motion: &'a [f32],
    /// What counts.
    pub limits: Limits,
}

/// What is known about the pixels of the first view, each `[batch, planes, rows, columns]`.
#[derive(Clone, Debug, Default)]
pub struct Found {
    /// Column and row in the second picture; two planes.
    pub positions: Vec<f32>,
    /// Depth along the second camera's axis, 1 where not defined.
    pub depth: Vec<f32>,
    /// 1 where the pixel has a ray, a sane depth, and a point that the lens images, else 0.
    pub defined: Vec<f32>,
    /// 1 where the position lies in the second picture besides, else 0.
    pub in_view: Vec<f32>,
}

/// The gradient of what was found, from which those of depth and motion follow.
#[derive(Clone, Copy, Debug)]
pub enum OfFound<'a> {
    /// Of [`Found::positions`].
    Positions(&'a [f32]),
    /// Of [`Found::depth`].
    Depth(&'a [f32]),
}

impl Correspondence<'_> {
    /// Finds the pixels in the second view.
    ///
    /// # Panics
    /// If lengths do not fit together.
    pub fn find(&self) -> Found {
        let (area, batch) = (self.area(), self.batch());
        let map = || vec![0.0; batch * area];
        let mut found = Found { positions: vec![0.0; 2 * batch * area], depth: map(), defined: map(), in_view: map() };
        let planes = found.positions.chunks_mut(2 * area).zip(found.depth.chunks_mut(area));
        let planes = planes.zip(found.defined.chunks_mut(area)).zip(found.in_view.chunks_mut(area));
        let mut work = Vec::new();
        for (picture, (((positions, depth), defined), in_view)) in planes.enumerate() {
            let (columns, rows) = positions.split_at_mut(area);
            work.extend(pieces(picture, [columns, rows, depth, defined, in_view]));
        }
        work.into_par_iter().for_each(|Piece { picture, first, planes }| {
            let part = self.part(picture, first);
            Level::default().run(
                #[inline(always)]
                || part.lens.curve.visit(Find { part: &part, size: self.size, planes }),
            );
        });
        found
    }

    /// The gradients of depth and motion, shaped like them.
    ///
    /// # Panics
    /// If lengths do not fit together.
    pub fn gradients(&self, of_found: OfFound<'_>) -> (Vec<f32>, Vec<f32>) {
        let (area, batch) = (self.area(), self.batch());
        let mut of_depth = vec![0.0; batch * area];
        let planes = of_depth.chunks_mut(area).enumerate();
        let work: Vec<_> = planes.flat_map(|(picture, plane)| pieces(picture, [plane])).collect();
        let sums = work.into_par_iter().map(|Piece { picture, first, planes: [of_depth] }| {
            let part = self.part(picture, first);
            let of_part = match of_found {
                OfFound::Positions(gradient) => {
                    OfPart::Positions([0, 1].map(|axis| self.window(gradient, 2 * picture + axis, first)))
                }
                OfFound::Depth(gradient) => OfPart::Depth(self.window(gradient, picture, first)),
            };
            Level::default().run(
                #[inline(always)]
                || part.lens.curve.visit(Differentiate { part: &part, of_part, of_depth }),
            )
        });
        let sums: Vec<[f32; 12]> = sums.collect();
        let mut of_motion = vec![0.0; self.motion.len()];
        let of_pictures = of_motion.chunks_exact_mut(12).zip(sums.chunks(area.div_ceil(PIECE)));
        for (of_picture, sums) in of_pictures {
            for sum in sums {
                of_picture.iter_mut().zip(sum).for_each(|(total, sum)| *total += sum);
            }
        }
        (of_depth, of_motion)
    }

    fn area(&self) -> usize {
        (self.size[0] * self.size[1]).max(1)
    }

    fn batch(&self) -> usize {
        assert_eq!(self.motion.len() / 12, self.depth.len() / self.area(), "a motion for each picture");
        self.depth.len() / self.area()
    }

    /// A piece of a plane of some map.
    fn window<'a>(&self, maps: &'a [f32], plane: usize, first: usize) -> &'a [f32] {
        &maps[plane * self.area() + first..][..PIECE.min(self.area() - first)]
    }

    fn part(&self, picture: usize, first: usize) -> Part<'_> {
        let camera = if self.lenses.len() == 1 { 0 } else { picture };
        let mut motion = [0.0; 12];
        motion.copy_from_slice(&self.motion[12 * picture..][..12]);
        Part {
            rays: [0, 1].map(|axis| self.window(self.rays, 3 * camera + axis, first)),
            seen: self.window(self.seen, camera, first),
            depth: self.window(self.depth, picture, first),
            lens: &self.lenses[camera],
            motion,
            limits: self.limits,
        }
    }
}

/// A piece of a picture.
struct Part<'a> {
    /// Across and down, where the axis has 1.
    rays: [&'a [f32]; 2],
    seen: &'a [f32],
    depth: &'a [f32],
    lens: &'a Lens,
    motion: [f32; 12],
    limits: Limits,
}

/// A pixel's way to the other camera.
struct Pixel {
    sane: bool,
    /// In the first camera's frame.
    from: [f32; 3],
    /// In the second's.
    to: [f32; 3],
    in_domain: bool,
}

impl Pixel {
    /// The point, on the axis where the lens does not image it.
    #[inline(always)]
    fn imaged(&self) -> [f32; 3] {
        let [x, y, z] = self.to;
        let or = |value, other| if self.in_domain { value } else { other };
        [or(x, 0.0), or(y, 0.0), or(z, 1.0)]
    }
}

impl Part<'_> {
    #[inline(always)]
    fn pixel(&self, place: usize) -> Pixel {
        let ([low, high], depth) = (self.limits.depth, self.depth[place]);
        // False for NaN.
        let sane = (depth > low) & (depth < high);
        let depth = if sane { depth } else { 1.0 };
        let from = [self.rays[0][place] * depth, self.rays[1][place] * depth, depth];
        let [x, y, z] = from;
        let row = |row: usize| {
            let [a, b, c, t] = [0, 1, 2, 3].map(|column| self.motion[4 * row + column]);
            a * x + b * y + c * z + t
        };
        let to = [row(0), row(1), row(2)];
        let length = (to[0] * to[0] + to[1] * to[1] + to[2] * to[2]).sqrt();
        let distance = if self.lens.curve.is_perspective() { to[2] } else { length };
        let within = to[2] - length * self.lens.cos_widest >= 0.0;
        let in_domain = within & (distance > depth * self.limits.nearest) & (length < f32::INFINITY);
        Pixel { sane, from, to, in_domain }
    }
}

/// Fills columns, rows, depth, definedness and visibility of a piece.
struct Find<'a, 'b> {
    part: &'b Part<'a>,
    size: [usize; 2],
    planes: [&'a mut [f32]; 5],
}

impl Visitor for Find<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn visit(self, model: &impl Projection) {
        let Self { part, size: [height, width], planes: [columns, rows, depths, defined, in_view] } = self;
        let Lens { matrix, centre, .. } = part.lens;
        let bounds = |length: usize| {
            let slack = part.limits.border_slack * length as f32;
            [-slack, length.saturating_sub(1) as f32 + slack]
        };
        let ([left, right], [top, bottom]) = (bounds(width), bounds(height));
        let flag = |holds: bool| if holds { 1.0 } else { 0.0 };
        for place in 0..part.depth.len() {
            let pixel = part.pixel(place);
            let [x, y] = model.plane(pixel.imaged());
            let column = x * matrix[0][0] + y * matrix[0][1] + centre[0];
            let row = x * matrix[1][0] + y * matrix[1][1] + centre[1];
            let known = pixel.in_domain & pixel.sane & (part.seen[place] > 0.5);
            let inside = (column >= left) & (column <= right) & (row >= top) & (row <= bottom);
            (columns[place], rows[place]) = (column, row);
            depths[place] = if known { pixel.to[2] } else { 1.0 };
            defined[place] = flag(known);
            in_view[place] = flag(known & inside);
        }
    }
}

/// Gradients of a piece of what was found.
enum OfPart<'a> {
    Positions([&'a [f32]; 2]),
    Depth(&'a [f32]),
}

/// Writes the gradient of the depth and returns that of the motion.
struct Differentiate<'a, 'b> {
    part: &'b Part<'a>,
    of_part: OfPart<'a>,
    of_depth: &'a mut [f32],
}

impl Visitor for Differentiate<'_, '_> {
    type Output = [f32; 12];

    #[inline(always)]
    fn visit(self, model: &impl Projection) -> [f32; 12] {
        let Self { part, of_part, of_depth } = self;
        let (mut from, mut of_to) = ([[0.0; PIECE]; 3], [[0.0; PIECE]; 3]);
        let matrix = &part.lens.matrix;
        for (place, of_depth) in of_depth.iter_mut().enumerate() {
            let pixel = part.pixel(place);
            let gradient = match &of_part {
                OfPart::Positions([columns, rows]) => {
                    let (of_column, of_row) = (columns[place], rows[place]);
                    let of_x = of_column * matrix[0][0] + of_row * matrix[1][0];
                    let of_y = of_column * matrix[0][1] + of_row * matrix[1][1];
                    let [x, y] = model.plane(Dual::coordinates(pixel.imaged())).map(|value| value.slopes);
                    [0, 1, 2].map(|axis| if pixel.in_domain { of_x * x[axis] + of_y * y[axis] } else { 0.0 })
                }
                OfPart::Depth(depth) => {
                    let known = pixel.in_domain & pixel.sane & (part.seen[place] > 0.5);
                    [0.0, 0.0, if known { depth[place] } else { 0.0 }]
                }
            };
            let back = |axis: usize| (0..3).map(|row| part.motion[4 * row + axis] * gradient[row]).sum::<f32>();
            let along = part.rays[0][place] * back(0) + part.rays[1][place] * back(1) + back(2);
            *of_depth = if pixel.sane { along } else { 0.0 };
            for axis in 0..3 {
                from[axis][place] = pixel.from[axis];
                of_to[axis][place] = gradient[axis];
            }
        }
        let (mut of_motion, count) = ([0.0; 12], of_depth.len());
        for row in 0..3 {
            let of_row = &of_to[row][..count];
            for column in 0..3 {
                of_motion[4 * row + column] = dot(of_row, &from[column][..count]);
            }
            of_motion[4 * row + 3] = sum(of_row);
        }
        of_motion
    }
}
