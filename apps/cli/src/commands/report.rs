//! `endoscape report`.

use anyhow::bail;
use endoscape_frames::formats;
use std::io::Write as _;
use std::path::PathBuf;

/// The report of one run, as `run` writes it at its end.
///
/// RUN is a folder that `run` wrote. The page is RUN/report.html.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  endoscape report runs/colon --truth patient/colon")]
pub struct Args {
    /// Run folder
    run: PathBuf,
    /// The sequence it ran on: its pictures, and its truth where it has one
    #[arg(long, value_name = "SEQ")]
    truth: Option<PathBuf>,
}

/// Reads, judges, writes.
///
/// # Errors
/// One sentence on what cannot be read, compared or written.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let holds = |name: &str| args.run.join(name).exists();
    if !["trajectory.tum", "depth", "frames.csv"].into_iter().any(holds) {
        bail!("{}: is no run folder; give a folder that `endoscape run` wrote", args.run.display());
    }
    let sequence = args.truth.as_ref().map(|path| formats::open(path, None)).transpose()?;
    let page = endoscape_report::run_report(&args.run, sequence.as_ref())?;
    writeln!(std::io::stdout(), "{}", page.display())?;
    Ok(())
}
