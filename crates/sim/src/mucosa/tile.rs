//! A square of mucosa that repeats without a seam: branching vessels, capillaries and fine relief.

use super::Relief;
use crate::random::{Key, Series};
use std::f64::consts::TAU;

/// Texels along one side of the finest level; a power of two, so that wrapping is a mask.
const SIDE: usize = 1024;
/// Stored slopes reach this far either way.
const STEEPEST: f64 = 1.5;

/// The tile with its reduced levels.
#[derive(Clone, Debug)]
pub struct Tile {
    /// Level after level, each half as wide; a texel is vessel, capillary, slope along, slope around, cavity.
    levels: Vec<Vec<[u8; 5]>>,
}

/// What the tile says about a place.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Texel {
    /// Share of a vessel, 0 to 1.
    pub vessel: f64,
    /// Share of a capillary, 0 to 1.
    pub capillary: f64,
    /// Slopes of the relief along both sides.
    pub slope: [f64; 2],
    /// How deep in a groove, 0 to 1.
    pub cavity: f64,
}

impl Tile {
    /// Length of a side on the wall, metres.
    pub const EXTENT_M: f64 = 0.048;

    /// Paints a tile.
    pub fn paint(relief: Relief, key: Key) -> Self {
        let vessels = paint_trees(key.of("vessels"), 15, 5.0, 0.9982);
        let capillaries = paint_trees(key.of("capillaries"), 150, 1.8, 0.9955);
        let height = heights(relief, key.of("relief"));
        let texel_mm = 1e3 * Self::EXTENT_M / SIDE as f64;
        let at = |x: usize, y: usize| f64::from(height[(y % SIDE) * SIDE + x % SIDE]);
        let byte = |share: f64| (255.0 * share.clamp(0.0, 1.0)).round() as u8;
        let texel = |i: usize| {
            let (x, y) = (i % SIDE, i / SIDE);
            let slope = |difference: f64| byte(0.5 + 0.5 * difference / (2.0 * texel_mm) / STEEPEST);
            let cavity = (-at(x, y) / 0.12).clamp(0.0, 1.0);
            [
                byte(f64::from(vessels[i])),
                byte(f64::from(capillaries[i])),
                slope(at(x + 1, y) - at(x + SIDE - 1, y)),
                slope(at(x, y + 1) - at(x, y + SIDE - 1)),
                byte(cavity),
            ]
        };
        let mut levels = vec![(0..SIDE * SIDE).map(texel).collect::<Vec<_>>()];
        let mut side = SIDE;
        while side > 8 {
            levels.push(halved(&levels[levels.len() - 1], side));
            side /= 2;
        }
        Self { levels }
    }

    /// The tile at `u`, `v` (in tiles, any value) for a pixel that covers `footprint_m` of the wall.
    pub fn at(&self, u: f64, v: f64, footprint_m: f64) -> Texel {
        let texels = footprint_m / Self::EXTENT_M * SIDE as f64;
        let level = (texels.max(1.0).log2().round() as usize).min(self.levels.len() - 1);
        let side = SIDE >> level;
        let (x, y) = (u.rem_euclid(1.0) * side as f64, v.rem_euclid(1.0) * side as f64);
        let (column, row) = (x as usize, y as usize);
        let (right, down) = (x - column as f64, y - row as f64);
        let mask = side - 1;
        let texels = &self.levels[level];
        let texel = |dx: usize, dy: usize| texels[((row + dy) & mask) * side + ((column + dx) & mask)];
        let corners = [texel(0, 0), texel(1, 0), texel(0, 1), texel(1, 1)];
        let weights = [(1.0 - right) * (1.0 - down), right * (1.0 - down), (1.0 - right) * down, right * down];
        let channel = |c: usize| {
            corners.iter().zip(weights).map(|(corner, weight)| weight * f64::from(corner[c])).sum::<f64>() / 255.0
        };
        let slope = |c: usize| (2.0 * channel(c) - 1.0) * STEEPEST;
        Texel { vessel: channel(0), capillary: channel(1), slope: [slope(2), slope(3)], cavity: channel(4) }
    }
}

fn halved(level: &[[u8; 5]], side: usize) -> Vec<[u8; 5]> {
    let half = side / 2;
    let texel = |i: usize| {
        let (x, y) = (2 * (i % half), 2 * (i / half));
        let four =
            [level[y * side + x], level[y * side + x + 1], level[(y + 1) * side + x], level[(y + 1) * side + x + 1]];
        std::array::from_fn(|c| (four.iter().map(|texel| u16::from(texel[c])).sum::<u16>().div_ceil(4)).min(255) as u8)
    };
    (0..half * half).map(texel).collect()
}

/// One twig that still grows.
struct Twig {
    x: f64,
    y: f64,
    heading: f64,
    width: f64,
}

/// Winding, branching lines that taper off.
fn paint_trees(key: Key, trees: u64, width: f64, taper: f64) -> Vec<f32> {
    let mut canvas = vec![0.0_f32; SIDE * SIDE];
    for tree in 0..trees {
        let mut series = key.at(tree).series();
        let side = SIDE as f64;
        let root = Twig {
            x: series.range(0.0, side),
            y: series.range(0.0, side),
            heading: series.range(0.0, TAU),
            width: width * series.range(0.6, 1.0),
        };
        let mut twigs = vec![root];
        // A tree has so many twigs that the count, not chance, must end it.
        for _ in 0..60 {
            let Some(twig) = twigs.pop() else { break };
            grow(&mut canvas, twig, taper, &mut series, &mut twigs);
        }
    }
    canvas
}

