//! SVG elements, and the canvas on which plotters draws them.
//!
//! Plotters counts whole pixels; the canvas is ten times as fine, so that lines come out smooth. A colour of plotters
//! carries the number of an [`Ink`] in its red part, because a figure needs classes and dashes that colours lack.

use super::ink::Ink;
use plotters_backend::text_anchor::{HPos, VPos};
use plotters_backend::{
    BackendColor, BackendCoord, BackendStyle, BackendTextStyle, DrawingBackend, DrawingErrorKind, FontTransform,
};
use std::convert::Infallible;
use std::fmt::Write as _;

/// Units of the canvas per pixel of the figure.
pub const UNITS: f64 = 10.0;

/// Points of a line nearer than this to the one before are left out, pixels; nobody sees them.
const FINEST: f64 = 0.35;

/// Most points of a line that crosses from column to column of pixels all the time; of a longer one every n-th is drawn.
const MOST: usize = 4000;

type Drawn = Result<(), DrawingErrorKind<Infallible>>;

/// Escapes text for SVG.
pub fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            // Control characters may not stand in XML at all.
            letter if letter.is_control() => escaped.push(' '),
            letter => escaped.push(letter),
        }
    }
    escaped
}

/// `#rrggbb`.
pub fn hex([r, g, b]: [u8; 3]) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// A line through points in pixels, `width` wide; `dashed` draws it with the dash of its ink.
pub fn polyline(points: &[(f64, f64)], ink: Ink, width: f64, opacity: f64, dashed: bool) -> String {
    let Some(path) = path(points) else { return String::new() };
    let dash = match ink.dash() {
        dash if dashed && !dash.is_empty() => format!(" stroke-dasharray=\"{dash}\""),
        _ => String::new(),
    };
    format!(
        "<path class=\"s-{}\" d=\"{path}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{width}\" \
         stroke-linejoin=\"round\"{}{dash}/>",
        ink.class(),
        hex(ink.rgb()),
        opacity_attribute(opacity)
    )
}

/// A filled shape with corners in pixels.
pub fn polygon(points: &[(f64, f64)], ink: Ink, opacity: f64) -> String {
    let Some(path) = path(points) else { return String::new() };
    format!(
        "<path class=\"f-{}\" d=\"{path}Z\" fill=\"{}\"{}/>",
        ink.class(),
        hex(ink.rgb()),
        opacity_attribute(opacity)
    )
}

/// Left-aligned letters whose base line begins at `at`, sizes in pixels.
pub fn text(at: (f64, f64), text: &str, size: f64, ink: Ink) -> String {
    anchored(at, text, size, ink, "start")
}

/// Letters that start, end, or have their middle at `at`.
pub fn anchored((x, y): (f64, f64), text: &str, size: f64, ink: Ink, anchor: &str) -> String {
    format!(
        "<text class=\"f-{}\" x=\"{x:.1}\" y=\"{y:.1}\" font-size=\"{size}\" text-anchor=\"{anchor}\" fill=\"{}\">{}</text>",
        ink.class(),
        hex(ink.rgb()),
        escape(text)
    )
}

fn opacity_attribute(opacity: f64) -> String {
    if opacity < 1.0 { format!(" opacity=\"{opacity}\"") } else { String::new() }
}

/// `M x y L x y ...` without the points nobody sees; `None` for no points.
fn path(points: &[(f64, f64)]) -> Option<String> {
    let points = thinned(points);
    let (mut kept, last) = (*points.first()?, points.len() - 1);
    let mut path = format!("M{:.1} {:.1}", kept.0, kept.1);
    for (index, point) in points.iter().enumerate().skip(1) {
        if index == last || (point.0 - kept.0).hypot(point.1 - kept.1) >= FINEST {
            // Writing to a String cannot fail.
            write!(path, "L{:.1} {:.1}", point.0, point.1).ok();
            kept = *point;
        }
    }
    Some(path)
}

/// Where a line stays in one column of pixels, its ends, lowest and highest point paint the same as all of it: an hour of
/// frames is drawn by a few thousand points.
fn thinned(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let column = |run: &[(f64, f64)]| {
        let by_height = |a: &usize, b: &usize| run[*a].1.total_cmp(&run[*b].1);
        let (low, high) = ((0..run.len()).min_by(by_height), (0..run.len()).max_by(by_height));
        let mut kept: Vec<usize> = [Some(0), low, high, run.len().checked_sub(1)].into_iter().flatten().collect();
        kept.sort_unstable();
        kept.dedup();
        kept.into_iter().map(|index| run[index]).collect::<Vec<_>>()
    };
    let kept: Vec<_> = points.chunk_by(|a, b| a.0.floor() == b.0.floor()).flat_map(column).collect();
    let (step, end) = (kept.len().div_ceil(MOST).max(1), kept.last().copied());
    let tail = end.filter(|_| kept.len() % step != 1 && step > 1);
    kept.into_iter().step_by(step).chain(tail).collect()
}

