//! The tables of a report.

use crate::run_folder::RunFolder;
use crate::study::{MethodStudy, MotionStudy, SequenceStudy, Study};
use crate::table::{Best, Cell, Table, length_unit};
use crate::wins::{self, Wins};
use endoscape_eval::trajectory::TrajectoryErrors;

/// All tables of one sequence; those without data are left out.
pub fn of(sequence: &SequenceStudy) -> Vec<Table> {
    [motion(sequence), windows(sequence), depth(sequence), differences(sequence), runs(sequence)]
        .into_iter()
        .flatten()
        .collect()
}

fn judged(sequence: &SequenceStudy) -> Vec<(&MethodStudy, &MotionStudy)> {
    sequence.methods.iter().filter_map(|method| Some((method, method.motion.as_ref()?))).collect()
}

/// Trajectory errors with the trivial answers below.
fn motion(sequence: &SequenceStudy) -> Option<Table> {
    let judged = judged(sequence);
    let (_, first) = *judged.first()?;
    let (unit, factor) = length_unit(first.evaluation.path_length_m);
    let rpe = &first.evaluation.errors.rpe;
    let heads = [
        format!("ATE rmse [{unit}]"),
        format!("ATE max [{unit}]"),
        format!("RPE {} {} rmse [{unit}]", rpe.delta, rpe.unit.name()),
    ];
    let columns = [
        ("answer", Best::Neither),
        ("complete [%]", Best::Highest),
        (heads[0].as_str(), Best::Lowest),
        (&heads[1], Best::Lowest),
        ("rotation rmse [deg]", Best::Lowest),
        (&heads[2], Best::Lowest),
        ("RPE rmse [deg]", Best::Lowest),
        ("drift [% of length]", Best::Lowest),
        ("drift [deg/m]", Best::Lowest),
        ("end drift [%]", Best::Lowest),
        ("scale", Best::Neither),
        ("scale drift [%]", Best::Lowest),
    ];
    let title = format!(
        "Errors of trajectories over a path of {:.3} {unit}, alignment {}",
        first.evaluation.path_length_m * factor,
        first.evaluation.align
    );
    let mut table = Table::new(title, &columns);
    for (method, motion) in &judged {
        let evaluation = &motion.evaluation;
        let own = [Cell::Number(evaluation.scale), evaluation.scale_drift_percent.into()];
        table.push(row(&method.name, Some(evaluation.completeness), &evaluation.errors, factor, own));
    }
    let baselines = &first.evaluation.baselines;
    let names = ["zero motion", "constant motion", "previous motion"];
    for (name, errors) in names.into_iter().zip([&baselines.zero, &baselines.constant, &baselines.previous]) {
        table.push_aside(row(name, None, errors, factor, [Cell::Missing, Cell::Missing]));
    }
    Some(table)
}

fn row(name: &str, completeness: Option<f64>, errors: &TrajectoryErrors, factor: f64, scale: [Cell; 2]) -> Vec<Cell> {
    let [scale, scale_drift] = scale;
    vec![
        Cell::Text(name.to_owned()),
        completeness.map(|share| 100.0 * share).into(),
        Cell::Number(errors.ate_m.rmse * factor),
        Cell::Number(errors.ate_m.max * factor),
        Cell::Number(errors.rotation_deg.rmse),
        Cell::Number(errors.rpe.translation_m.rmse * factor),
        Cell::Number(errors.rpe.rotation_deg.rmse),
        errors.segments_mean.map(|mean| mean.translation_percent).into(),
        errors.segments_mean.map(|mean| mean.rotation_deg_per_m).into(),
        errors.endpoint_drift_percent.into(),
        scale,
        scale_drift,
    ]
}

