//! Whether methods know when they are wrong, how well their masks fit, and how long frames take.

use super::{CHART, Csv, inked};
use crate::ReportError;
use crate::figure::{Axis, Chart, Figure, Ink, Line, Shape};
use crate::study::{MethodStudy, SequenceStudy};
use endoscape_eval::calibration::Calibration;
use endoscape_eval::roc::{Roc, RocPoint};

/// Millimetres per metre.
const MILLIMETRES: f64 = 1e3;

/// Points a curve is thinned to.
const POINTS: usize = 400;

/// ROC of reliability maps.
pub fn masks(sequence: &SequenceStudy) -> Result<Option<Figure>, ReportError> {
    let roc = |method: &MethodStudy| method.masks.as_ref()?.roc.clone();
    let judged: Vec<(Ink, String, Roc)> =
        inked(sequence).filter_map(|(ink, method)| Some((ink, method.name.clone(), roc(method)?))).collect();
    if judged.is_empty() {
        return Ok(None);
    }
    let mut lines = vec![Line::new("chance", Ink::Muted, Shape::Joined, vec![[0.0, 0.0], [1.0, 1.0]])];
    let mut csv = Csv::new(&["method", "threshold", "false_positive_rate", "true_positive_rate"]);
    for (ink, name, roc) in &judged {
        let thinned = thin(&roc.points);
        for point in &thinned {
            let numbers = [point.threshold, point.false_positive_rate, point.true_positive_rate];
            csv.push(std::iter::once(name.clone()).chain(numbers.map(|number| number.to_string())));
        }
        let points = thinned.iter().map(|point| [point.false_positive_rate, point.true_positive_rate]);
        let points = std::iter::once([0.0, 0.0]).chain(points).collect();
        lines.push(Line::new(format!("{name} (AUC {:.3})", roc.auc), *ink, Shape::Joined, points));
    }
    let chart = Chart {
        title: "Reliability masks".to_owned(),
        label: "True positive rate over false positive rate of the reliability maps against the true masks.".to_owned(),
        x: Axis::over("false positive rate", [0.0, 1.0]),
        y: Axis::over("true positive rate", [0.0, 1.02]),
        lines,
        equal: false,
        size: (CHART.1 + 40.0, CHART.1),
    };
    Ok(Some(Figure {
        id: "mask-quality".to_owned(),
        title: "Quality of the reliability masks".to_owned(),
        caption: "Share of the usable pixels found against share of the unusable ones taken for usable, over all \
                  thresholds. The area under the curve is 1 for perfect masks and 0.5 for chance."
            .to_owned(),
        legend: chart.legend(),
        panels: vec![chart.svg()?],
        columns: 1,
        csv: csv.text(),
    }))
}

fn thin(points: &[RocPoint]) -> Vec<RocPoint> {
    let step = points.len().div_ceil(POINTS).max(1);
    let last = points.len().saturating_sub(1);
    points
        .iter()
        .enumerate()
        .filter(|(index, _)| index % step == 0 || *index == last)
        .map(|(_, point)| *point)
        .collect()
}

/// A method with its colour and how well its confidence fits.
type Judged = (Ink, String, Calibration);

/// Reliability curve and sparsification of confidences.
pub fn calibration(sequence: &SequenceStudy) -> Result<Option<Figure>, ReportError> {
    let of = |method: &MethodStudy| method.motion.as_ref()?.calibration.clone();
    let judged: Vec<Judged> =
        inked(sequence).filter_map(|(ink, method)| Some((ink, method.name.clone(), of(method)?))).collect();
    if judged.is_empty() {
        return Ok(None);
    }
    let charts = [sparsification(&judged), reliability(&judged)];
    Ok(Some(Figure {
        id: "calibration".to_owned(),
        title: "Does the method know when it is wrong?".to_owned(),
        caption:
            "Confidence of each frame beside the translational error of the motion that led to it. Left: the mean \
                  error that remains when the least confident frames are taken away; grey is the best order possible, \
                  and the area between the curves (AUSE) is 0 for a perfect one; chance is that of a confidence that says nothing. Right: mean error in twenty bins of \
                  equally many frames."
                .to_owned(),
        legend: charts[0].legend(),
        panels: charts.iter().map(Chart::svg).collect::<Result<_, _>>()?,
        columns: 2,
        csv: calibration_csv(&judged),
    }))
}

