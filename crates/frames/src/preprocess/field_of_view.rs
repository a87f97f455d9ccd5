//! The part of the picture the optics fill, found from the dark border around it.
//!
//! Endoscopes show a circle, an octagon or a rectangle on black. The border stays black in every frame while tissue is
//! bright in some, so the brightest value over several frames tells them apart, even where a lumen is dark for a while.
//! Marks in the border are not connected to the field of view, and the outline is fitted, so neither counts.

use super::convex::{self, Point};
use endoscape_core::{Grid, Image, Mask, Rect, Size};

/// The brightest a border may be, 0 to 255: cheap cameras have blacks of about 30.
const BRIGHTEST_BORDER: u8 = 48;
/// Steps by which the field of view exceeds the border: noise and compression reach about 8.
const LEAST_CONTRAST: f32 = 10.0;
/// Frames looked at; more add nothing but time.
const FRAMES: usize = 64;
/// A border below this share of the picture is not worth a mask.
const LEAST_BORDER: f64 = 0.005;
/// A smaller share of the picture is a mark or a lit spot, not a field of view.
const LEAST_SHARE: f64 = 0.2;
/// Share of its outline that a field of view must fill, else the dark parts are dark tissue.
const LEAST_FILLING: f64 = 0.93;

/// What the optics fill.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldOfView {
    /// Pixels well inside the outline; the rim itself, half bright, is not usable.
    pub mask: Mask,
    /// The outline that was fitted, pixels, before the rim is taken off.
    pub shape: Shape,
}

/// The outline of a field of view; it may reach beyond the picture.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// A disc, cut by the picture where it does not fit.
    Circle {
        /// Column and row of the centre, pixels.
        centre: [f64; 2],
        /// Radius, pixels.
        radius: f64,
    },
    /// A convex polygon such as the octagon of many colonoscopes.
    Polygon {
        /// Column and row of the corners, pixels, in turn.
        corners: Vec<[f64; 2]>,
    },
    /// A block with black bars beside it.
    Rectangle(Rect),
}

/// Finds the field of view common to frames of one video.
///
/// A handful of frames some seconds apart do; up to 64, evenly chosen, are looked at. `None` if the picture is full to
/// its corners, if the dark parts do not surround something convex, or if the frames differ in size.
pub fn find(images: &[Image]) -> Option<FieldOfView> {
    let size = images.first()?.size();
    if size.width < 8 || size.height < 8 || images.iter().any(|image| image.size() != size) {
        return None;
    }
    let brightest = brightest(images, size);
    let bright = above_border(&brightest)?;
    let region = Region::largest(&bright)?;
    let share = region.spanned() / size.area() as f64;
    if !(LEAST_SHARE..=1.0 - LEAST_BORDER).contains(&share) || region.filling() < LEAST_FILLING {
        return None;
    }
    let shape = region.shape();
    Some(FieldOfView { mask: region.mask(&shape), shape })
}

/// The strongest colour of every pixel over all frames.
fn brightest(images: &[Image], size: Size) -> Grid<u8> {
    let mut brightest = Grid::filled(size, 0_u8);
    for image in images.iter().step_by(images.len().div_ceil(FRAMES)) {
        for (value, rgb) in brightest.values_mut().iter_mut().zip(image.rgb().chunks_exact(3)) {
            *value = rgb.iter().fold(*value, |value, colour| value.max(*colour));
        }
    }
    brightest
}

/// Pixels brighter than the border; `None` without a dark border in at least three corners.
fn above_border(brightest: &Grid<u8>) -> Option<Mask> {
    let mut sorted = brightest.values().to_vec();
    let mut quantile = |share: usize| *sorted.select_nth_unstable(share * brightest.size().area() / 100).1;
    let (border, middle) = (quantile(1), quantile(60));
    if border > BRIGHTEST_BORDER {
        return None;
    }
    // A tenth of the way up, as the rim of many lenses fades slowly.
    let contrast = (0.1 * f32::from(middle.saturating_sub(border))).max(LEAST_CONTRAST);
    let bright = brightest.map(|value| f32::from(*value) > f32::from(border) + contrast);
    let Size { width, height } = bright.size();
    let corners = [(1, 1), (width - 2, 1), (1, height - 2), (width - 2, height - 2)];
    let dark = corners.iter().filter(|(x, y)| bright.get(*x, *y) == Some(&false)).count();
    (dark >= 3).then_some(bright)
}

/// A connected set of pixels, known by its first and last column in every row.
struct Region {
    size: Size,
    spans: Vec<Option<(usize, usize)>>,
}

impl Region {
    /// The largest set connected through edges; `None` if nothing is set.
    fn largest(bright: &Mask) -> Option<Self> {
        let size = bright.size();
        let mut open = bright.values().to_vec();
        let (mut best, mut most) = (None, 0);
        let mut stack = Vec::new();
        for seed in 0..size.area() {
            if !open[seed] {
                continue;
            }
            let (mut spans, mut count) = (vec![None; size.height], 0);
            open[seed] = false;
            stack.push(seed);
            while let Some(index) = stack.pop() {
                let (x, y) = (index % size.width, index / size.width);
                count += 1;
                let (first, last) = spans[y].unwrap_or((x, x));
                spans[y] = Some((x.min(first), x.max(last)));
                for next in neighbours(index, size) {
                    if std::mem::take(&mut open[next]) {
                        stack.push(next);
                    }
                }
            }
            if count > most {
                (best, most) = (Some(spans), count);
            }
        }
        best.map(|spans| Self { size, spans })
    }

