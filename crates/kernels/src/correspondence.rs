//! Where the target's pixels lie in the source view, and the way back.
//!
//! Back-projection, the rigid motion and the projection in one pass over the pixels: `p_s = lens(R (D ray) + t)`
//! (Eq. 2 of docs/math.md). On the way back the projection is computed again, with its derivatives.

use crate::lens::{Dual, Lens};
use rayon::prelude::*;

/// Numbers of the result per pixel: column, row, depth in the source, whether they mean something, and whether the
/// source shows the pixel (0 or 1).
pub const PLANES: usize = 5;

/// A batch of views.
#[derive(Clone, Copy, Debug)]
pub struct Correspondence<'a> {
    /// One for each picture, or one for all.
    pub lenses: &'a [Lens],
    /// Rays of all pixels with z = 1: `[lenses, 3, rows, columns]`.
    pub rays: &'a [f32],
    /// 1 where a pixel has a ray: `[lenses, 1, rows, columns]`.
    pub seen: &'a [f32],
    /// Rows and columns.
    pub size: [usize; 2],
    /// `[batch, 1, rows, columns]`, along the target's optical axis.
    pub depth: &'a [f32],
    /// `[batch, 3, 4]`, translation in the unit of the depth.
    pub source_from_target: &'a [f32],
    /// What counts as a depth, a point in front of the lens and a place in the picture.
    pub limits: Limits,
}

/// What counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Smallest and largest depth, both excluded.
    pub depth: [f32; 2],
    /// Smallest distance from the source camera, as a fraction of the depth in the target.
    pub nearest: f32,
    /// How far positions may pass the outermost pixel centres, as a fraction of the picture.
    pub border: f32,
}

/// One pixel on its way.
struct Ray {
    /// In the target's frame, z = 1.
    direction: [f32; 3],
    depth: f32,
    sane: bool,
    /// In the source's frame.
    point: [f32; 3],
    in_domain: bool,
}

