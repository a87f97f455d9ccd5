//! `endoscape export`: a checkpoint as ONNX or safetensors.

use crate::device::DeviceArgs;
use crate::input::parse_size;
use anyhow::bail;
use endoscape_core::Size;
use endoscape_nets::{Checkpoint, Network, OnnxOptions};
use std::io::Write as _;
use std::path::PathBuf;

/// Write the networks for other programs: ONNX (operator set 17) or safetensors, by the ending of OUT.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  endoscape export run/best depth.onnx --only depth --size 320x256")]
pub struct Args {
    /// Checkpoint folder.
    checkpoint: PathBuf,
    /// File to write, ending in .onnx or .safetensors.
    out: PathBuf,
    /// One network alone (ONNX).
    #[arg(long, value_name = "NETWORK")]
    only: Option<Only>,
    /// Fix the size of the pictures (ONNX); any size if left out.
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    size: Option<Size>,
    /// Fix the number of pictures per call (ONNX); any number if left out.
    #[arg(long, value_name = "N")]
    batch: Option<usize>,
    #[command(flatten)]
    device: DeviceArgs,
}

#[derive(clap::ValueEnum, Clone, Copy)]
enum Only {
    Depth,
    Motion,
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let device = args.device.device.open()?;
    let ending = args.out.extension().map(|ending| ending.to_string_lossy().to_lowercase()).unwrap_or_default();
    if !matches!(ending.as_str(), "onnx" | "safetensors") {
        bail!("{}: unknown kind of file; end its name in .onnx or .safetensors", args.out.display());
    }
    let checkpoint = Checkpoint::load(&args.checkpoint, &device)?;
    if ending == "onnx" {
        let only = args.only.map(|only| match only {
            Only::Depth => Network::Disp,
            Only::Motion => Network::Pose,
        });
        let size = args.size.map(|size| [size.height, size.width]);
        checkpoint.export_onnx(&args.out, &OnnxOptions { only, batch: args.batch, size })?;
    } else {
        checkpoint.export_safetensors(&args.out)?;
    }
    writeln!(std::io::stdout(), "{}", args.out.display())?;
    Ok(())
}
