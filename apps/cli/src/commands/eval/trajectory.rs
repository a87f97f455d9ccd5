//! `endoscape eval trajectory`.

use super::Output;
use super::load::Pairing;
use endoscape_eval::Alignment;
use endoscape_eval::rpe::{Delta, DeltaUnit};
use endoscape_eval::trajectory::{Settings, TrajectoryErrors, TrajectoryEvaluation, evaluate};
use endoscape_report::table::{Best, Cell, Table, length_unit};
use std::path::PathBuf;

/// Errors of a trajectory: absolute, relative, and against path length.
///
/// ESTIMATE and TRUTH are files (tum, kitti, euroc, csv, npy, npz; told apart by content), run folders, sequence
/// folders or data-set sequences.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  endoscape eval trajectory runs/colon patient/colon --align sim3 --lengths 0.1,0.2,0.3,0.4,0.5"
)]
pub struct Args {
    /// The estimated trajectory
    estimate: PathBuf,
    /// The true trajectory
    truth: PathBuf,
    /// What is corrected before errors are taken: none, se3, sim3, scale, first (first poses laid over each other)
    #[arg(long, value_name = "KIND", default_value = "sim3")]
    align: Alignment,
    /// Lengths of sub-trajectories in metres [default: 10 to 50 cm, 100 to 800 m from a path of 100 m on]
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    lengths: Option<Vec<f64>>,
    /// Frames from the start of one sub-trajectory to the next [default: 1; 10 for the default lengths of 100 m on]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    segment_step: Option<u32>,
    /// Distance of the poses whose relative error is taken
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    rpe_delta: f64,
    /// Unit of that distance: f (frames), m (metres), d (degrees), r (radians)
    #[arg(long, value_name = "UNIT", default_value = "f")]
    rpe_unit: DeltaUnit,
    /// Take all pairs at that distance, not only consecutive ones
    #[arg(long)]
    all_pairs: bool,
    /// Leave out the pair that starts at the first pose (older versions of evo did for consecutive pairs in metres)
    #[arg(long)]
    skip_first_pair: bool,
    #[command(flatten)]
    pairing: Pairing,
    #[command(flatten)]
    output: Output,
}

/// Reads, evaluates, writes.
///
/// # Errors
/// One sentence on what cannot be read or compared.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let (estimate, truth) = args.pairing.read(&args.estimate, &args.truth)?;
    let settings = Settings {
        association: args.pairing.association(),
        align: args.align,
        delta: Delta {
            value: args.rpe_delta,
            unit: args.rpe_unit,
            all_pairs: args.all_pairs,
            skip_first: args.skip_first_pair,
        },
        lengths_m: args.lengths.clone(),
        segment_step: args.segment_step.map(|step| step as usize),
        constant_motion: args.pairing.training_motion()?,
    };
    let evaluation = evaluate(&estimate, &truth, &settings)?;
    args.output.write(&evaluation, &tables(&evaluation), &evaluation.warnings)
}

fn tables(evaluation: &TrajectoryEvaluation) -> Vec<Table> {
    let mut tables = vec![errors(evaluation)];
    if !evaluation.errors.segments.is_empty() {
        tables.push(segments(evaluation));
    }
    if !evaluation.errors.turns.is_empty() {
        tables.push(turns(evaluation));
    }
    tables
}

