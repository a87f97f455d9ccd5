//! `endoscape compare`.

use super::eval::load::Pairing;
use crate::record::RecordArgs;
use anyhow::{Context as _, bail};
use endoscape_eval::Alignment;
use endoscape_eval::trajectory::Settings;
use endoscape_frames::{Sequence, formats};
use endoscape_report::summary::Summary;
use endoscape_report::{MethodInput, RunFolder, SequenceInput, Study, judge, tables, verdict, wins, write_comparison};
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Several methods on one or several sequences: one page with figures, tables and a verdict.
///
/// RUNS are run folders or trajectory files of any format that `eval` reads. With several --truth, RUNS are given in as
/// many groups, one per truth in the same order, each with the same methods in the same order. A path may be named,
/// as in `ours=runs/a`; without a name it is called after its file or folder.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  endoscape compare --truth patient/colon ours=runs/learned runs/orb other.txt --out compared\n  \
                  endoscape compare --truth seq1 ours=a1 orb=b1 --truth seq2 a2 b2 --out compared"
)]
pub struct Args {
    /// Run folders or trajectories, each as PATH or NAME=PATH
    #[arg(required = true, value_name = "RUNS")]
    runs: Vec<String>,
    /// Sequence or trajectory that is true, as PATH or NAME=PATH; once per sequence
    #[arg(long, required = true, value_name = "SEQ")]
    truth: Vec<String>,
    /// Folder for report.html, compare.json and figures
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Headline of the page
    #[arg(long, value_name = "TEXT")]
    title: Option<String>,
    /// What is corrected before errors are taken: none, se3, sim3, scale, first (first poses laid over each other)
    #[arg(long, value_name = "KIND", default_value = "sim3")]
    align: Alignment,
    /// Lengths of sub-trajectories in metres [default: 10 to 50 cm, 100 to 800 m from a path of 100 m on]
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    lengths: Option<Vec<f64>>,
    #[command(flatten)]
    pairing: Pairing,
    #[command(flatten)]
    record: RecordArgs,
    /// One JSON object on standard output, the same as compare.json
    #[arg(long)]
    json: bool,
}

/// A path with the name the user gave it.
struct Named {
    name: Option<String>,
    path: PathBuf,
}

impl Named {
    /// `NAME=PATH`; a text that is a path as it stands has no name.
    fn parse(text: &str) -> Self {
        match text.split_once('=') {
            Some((name, path)) if !name.is_empty() && !Path::new(text).exists() => {
                Self { name: Some(name.to_owned()), path: PathBuf::from(path) }
            }
            _ => Self { name: None, path: PathBuf::from(text) },
        }
    }

    fn name(&self) -> String {
        let own = || {
            let path = self.path.canonicalize().unwrap_or_else(|_| self.path.clone());
            let name = if path.is_dir() { path.file_name() } else { path.file_stem() };
            name.map_or_else(|| self.path.display().to_string(), |name| name.to_string_lossy().into_owned())
        };
        self.name.clone().unwrap_or_else(own)
    }
}

/// Reads, judges, writes.
///
/// # Errors
/// One sentence on what cannot be read, compared or written.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let recorder = args.record.open()?;
    let inputs = inputs(args)?;
    let sequences: Vec<Option<Sequence>> = inputs.iter().map(|input| input.sequence.clone()).collect();
    let settings = Settings {
        association: args.pairing.association(),
        align: args.align,
        lengths_m: args.lengths.clone(),
        constant_motion: args.pairing.training_motion()?,
        ..Settings::default()
    };
    let title = args.title.clone().unwrap_or_else(|| title(&inputs));
    let study = judge(title, inputs, &settings)?;
    let page = write_comparison(&study, &args.out)?;
    let recording = recorder.write(&study, &sequences.iter().map(Option::as_ref).collect::<Vec<_>>())?;
    let text = if args.json {
        serde_json::to_string_pretty(&Summary::of(&study)).context("the result cannot be written as JSON")? + "\n"
    } else {
        text(&study, &page, recording.as_deref())
    };
    std::io::stdout().lock().write_all(text.as_bytes())?;
    Ok(())
}

fn inputs(args: &Args) -> anyhow::Result<Vec<SequenceInput>> {
    let (truths, runs) = (args.truth.len(), args.runs.len());
    if runs % truths != 0 {
        bail!("{runs} runs cannot be shared out to {truths} sequences; give the same number of runs for each --truth");
    }
    let runs: Vec<Named> = args.runs.iter().map(|text| Named::parse(text)).collect();
    let names = distinct(runs[..args.runs.len() / truths].iter().map(Named::name).collect());
    let groups = runs.chunks(names.len());
    args.truth.iter().zip(groups).map(|(truth, group)| input(args, &Named::parse(truth), group, &names)).collect()
}

/// Names that occur twice get a number.
fn distinct(names: Vec<String>) -> Vec<String> {
    let mut distinct: Vec<String> = Vec::new();
    for name in names {
        let numbered = (2..).map(|number| format!("{name} ({number})"));
        let free = std::iter::once(name.clone()).chain(numbered).find(|name| !distinct.contains(name));
        distinct.push(free.unwrap_or(name));
    }
    distinct
}

fn input(args: &Args, truth: &Named, runs: &[Named], names: &[String]) -> anyhow::Result<SequenceInput> {
    let sequence = sequence(&truth.path)?;
    let methods = runs.iter().zip(names).map(|(run, name)| method(args, run, name)).collect::<anyhow::Result<_>>()?;
    let poses = args.pairing.truth(&truth.path)?;
    Ok(SequenceInput { name: truth.name(), truth: Some(poses), sequence, methods })
}

/// The frames behind a truth; a trajectory alone has none.
fn sequence(path: &Path) -> anyhow::Result<Option<Sequence>> {
    if !path.is_dir() || path.join("trajectory.tum").is_file() {
        return Ok(None);
    }
    Ok(Some(formats::open(path, None)?))
}

fn method(args: &Args, run: &Named, name: &str) -> anyhow::Result<MethodInput> {
    let folder = run.path.is_dir().then(|| RunFolder::open(&run.path)).transpose()?;
    Ok(MethodInput { name: name.to_owned(), poses: Some(args.pairing.estimate(&run.path)?), run: folder })
}

fn title(inputs: &[SequenceInput]) -> String {
    let methods: Vec<&str> =
        inputs.first().map_or_else(Vec::new, |input| input.methods.iter().map(|method| method.name.as_str()).collect());
    match inputs {
        [one] => format!("{} on {}", methods.join(", "), one.name),
        several => format!("{} on {} sequences", methods.join(", "), several.len()),
    }
}

/// Tables and verdict for a terminal, and where the page and the recording are.
fn text(study: &Study, page: &Path, recording: Option<&Path>) -> String {
    let mut text = String::new();
    for sequence in &study.sequences {
        // Writing to a String cannot fail.
        writeln!(text, "{}\n", sequence.name).ok();
        for table in tables::of(sequence) {
            writeln!(text, "{}", table.text()).ok();
        }
        for sentence in verdict::of(sequence) {
            writeln!(text, "{sentence}").ok();
        }
        text.push('\n');
    }
    if let Some(wins) = wins::count(study) {
        if let Some(table) = tables::wins(study, &wins) {
            writeln!(text, "{}", table.text()).ok();
        }
        for sentence in verdict::overall(study, &wins) {
            writeln!(text, "{sentence}").ok();
        }
    }
    for file in std::iter::once(page).chain(recording) {
        writeln!(text, "{}", file.display()).ok();
    }
    text
}
