//! Lines over two axes, drawn by plotters.

use super::canvas::{Canvas, UNITS};
use super::{Entry, Ink, Svg};
use crate::ReportError;
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Width of a line of data, pixels; thinner ones are never dashed.
pub const LINE: f64 = 1.8;

/// Width of whiskers, pixels.
const WHISKER: f64 = 1.1;

/// Half the width of the bar at the end of a whisker, units of the canvas.
const BAR: i32 = 30;

/// Opacity of a band of spread.
const BAND: f64 = 0.16;

/// Space for labels left and below, for the title above, and free at the right, pixels.
const MARGINS: [f64; 4] = [58.0, 46.0, 30.0, 16.0];

/// Sizes of letters, pixels.
const TITLE_SIZE: f64 = 14.0;
const LABEL_SIZE: f64 = 12.5;
const TICK_SIZE: f64 = 11.5;

/// Share of the range left free beside the data.
const PAD: f64 = 0.05;

/// How a line shows its points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// Joined, without markers.
    Joined,
    /// Joined, with markers, and whiskers where a spread is given.
    Marked,
    /// A thin line that stands back.
    Thin,
    /// Joined, with a band where a spread is given.
    Banded,
    /// One dot per point, not joined.
    Dots,
}

/// One series.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Its name in the legend; empty for helping lines.
    pub name: String,
    /// Its colour, dash and marker.
    pub ink: Ink,
    /// How it is drawn.
    pub shape: Shape,
    /// Points; a point that is not finite interrupts the line.
    pub points: Vec<[f64; 2]>,
    /// Lower and upper end of the spread at each point; empty for none.
    pub spread: Vec<[f64; 2]>,
}

impl Line {
    /// A line without spread.
    pub fn new(name: impl Into<String>, ink: Ink, shape: Shape, points: Vec<[f64; 2]>) -> Self {
        Self { name: name.into(), ink, shape, points, spread: Vec::new() }
    }

    fn finite(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        self.points.iter().copied().filter(|point| point.iter().all(|value| value.is_finite()))
    }
}

/// A direction of a chart.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Axis {
    /// Quantity and unit; empty hides the axis.
    pub label: String,
    /// A range to keep instead of that of the data.
    pub range: Option<[f64; 2]>,
    /// Whether zero belongs to the range.
    pub from_zero: bool,
}

impl Axis {
    /// An axis that follows the data.
    pub fn new(label: impl Into<String>) -> Self {
        Self { label: label.into(), ..Self::default() }
    }

    /// An axis from zero.
    pub fn from_zero(label: impl Into<String>) -> Self {
        Self { label: label.into(), from_zero: true, range: None }
    }

    /// An axis of a known range.
    pub fn over(label: impl Into<String>, range: [f64; 2]) -> Self {
        Self { label: label.into(), from_zero: false, range: Some(range) }
    }

    /// The range for values `low` to `high`, never empty.
    fn span(&self, values: impl Iterator<Item = f64>) -> [f64; 2] {
        if let Some(range) = self.range {
            return range;
        }
        let [low, high] =
            values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)]);
        let [low, high] = if low <= high { [low, high] } else { [0.0, 1.0] };
        let low = if self.from_zero { low.min(0.0) } else { low };
        let width = if high > low { high - low } else { low.abs().max(1e-6) };
        let below = if self.from_zero && low == 0.0 { 0.0 } else { PAD * width };
        [low - below, high + PAD * width]
    }
}

/// Lines over two axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Chart {
    /// Headline of the panel.
    pub title: String,
    /// What it shows, for those who cannot see it.
    pub label: String,
    /// To the right.
    pub x: Axis,
    /// Upwards.
    pub y: Axis,
    /// The series, drawn in this order.
    pub lines: Vec<Line>,
    /// Whether one unit is equally long on both axes.
    pub equal: bool,
    /// Width and height, pixels.
    pub size: (f64, f64),
}

type Area<'a> = DrawingArea<Canvas<'a>, Shift>;
type Context<'a, 'b> = ChartContext<'b, Canvas<'a>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

impl Chart {
    /// Draws it.
    ///
    /// # Errors
    /// [`ReportError::Drawing`] if plotters refuses.
    pub fn svg(&self) -> Result<Svg, ReportError> {
        let mut body = String::new();
        self.draw(&Canvas::new(self.size, &mut body).into_drawing_area())
            .map_err(|error| ReportError::Drawing { figure: self.title.clone(), reason: error.to_string() })?;
        let (width, height) = self.size;
        Ok(Svg { width, height, label: self.label.clone(), body })
    }

    /// Entries of the legend for its named lines.
    pub fn legend(&self) -> Vec<Entry> {
        let named = self.lines.iter().filter(|line| !line.name.is_empty());
        let marked = |line: &Line| matches!(line.shape, Shape::Marked | Shape::Dots);
        named.map(|line| Entry { name: line.name.clone(), ink: line.ink, marked: marked(line) }).collect()
    }

    fn draw(&self, area: &Area<'_>) -> Result<(), Box<dyn std::error::Error>> {
        let [left, bottom, top, right] = if self.bare() { [8.0, 8.0, MARGINS[2], 8.0] } else { MARGINS };
        area.draw(&Text::new(self.title.clone(), (units(2.0), units(3.0)), letters(TITLE_SIZE, Ink::Text)))?;
        let [[x0, x1], [y0, y1]] = self.ranges((self.size.0 - left - right, self.size.1 - top - bottom));
        let mut context = ChartBuilder::on(area)
            .margin_top(units(top))
            .margin_right(units(right))
            .margin_left(units(if self.bare() { left } else { 0.0 }))
            .margin_bottom(units(if self.bare() { bottom } else { 0.0 }))
            .x_label_area_size(units(if self.bare() { 0.0 } else { bottom }))
            .y_label_area_size(units(if self.bare() { 0.0 } else { left }))
            .build_cartesian_2d(x0..x1, y0..y1)?;
        if !self.bare() {
            self.axes(&mut context, [x1 - x0, y1 - y0])?;
        }
        for line in &self.lines {
            draw_line(&mut context, line)?;
        }
        Ok(())
    }

