//! What happens along the sequence: errors, and how sure the method was.

use super::{Csv, inked, unit};
use crate::ReportError;
use crate::figure::{Axis, Chart, Figure, Line, Shape};
use crate::study::{MotionStudy, SequenceStudy};

/// A wide panel, pixels.
const WIDE: (f64, f64) = (520.0, 280.0);

/// Errors of position and rotation along time.
pub fn errors(sequence: &SequenceStudy) -> Result<Option<Figure>, ReportError> {
    let judged: Vec<_> =
        inked(sequence).filter_map(|(ink, method)| Some((ink, &method.name, method.motion.as_ref()?))).collect();
    let Some((_, _, first)) = judged.first() else { return Ok(None) };
    let (unit, factor) = unit(sequence);
    let x = if first.trace.in_seconds { "time [s]" } else { "frame" };
    let start = if first.trace.in_seconds { first.trace.stamps.first().copied().unwrap_or_default() } else { 0.0 };
    let line = |errors: fn(&MotionStudy) -> &[f64], factor: f64| -> Vec<Line> {
        let line = |(ink, name, motion): &(_, &String, &MotionStudy)| {
            let points = broken(motion, start, errors(motion), factor);
            Line::new((*name).clone(), *ink, Shape::Joined, points)
        };
        judged.iter().map(line).collect()
    };
    let chart = |title: &str, y: String, lines: Vec<Line>| Chart {
        title: title.to_owned(),
        label: format!("{title}: {y} over {x}, one line per method."),
        x: Axis::new(x),
        y: Axis::from_zero(y),
        lines,
        equal: false,
        size: WIDE,
    };
    let charts = [
        chart("Position", format!("error [{unit}]"), line(|motion| &motion.trace.absolute.translation_m, factor)),
        chart(
            "Orientation",
            "error [deg]".to_owned(),
            line(|motion| &motion.trace.absolute.rotation_rad, 1_f64.to_degrees()),
        ),
    ];
    Ok(Some(Figure {
        id: "error-along-time".to_owned(),
        title: "Error along the sequence".to_owned(),
        caption: "Distance of each aligned position from the true one, and angle between the orientations. A line is \
                  interrupted where frames are missing. Errors here are after one alignment of the whole path, so they \
                  need not start at zero."
            .to_owned(),
        legend: charts[0].legend(),
        panels: charts.iter().map(Chart::svg).collect::<Result<_, _>>()?,
        columns: 2,
        csv: errors_csv(&judged.iter().map(|(_, name, motion)| (*name, *motion)).collect::<Vec<_>>()),
    }))
}

/// Points of a line, interrupted where frames are missing.
fn broken(motion: &MotionStudy, start: f64, errors: &[f64], factor: f64) -> Vec<[f64; 2]> {
    let mut points = Vec::with_capacity(errors.len());
    for ((stamp, gap), error) in motion.trace.stamps.iter().zip(&motion.trace.after_gap).zip(errors) {
        if *gap {
            points.push([f64::NAN; 2]);
        }
        points.push([stamp - start, error * factor]);
    }
    points
}

fn errors_csv(judged: &[(&String, &MotionStudy)]) -> String {
    let mut csv = Csv::new(&["method", "stamp", "travelled_m", "translation_m", "rotation_deg"]);
    for (name, motion) in judged {
        let trace = &motion.trace;
        for index in 0..trace.stamps.len() {
            let numbers = [
                trace.stamps[index],
                trace.travelled_m[index],
                trace.absolute.translation_m[index],
                trace.absolute.rotation_rad[index].to_degrees(),
            ];
            csv.push(std::iter::once((*name).clone()).chain(numbers.map(|number| number.to_string())));
        }
    }
    csv.text()
}

/// Confidence and latency of runs along time.
pub fn confidence(sequence: &SequenceStudy) -> Result<Option<Figure>, ReportError> {
    let mut csv = Csv::new(&["method", "frame", "time_s", "tracked", "confidence", "latency_ms"]);
    let (mut sure, mut slow) = (Vec::new(), Vec::new());
    for (ink, method) in inked(sequence) {
        let Some(run) = &method.run else { continue };
        let (mut confidences, mut latencies) = (Vec::new(), Vec::new());
        for frame in &run.frames {
            let number = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
            csv.push([
                method.name.clone(),
                frame.index.to_string(),
                frame.time_s.to_string(),
                frame.tracked.to_string(),
                number(frame.confidence),
                number(frame.latency_ms),
            ]);
            confidences.push([frame.time_s, frame.confidence.filter(|_| frame.tracked).unwrap_or(f64::NAN)]);
            latencies.push([frame.time_s, frame.latency_ms.unwrap_or(f64::NAN)]);
        }
        let known = |points: &[[f64; 2]]| points.iter().any(|point| point[1].is_finite());
        if known(&confidences) {
            sure.push(Line::new(method.name.clone(), ink, Shape::Joined, confidences));
        }
        if known(&latencies) {
            slow.push(Line::new(method.name.clone(), ink, Shape::Joined, latencies));
        }
    }
    let chart = |title: &str, y: Axis, lines: Vec<Line>| Chart {
        title: title.to_owned(),
        label: format!("{title} over time, one line per method."),
        x: Axis::new("time [s]"),
        y,
        lines,
        equal: false,
        size: WIDE,
    };
    let charts = [
        chart("Confidence", Axis::over("confidence", [0.0, 1.05]), sure),
        chart("Latency", Axis::from_zero("time per frame [ms]"), slow),
    ];
    let charts: Vec<&Chart> = charts.iter().filter(|chart| !chart.lines.is_empty()).collect();
    let Some(first) = charts.first() else { return Ok(None) };
    Ok(Some(Figure {
        id: "confidence-along-time".to_owned(),
        title: "Confidence and latency along the sequence".to_owned(),
        caption: "How sure the method was of each pose and how long each frame took. Frames without a pose interrupt \
                  the line of confidence."
            .to_owned(),
        legend: first.legend(),
        panels: charts.iter().map(|chart| chart.svg()).collect::<Result<_, _>>()?,
        columns: 2,
        csv: csv.text(),
    }))
}