/// Share of the frames taken away at a step, percent.
fn removed_percent(calibration: &Calibration, step: usize) -> f64 {
    100.0 * step as f64 / calibration.sparsification.len() as f64
}

fn sparsification(judged: &[Judged]) -> Chart {
    let mut lines = Vec::new();
    for (ink, name, calibration) in judged {
        let curve = |values: &[f64]| {
            let point = |(step, value): (usize, &f64)| [removed_percent(calibration, step), *value];
            values.iter().enumerate().map(point).collect()
        };
        lines.push(Line::new("", Ink::Muted, Shape::Joined, curve(&calibration.oracle)));
        let name = format!("{name} (AUSE {:.3}, chance {:.3})", calibration.ause, calibration.ause_chance);
        lines.push(Line::new(name, *ink, Shape::Joined, curve(&calibration.sparsification)));
    }
    Chart {
        title: "Sparsification".to_owned(),
        label: "Mean error left after removing the least confident frames; lower is better.".to_owned(),
        x: Axis::over("least confident frames removed [%]", [0.0, 100.0]),
        y: Axis::from_zero("mean error left, relative"),
        lines,
        equal: false,
        size: CHART,
    }
}

fn reliability(judged: &[Judged]) -> Chart {
    let line = |(ink, name, calibration): &Judged| {
        let points = calibration.reliability.iter().map(|bin| [bin.confidence, MILLIMETRES * bin.error]).collect();
        Line::new(name.clone(), *ink, Shape::Marked, points)
    };
    Chart {
        title: "Reliability".to_owned(),
        label: "Mean error in bins of confidence; it should fall to the right.".to_owned(),
        x: Axis::new("mean confidence of the bin"),
        y: Axis::from_zero("mean error of the step [mm]"),
        lines: judged.iter().map(line).collect(),
        equal: false,
        size: CHART,
    }
}

fn calibration_csv(judged: &[Judged]) -> String {
    let head = ["method", "removed_percent", "error_left", "error_left_oracle", "bin_confidence", "bin_error_m"];
    let mut csv = Csv::new(&head);
    for (_, name, calibration) in judged {
        for (step, bin) in calibration.reliability.iter().enumerate() {
            let left = [calibration.sparsification[step], calibration.oracle[step]];
            let numbers = [removed_percent(calibration, step), left[0], left[1], bin.confidence, bin.error];
            csv.push(std::iter::once(name.clone()).chain(numbers.map(|number| number.to_string())));
        }
    }
    csv.text()
}

/// Share of frames done within a time.
pub fn latency(sequence: &SequenceStudy) -> Result<Option<Figure>, ReportError> {
    let mut csv = Csv::new(&["method", "latency_ms", "share"]);
    let mut lines = Vec::new();
    for (ink, method) in inked(sequence) {
        let Some(run) = &method.run else { continue };
        let mut sorted: Vec<f64> = run.frames.iter().filter_map(|frame| frame.latency_ms).collect();
        sorted.sort_by(f64::total_cmp);
        let mut points = Vec::new();
        for (index, latency_ms) in sorted.iter().enumerate() {
            let (below, share) = (index as f64 / sorted.len() as f64, (index + 1) as f64 / sorted.len() as f64);
            points.extend([[*latency_ms, 100.0 * below], [*latency_ms, 100.0 * share]]);
            csv.push([method.name.clone(), latency_ms.to_string(), share.to_string()]);
        }
        if !points.is_empty() {
            lines.push(Line::new(method.name.clone(), ink, Shape::Joined, points));
        }
    }
    if lines.is_empty() {
        return Ok(None);
    }
    let chart = Chart {
        title: "Latency".to_owned(),
        label: "Share of frames done within a time.".to_owned(),
        x: Axis::from_zero("time per frame [ms]"),
        y: Axis::over("frames done [%]", [0.0, 102.0]),
        lines,
        equal: false,
        size: CHART,
    };
    Ok(Some(Figure {
        id: "latency".to_owned(),
        title: "Time per frame".to_owned(),
        caption: "Share of the frames that are done within a time: the further left and the steeper, the better."
            .to_owned(),
        legend: chart.legend(),
        panels: vec![chart.svg()?],
        columns: 1,
        csv: csv.text(),
    }))
}
