//! `endoscape import`: weights of other programs into a checkpoint folder.

use crate::device::DeviceArgs;
use endoscape_nets::{Checkpoint, Network};
use std::io::Write as _;
use std::path::PathBuf;

/// Take weights from a PyTorch file of the SfMLearner port, or from safetensors.
#[derive(clap::Args)]
#[command(after_help = "Example:
  endoscape import dispnet.pth.tar model
  endoscape import posenet.pth.tar model      (the second file joins the first)")]
pub struct Args {
    /// `.pth`, `.pth.tar` or `.safetensors`.
    weights: PathBuf,
    /// Checkpoint folder to write; one that holds the other network is completed.
    out: PathBuf,
    /// Which network the file holds; found out from its tensors if left out.
    #[arg(long, value_name = "KIND")]
    kind: Option<Kind>,
    #[command(flatten)]
    device: DeviceArgs,
}

#[derive(clap::ValueEnum, Clone, Copy)]
enum Kind {
    Dispnet,
    Posenet,
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let device = args.device.device.open()?;
    let only = args.kind.map(|kind| match kind {
        Kind::Dispnet => Network::Disp,
        Kind::Posenet => Network::Pose,
    });
    let (imported, report) = Checkpoint::import(&args.weights, only, &device)?;
    let checkpoint = if args.out.join("manifest.json").exists() {
        let mut checkpoint = Checkpoint::load(&args.out, &device)?;
        checkpoint.absorb(imported);
        checkpoint
    } else {
        imported
    };
    checkpoint.save(&args.out)?;
    let mut out = std::io::stdout();
    for name in &report.matched {
        writeln!(out, "  {name}")?;
    }
    writeln!(out, "{}: {} tensors matched", args.out.display(), report.matched.len())?;
    Ok(())
}