/// Errors of short windows.
fn windows(sequence: &SequenceStudy) -> Option<Table> {
    let judged: Vec<_> =
        judged(sequence).into_iter().filter_map(|(method, motion)| Some((method, motion.snippets.as_ref()?))).collect();
    let (_, first) = *judged.first()?;
    let (unit, factor) = length_unit(first.baselines.zero.ate_rmse.mean);
    let heads = [format!("published [{unit}]"), format!("std [{unit}]"), format!("rmse [{unit}]")];
    let columns = [
        ("answer", Best::Neither),
        ("windows", Best::Neither),
        (heads[0].as_str(), Best::Lowest),
        (&heads[1], Best::Neither),
        (&heads[2], Best::Lowest),
        ("rotation [deg]", Best::Lowest),
    ];
    let title = format!("Windows of {} frames, each scaled on its own", first.length);
    let mut table = Table::new(title, &columns);
    let row = |name: &str, windows: Cell, errors: &endoscape_eval::snippets::SnippetErrors| {
        vec![
            Cell::Text(name.to_owned()),
            windows,
            Cell::Number(errors.ate_published.mean * factor),
            Cell::Number(errors.ate_published.std * factor),
            Cell::Number(errors.ate_rmse.mean * factor),
            Cell::Number(errors.rotation_rad.mean.to_degrees()),
        ]
    };
    for (method, snippets) in &judged {
        let windows = Cell::Text(format!("{} of {}", snippets.windows, snippets.windows_possible));
        table.push(row(&method.name, windows, &snippets.errors));
    }
    let names = ["zero motion", "constant motion", "previous motion"];
    let baselines = &first.baselines;
    for (name, errors) in names.into_iter().zip([&baselines.zero, &baselines.constant, &baselines.previous]) {
        table.push_aside(row(name, Cell::Missing, errors));
    }
    Some(table)
}

/// Errors of depth with the constant answer below.
fn depth(sequence: &SequenceStudy) -> Option<Table> {
    let evaluation = |method: &MethodStudy| method.depth.as_ref()?.evaluation.clone();
    let judged: Vec<_> =
        sequence.methods.iter().filter_map(|method| Some((method.name.clone(), evaluation(method)?))).collect();
    let (_, first) = judged.first()?;
    let (unit, factor) = length_unit(first.baselines.constant.rmse_m);
    let rmse = format!("RMSE [{unit}]");
    let columns = [
        ("answer", Best::Neither),
        ("images", Best::Neither),
        ("predicted [%]", Best::Highest),
        ("AbsRel", Best::Lowest),
        (rmse.as_str(), Best::Lowest),
        ("RMSE log", Best::Lowest),
        ("d < 1.25", Best::Highest),
        ("d < 1.25^2", Best::Highest),
        ("SILog", Best::Lowest),
        ("scale spread", Best::Lowest),
    ];
    let mut table = Table::new("Errors of depth, each image scaled by its median", &columns);
    let row = |name: &str, own: [Cell; 3], errors: &endoscape_eval::depth::DepthErrors| {
        let [images, coverage, spread] = own;
        vec![
            Cell::Text(name.to_owned()),
            images,
            coverage,
            Cell::Number(errors.abs_rel),
            Cell::Number(errors.rmse_m * factor),
            Cell::Number(errors.rmse_log),
            Cell::Number(errors.d1),
            Cell::Number(errors.d2),
            Cell::Number(errors.silog),
            spread,
        ]
    };
    for (name, depth) in &judged {
        let own = [Cell::Count(depth.frames), Cell::Number(100.0 * depth.coverage), Cell::Number(depth.scale_std)];
        table.push(row(name, own, &depth.errors));
    }
    let nothing = [Cell::Missing, Cell::Missing, Cell::Missing];
    table.push_aside(row("constant depth", nothing, &first.baselines.constant));
    Some(table)
}