fn grow(canvas: &mut [f32], mut twig: Twig, taper: f64, series: &mut Series, twigs: &mut Vec<Twig>) {
    const THINNEST: f64 = 0.75;
    let mut bend = 0.0;
    while twig.width > THINNEST {
        dab(canvas, &twig);
        bend = 0.9 * bend + 0.022 * series.range(-1.0, 1.0);
        twig.heading += bend;
        twig.x += twig.heading.cos();
        twig.y += twig.heading.sin();
        twig.width *= taper;
        if series.range(0.0, 1.0) < 0.045 / twig.width.max(1.5) {
            let side = if series.range(0.0, 1.0) < 0.5 { 1.0 } else { -1.0 };
            let heading = twig.heading + side * series.range(0.4, 1.1);
            twigs.push(Twig { heading, width: twig.width * series.range(0.5, 0.8), ..twig });
            twig.heading -= side * 0.15;
        }
    }
}

/// A soft round spot; darker where the twig is wider.
fn dab(canvas: &mut [f32], twig: &Twig) {
    let reach = (1.5 * twig.width).ceil() as i64;
    let (column, row) = (twig.x.floor() as i64, twig.y.floor() as i64);
    let strength = (0.45 + 0.16 * twig.width).min(1.0);
    for (dx, dy) in (-reach..=reach).flat_map(|dx| (-reach..=reach).map(move |dy| (dx, dy))) {
        let distance = ((column + dx) as f64 - twig.x).hypot((row + dy) as f64 - twig.y) / twig.width;
        let value = (strength * (-1.6 * distance * distance).exp()) as f32;
        let wrap = |at: i64| at.rem_euclid(SIDE as i64) as usize;
        let texel = &mut canvas[wrap(row + dy) * SIDE + wrap(column + dx)];
        *texel = texel.max(value);
    }
}

/// Heights in millimetres above the mean surface.
fn heights(relief: Relief, key: Key) -> Vec<f32> {
    let waves = |count: usize, key: Key| lattice(count, key);
    let (coarse, fine, bumps, scale) = match relief {
        Relief::Crypts => (waves(14, key.at(1)), waves(70, key.at(2)), cells(110, key.at(3)), [0.12, 0.012, 0.014]),
        Relief::Areae => (waves(10, key.at(1)), waves(60, key.at(2)), cells(19, key.at(3)), [0.16, 0.020, 0.035]),
        Relief::Villi => (waves(16, key.at(1)), waves(90, key.at(2)), cells(84, key.at(3)), [0.12, 0.020, 0.13]),
    };
    (0..SIDE * SIDE).map(|i| scale[0] * coarse[i] + scale[1] * fine[i] + scale[2] * bumps[i]).collect()
}

/// Smooth noise that repeats with the tile, -1 to 1, with `count` cells along a side.
fn lattice(count: usize, key: Key) -> Vec<f32> {
    let corner = |x: usize, y: usize| 2.0 * key.at(((y % count) * count + x % count) as u64).uniform() - 1.0;
    let corners: Vec<f64> = (0..count * count).map(|i| corner(i % count, i / count)).collect();
    let texel = |i: usize| {
        let place = |at: usize| (at as f64 + 0.5) * count as f64 / SIDE as f64;
        let (x, y) = (place(i % SIDE), place(i / SIDE));
        let (column, row) = (x as usize, y as usize);
        let ease = |t: f64| t * t * t * (t * (6.0 * t - 15.0) + 10.0);
        let (u, v) = (ease(x.fract()), ease(y.fract()));
        let at = |dx: usize, dy: usize| corners[((row + dy) % count) * count + (column + dx) % count];
        let top = at(0, 0) + u * (at(1, 0) - at(0, 0));
        let bottom = at(0, 1) + u * (at(1, 1) - at(0, 1));
        (top + v * (bottom - top)) as f32
    };
    (0..SIDE * SIDE).map(texel).collect()
}

/// Rounded cells with grooves between them, -1 in the grooves to 1 on the tops (S. Worley, 1996).
fn cells(count: usize, key: Key) -> Vec<f32> {
    let seed = |x: usize, y: usize| {
        let key = key.at(((y % count) * count + x % count) as u64);
        [key.at(0).range(0.15, 0.85), key.at(1).range(0.15, 0.85)]
    };
    let seeds: Vec<[f64; 2]> = (0..count * count).map(|i| seed(i % count, i / count)).collect();
    let texel = |i: usize| {
        let place = |at: usize| (at as f64 + 0.5) * count as f64 / SIDE as f64;
        let (x, y) = (place(i % SIDE), place(i / SIDE));
        let (column, row) = (x as usize, y as usize);
        let (mut first, mut second) = (f64::INFINITY, f64::INFINITY);
        for (dx, dy) in (0..3).flat_map(|dy| (0..3).map(move |dx| (dx, dy))) {
            let (cx, cy) = ((column + dx + count - 1) % count, (row + dy + count - 1) % count);
            let [sx, sy] = seeds[cy * count + cx];
            let distance = (sx + dx as f64 - 1.0 - x.fract()).hypot(sy + dy as f64 - 1.0 - y.fract());
            (first, second) = if distance < first { (distance, first) } else { (first, second.min(distance)) };
        }
        // The difference is 0 on the borders between cells and largest at their middles.
        let rise = ((second - first) / 0.55).min(1.0);
        (2.0 * rise.sqrt() - 1.0) as f32
    };
    (0..SIDE * SIDE).map(texel).collect()
}
