//! The figures of a report, each made from a [`crate::study::Study`].

mod along;
mod drift;
mod maps;
mod paths;
mod quality;

use crate::ReportError;
use crate::figure::{Figure, Ink};
use crate::study::SequenceStudy;
use crate::table::length_unit;

/// Size of a chart, pixels.
const CHART: (f64, f64) = (520.0, 340.0);

/// All figures of one sequence; what has no data is left out.
///
/// # Errors
/// [`ReportError`] if a figure cannot be drawn.
pub fn of(sequence: &SequenceStudy, position: usize) -> Result<Vec<Figure>, ReportError> {
    let mut figures = Vec::new();
    figures.extend(paths::figure(sequence)?);
    figures.extend(drift::by_length(sequence)?);
    figures.extend(drift::by_turn(sequence)?);
    figures.extend(along::errors(sequence)?);
    figures.extend(along::confidence(sequence)?);
    figures.extend(maps::depth(sequence)?);
    figures.extend(maps::reliability(sequence)?);
    figures.extend(quality::masks(sequence)?);
    figures.extend(quality::calibration(sequence)?);
    figures.extend(quality::latency(sequence)?);
    for figure in &mut figures {
        // Names of files and anchors: those of the first sequence stay plain.
        figure.id = if position == 0 { figure.id.clone() } else { format!("{}-{}", figure.id, position + 1) };
    }
    Ok(figures)
}

/// Unit of lengths on this sequence and its factor: that of its path.
fn unit(sequence: &SequenceStudy) -> (&'static str, f64) {
    let path_m = |motion: &crate::study::MotionStudy| motion.evaluation.path_length_m;
    let judged = sequence.methods.iter().filter_map(|method| method.motion.as_ref()).map(path_m);
    let longest = judged.fold(0.0, f64::max);
    if longest > 0.0 { length_unit(longest) } else { ("m", 1.0) }
}

/// Methods with their position and colour.
fn inked(sequence: &SequenceStudy) -> impl Iterator<Item = (Ink, &crate::study::MethodStudy)> {
    sequence.methods.iter().enumerate().map(|(index, method)| (Ink::Method(index), method))
}

/// A table of numbers as comma-separated text.
struct Csv {
    writer: csv::Writer<Vec<u8>>,
}

impl Csv {
    fn new(head: &[&str]) -> Self {
        let mut csv = Self { writer: csv::Writer::from_writer(Vec::new()) };
        csv.push(head.iter().map(|cell| (*cell).to_owned()));
        csv
    }

    fn push(&mut self, cells: impl IntoIterator<Item = String>) {
        // Memory does not fail to be written to, and all rows of a figure are of one length.
        self.writer.write_record(cells.into_iter().collect::<Vec<_>>()).ok();
    }

    fn text(self) -> String {
        String::from_utf8(self.writer.into_inner().unwrap_or_default()).unwrap_or_default()
    }
}
