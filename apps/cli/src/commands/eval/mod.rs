//! `endoscape eval`: errors of trajectories, short windows and depth maps, beside what a trivial answer would get.

mod depth;
pub mod load;
mod snippets;
mod trajectory;

use anyhow::Context as _;
use endoscape_report::table::Table;
use serde::Serialize;
use std::io::Write as _;

/// Compare an estimate with the truth.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    Trajectory(Box<trajectory::Args>),
    Snippets(snippets::Args),
    Depth(depth::Args),
}

/// Runs one of the evaluations.
///
/// # Errors
/// One sentence on the input that cannot be compared.
pub fn run(args: &Args) -> anyhow::Result<()> {
    match &args.command {
        Command::Trajectory(args) => trajectory::run(args),
        Command::Snippets(args) => snippets::run(args),
        Command::Depth(args) => depth::run(args),
    }
}

/// How the result is written to standard output; a table for people by default.
#[derive(clap::Args)]
#[group(multiple = false)]
pub struct Output {
    /// One JSON object
    #[arg(long)]
    json: bool,
    /// The tables as comma-separated values, full precision
    #[arg(long)]
    csv: bool,
    /// The tables for a LaTeX paper (package booktabs)
    #[arg(long)]
    latex: bool,
}

impl Output {
    /// Writes the result in the form asked for; warnings go to standard error.
    pub fn write(&self, result: &impl Serialize, tables: &[Table], warnings: &[String]) -> anyhow::Result<()> {
        let mut errors = std::io::stderr().lock();
        for warning in warnings {
            // Nothing can be done about a standard error that is closed.
            writeln!(errors, "warning: {warning}").ok();
        }
        let joined = |form: fn(&Table) -> String| tables.iter().map(form).collect::<Vec<_>>().join("\n");
        let text = if self.json {
            serde_json::to_string_pretty(result).context("the result cannot be written as JSON")? + "\n"
        } else if self.csv {
            joined(Table::csv)
        } else if self.latex {
            joined(Table::latex)
        } else {
            joined(Table::text)
        };
        std::io::stdout().lock().write_all(text.as_bytes())?;
        Ok(())
    }
}
