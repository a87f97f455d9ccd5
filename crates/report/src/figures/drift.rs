//! Errors of sub-trajectories: how drift grows with the way and with the turns.

use super::{CHART, Csv, inked, unit};
use crate::ReportError;
use crate::figure::{Axis, Chart, Figure, Ink, Line, Shape};
use crate::study::{MotionStudy, SequenceStudy};
use crate::table::length_unit;
use endoscape_eval::segments::{LengthErrors, TurnErrors};
use endoscape_eval::trajectory::TrajectoryErrors;

/// Methods at one length are drawn this share of the distance between lengths apart.
const DODGE: f64 = 0.09;

/// A baseline this many times above the highest whisker would squash the methods; it is named instead.
const SQUASHING: f64 = 1.6;

/// One length or turn: where, mean, standard deviation.
struct Point {
    at: f64,
    mean: f64,
    std: f64,
}

/// How a panel takes its points from the errors of a trajectory.
type Pick = fn(&TrajectoryErrors) -> Vec<Point>;

/// One panel: its words, its units and where its points come from.
struct Panel<'a> {
    title: &'a str,
    x: &'a str,
    y: &'a str,
    /// From metres (or degrees) to the units of the axes.
    factors: [f64; 2],
    pick: Pick,
}

/// Errors against the length of the path: the figure of the capsule papers and of KITTI.
pub fn by_length(sequence: &SequenceStudy) -> Result<Option<Figure>, ReportError> {
    let longest = judged(sequence).flat_map(|motion| &motion.evaluation.errors.segments);
    let longest_m = longest.map(|errors| errors.length_m).fold(0.0, f64::max);
    if longest_m == 0.0 {
        return Ok(None);
    }
    let (unit, factor) = length_unit(longest_m);
    let x = format!("path length [{unit}]");
    let translation = Panel {
        title: "Translation",
        x: &x,
        y: "translational error [% of length]",
        factors: [factor, 1.0],
        pick: |errors| errors.segments.iter().map(translation_percent).collect(),
    };
    let rotation = Panel {
        title: "Rotation",
        y: "rotational error [deg]",
        pick: |errors| errors.segments.iter().map(rotation_deg).collect(),
        ..translation
    };
    let lead = "Mean error at the end of all sub-trajectories of a length, with the standard deviation over them as \
                whiskers (cut at zero).";
    let names = ["drift-by-length", "Error against path length", lead];
    figure(sequence, names, &[translation, rotation], by_length_csv(sequence)).map(Some)
}

/// Errors against the rotation gone through.
pub fn by_turn(sequence: &SequenceStudy) -> Result<Option<Figure>, ReportError> {
    if judged(sequence).all(|motion| motion.evaluation.errors.turns.is_empty()) {
        return Ok(None);
    }
    let (unit, factor) = unit(sequence);
    let y = format!("translational error [{unit}]");
    let translation = Panel {
        title: "Translation",
        x: "accumulated rotation [deg]",
        y: &y,
        factors: [1.0, factor],
        pick: |errors| {
            let point = |turn: &TurnErrors| Point {
                at: turn.turned_deg,
                mean: turn.translation_m,
                std: turn.translation_m_std,
            };
            errors.turns.iter().map(point).collect()
        },
    };
    let rotation = Panel {
        title: "Rotation",
        y: "rotational error [deg]",
        factors: [1.0, 1.0],
        pick: |errors| {
            let point =
                |turn: &TurnErrors| Point { at: turn.turned_deg, mean: turn.rotation_deg, std: turn.rotation_deg_std };
            errors.turns.iter().map(point).collect()
        },
        ..translation
    };
    let lead = "The same for sub-trajectories in which the camera turns by a given angle in all.";
    let names = ["drift-by-rotation", "Error against accumulated rotation", lead];
    figure(sequence, names, &[translation, rotation], by_turn_csv(sequence)).map(Some)
}

fn translation_percent(errors: &LengthErrors) -> Point {
    let std = 100.0 * errors.translation_m_std / errors.length_m;
    Point { at: errors.length_m, mean: errors.translation_percent, std }
}

fn rotation_deg(errors: &LengthErrors) -> Point {
    Point { at: errors.length_m, mean: errors.rotation_deg, std: errors.rotation_deg_std }
}

fn figure(
    sequence: &SequenceStudy,
    [id, title, lead]: [&str; 3],
    panels: &[Panel<'_>],
    csv: String,
) -> Result<Figure, ReportError> {
    let charts: Vec<Chart> = panels.iter().map(|panel| chart(sequence, panel)).collect();
    let widest = charts.iter().map(Chart::legend).max_by_key(Vec::len).unwrap_or_default();
    Ok(Figure {
        id: id.to_owned(),
        title: title.to_owned(),
        caption: format!("{lead} {}", baseline_note(&charts)),
        legend: widest,
        panels: charts.iter().map(Chart::svg).collect::<Result<_, _>>()?,
        columns: 2,
        csv,
    })
}

fn judged(sequence: &SequenceStudy) -> impl Iterator<Item = &MotionStudy> {
    sequence.methods.iter().filter_map(|method| method.motion.as_ref())
}

fn baseline_note(charts: &[Chart]) -> &'static str {
    let shown = charts.iter().filter(|chart| chart.lines.iter().any(|line| line.ink == Ink::Muted)).count();
    match shown {
        0 => "Constant motion lies above the panels; the tables give it.",
        shown if shown < charts.len() => {
            "The grey line is constant motion, the best answer that looks at no picture; where it is not drawn it lies \
             above the panel."
        }
        _ => "The grey line is constant motion, the best answer that looks at no picture.",
    }
}

