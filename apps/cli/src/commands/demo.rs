//! `endoscape demo`: the whole product on a simulated patient, with nothing to download and nothing to configure.
//!
//! The demo is a script of the other commands, each shown before it runs, so that a reader can type it again with an
//! own video in the place of the patient.

use crate::{Cli, perform};
use anyhow::{Context as _, bail};
use clap::Parser as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// The bundled model; models/capsule/README.md says how it was trained.
const MODEL: [(&str, &[u8]); 3] = [
    ("config.toml", include_bytes!("../../../../models/capsule/config.toml")),
    ("manifest.json", include_bytes!("../../../../models/capsule/manifest.json")),
    ("weights.safetensors", include_bytes!("../../../../models/capsule/weights.safetensors")),
];

/// Seed of a patient that took no part in training.
const SEED: &str = "2026";

/// Show the whole product on a simulated patient: odometry, depth, and how far both are from the truth.
///
/// Takes some minutes on two processor cores, works offline, and ends with DIR/report.html.
#[derive(clap::Args)]
#[command(after_help = "Example:
  endoscape demo
  endoscape run patient.mp4 --hfov 140 --model endoscape-demo/model    # its model on a video of yours")]
pub struct Args {
    /// Folder for everything; it must not exist or be empty.
    #[arg(long, value_name = "DIR", default_value = "endoscape-demo")]
    out: PathBuf,
    /// Length of the flight in frames.
    #[arg(long, value_name = "N", default_value_t = 120, value_parser = clap::value_parser!(u16).range(10..=5000))]
    frames: u16,
}

/// Runs the command.
///
/// # Errors
/// The folder is in use or cannot be written, or a step fails.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let out = &args.out;
    if std::fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_some()) {
        bail!("{}: holds files already; name another folder with --out, or empty it", out.display());
    }
    let model = out.join("model");
    unpack(&model)?;
    say("A capsule in a simulated colon. No picture, pose or depth of this demo is from a patient.")?;
    let [patient, learned, magnetic, compared] =
        ["patient", "learned", "magnetic", "comparison"].map(|name| out.join(name).display().to_string());
    let (model, frames) = (model.display().to_string(), args.frames.to_string());
    step(&[
        "simulate",
        &patient,
        "--anatomy",
        "colon",
        "--seed",
        SEED,
        "--path",
        "withdrawal",
        "--frames",
        &frames,
        "--size",
        "256x256",
    ])?;
    step(&["run", &patient, "--model", &model, "--out", &learned])?;
    step(&["run", &patient, "--method", "magnetic", "--out", &magnetic])?;
    step(&[
        "compare",
        "--truth",
        &patient,
        &learned,
        &magnetic,
        "--out",
        &compared,
        "--title",
        "Demonstration on a simulated patient",
    ])?;
    finish(Path::new(&compared), out)
}

/// Writes the bundled model out, where `--model` finds it.
fn unpack(folder: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| {
        format!("{}: cannot be made; choose a place that can be written with --out", folder.display())
    })?;
    for (name, bytes) in MODEL {
        let path = folder.join(name);
        std::fs::write(&path, bytes)
            .with_context(|| format!("{}: cannot be written; make room or choose another --out", path.display()))?;
    }
    Ok(())
}

/// Shows a command and performs it.
fn step(words: &[&str]) -> anyhow::Result<()> {
    let quoted = words.iter().map(|word| if word.contains(' ') { format!("'{word}'") } else { (*word).to_owned() });
    say(&format!("\n$ endoscape {}", quoted.collect::<Vec<_>>().join(" ")))?;
    let cli = Cli::try_parse_from(std::iter::once("endoscape").chain(words.iter().copied()))?;
    perform(&cli.command)
}

/// Lays the page, which needs no other file, where it is looked for first.
fn finish(compared: &Path, out: &Path) -> anyhow::Result<()> {
    let page = out.join("report.html");
    std::fs::copy(compared.join("report.html"), &page)
        .with_context(|| format!("{}: cannot be written; make room", page.display()))?;
    say(&format!("\nEverything at a glance, in a browser: {}", page.display()))
}

fn say(line: &str) -> anyhow::Result<()> {
    Ok(writeln!(std::io::stdout(), "{line}")?)
}
