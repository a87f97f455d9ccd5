//! Errors of sub-trajectories: how drift grows with the way and with the turns.

use super::{CHART, Csv, inked, unit};
use crate::ReportError;
use crate::figure::{Axis, Chart, Figure, Ink, Line, Shape};
use crate::study::{MotionStudy, SequenceStudy};
use crate::table::length_unit;
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

/// Errors against the length of the path: the figure of the capsule papers and of KITTI.
pub fn by_length(sequence: &SequenceStudy) -> Result<Option<Figure>, ReportError> {
    let longest = judged(sequence).flat_map(|motion| &motion.evaluation.errors.segments);
    let longest_m = longest.map(|errors| errors.length_m).fold(0.0, f64::max);
    if longest_m == 0.0 {
        return Ok(None);
    }
    let (length_unit, length_factor) = length_unit(longest_m);
    let translation: Pick = |errors| {
        let point = |errors: &endoscape_eval::segments::LengthErrors| Point {
            at: errors.length_m,
            mean: errors.translation_percent,
            std: 100.0 * errors.translation_m_std / errors.length_m,
        };
        errors.segments.iter().map(point).collect()
    };
    let rotation: Pick = |errors| {
        let point = |errors: &endoscape_eval::segments::LengthErrors| Point {
            at: errors.length_m,
            mean: errors.rotation_deg,
            std: errors.rotation_deg_std,
        };
        errors.segments.iter().map(point).collect()
    };
    let x = format!("path length [{length_unit}]");
    let panels = [
        ("Translation", "translational error [% of length]", translation),
        ("Rotation", "rotational error [deg]", rotation),
    ];
    let charts = panels.map(|(title, y, pick)| chart(sequence, title, &x, y, length_factor, pick));
    Ok(Some(Figure {
        id: "drift-by-length".to_owned(),
        title: "Error against path length".to_owned(),
        caption: format!(
            "Mean error at the end of all sub-trajectories of a length, with the standard deviation over them as \
             whiskers (cut at zero). {}",
            baseline_note(&charts)
        ),
        legend: charts[0].legend(),
        panels: charts.iter().map(Chart::svg).collect::<Result<_, _>>()?,
        columns: 2,
        csv: by_length_csv(sequence),
    }))
}

/// Errors against the rotation gone through.
pub fn by_turn(sequence: &SequenceStudy) -> Result<Option<Figure>, ReportError> {
    if judged(sequence).all(|motion| motion.evaluation.errors.turns.is_empty()) {
        return Ok(None);
    }
    let (unit, factor) = unit(sequence);
    let rotation: Pick = |errors| {
        let point = |errors: &endoscape_eval::segments::TurnErrors| Point {
            at: errors.turned_deg,
            mean: errors.rotation_deg,
            std: errors.rotation_deg_std,
        };
        errors.turns.iter().map(point).collect()
    };
    let translation_mm: Pick = |errors| {
        let point = |errors: &endoscape_eval::segments::TurnErrors| Point {
            at: errors.turned_deg,
            mean: errors.translation_m,
            std: errors.translation_m_std,
        };
        errors.turns.iter().map(point).collect()
    };
    let x = "accumulated rotation [deg]";
    let mut turned = chart(sequence, "Rotation", x, "rotational error [deg]", 1.0, rotation);
    let mut moved = chart(sequence, "Translation", x, &format!("translational error [{unit}]"), 1.0, translation_mm);
    for line in &mut moved.lines {
        line.points.iter_mut().for_each(|point| point[1] *= factor);
        line.spread.iter_mut().for_each(|spread| *spread = spread.map(|value| value * factor));
    }
    turned.label.push_str(" Against accumulated rotation.");
    let charts = [turned, moved];
    Ok(Some(Figure {
        id: "drift-by-rotation".to_owned(),
        title: "Error against accumulated rotation".to_owned(),
        caption: format!(
            "The same for sub-trajectories in which the camera turns by a given angle in all. {}",
            baseline_note(&charts)
        ),
        legend: charts[0].legend(),
        panels: charts.iter().map(Chart::svg).collect::<Result<_, _>>()?,
        columns: 2,
        csv: by_turn_csv(sequence),
    }))
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

fn chart(sequence: &SequenceStudy, title: &str, x: &str, y: &str, factor: f64, pick: Pick) -> Chart {
    let all: Vec<f64> =
        judged(sequence).flat_map(|motion| pick(&motion.evaluation.errors)).map(|point| point.at).collect();
    let farthest = all.iter().copied().fold(0.0, f64::max) * factor;
    let nearest = all.iter().copied().fold(f64::INFINITY, f64::min) * factor;
    let step = (farthest - nearest) / (all.len() / judged(sequence).count().max(1)).saturating_sub(1).max(1) as f64;
    let step = if step > 0.0 { step } else { nearest };
    let middle = 0.5 * sequence.methods.len().saturating_sub(1) as f64;
    let mut lines: Vec<Line> = Vec::new();
    for (index, (ink, method)) in inked(sequence).enumerate() {
        let Some(motion) = &method.motion else { continue };
        let shift = (index as f64 - middle) * DODGE * step;
        let points = pick(&motion.evaluation.errors);
        let spread = points.iter().map(|point| [(point.mean - point.std).max(0.0), point.mean + point.std]).collect();
        let points = points.iter().map(|point| [point.at * factor + shift, point.mean]).collect();
        lines.push(Line { spread, ..Line::new(method.name.clone(), ink, Shape::Marked, points) });
    }
    let highest = lines.iter().flat_map(|line| line.spread.iter().map(|spread| spread[1])).fold(0.0, f64::max);
    if let Some(motion) = judged(sequence).next() {
        let points = pick(&motion.evaluation.baselines.constant);
        if points.iter().all(|point| point.mean <= SQUASHING * highest) {
            let points = points.iter().map(|point| [point.at * factor, point.mean]).collect();
            lines.insert(0, Line::new("constant motion", Ink::Muted, Shape::Joined, points));
        }
    }
    Chart {
        title: title.to_owned(),
        label: format!(
            "{title}: {y} over {x} for {}.",
            sequence.methods.iter().map(|method| method.name.as_str()).collect::<Vec<_>>().join(", ")
        ),
        x: Axis::over(x, [nearest - 0.5 * step, farthest + 0.5 * step]),
        y: Axis::from_zero(y),
        lines,
        equal: false,
        size: CHART,
    }
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
