//! What is drawn with which colour, dash and marker.
//!
//! Colours of methods are those of M. Okabe and K. Ito, "Color universal design" (2008), told apart by people who see
//! two primary colours only; each also has its own dash and marker, so nothing depends on colour alone. Yellow is left
//! out because it vanishes on paper.

/// Colours of methods on white: blue, vermilion, bluish green, reddish purple, orange, sky blue.
const HUES: [[u8; 3]; 6] = [[0, 114, 178], [213, 94, 0], [0, 158, 115], [204, 121, 167], [230, 159, 0], [86, 180, 233]];

/// Dashes of methods, pixels; the sixth colour is reached before the seventh dash repeats the first.
const DASHES: [&str; 6] = ["", "7 3", "2 2.5", "9 3 2 3", "12 3", "5 2 2 2 2 2"];

/// Radius of markers, pixels.
const RADIUS: f64 = 3.8;

/// A colour with a meaning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ink {
    /// Letters.
    Text,
    /// Axes and what should stand back.
    Muted,
    /// Grid lines and shadows.
    Grid,
    /// The truth.
    Truth,
    /// A method by its position.
    Method(usize),
}

impl Ink {
    /// Colour on white paper.
    pub const fn rgb(self) -> [u8; 3] {
        match self {
            Self::Text => [26, 26, 26],
            Self::Muted => [97, 97, 97],
            Self::Grid => [222, 222, 222],
            Self::Truth => [0, 0, 0],
            Self::Method(index) => HUES[index % HUES.len()],
        }
    }

    /// Class by which the page recolours it: `s-` for strokes, `f-` for fills in front.
    pub fn class(self) -> String {
        match self {
            Self::Text => "text".into(),
            Self::Muted => "muted".into(),
            Self::Grid => "grid".into(),
            Self::Truth => "truth".into(),
            Self::Method(index) => format!("m{}", index % HUES.len()),
        }
    }

    /// Dash of its lines, as SVG writes it; empty for whole lines.
    pub const fn dash(self) -> &'static str {
        match self {
            // After six methods colours repeat; the dash is moved on by one, so pairs of both are new.
            Self::Method(index) => DASHES[(index + index / HUES.len()) % DASHES.len()],
            Self::Muted => "3 3",
            _ => "",
        }
    }

    /// Corners of its marker around the origin, pixels.
    pub fn marker(self) -> Vec<(f64, f64)> {
        let (corners, turn) = match self {
            Self::Method(index) => [(16, 0.0), (4, 0.125), (3, 0.25), (4, 0.0), (3, 0.75), (5, 0.25)][index % 6],
            _ => (16, 0.0),
        };
        let corner = |index: i32| {
            let (sin, cos) = (std::f64::consts::TAU * (f64::from(index) / f64::from(corners) - turn)).sin_cos();
            (RADIUS * cos, RADIUS * sin)
        };
        (0..corners).map(corner).collect()
    }

    /// Number under which plotters carries it in place of a colour.
    pub(super) const fn code(self) -> u8 {
        match self {
            Self::Text => 0,
            Self::Muted => 1,
            Self::Grid => 2,
            Self::Truth => 3,
            // More than 250 methods share the last number; no reader could tell them apart.
            Self::Method(index) => {
                if index < 250 {
                    4 + index as u8
                } else {
                    254
                }
            }
        }
    }

    /// The ink of a number.
    pub(super) const fn of_code(code: u8) -> Self {
        match code {
            0 => Self::Text,
            1 => Self::Muted,
            2 => Self::Grid,
            3 => Self::Truth,
            method => Self::Method(method as usize - 4),
        }
    }
}
