//! The `endoscape` command: parses, dispatches, and turns errors into one sentence and an exit code.
//!
//! Exit codes: 0 done, 1 the work failed, 2 the call itself was wrong.

mod commands;

use clap::{Parser, Subcommand};
use std::io::Write as _;
use std::process::ExitCode;

/// Motion and depth from the plain video of an endoscope or capsule robot.
#[derive(Parser)]
#[command(name = "endoscape", version, propagate_version = true, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Eval(commands::eval::Args),
}

fn main() -> ExitCode {
    let done = match &Cli::parse().command {
        Command::Eval(args) => commands::eval::run(args),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // Nothing can be done about a standard error that is closed.
            writeln!(std::io::stderr(), "error: {error:#}").ok();
            ExitCode::FAILURE
        }
    }
}
