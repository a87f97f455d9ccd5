//! `endoscape eval depth`.

use super::Output;
use anyhow::{Context as _, anyhow, bail};
use endoscape_core::DepthMap;
use endoscape_eval::depth::{Crop, DepthErrors, DepthEvaluation, Samples, Scaling, Valid, evaluate};
use endoscape_frames::{FrameEntry, Sequence, formats};
use endoscape_report::maps::{self, MILLIMETRES};
use endoscape_report::table::{Best, Cell, Table, length_unit};
use std::path::PathBuf;

/// Errors of predicted depth maps.
///
/// ESTIMATE is a run folder or a folder of maps (16-bit PNG, or NPY in metres) numbered like the frames of SEQ. Maps are
/// resized to the truth. SEQ is a sequence folder or a data-set sequence with depth.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  endoscape eval depth runs/colon patient/colon --scaling median --max 0.15")]
pub struct Args {
    /// Run folder or folder of maps
    estimate: PathBuf,
    /// Sequence with true depth
    sequence: PathBuf,
    /// Bring predictions to metres by the medians of each image, by one factor per sequence, or not: median, sequence, none
    #[arg(long, value_name = "KIND", default_value = "median")]
    scaling: Scaling,
    /// Nearest true depth that counts, metres [default: what is usual for the data set]
    #[arg(long, value_name = "M")]
    min: Option<f64>,
    /// Farthest true depth that counts, metres [default: what is usual for the data set]
    #[arg(long, value_name = "M")]
    max: Option<f64>,
    /// Part of the picture that counts: none, garg, eigen
    #[arg(long, value_name = "NAME", default_value = "none")]
    crop: Crop,
    /// Metres per unit of PNG maps [default: from run.json]
    #[arg(long, value_name = "M")]
    metres_per_unit: Option<f64>,
    #[command(flatten)]
    output: Output,
}

/// Reads, evaluates, writes.
///
/// # Errors
/// One sentence on what cannot be read or compared.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let sequence = formats::open(&args.sequence, None)?;
    if !sequence.has_depth() {
        bail!("{}: has no depth to compare with; give a sequence with depth maps", args.sequence.display());
    }
    let (usual_min, usual_max) = maps::usual_range_m(sequence.format);
    let valid = Valid::new(args.min.unwrap_or(usual_min), args.max.unwrap_or(usual_max), args.crop)?;
    let unit = metres_per_unit(args)?;
    let pairs = maps::pairs(&args.estimate, &sequence)?;
    let load = |index: usize| -> anyhow::Result<Samples> {
        let (map, frame) = &pairs[index];
        let prediction = maps::read_depth(map, unit)?;
        let truth = read_truth(&sequence, frame)?;
        Samples::of(&prediction, &truth, &valid).map_err(|error| anyhow!("{}: {error}", map.display()))
    };
    let evaluation = evaluate(pairs.len(), load, args.scaling, &valid)?.with_context(|| {
        format!(
            "{}: no pixel has both a prediction and a true depth in range; widen --min and --max",
            args.estimate.display()
        )
    })?;
    args.output.write(&evaluation, &[table(&evaluation, sequence.frames.len())], &sequence.warnings)
}

fn read_truth(sequence: &Sequence, frame: &FrameEntry) -> anyhow::Result<DepthMap> {
    let file = frame.depth.as_ref().context("a frame without depth has none to compare with")?;
    Ok(file.read(sequence.camera.as_ref(), sequence.size)?)
}

/// Unit of 16-bit maps: as given, as the run says, or any where scaling makes it meaningless.
fn metres_per_unit(args: &Args) -> anyhow::Result<f64> {
    let path = args.estimate.join("run.json");
    let said = std::fs::read_to_string(&path).ok().map(|text| {
        let run: serde_json::Value = serde_json::from_str(&text)
            .with_context(|| format!("{}: is not JSON; run the method again", path.display()))?;
        anyhow::Ok(run.get("depth_metres_per_unit").and_then(serde_json::Value::as_f64))
    });
    let scaled = (args.scaling != Scaling::None).then_some(MILLIMETRES);
    let unit = args.metres_per_unit.or(said.transpose()?.flatten()).or(scaled).with_context(|| {
        format!("{}: nothing says how long a unit of its maps is; pass --metres-per-unit", args.estimate.display())
    })?;
    if unit > 0.0 && unit.is_finite() {
        Ok(unit)
    } else {
        bail!("{unit} m is no unit of depth; give a positive --metres-per-unit")
    }
}

fn table(evaluation: &DepthEvaluation, sequence_frames: usize) -> Table {
    let (unit, factor) = length_unit(evaluation.baselines.constant.rmse_m);
    let title = format!(
        "{} images of a sequence of {sequence_frames} frames, {:.1} % of their pixels predicted; scale {:.6}, its spread {:.4}",
        evaluation.frames,
        100.0 * evaluation.coverage,
        evaluation.scale,
        evaluation.scale_std
    );
    let heads = [format!("SqRel [{unit}]"), format!("RMSE [{unit}]")];
    let columns = [
        ("answer", Best::Neither),
        ("AbsRel", Best::Lowest),
        (heads[0].as_str(), Best::Lowest),
        (&heads[1], Best::Lowest),
        ("RMSE log", Best::Lowest),
        ("d < 1.25", Best::Highest),
        ("d < 1.25^2", Best::Highest),
        ("d < 1.25^3", Best::Highest),
        ("SILog", Best::Lowest),
    ];
    let mut table = Table::new(title, &columns);
    table.push(row("estimate", &evaluation.errors, factor));
    table.push(row("constant depth", &evaluation.baselines.constant, factor));
    table
}

fn row(name: &str, errors: &DepthErrors, factor: f64) -> Vec<Cell> {
    vec![
        Cell::Text(name.into()),
        Cell::Number(errors.abs_rel),
        Cell::Number(errors.sq_rel * factor),
        Cell::Number(errors.rmse_m * factor),
        Cell::Number(errors.rmse_log),
        Cell::Number(errors.d1),
        Cell::Number(errors.d2),
        Cell::Number(errors.d3),
        Cell::Number(errors.silog),
    ]
}