fn chart(sequence: &SequenceStudy, panel: &Panel<'_>) -> Chart {
    let [x_factor, y_factor] = panel.factors;
    let first = judged(sequence).map(|motion| (panel.pick)(&motion.evaluation.errors)).max_by_key(Vec::len);
    let at: Vec<f64> = first.iter().flatten().map(|point| point.at * x_factor).collect();
    let (nearest, farthest) = (at.first().copied().unwrap_or(0.0), at.last().copied().unwrap_or(1.0));
    let step = if at.len() > 1 { (farthest - nearest) / (at.len() - 1) as f64 } else { nearest };
    let middle = 0.5 * sequence.methods.len().saturating_sub(1) as f64;
    let mut lines: Vec<Line> = Vec::new();
    for (index, (ink, method)) in inked(sequence).enumerate() {
        let Some(motion) = &method.motion else { continue };
        let shift = (index as f64 - middle) * DODGE * step;
        let points = (panel.pick)(&motion.evaluation.errors);
        let ends =
            |point: &Point| [(point.mean - point.std).max(0.0), point.mean + point.std].map(|end| end * y_factor);
        let spread = points.iter().map(ends).collect();
        let points = points.iter().map(|point| [point.at * x_factor + shift, point.mean * y_factor]).collect();
        lines.push(Line { spread, ..Line::new(method.name.clone(), ink, Shape::Marked, points) });
    }
    lines.splice(0..0, constant_motion(sequence, panel, &lines));
    Chart {
        title: panel.title.to_owned(),
        label: format!("{}: {} over {}, one line with whiskers per method.", panel.title, panel.y, panel.x),
        x: Axis::over(panel.x, [nearest - 0.5 * step, farthest + 0.5 * step]),
        y: Axis::from_zero(panel.y),
        lines,
        equal: false,
        size: CHART,
    }
}

/// The line of constant motion, where it does not squash those of the methods.
fn constant_motion(sequence: &SequenceStudy, panel: &Panel<'_>, methods: &[Line]) -> Option<Line> {
    let highest = methods.iter().flat_map(|line| line.spread.iter().map(|spread| spread[1])).fold(0.0, f64::max);
    let points = (panel.pick)(&judged(sequence).next()?.evaluation.baselines.constant);
    let points = points.iter().map(|point| [point.at * panel.factors[0], point.mean * panel.factors[1]]);
    let points: Vec<[f64; 2]> = points.collect();
    let fits = points.iter().all(|point| point[1] <= SQUASHING * highest);
    fits.then(|| Line::new("constant motion", Ink::Muted, Shape::Joined, points))
}

/// The methods and, by the name of the baseline, what looks at no picture.
fn answers(sequence: &SequenceStudy) -> Vec<(String, &TrajectoryErrors)> {
    let methods = sequence.methods.iter().filter_map(|method| Some((method.name.clone(), method.motion.as_ref()?)));
    let mut answers: Vec<_> = methods.map(|(name, motion)| (name, &motion.evaluation.errors)).collect();
    if let Some(motion) = judged(sequence).next() {
        answers.push(("constant motion".to_owned(), &motion.evaluation.baselines.constant));
    }
    answers
}

fn by_length_csv(sequence: &SequenceStudy) -> String {
    let mut csv = Csv::new(&[
        "method",
        "length_m",
        "count",
        "translation_m",
        "translation_m_std",
        "translation_m_low95",
        "translation_m_high95",
        "translation_percent",
        "rotation_deg",
        "rotation_deg_std",
        "rotation_deg_low95",
        "rotation_deg_high95",
    ]);
    for (name, errors) in answers(sequence) {
        for row in &errors.segments {
            let numbers = [
                row.length_m,
                row.count as f64,
                row.translation_m,
                row.translation_m_std,
                row.translation_m_ci95[0],
                row.translation_m_ci95[1],
                row.translation_percent,
                row.rotation_deg,
                row.rotation_deg_std,
                row.rotation_deg_ci95[0],
                row.rotation_deg_ci95[1],
            ];
            csv.push(std::iter::once(name.clone()).chain(numbers.map(|number| number.to_string())));
        }
    }
    csv.text()
}

fn by_turn_csv(sequence: &SequenceStudy) -> String {
    let mut csv = Csv::new(&[
        "method",
        "turned_deg",
        "count",
        "translation_m",
        "translation_m_std",
        "rotation_deg",
        "rotation_deg_std",
    ]);
    for (name, errors) in answers(sequence) {
        for row in &errors.turns {
            let numbers = [
                row.turned_deg,
                row.count as f64,
                row.translation_m,
                row.translation_m_std,
                row.rotation_deg,
                row.rotation_deg_std,
            ];
            csv.push(std::iter::once(name.clone()).chain(numbers.map(|number| number.to_string())));
        }
    }
    csv.text()
}
