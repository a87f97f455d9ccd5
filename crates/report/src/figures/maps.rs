//! Depth and reliability maps beside the pictures they belong to.

use super::Csv;
use crate::ReportError;
use crate::depth_study::DepthView;
use crate::figure::Figure;
use crate::figure::pictures::{Bar, PictureGrid, black_and_white, coloured};
use crate::mask_study::MaskView;
use crate::study::{MethodStudy, SequenceStudy};
use crate::table::length_unit;
use colorous::{CIVIDIS, Gradient, MAGMA, VIRIDIS};
use endoscape_core::{DepthMap, Grid, Image};
use std::collections::BTreeMap;

/// Disparity, reliability and error each have a colour map of their own, all perceptually uniform.
const DISPARITY: Gradient = MAGMA;
const RELIABILITY: Gradient = VIRIDIS;
const ERROR: Gradient = CIVIDIS;

/// Shares of the disparities that the colours span; the rest is cut, so that single pixels do not rule.
const CUT: [f64; 2] = [0.02, 0.98];

/// Relative error of the last colour.
const WORST: f32 = 0.3;

/// Disparity of prediction and truth side by side, with the error between them.
pub fn depth(sequence: &SequenceStudy) -> Result<Option<Figure>, ReportError> {
    let methods = by_method(sequence, |method| Some(&method.depth.as_ref()?.views), |view: &DepthView| view.number);
    let Some((_, first)) = methods.first() else { return Ok(None) };
    let judged = first.values().any(|view| view.truth.is_some());
    let mut heads = heads(&methods, judged.then_some("truth"));
    if judged {
        heads.extend(methods.iter().map(|(method, _)| format!("error of {}", method.name)));
    }
    let range = disparity_range(&methods, judged);
    let mut rows = Vec::new();
    for (number, view) in first {
        let views: Vec<Option<&DepthView>> = methods.iter().map(|(_, views)| views.get(number).copied()).collect();
        let mut row = vec![view.image.clone()];
        row.extend(views.iter().map(|view| view.map(|view| disparity(&view.prediction, range))));
        if judged {
            row.push(view.truth.as_ref().map(|truth| disparity(truth, range)));
            row.extend(views.iter().map(|view| view.and_then(error)));
        }
        rows.push((format!("frame {number}"), row));
    }
    let grid = PictureGrid {
        label: format!("Columns {} for frames {}.", heads.join(", "), numbers(first.keys())),
        heads,
        rows,
        bars: bars(range, judged),
    };
    Ok(Some(Figure {
        id: "depth".to_owned(),
        title: "Depth".to_owned(),
        caption: depth_caption(judged),
        panels: vec![grid.svg()?],
        columns: 1,
        legend: Vec::new(),
        csv: depth_csv(sequence),
    }))
}

/// A method with the frames a figure shows of it, by number.
type Shown<'a, T> = (&'a MethodStudy, BTreeMap<usize, &'a T>);

/// The methods that have `views`.
fn by_method<'a, T>(
    sequence: &'a SequenceStudy,
    views: impl Fn(&'a MethodStudy) -> Option<&'a Vec<T>>,
    number: impl Fn(&T) -> usize,
) -> Vec<Shown<'a, T>> {
    let by_number = |views: &'a Vec<T>| views.iter().map(|view| (number(view), view)).collect();
    sequence.methods.iter().filter_map(|method| Some((method, by_number(views(method)?)))).collect()
}

