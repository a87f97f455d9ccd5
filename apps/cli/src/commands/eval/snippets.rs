//! `endoscape eval snippets`.

use super::Output;
use super::load::Pairing;
use endoscape_eval::snippets::{SnippetErrors, SnippetEvaluation, evaluate};
use endoscape_report::table::{Best, Cell, Table, length_unit};
use std::path::PathBuf;

/// Errors of short windows (the protocol of SfMLearner), in both definitions in use.
///
/// Each window is scaled on its own, by a factor that may come out negative: these figures cannot see an inverted pose
/// chain, so give `eval trajectory` beside them.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  endoscape eval snippets runs/kitti09.txt poses/09.txt --length 5")]
pub struct Args {
    /// The estimated trajectory
    estimate: PathBuf,
    /// The true trajectory
    truth: PathBuf,
    /// Poses per window
    #[arg(long, value_name = "N", default_value_t = 5)]
    length: usize,
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
    let motion = args.pairing.training_motion()?;
    let evaluation = evaluate(&estimate, &truth, args.pairing.association(), args.length, motion.as_ref())?;
    args.output.write(&evaluation, &[table(&evaluation)], &[])
}

fn table(evaluation: &SnippetEvaluation) -> Table {
    let largest = evaluation.baselines.zero.ate_rmse.mean;
    let (unit, factor) = length_unit(largest);
    let title = format!(
        "{} of {} windows of {} poses, {:.1} % complete",
        evaluation.windows,
        evaluation.windows_possible,
        evaluation.length,
        100.0 * evaluation.completeness
    );
    let heads =
        [format!("published [{unit}]"), format!("std [{unit}]"), format!("rmse [{unit}]"), format!("std [{unit}]")];
    let columns = [
        ("answer", Best::Neither),
        (heads[0].as_str(), Best::Lowest),
        (&heads[1], Best::Neither),
        (&heads[2], Best::Lowest),
        (&heads[3], Best::Neither),
        ("rotation [deg]", Best::Lowest),
        ("std [deg]", Best::Neither),
    ];
    let mut table = Table::new(title, &columns);
    let baselines = &evaluation.baselines;
    let answers = [
        ("estimate", &evaluation.errors),
        ("zero motion", &baselines.zero),
        ("constant motion", &baselines.constant),
        ("previous motion", &baselines.previous),
    ];
    for (name, errors) in answers {
        table.push(row(name, errors, factor));
    }
    table
}

fn row(name: &str, errors: &SnippetErrors, factor: f64) -> Vec<Cell> {
    vec![
        Cell::Text(name.into()),
        Cell::Number(errors.ate_published.mean * factor),
        Cell::Number(errors.ate_published.std * factor),
        Cell::Number(errors.ate_rmse.mean * factor),
        Cell::Number(errors.ate_rmse.std * factor),
        Cell::Number(errors.rotation_rad.mean.to_degrees()),
        Cell::Number(errors.rotation_rad.std.to_degrees()),
    ]
}