    const fn bare(&self) -> bool {
        self.x.label.is_empty()
    }

    fn axes(&self, context: &mut Context<'_, '_>, spans: [f64; 2]) -> Result<(), Box<dyn std::error::Error>> {
        let decimals = spans.map(|span| (1.0 - span.log10().floor()).clamp(0.0, 6.0) as usize);
        let shown = move |value: f64, decimals: usize| {
            let text = format!("{value:.decimals$}");
            let text =
                if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text };
            if text == "-0" { "0".to_owned() } else { text.replace('-', "\u{2212}") }
        };
        context
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(stroke(Ink::Grid, 0.8))
            .axis_style(stroke(Ink::Muted, 1.0))
            .x_desc(self.x.label.as_str())
            .y_desc(self.y.label.as_str())
            .axis_desc_style(letters(LABEL_SIZE, Ink::Text))
            .label_style(letters(TICK_SIZE, Ink::Muted))
            .x_labels(6)
            .y_labels(6)
            .set_all_tick_mark_size(units(4.0))
            .x_label_formatter(&|value| shown(*value, decimals[0]))
            .y_label_formatter(&|value| shown(*value, decimals[1]))
            .draw()?;
        Ok(())
    }

    /// Ranges of both axes; with equal units the shorter one is widened around its middle.
    fn ranges(&self, (width, height): (f64, f64)) -> [[f64; 2]; 2] {
        let points = || self.lines.iter().flat_map(Line::finite);
        let spreads = self.lines.iter().flat_map(|line| line.spread.iter().flatten().copied());
        let x = self.x.span(points().map(|point| point[0]));
        let y = self.y.span(points().map(|point| point[1]).chain(spreads.filter(|value| value.is_finite())));
        if !self.equal {
            return [x, y];
        }
        let per_pixel = ((x[1] - x[0]) / width).max((y[1] - y[0]) / height);
        let widened = |[low, high]: [f64; 2], pixels: f64| {
            let (middle, half) = (0.5 * (low + high), 0.5 * per_pixel * pixels);
            [middle - half, middle + half]
        };
        [widened(x, width), widened(y, height)]
    }
}

fn draw_line(context: &mut Context<'_, '_>, line: &Line) -> Result<(), Box<dyn std::error::Error>> {
    if line.shape == Shape::Banded {
        band(context, line)?;
    }
    let width = if line.shape == Shape::Thin { WHISKER } else { LINE };
    if line.shape != Shape::Dots {
        for run in line.points.split(|point| !point.iter().all(|value| value.is_finite())) {
            let points: Vec<(f64, f64)> = run.iter().map(|[x, y]| (*x, *y)).collect();
            context.draw_series([PathElement::new(points, stroke(line.ink, width))])?;
        }
    }
    if matches!(line.shape, Shape::Marked | Shape::Dots) {
        markers(context, line)?;
    }
    Ok(())
}

/// The area between the lower and the upper end of the spread.
fn band(context: &mut Context<'_, '_>, line: &Line) -> Result<(), Box<dyn std::error::Error>> {
    let ends = || line.points.iter().zip(&line.spread);
    let upper = ends().map(|(point, spread)| (point[0], spread[1]));
    let lower = ends().rev().map(|(point, spread)| (point[0], spread[0]));
    let corners: Vec<(f64, f64)> = upper.chain(lower).collect();
    context.draw_series([Polygon::new(corners, colour(line.ink).mix(BAND).filled())])?;
    Ok(())
}

fn markers(context: &mut Context<'_, '_>, line: &Line) -> Result<(), Box<dyn std::error::Error>> {
    for (index, [x, y]) in line.points.iter().copied().enumerate().filter(|(_, [_, y])| y.is_finite()) {
        if let Some([low, high]) = line.spread.get(index).copied() {
            let whisker = stroke(line.ink, WHISKER);
            context.draw_series([PathElement::new(vec![(x, low), (x, high)], whisker)])?;
            let bar = |y: f64| EmptyElement::at((x, y)) + PathElement::new(vec![(-BAR, 0), (BAR, 0)], whisker);
            context.draw_series([bar(low), bar(high)])?;
        }
        let corners: Vec<(i32, i32)> =
            line.ink.marker().iter().map(|(x, y)| ((x * UNITS) as i32, (y * UNITS) as i32)).collect();
        context.draw_series([EmptyElement::at((x, y)) + Polygon::new(corners, colour(line.ink).filled())])?;
    }
    Ok(())
}

const fn units(pixels: f64) -> i32 {
    (pixels * UNITS) as i32
}

const fn colour(ink: Ink) -> RGBColor {
    RGBColor(ink.code(), 0, 0)
}

fn stroke(ink: Ink, width: f64) -> ShapeStyle {
    colour(ink).stroke_width((width * UNITS) as u32)
}

fn letters(size: f64, ink: Ink) -> TextStyle<'static> {
    let anchor = Pos::new(HPos::Left, VPos::Top);
    ("sans-serif", size * UNITS).into_font().color(&colour(ink)).pos(anchor)
}