/// Heads of the columns: the picture, what each method says, and the truth if there is one.
fn heads<T>(methods: &[Shown<'_, T>], truth: Option<&str>) -> Vec<String> {
    let names = methods.iter().map(|(method, _)| method.name.as_str());
    std::iter::once("input").chain(names).chain(truth).map(str::to_owned).collect()
}

fn numbers<'a>(numbers: impl Iterator<Item = &'a usize>) -> String {
    numbers.map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

fn depth_caption(judged: bool) -> String {
    let scale = if judged {
        "Predictions are scaled by the ratio of the medians of each image, as in the table, and share the colours of \
         the truth. The error is relative: the difference of prediction and truth over the truth."
    } else {
        "No true depth is known: predictions are shown in the method's own unit, before (the picture) and after."
    };
    format!("Disparity, the inverse of depth along the optical axis; grey where nothing is known. {scale}")
}

/// Lowest and highest disparity of the colours, of the truth if there is any.
fn disparity_range(methods: &[Shown<'_, DepthView>], judged: bool) -> [f32; 2] {
    let views = || methods.iter().flat_map(|(_, views)| views.values());
    let maps: Vec<&DepthMap> = if judged {
        views().filter_map(|view| view.truth.as_ref()).collect()
    } else {
        views().map(|view| &view.prediction).collect()
    };
    let depths = maps.iter().flat_map(|map| map.grid().values()).filter(|depth| **depth > 0.0);
    let mut disparities: Vec<f32> = depths.map(|depth| 1.0 / depth).collect();
    disparities.sort_by(f32::total_cmp);
    let at = |share: f64| disparities.get((share * disparities.len().saturating_sub(1) as f64) as usize).copied();
    match (at(CUT[0]), at(CUT[1])) {
        (Some(low), Some(high)) if high > low => [low, high],
        (Some(low), _) => [0.5 * low, 1.5 * low],
        _ => [0.0, 1.0],
    }
}

fn disparity(depth: &DepthMap, [low, high]: [f32; 2]) -> Image {
    let share = |depth: &f32| (*depth > 0.0).then(|| (1.0 / depth - low) / (high - low));
    coloured(&depth.grid().map(share), DISPARITY)
}

/// Relative error in colours; `None` without truth.
fn error(view: &DepthView) -> Option<Image> {
    let truth = view.truth.as_ref()?;
    let share = |x: usize, y: usize| {
        let (truth, prediction) = (truth.get(x, y)?, view.prediction.get(x, y)?);
        Some((prediction - truth).abs() / truth / WORST)
    };
    Some(coloured(&Grid::from_fn(truth.size(), share), ERROR))
}

fn bars([low, high]: [f32; 2], judged: bool) -> Vec<Bar> {
    let [far, near] = [low, high].map(|disparity| f64::from(1.0 / disparity.max(f32::MIN_POSITIVE)));
    let (unit, factor) = if judged { length_unit(near) } else { ("of its own units", 1.0) };
    let end = |word: &str, depth: f64| format!("{word}, {:.3} {unit}", depth * factor);
    let disparity = Bar {
        title: "disparity (labels: depth)".to_owned(),
        ends: [end("far", far), end("near", near)],
        gradient: DISPARITY,
    };
    let error = Bar {
        title: "relative error of depth".to_owned(),
        ends: ["0 %".to_owned(), format!("{:.0} % and more", 100.0 * WORST)],
        gradient: ERROR,
    };
    if judged { vec![disparity, error] } else { vec![disparity] }
}

fn depth_csv(sequence: &SequenceStudy) -> String {
    let mut csv = Csv::new(&["method", "image", "scale", "coverage", "abs_rel", "sq_rel", "rmse_m", "d1"]);
    for method in &sequence.methods {
        let evaluation = method.depth.as_ref().and_then(|depth| depth.evaluation.as_ref());
        for image in evaluation.iter().flat_map(|evaluation| &evaluation.images) {
            let errors = &image.errors;
            let numbers = [
                image.index as f64,
                image.scale,
                image.coverage,
                errors.abs_rel,
                errors.sq_rel,
                errors.rmse_m,
                errors.d1,
            ];
            csv.push(std::iter::once(method.name.clone()).chain(numbers.map(|number| number.to_string())));
        }
    }
    csv.text()
}

/// Reliability beside the picture and, where there is one, the true mask.
pub fn reliability(sequence: &SequenceStudy) -> Result<Option<Figure>, ReportError> {
    let methods = by_method(sequence, |method| Some(&method.masks.as_ref()?.views), |view: &MaskView| view.number);
    let Some((_, first)) = methods.first() else { return Ok(None) };
    let judged = first.values().any(|view| view.truth.is_some());
    let heads = heads(&methods, judged.then_some("true mask"));
    let mut csv = Csv::new(&["method", "frame", "mean_reliability"]);
    let mut rows = Vec::new();
    for (number, view) in first {
        let mut row = vec![view.image.clone()];
        for (method, views) in &methods {
            let map = views.get(number).map(|view| &view.reliability);
            row.push(map.map(|map| coloured(&map.map(|value| Some(*value)), RELIABILITY)));
            if let Some(map) = map {
                let mean = map.values().iter().sum::<f32>() / map.values().len().max(1) as f32;
                csv.push([method.name.clone(), number.to_string(), mean.to_string()]);
            }
        }
        if judged {
            row.push(view.truth.as_ref().map(black_and_white));
        }
        rows.push((format!("frame {number}"), row));
    }
    let grid = PictureGrid {
        label: format!("Columns {} for frames {}.", heads.join(", "), numbers(first.keys())),
        heads,
        rows,
        bars: vec![Bar {
            title: "reliability".to_owned(),
            ends: ["0, ignored".to_owned(), "1, trusted".to_owned()],
            gradient: RELIABILITY,
        }],
    };
    Ok(Some(Figure {
        id: "reliability".to_owned(),
        title: "Reliability masks".to_owned(),
        caption: "How far the method trusts each pixel to be explained by camera motion: reflections, floating matter \
                  and moving tissue should be dark. White in a true mask is usable."
            .to_owned(),
        panels: vec![grid.svg()?],
        columns: 1,
        legend: Vec::new(),
        csv: csv.text(),
    }))
}