/// The best method against each other one, on the poses both have.
fn differences(sequence: &SequenceStudy) -> Option<Table> {
    let differences = wins::differences(sequence);
    let best = differences.first()?.best;
    let (unit, factor) = judged(sequence).first().map(|(_, motion)| length_unit(motion.evaluation.path_length_m))?;
    let heads = [format!("mean difference [{unit}]"), format!("95 % from [{unit}]"), format!("to [{unit}]")];
    let columns = [
        ("method", Best::Neither),
        ("shared poses", Best::Neither),
        (heads[0].as_str(), Best::Neither),
        (&heads[1], Best::Neither),
        (&heads[2], Best::Neither),
        ("beyond chance", Best::Neither),
    ];
    let title =
        format!("Error of position beyond that of {}, with block bootstrap intervals", sequence.methods[best].name);
    let mut table = Table::new(title, &columns);
    for difference in &differences {
        table.push(vec![
            Cell::Text(sequence.methods[difference.other].name.clone()),
            Cell::Count(difference.poses),
            Cell::Number(difference.mean_m * factor),
            Cell::Number(difference.ci95_m[0] * factor),
            Cell::Number(difference.ci95_m[1] * factor),
            Cell::Text(if difference.is_decided() { "yes" } else { "no" }.to_owned()),
        ]);
    }
    Some(table)
}

/// Completeness, speed and machine of runs.
fn runs(sequence: &SequenceStudy) -> Option<Table> {
    let runs: Vec<(&str, &RunFolder)> = sequence
        .methods
        .iter()
        .filter_map(|method| Some((method.name.as_str(), method.run.as_ref()?)))
        .filter(|(_, run)| run.counts().is_some() || run.latency().is_some())
        .collect();
    if runs.is_empty() {
        return None;
    }
    let columns = [
        ("run", Best::Neither),
        ("method", Best::Neither),
        ("device", Best::Neither),
        ("frames", Best::Neither),
        ("lost", Best::Neither),
        ("tracked [%]", Best::Highest),
        ("frames/s", Best::Highest),
        ("p50 [ms]", Best::Lowest),
        ("p95 [ms]", Best::Lowest),
        ("p99 [ms]", Best::Lowest),
        ("max [ms]", Best::Lowest),
        ("memory [MB]", Best::Lowest),
    ];
    let mut table = Table::new("Completeness and speed", &columns);
    for (name, run) in runs {
        let text = |value: &Option<String>| value.clone().map_or(Cell::Missing, Cell::Text);
        let (counts, latency) = (run.counts(), run.latency());
        table.push(vec![
            Cell::Text(name.to_owned()),
            text(&run.facts.method),
            text(&run.facts.device),
            counts.map_or(Cell::Missing, |(frames, _)| Cell::Count(frames)),
            counts.map_or(Cell::Missing, |(frames, tracked)| Cell::Count(frames.saturating_sub(tracked))),
            counts.map(|(frames, tracked)| 100.0 * tracked as f64 / frames.max(1) as f64).into(),
            run.facts.fps.into(),
            latency.map(|latency| latency.p50).into(),
            latency.map(|latency| latency.p95).into(),
            latency.map(|latency| latency.p99).into(),
            latency.map(|latency| latency.max).into(),
            run.facts.peak_memory_mb.into(),
        ]);
    }
    Some(table)
}

/// Wins over all sequences, for at least two of them.
pub fn wins(study: &Study, wins: &Wins) -> Option<Table> {
    if study.sequences.len() < 2 {
        return None;
    }
    let names: Vec<String> = study.sequences.iter().map(|sequence| format!("{} [%]", sequence.name)).collect();
    let mut columns = vec![("method", Best::Neither)];
    columns.extend(names.iter().map(|name| (name.as_str(), Best::Lowest)));
    columns.extend([("mean [%]", Best::Lowest), ("wins", Best::Neither), ("p against the best", Best::Neither)]);
    let mut table = Table::new("Absolute error (rmse) in percent of the path, by sequence", &columns);
    let methods = study.sequences.iter().max_by_key(|sequence| sequence.methods.len())?;
    for (index, method) in methods.methods.iter().enumerate() {
        let mut cells = vec![Cell::Text(method.name.clone())];
        for sequence in &study.sequences {
            let motion = sequence.methods.get(index).and_then(|method| method.motion.as_ref());
            cells.push(motion.and_then(wins::percent_of_path).into());
        }
        cells.push(wins.mean_percent[index].into());
        cells.push(Cell::Count(wins.wins[index]));
        cells.push(wins.tests[index].map(|test| test.p_value).into());
        table.push(cells);
    }
    Some(table)
}