/// The estimate and the trivial answers by name.
fn answers(evaluation: &TrajectoryEvaluation) -> [(&'static str, &TrajectoryErrors); 4] {
    let baselines = &evaluation.baselines;
    [
        ("estimate", &evaluation.errors),
        ("zero motion", &baselines.zero),
        ("constant motion", &baselines.constant),
        ("previous motion", &baselines.previous),
    ]
}

fn errors(evaluation: &TrajectoryEvaluation) -> Table {
    let (unit, factor) = length_unit(evaluation.path_length_m);
    let title = format!(
        "{} of {} estimated and {} true poses match, {:.1} % complete; path {:.4} {unit}; alignment {}, scale {:.6}",
        evaluation.matched,
        evaluation.estimate_frames,
        evaluation.truth_frames,
        100.0 * evaluation.completeness,
        evaluation.path_length_m * factor,
        evaluation.align,
        evaluation.scale
    );
    let rpe = &evaluation.errors.rpe;
    let (ate, rpe) = (|name: &str| format!("ATE {name} [{unit}]"), format!("RPE {} {}", rpe.delta, rpe.unit.name()));
    let heads = [
        ate("rmse"),
        ate("mean"),
        ate("median"),
        ate("max"),
        "rotation rmse [deg]".into(),
        format!("{rpe} rmse [{unit}]"),
        format!("{rpe} rmse [deg]"),
        "end drift [%]".into(),
    ];
    let mut columns = vec![("answer", Best::Neither)];
    columns.extend(heads.iter().map(|head| (head.as_str(), Best::Lowest)));
    let mut table = Table::new(title, &columns);
    for (name, errors) in answers(evaluation) {
        table.push(vec![
            Cell::Text(name.into()),
            Cell::Number(errors.ate_m.rmse * factor),
            Cell::Number(errors.ate_m.mean * factor),
            Cell::Number(errors.ate_m.median * factor),
            Cell::Number(errors.ate_m.max * factor),
            Cell::Number(errors.rotation_deg.rmse),
            Cell::Number(errors.rpe.translation_m.rmse * factor),
            Cell::Number(errors.rpe.rotation_deg.rmse),
            errors.endpoint_drift_percent.into(),
        ]);
    }
    table
}

fn segments(evaluation: &TrajectoryEvaluation) -> Table {
    let lengths = &evaluation.errors.segments;
    let (unit, factor) = length_unit(lengths.iter().map(|errors| errors.length_m).fold(0.0, f64::max));
    let mean = evaluation.errors.segments_mean.map_or_else(String::new, |mean| {
        format!("; mean {:.4} %, {:.6} deg/m", mean.translation_percent, mean.rotation_deg_per_m)
    });
    let heads = [
        format!("length [{unit}]"),
        format!("translation [{unit}]"),
        format!("std [{unit}]"),
        format!("rotation per length [deg/{unit}]"),
    ];
    let columns = [
        (heads[0].as_str(), Best::Neither),
        ("count", Best::Neither),
        (&heads[1], Best::Neither),
        (&heads[2], Best::Neither),
        ("translation [%]", Best::Neither),
        ("rotation [deg]", Best::Neither),
        ("std [deg]", Best::Neither),
        (&heads[3], Best::Neither),
        ("constant motion [%]", Best::Neither),
        ("previous motion [%]", Best::Neither),
    ];
    let mut table = Table::new(format!("Errors over sub-trajectories{mean}"), &columns);
    let baselines = &evaluation.baselines;
    for (index, errors) in lengths.iter().enumerate() {
        let percent = |other: &TrajectoryErrors| other.segments.get(index).map(|errors| errors.translation_percent);
        table.push(vec![
            Cell::Text(format!("{}", (errors.length_m * factor * 1e6).round() / 1e6)),
            Cell::Count(errors.count),
            Cell::Number(errors.translation_m * factor),
            Cell::Number(errors.translation_m_std * factor),
            Cell::Number(errors.translation_percent),
            Cell::Number(errors.rotation_deg),
            Cell::Number(errors.rotation_deg_std),
            Cell::Number(errors.rotation_deg_per_m / factor),
            percent(&baselines.constant).into(),
            percent(&baselines.previous).into(),
        ]);
    }
    table
}

fn turns(evaluation: &TrajectoryEvaluation) -> Table {
    let turns = &evaluation.errors.turns;
    let (unit, factor) = length_unit(evaluation.path_length_m);
    let head = format!("translation [{unit}]");
    let columns = [
        ("turned [deg]", Best::Neither),
        ("count", Best::Neither),
        ("rotation [deg]", Best::Neither),
        ("std [deg]", Best::Neither),
        (&head, Best::Neither),
        ("constant motion [deg]", Best::Neither),
        ("previous motion [deg]", Best::Neither),
    ];
    let mut table = Table::new("Errors over accumulated rotation", &columns);
    let baselines = &evaluation.baselines;
    for (index, errors) in turns.iter().enumerate() {
        let degrees = |other: &TrajectoryErrors| other.turns.get(index).map(|errors| errors.rotation_deg);
        table.push(vec![
            Cell::Text(format!("{}", errors.turned_deg)),
            Cell::Count(errors.count),
            Cell::Number(errors.rotation_deg),
            Cell::Number(errors.rotation_deg_std),
            Cell::Number(errors.translation_m * factor),
            degrees(&baselines.constant).into(),
            degrees(&baselines.previous).into(),
        ]);
    }
    table
}
