//! The paths against the truth: three projections and a view in space.

use super::{Csv, inked, unit};
use crate::ReportError;
use crate::figure::{Axis, Chart, Figure, Ink, Line, Shape};
use crate::study::SequenceStudy;

const AXES: [&str; 3] = ["x", "y", "z"];

/// Size of a panel, pixels.
const PANEL: (f64, f64) = (470.0, 360.0);

/// Direction of the view in space: turned around the upright axis, and above the floor, radians.
const TURN: f64 = -0.7;
const RISE: f64 = 0.45;

type Point = [f64; 3];

/// A path with its name and colour.
struct Path {
    name: String,
    ink: Ink,
    points: Vec<Point>,
}

/// Paths of all methods and the truth; `None` without any.
pub fn figure(sequence: &SequenceStudy) -> Result<Option<Figure>, ReportError> {
    let (unit, factor) = unit(sequence);
    let paths = paths(sequence, factor);
    if paths.is_empty() {
        return Ok(None);
    }
    let span = bounds(&paths);
    // The two axes along which there is most to see come first, and the third is upright in space.
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| (span[*b][1] - span[*b][0]).total_cmp(&(span[*a][1] - span[*a][0])));
    let mut floor = [order[0], order[1]];
    floor.sort_unstable();
    let upright = order[2];
    let planes = [floor, [floor[0], upright], [floor[1], upright]];
    let mut charts: Vec<Chart> = planes.iter().map(|plane| projection(&paths, *plane, unit)).collect();
    charts.push(in_space(&paths, &span, floor, upright, unit));
    let panels = charts.iter().map(Chart::svg).collect::<Result<_, _>>()?;
    let caption = if sequence.has_truth {
        format!(
            "Camera positions in {unit}, in the frame of the truth; estimates are aligned to it as the tables say. One \
             unit is equally long on both axes of a panel. The last panel looks at the same paths in space, with \
             their shadows on the floor of least extent."
        )
    } else {
        "Camera positions as the method wrote them, in its own unit of length: the true path is not known, so neither \
         scale nor error can be judged."
            .to_owned()
    };
    Ok(Some(Figure {
        id: "paths".to_owned(),
        title: "Paths".to_owned(),
        caption,
        panels,
        columns: 2,
        legend: charts[0].legend(),
        csv: csv(&paths, unit),
    }))
}

fn paths(sequence: &SequenceStudy, factor: f64) -> Vec<Path> {
    let scaled = |point: Point| point.map(|value| value * factor);
    let longest = sequence.methods.iter().filter_map(|method| method.motion.as_ref());
    // Methods may have answered different parts; the truth of the one that answered most is drawn.
    let truth = longest.max_by_key(|motion| motion.trace.truth.len()).map(|motion| Path {
        name: "truth".to_owned(),
        ink: Ink::Truth,
        points: motion.trace.truth.iter().map(|pose| scaled(pose.translation.vector.into())).collect(),
    });
    let of_methods = inked(sequence).map(|(ink, method)| Path {
        name: method.name.clone(),
        ink,
        points: method.path().into_iter().map(scaled).collect(),
    });
    truth.into_iter().chain(of_methods).filter(|path| !path.points.is_empty()).collect()
}

/// Lowest and highest value per axis.
fn bounds(paths: &[Path]) -> [[f64; 2]; 3] {
    [0, 1, 2].map(|axis| {
        let values = paths.iter().flat_map(|path| path.points.iter().map(move |point| point[axis]));
        values
            .filter(|value| value.is_finite())
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)])
    })
}

fn projection(paths: &[Path], [right, up]: [usize; 2], unit: &str) -> Chart {
    let line = |path: &Path| {
        let points = path.points.iter().map(|point| [point[right], point[up]]).collect();
        Line::new(path.name.clone(), path.ink, Shape::Joined, points)
    };
    Chart {
        title: format!("{}\u{2013}{} plane", AXES[right], AXES[up]),
        label: format!("Paths of {} projected onto the {} and {} axes.", names(paths), AXES[right], AXES[up]),
        x: Axis::new(format!("{} [{unit}]", AXES[right])),
        y: Axis::new(format!("{} [{unit}]", AXES[up])),
        lines: paths.iter().map(line).collect(),
        equal: true,
        size: PANEL,
    }
}

fn names(paths: &[Path]) -> String {
    paths.iter().map(|path| path.name.as_str()).collect::<Vec<_>>().join(", ")
}

/// A parallel view from above: the floor as a grid, shadows on it, paths over it.
fn in_space(paths: &[Path], span: &[[f64; 2]; 3], [a, b]: [usize; 2], upright: usize, unit: &str) -> Chart {
    let ground = span[upright][0];
    let on_floor = |u: f64, v: f64| {
        let mut point = [0.0; 3];
        (point[a], point[b], point[upright]) = (u, v, ground);
        point
    };
    let seen = |point: Point| view([point[a], point[b], point[upright]]);
    let mut lines = Vec::new();
    for share in [0.0, 0.25, 0.5, 0.75, 1.0] {
        let at = |axis: usize| span[axis][0] + share * (span[axis][1] - span[axis][0]);
        let across = vec![seen(on_floor(at(a), span[b][0])), seen(on_floor(at(a), span[b][1]))];
        let along = vec![seen(on_floor(span[a][0], at(b))), seen(on_floor(span[a][1], at(b)))];
        lines.push(Line::new("", Ink::Grid, Shape::Thin, across));
        lines.push(Line::new("", Ink::Grid, Shape::Thin, along));
    }
    for path in paths {
        let shadow =
            path.points.iter().map(|point| seen(on_floor(point[a], point[b]).map(|value| value))).collect::<Vec<_>>();
        let broken = shadow
            .into_iter()
            .zip(&path.points)
            .map(|(shadow, point)| if point[a].is_finite() { shadow } else { [f64::NAN; 2] });
        lines.push(Line::new("", Ink::Grid, Shape::Thin, broken.collect()));
    }
    for path in paths {
        let points = path.points.iter().map(|point| seen(*point)).collect();
        lines.push(Line::new(path.name.clone(), path.ink, Shape::Joined, points));
    }
    let extent = |axis: usize| format!("{} {:.3}", AXES[axis], span[axis][1] - span[axis][0]);
    Chart {
        title: format!(
            "In space ({} upright; extent {} \u{00d7} {} \u{00d7} {} {unit})",
            AXES[upright],
            extent(a),
            extent(b),
            extent(upright)
        ),
        label: format!("The same paths of {} seen from above at an angle.", names(paths)),
        x: Axis::default(),
        y: Axis::default(),
        lines,
        equal: true,
        size: PANEL,
    }
}

/// Parallel projection of (along the floor, across the floor, upright).
fn view([u, v, w]: Point) -> [f64; 2] {
    let (sin, cos) = TURN.sin_cos();
    let (right, depth) = (u * cos - v * sin, u * sin + v * cos);
    [right, w * RISE.cos() + depth * RISE.sin()]
}

fn csv(paths: &[Path], unit: &str) -> String {
    let heads = AXES.map(|axis| format!("{axis}_{unit}"));
    let mut csv = Csv::new(&["path", "pose", &heads[0], &heads[1], &heads[2]]);
    for path in paths {
        for (index, point) in path.points.iter().filter(|point| point[0].is_finite()).enumerate() {
            csv.push([path.name.clone(), index.to_string()].into_iter().chain(point.map(|value| value.to_string())));
        }
    }
    csv.text()
}
