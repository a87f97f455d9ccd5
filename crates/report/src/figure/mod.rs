//! Figures as data: panels drawn once, used in the page, as files, and beside the table of what they show.
//!
//! ```text
//! Chart (lines, axes) -> plotters -> canvas -> Svg     pictures -> pictures::grid -> Svg
//! Figure { panels, legend, csv } -> html (inline, themed)    \-> Figure::svg -> raster::png
//! ```
//!
//! Every shape carries its colour twice: as an attribute, for files, and as a class, by which the page adapts it to a
//! light or a dark screen.

pub mod canvas;
pub mod chart;
pub mod ink;
pub mod pictures;
pub mod raster;

pub use chart::{Axis, Chart, Line, Shape};
pub use ink::Ink;

use canvas::{escape, text};
use std::fmt::Write as _;

/// Space around and between the panels of a figure in a file, pixels.
const GAP: f64 = 16.0;

/// Height of a row of the legend, pixels.
const LEGEND_ROW: f64 = 22.0;

/// Width of the piece of line in the legend, pixels.
const SWATCH: f64 = 30.0;

/// Mean width of a letter as a share of the size of the font.
const LETTER: f64 = 0.56;

/// Size of letters in the legend, pixels.
const LEGEND_SIZE: f64 = 13.0;

/// A drawing: its elements and the size they are made for, in pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct Svg {
    /// Width in pixels.
    pub width: f64,
    /// Height in pixels.
    pub height: f64,
    /// What it shows, for those who cannot see it.
    pub label: String,
    /// SVG elements.
    pub body: String,
}

/// One entry of a legend.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// What the line is.
    pub name: String,
    /// How it is drawn.
    pub ink: Ink,
    /// Whether its points carry markers.
    pub marked: bool,
}

/// Panels that belong together.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// Name of its files and anchor in the page.
    pub id: String,
    /// Headline.
    pub title: String,
    /// What is drawn and how to read it.
    pub caption: String,
    /// The panels, row by row.
    pub panels: Vec<Svg>,
    /// Panels side by side in a file.
    pub columns: usize,
    /// What the lines are.
    pub legend: Vec<Entry>,
    /// The numbers behind it, with a head line; empty for pictures.
    pub csv: String,
}

impl Figure {
    /// The whole figure as one SVG document with a white ground.
    pub fn svg(&self) -> String {
        let cell = (
            self.panels.iter().map(|panel| panel.width).fold(0.0, f64::max),
            self.panels.iter().map(|panel| panel.height).fold(0.0, f64::max),
        );
        let columns = self.columns.clamp(1, self.panels.len().max(1));
        let width = columns as f64 * (cell.0 + GAP) + GAP;
        let (legend, top) = self.legend_row(width);
        let rows = self.panels.len().div_ceil(columns);
        let height = top + rows as f64 * (cell.1 + GAP) + GAP;
        let mut body = legend;
        for (index, panel) in self.panels.iter().enumerate() {
            let x = GAP + (index % columns) as f64 * (cell.0 + GAP);
            let y = top + GAP + (index / columns) as f64 * (cell.1 + GAP);
            // Writing to a String cannot fail.
            write!(body, "<g transform=\"translate({x} {y})\">{}</g>", panel.body).ok();
        }
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\" font-family=\"DejaVu Sans, sans-serif\"><title>{}</title>\
             <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>{body}</svg>\n",
            escape(&self.title)
        )
    }

    /// The legend in rows that fit into `width`, and where the panels begin below it.
    fn legend_row(&self, width: f64) -> (String, f64) {
        let (mut body, mut x, mut row) = (String::new(), GAP, 0.0);
        for entry in &self.legend {
            let needed = SWATCH + 8.0 + entry.name.chars().count() as f64 * LETTER * LEGEND_SIZE + 20.0;
            if x > GAP && x + needed > width - GAP {
                (x, row) = (GAP, row + 1.0);
            }
            let y = GAP + LEGEND_ROW * row;
            body.push_str(&swatch(entry, (x, y + 0.5 * LEGEND_ROW)));
            body.push_str(&text((x + SWATCH + 8.0, y + 0.5 * LEGEND_ROW + 4.5), &entry.name, LEGEND_SIZE, Ink::Text));
            x += needed;
        }
        let rows = if self.legend.is_empty() { 0.0 } else { row + 1.0 };
        (body, rows * LEGEND_ROW + if rows > 0.0 { 0.5 * GAP } else { 0.0 })
    }
}

/// The piece of line (and marker) that stands for an entry, its middle left at `at`.
pub fn swatch(entry: &Entry, at: (f64, f64)) -> String {
    let line = canvas::polyline(&[at, (at.0 + SWATCH, at.1)], entry.ink, chart::LINE, 1.0, true);
    if !entry.marked {
        return line;
    }
    let centre = (at.0 + 0.5 * SWATCH, at.1);
    let corners: Vec<(f64, f64)> = entry.ink.marker().iter().map(|(x, y)| (centre.0 + x, centre.1 + y)).collect();
    line + &canvas::polygon(&corners, entry.ink, 1.0)
}
