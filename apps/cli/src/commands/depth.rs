//! `endoscape depth`: the depth network alone, on still pictures.

use crate::device::DeviceArgs;
use crate::input::parse_size;
use crate::model;
use anyhow::bail;
use endoscape_core::Size;
use endoscape_frames::picture;
use endoscape_odometry::run_folder::{DepthWriter, Draft};
use endoscape_odometry::{DepthFormat, LearnedDepth};
use serde_json::json;
use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Depth of single pictures, each on its own.
///
/// The folder of --out gets a map per picture under its name, and depth.json with their unit. Maps have the size at
/// which the network sees the pictures; depth is along the optical axis in the unit of the training.
#[derive(clap::Args)]
#[command(after_help = "Example:
  endoscape depth polyp.png fold.png --model runs/phantom --out maps")]
pub struct Args {
    /// Pictures.
    #[arg(required = true, value_name = "IMAGE")]
    images: Vec<PathBuf>,
    /// Training run or checkpoint with a depth network.
    #[arg(long, value_name = "CKPT")]
    model: PathBuf,
    /// Folder for the maps; it must not exist or be empty.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Size at which the network sees the pictures [default: that of the training].
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    size: Option<Size>,
    /// How the maps are stored: png (16 bits) or npy (exact).
    #[arg(long, value_name = "FORM", default_value = "png")]
    depth: DepthFormat,
    #[command(flatten)]
    device: DeviceArgs,
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    if args.depth == DepthFormat::None {
        bail!("--depth none leaves nothing to write; choose png or npy");
    }
    let names = names(&args.images)?;
    let device = args.device.device.open()?;
    let (checkpoint, config) = model::load(&args.model, args.size, &device)?;
    let network = LearnedDepth::new(&checkpoint, config.size, &device)?;
    let (draft, mut writer) = (Draft::create(&args.out)?, DepthWriter::new(args.depth));
    for (name, path) in &names {
        writer.write(&draft, name, &network.depth(&picture::read(path)?)?)?;
    }
    let about = json!({
        "model": args.model.display().to_string(),
        "images": names.iter().map(|(name, path)| (name.clone(), path.display().to_string())).collect::<BTreeMap<_, _>>(),
        "size": config.size,
        "format": args.depth,
        "unit_per_step": writer.unit(),
        "unit": "of the training, not metres",
        "version": env!("CARGO_PKG_VERSION"),
    });
    draft.write("depth.json", serde_json::to_string_pretty(&about)?.as_bytes())?;
    draft.finish()?;
    writeln!(std::io::stdout(), "{}: {} depth maps of {}", args.out.display(), names.len(), config.size)?;
    Ok(())
}

/// What each map will be called: its picture's name without ending, which must be unique.
fn names(images: &[PathBuf]) -> anyhow::Result<Vec<(String, &Path)>> {
    let mut known: BTreeMap<String, &Path> = BTreeMap::new();
    let mut names = Vec::with_capacity(images.len());
    for path in images {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        if let Some(other) = known.insert(name.clone(), path) {
            bail!("{} and {} would both become {name}; rename one of them", other.display(), path.display());
        }
        names.push((name, path.as_path()));
    }
    Ok(names)
}