/// Where plotters draws: elements are appended to a text.
pub struct Canvas<'a> {
    size: (u32, u32),
    body: &'a mut String,
}

impl<'a> Canvas<'a> {
    /// A canvas of a size in pixels.
    pub fn new((width, height): (f64, f64), body: &'a mut String) -> Self {
        Self { size: ((width * UNITS) as u32, (height * UNITS) as u32), body }
    }
}

fn pixels((x, y): BackendCoord) -> (f64, f64) {
    (f64::from(x) / UNITS, f64::from(y) / UNITS)
}

fn ink(color: BackendColor) -> Ink {
    Ink::of_code(color.rgb.0)
}

impl DrawingBackend for Canvas<'_> {
    type ErrorType = Infallible;

    fn get_size(&self) -> (u32, u32) {
        self.size
    }

    fn ensure_prepared(&mut self) -> Drawn {
        Ok(())
    }

    fn present(&mut self) -> Drawn {
        Ok(())
    }

    fn draw_pixel(&mut self, point: BackendCoord, color: BackendColor) -> Drawn {
        self.draw_rect(point, (point.0 + 1, point.1 + 1), &color, true)
    }

    fn draw_line<S: BackendStyle>(&mut self, from: BackendCoord, to: BackendCoord, style: &S) -> Drawn {
        self.draw_path([from, to], style)
    }

    fn draw_rect<S: BackendStyle>(
        &mut self,
        (left, top): BackendCoord,
        (right, bottom): BackendCoord,
        style: &S,
        fill: bool,
    ) -> Drawn {
        let corners = [(left, top), (right, top), (right, bottom), (left, bottom)];
        if fill {
            self.fill_polygon(corners, style)
        } else {
            self.draw_path(corners.into_iter().chain([(left, top)]), style)
        }
    }

    fn draw_path<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(&mut self, path: I, style: &S) -> Drawn {
        let (color, width) = (style.color(), f64::from(style.stroke_width()) / UNITS);
        if color.alpha > 0.0 {
            let points: Vec<(f64, f64)> = path.into_iter().map(pixels).collect();
            // Only lines of data are dashed; axes and whiskers are thinner.
            let dashed = width >= super::chart::LINE;
            self.body.push_str(&polyline(&points, ink(color), width, color.alpha, dashed));
        }
        Ok(())
    }

    fn draw_circle<S: BackendStyle>(&mut self, centre: BackendCoord, radius: u32, style: &S, fill: bool) -> Drawn {
        let corner = |step: i32| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(step) / 24.0).sin_cos();
            (centre.0 + (f64::from(radius) * cos) as i32, centre.1 + (f64::from(radius) * sin) as i32)
        };
        if fill { self.fill_polygon((0..24).map(corner), style) } else { self.draw_path((0..=24).map(corner), style) }
    }

    fn fill_polygon<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(&mut self, corners: I, style: &S) -> Drawn {
        let color = style.color();
        if color.alpha > 0.0 {
            let points: Vec<(f64, f64)> = corners.into_iter().map(pixels).collect();
            self.body.push_str(&polygon(&points, ink(color), color.alpha));
        }
        Ok(())
    }

    fn draw_text<T: BackendTextStyle>(&mut self, letters: &str, style: &T, at: BackendCoord) -> Drawn {
        let ((x, y), size) = (pixels(at), style.size() / UNITS);
        let anchor = match style.anchor().h_pos {
            HPos::Left => "start",
            HPos::Right => "end",
            HPos::Center => "middle",
        };
        // Digits and capitals of common fonts are 0.73 of the size high.
        let down = match style.anchor().v_pos {
            VPos::Top => 0.8,
            VPos::Center => 0.36,
            // Room for what hangs below the line.
            VPos::Bottom => -0.25,
        } * size;
        let degrees = match style.transform() {
            FontTransform::None => None,
            FontTransform::Rotate90 => Some(90),
            FontTransform::Rotate180 => Some(180),
            FontTransform::Rotate270 => Some(270),
        };
        let written = |at| anchored(at, letters, size, ink(style.color()), anchor);
        let turned = degrees.map_or_else(
            || written((x, y + down)),
            |degrees| {
                let inside = written((0.0, down));
                format!("<g transform=\"translate({x:.1} {y:.1}) rotate({degrees})\">{inside}</g>")
            },
        );
        self.body.push_str(&turned);
        Ok(())
    }
}
