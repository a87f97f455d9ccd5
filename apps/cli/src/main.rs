//! The `endoscape` command: parses, dispatches, and turns errors into one sentence and an exit code.
//!
//! Exit codes: 0 done, 1 the work failed, 2 the call itself was wrong.

// Types of the GPU backends nest deeper than the compiler's default.
#![recursion_limit = "256"]

mod commands;
mod device;
mod input;
mod memory;
mod model;
mod progress;
mod record;

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
    Demo(commands::demo::Args),
    Inspect(commands::inspect::Args),
    Convert(commands::convert::Args),
    Devices(commands::devices::Args),
    Eval(commands::eval::Args),
    Import(commands::import::Args),
    Export(commands::export::Args),
    Simulate(commands::simulate::Args),
    Train(commands::train::Args),
    Adapt(commands::adapt::Args),
    Run(commands::run::Args),
    Depth(commands::depth::Args),
    Motion(commands::motion::Args),
    Compare(Box<commands::compare::Args>),
    Report(commands::report::Args),
}

fn main() -> ExitCode {
    match perform(&Cli::parse().command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            // Nothing can be done about a standard error that is closed.
            writeln!(std::io::stderr(), "error: {}", sentence(&error)).ok();
            ExitCode::FAILURE
        }
    }
}

/// Does what a command says.
fn perform(command: &Command) -> anyhow::Result<()> {
    match command {
        Command::Demo(args) => commands::demo::run(args),
        Command::Inspect(args) => commands::inspect::run(args),
        Command::Convert(args) => commands::convert::run(args),
        Command::Devices(args) => commands::devices::run(args),
        Command::Eval(args) => commands::eval::run(args),
        Command::Import(args) => commands::import::run(args),
        Command::Export(args) => commands::export::run(args),
        Command::Simulate(args) => commands::simulate::run(args),
        Command::Train(args) => commands::train::run(args),
        Command::Adapt(args) => commands::adapt::run(args),
        Command::Run(args) => commands::run::run(args),
        Command::Depth(args) => commands::depth::run(args),
        Command::Motion(args) => commands::motion::run(args),
        Command::Compare(args) => commands::compare::run(args),
        Command::Report(args) => commands::report::run(args),
    }
}

/// The error with its causes, leaving out those it already quotes.
fn sentence(error: &anyhow::Error) -> String {
    let mut sentence = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !sentence.contains(&cause) {
            sentence = format!("{sentence}: {cause}");
        }
    }
    sentence
}

/// A reader that has seen enough, such as `head`, is no failure.
fn is_broken_pipe(error: &anyhow::Error) -> bool {
    let io = error.downcast_ref::<std::io::Error>();
    io.is_some_and(|error| error.kind() == std::io::ErrorKind::BrokenPipe)
}