impl Correspondence<'_> {
    /// `[batch, 5, rows, columns]`: column, row, depth, defined, in view. Positions are finite everywhere; the depth is 1
    /// where it is not defined.
    ///
    /// # Panics
    /// If lengths do not fit together.
    pub fn places(&self) -> Vec<f32> {
        let columns = self.size[1];
        let mut places = vec![0.0; self.depth.len() * PLANES];
        places.par_chunks_mut(PLANES * self.area()).enumerate().for_each(|(picture, places)| {
            let mut planes = places.chunks_exact_mut(self.area()).map(|plane| plane.chunks_exact_mut(columns));
            let rows: Vec<Vec<&mut [f32]>> = {
                let mut planes: Vec<_> = planes.by_ref().collect();
                (0..self.size[0]).map(|_| planes.iter_mut().filter_map(Iterator::next).collect()).collect()
            };
            rows.into_par_iter().with_min_len(8).enumerate().for_each(|(row, mut lines)| {
                for column in 0..columns {
                    let numbers = self.place(picture, row * columns + column);
                    lines.iter_mut().zip(numbers).for_each(|(line, number)| line[column] = number);
                }
            });
        });
        places
    }

    fn place(&self, picture: usize, pixel: usize) -> [f32; PLANES] {
        let lens = self.lens(picture);
        let ray = self.ray(picture, pixel);
        let [x, y] = lens.project(if ray.in_domain { ray.point } else { [0.0, 0.0, 1.0] });
        let defined = ray.in_domain && ray.sane && self.seen[self.lens_index(picture) * self.area() + pixel] > 0.5;
        let inside = |coordinate: f32, length: usize| {
            let slack = self.limits.border * length as f32;
            (-slack..=length.saturating_sub(1) as f32 + slack).contains(&coordinate)
        };
        let in_view = defined && inside(x, self.size[1]) && inside(y, self.size[0]);
        let flag = |holds: bool| if holds { 1.0 } else { 0.0 };
        [x, y, if defined { ray.point[2] } else { 1.0 }, flag(defined), flag(in_view)]
    }

    /// Gradients of the depth, shaped like it, and of `source_from_target`, from that of the places; of those only the
    /// first three planes matter. `places` are the result of [`Self::places`].
    ///
    /// # Panics
    /// If lengths do not fit together.
    pub fn gradients(&self, places: &[f32], of_places: &[f32]) -> [Vec<f32>; 2] {
        let (area, columns) = (self.area(), self.size[1]);
        let mut of_depth = vec![0.0; self.depth.len()];
        let pictures = of_depth.par_chunks_mut(area).enumerate();
        let of_motion: Vec<[f64; 12]> = pictures
            .map(|(picture, of_depth)| {
                let rows = of_depth.par_chunks_mut(columns).with_min_len(8).enumerate();
                let of_rows: Vec<[f32; 12]> = rows
                    .map(|(row, of_depth)| {
                        let mut sums = [0.0; 12];
                        for (column, of_depth) in of_depth.iter_mut().enumerate() {
                            let pixel = row * columns + column;
                            let number = |plane: usize| of_places[(picture * PLANES + plane) * area + pixel];
                            let defined = places[(picture * PLANES + 3) * area + pixel] > 0.5;
                            let of_place = [number(0), number(1), if defined { number(2) } else { 0.0 }];
                            *of_depth = self.pixel_gradient(picture, pixel, of_place, &mut sums);
                        }
                        sums
                    })
                    .collect();
                of_rows.iter().fold([0.0; 12], |sums, of_row| std::array::from_fn(|i| sums[i] + f64::from(of_row[i])))
            })
            .collect();
        [of_depth, of_motion.into_iter().flatten().map(|sum| sum as f32).collect()]
    }

    /// The gradient of one depth; adds that of the motion.
    fn pixel_gradient(&self, picture: usize, pixel: usize, of_place: [f32; 3], sums: &mut [f32; 12]) -> f32 {
        if of_place == [0.0; 3] {
            return 0.0;
        }
        let ray = self.ray(picture, pixel);
        let mut of_point = [0.0, 0.0, of_place[2]];
        if ray.in_domain {
            let unit = |axis: usize| std::array::from_fn(|other| if other == axis { 1.0 } else { 0.0 });
            let point = [0, 1, 2].map(|axis| Dual { value: ray.point[axis], slope: unit(axis) });
            let [x, y] = self.lens(picture).project(point);
            of_point = [0, 1, 2].map(|axis| of_point[axis] + of_place[0] * x.slope[axis] + of_place[1] * y.slope[axis]);
        }
        let motion = self.motion(picture);
        let mut of_depth = 0.0;
        for (row, of_row) in of_point.into_iter().enumerate() {
            for axis in 0..3 {
                sums[4 * row + axis] += of_row * ray.depth * ray.direction[axis];
                of_depth += of_row * motion[4 * row + axis] * ray.direction[axis];
            }
            sums[4 * row + 3] += of_row;
        }
        if ray.sane { of_depth } else { 0.0 }
    }

    fn ray(&self, picture: usize, pixel: usize) -> Ray {
        let area = self.area();
        let direction = [0, 1, 2].map(|axis| self.rays[(3 * self.lens_index(picture) + axis) * area + pixel]);
        let depth = self.depth[picture * area + pixel];
        let [low, high] = self.limits.depth;
        let sane = depth > low && depth < high;
        let depth = if sane { depth } else { 1.0 };
        let motion = self.motion(picture);
        let point = [0, 1, 2].map(|row| {
            let [a, b, c] = [0, 1, 2].map(|axis| motion[4 * row + axis] * (depth * direction[axis]));
            a + b + c + motion[4 * row + 3]
        });
        let in_domain = self.lens(picture).images(point, depth * self.limits.nearest);
        Ray { direction, depth, sane, point, in_domain }
    }

    fn area(&self) -> usize {
        self.size[0] * self.size[1]
    }

    fn lens_index(&self, picture: usize) -> usize {
        if self.lenses.len() == 1 { 0 } else { picture }
    }

    fn lens(&self, picture: usize) -> &Lens {
        &self.lenses[self.lens_index(picture)]
    }

    fn motion(&self, picture: usize) -> &[f32] {
        &self.source_from_target[12 * picture..][..12]
    }
}
