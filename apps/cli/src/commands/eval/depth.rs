//! `endoscape eval depth`.

use super::Output;
use super::table::{Best, Cell, Table, length_unit};
use anyhow::{Context as _, anyhow, bail};
use endoscape_core::{DepthMap, Grid, Size};
use endoscape_eval::depth::{Crop, DepthErrors, DepthEvaluation, Samples, Scaling, Valid, evaluate};
use endoscape_eval::read::numpy;
use endoscape_frames::{Format, FrameEntry, FramesError, Sequence, formats, natural};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Metres per unit of 16-bit maps whose unit does not matter because they are scaled anyway.
const MILLIMETRES: f64 = 1e-3;

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
    let (usual_min, usual_max) = usual_range_m(sequence.format);
    let valid = Valid::new(args.min.unwrap_or(usual_min), args.max.unwrap_or(usual_max), args.crop)?;
    let unit = metres_per_unit(args)?;
    let pairs = pairs(&args.estimate, &sequence)?;
    let load = |index: usize| -> anyhow::Result<Samples> {
        let (map, frame) = &pairs[index];
        let prediction = read_map(map, unit)?;
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

/// Ranges papers use; elsewhere every known depth counts.
const fn usual_range_m(format: Format) -> (f64, f64) {
    match format {
        Format::KittiOdometry | Format::KittiRaw => (1e-3, 80.0),
        Format::Scared => (1e-6, 0.15),
        _ => (1e-6, 1e4),
    }
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

/// Maps with the frames they belong to: by number, or by order where there are as many.
fn pairs<'a>(estimate: &Path, sequence: &'a Sequence) -> anyhow::Result<Vec<(PathBuf, &'a FrameEntry)>> {
    let folder =
        Some(estimate.join("depth")).filter(|folder| folder.is_dir()).unwrap_or_else(|| estimate.to_path_buf());
    let maps = list(&folder)?;
    let true_frames: Vec<&FrameEntry> = sequence.frames.iter().filter(|frame| frame.depth.is_some()).collect();
    let numbered: BTreeMap<usize, &PathBuf> = maps.iter().filter_map(|map| Some((number(map)?, map))).collect();
    let by_number: Vec<_> = true_frames
        .iter()
        .filter_map(|frame| numbered.get(&frame.number).map(|map| ((*map).clone(), *frame)))
        .collect();
    if !by_number.is_empty() {
        return Ok(by_number);
    }
    if maps.len() == true_frames.len() && !maps.is_empty() {
        return Ok(maps.into_iter().zip(true_frames).collect());
    }
    bail!(
        "{}: none of its {} maps has the number of one of the {} frames with depth; name maps after frames",
        folder.display(),
        maps.len(),
        true_frames.len()
    )
}

fn number(path: &Path) -> Option<usize> {
    natural::number(&path.file_stem()?.to_string_lossy())
}

/// Maps of a folder in natural order.
fn list(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|error| FramesError::io(folder, "list", error))?;
    let is_map = |path: &PathBuf| path.extension().is_some_and(|ending| ending == "png" || ending == "npy");
    let mut maps: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).filter(is_map).collect();
    maps.sort_by(|a, b| natural::cmp(&a.to_string_lossy(), &b.to_string_lossy()));
    if maps.is_empty() {
        bail!("{}: holds no depth map (png or npy); give a run folder or a folder of maps", folder.display());
    }
    Ok(maps)
}

/// One map in metres.
fn read_map(path: &Path, metres_per_unit: f64) -> anyhow::Result<DepthMap> {
    let bytes = std::fs::read(path).map_err(|error| FramesError::io(path, "read", error))?;
    if path.extension().is_some_and(|ending| ending == "npy") {
        let array = numpy::array(&bytes).map_err(|error| anyhow!("{}: {error}", path.display()))?;
        let [.., height, width] = array.shape[..] else {
            bail!("{}: an array of shape {:?} is no depth map; save height x width", path.display(), array.shape)
        };
        let depth_m = array.values.iter().map(|value| *value as f32).collect();
        return Ok(DepthMap::new(
            Grid::new(Size::new(width, height), depth_m).with_context(|| path.display().to_string())?,
        ));
    }
    let picture = image::load_from_memory_with_format(&bytes, image::ImageFormat::Png)
        .map_err(|error| anyhow!("{}: cannot be read as a depth map: {error}; write it again", path.display()))?;
    let units = match picture {
        image::DynamicImage::ImageLuma16(units) => units,
        image::DynamicImage::ImageLuma8(_) => picture.to_luma16(),
        _ => bail!("{}: has colours, so it is no depth map; give single-channel maps", path.display()),
    };
    let size = Size::new(units.width() as usize, units.height() as usize);
    let depth_m = units.into_raw().into_iter().map(|unit| (f64::from(unit) * metres_per_unit) as f32).collect();
    Ok(DepthMap::new(Grid::new(size, depth_m).with_context(|| path.display().to_string())?))
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