    /// Pixels between the first and last column of every row, dark ones inside included.
    fn spanned(&self) -> f64 {
        self.spans.iter().flatten().map(|(first, last)| (last - first + 1) as f64).sum()
    }

    /// Share of the convex hull that the rows span.
    fn filling(&self) -> f64 {
        let corners = convex::hull(self.outline());
        let turns = corners.iter().zip(corners.iter().cycle().skip(1));
        let area = 0.5 * turns.map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum::<f64>();
        // The hull runs through pixel centres; half its length around it is missing from its area.
        let length: f64 =
            corners.iter().zip(corners.iter().cycle().skip(1)).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1])).sum();
        self.spanned() / (area.abs() + 0.5 * length).max(1.0)
    }

    /// First and last pixel of every row.
    fn outline(&self) -> Vec<Point> {
        let rows = self.spans.iter().enumerate().filter_map(|(y, span)| span.map(|span| (y as f64, span)));
        rows.flat_map(|(y, (first, last))| [[first as f64, y], [last as f64, y]]).collect()
    }

    /// Smallest block around the region.
    fn block(&self) -> Rect {
        let columns = || self.spans.iter().flatten();
        let first = columns().map(|span| span.0).min().unwrap_or(0);
        let last = columns().map(|span| span.1).max().unwrap_or(0);
        let top = self.spans.iter().position(Option::is_some).unwrap_or(0);
        let bottom = self.spans.iter().rposition(Option::is_some).unwrap_or(0);
        Rect { x: first, y: top, size: Size::new(last - first + 1, bottom - top + 1) }
    }

    fn shape(&self) -> Shape {
        let block = self.block();
        if self.spanned() > 0.99 * block.size.area() as f64 {
            return Shape::Rectangle(block);
        }
        let tolerance = (0.006 * self.size.width.min(self.size.height) as f64).max(1.5);
        // Where the block ends, the picture or a straight edge cuts the circle.
        let curved: Vec<Point> = self.outline().into_iter().filter(|point| !self.on_block_edge(*point)).collect();
        if let Some((centre, radius)) = convex::circle(&curved)
            && convex::on_circle(&curved, (centre, radius), tolerance) > 0.85
        {
            return Shape::Circle { centre, radius };
        }
        Shape::Polygon { corners: convex::simplified(convex::hull(self.outline()), tolerance) }
    }

    /// Whether a point lies within two pixels of the edge of the smallest block.
    fn on_block_edge(&self, point: Point) -> bool {
        let block = self.block();
        let near = |value: f64, start: usize, extent: usize| {
            value < start as f64 + 2.0 || value > (start + extent) as f64 - 3.0
        };
        near(point[0], block.x, block.size.width) || near(point[1], block.y, block.size.height)
    }

    /// Pixels inside the shape and the block, a rim taken off wherever the outline is not the picture's own edge.
    fn mask(&self, shape: &Shape) -> Mask {
        let rim = (0.005 * self.size.width.min(self.size.height) as f64).max(2.0);
        let (right, low) = (self.size.width as f64 - 1.0, self.size.height as f64 - 1.0);
        let block = self.block();
        let (x0, y0) = (block.x as f64, block.y as f64);
        let (x1, y1) = (x0 + block.size.width as f64 - 1.0, y0 + block.size.height as f64 - 1.0);
        let inset = |touches: bool| if touches { 0.0 } else { rim };
        let (left_rim, right_rim) = (inset(x0 <= 1.0), inset(x1 >= right - 1.0));
        let (top_rim, low_rim) = (inset(y0 <= 1.0), inset(y1 >= low - 1.0));
        let in_block =
            |[x, y]: Point| x >= x0 + left_rim && x <= x1 - right_rim && y >= y0 + top_rim && y <= y1 - low_rim;
        let at_picture_edge = |a: Point, b: Point| {
            let both = |axis: usize, edge: f64| (a[axis] - edge).abs() <= 2.0 && (b[axis] - edge).abs() <= 2.0;
            both(0, 0.0) || both(0, right) || both(1, 0.0) || both(1, low)
        };
        let in_shape = |point: Point| match shape {
            Shape::Rectangle(_) => true,
            Shape::Circle { centre, radius } => (point[0] - centre[0]).hypot(point[1] - centre[1]) <= radius - rim,
            Shape::Polygon { corners } => {
                let mut edges = corners.iter().zip(corners.iter().cycle().skip(1));
                edges.all(|(a, b)| at_picture_edge(*a, *b) || convex::depth_behind((*a, *b), point) >= rim)
            }
        };
        Grid::from_fn(self.size, |x, y| {
            let point = [x as f64, y as f64];
            in_block(point) && in_shape(point)
        })
    }
}

/// Indices of the pixels left, right, above and below.
fn neighbours(index: usize, size: Size) -> impl Iterator<Item = usize> {
    let (x, y) = (index % size.width, index / size.width);
    let left = (x > 0).then(|| index - 1);
    let right = (x + 1 < size.width).then_some(index + 1);
    let above = (y > 0).then(|| index - size.width);
    let below = (y + 1 < size.height).then_some(index + size.width);
    [left, right, above, below].into_iter().flatten()
}

#[cfg(test)]
mod tests;
