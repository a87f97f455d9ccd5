//! Reports on disk: each file is written beside its place and moved there when complete.

use crate::figure::raster;
use crate::page::{Page, Section};
use crate::study::{MethodInput, SequenceInput, SequenceStudy, Study, judge};
use crate::summary::Summary;
use crate::{ReportError, RunFolder, figures, tables, verdict, wins};
use endoscape_eval::poses::{Duplicates, Poses};
use endoscape_eval::trajectory::Settings;
use endoscape_eval::{TrajectoryFormat, read};
use endoscape_frames::Sequence;
use std::path::{Path, PathBuf};

/// Writes `report.html`, `compare.json` and `figures/` into a folder, which is made if need be; returns the page.
///
/// # Errors
/// [`ReportError`] if a figure cannot be drawn or a file not be written.
pub fn write_comparison(study: &Study, out: &Path) -> Result<PathBuf, ReportError> {
    let sections = sections(study)?;
    let folder = out.join("figures");
    create(&folder)?;
    for figure in sections.iter().flat_map(|section| &section.figures) {
        let svg = figure.svg();
        save(&folder.join(format!("{}.svg", figure.id)), svg.as_bytes())?;
        save(&folder.join(format!("{}.png", figure.id)), &raster::png(&figure.title, &svg)?)?;
        save(&folder.join(format!("{}.csv", figure.id)), figure.csv.as_bytes())?;
    }
    let json = out.join("compare.json");
    let summary = serde_json::to_string_pretty(&Summary::of(study))
        .map_err(|error| ReportError::file(&json, format!("cannot be made: {error}"), "report this"))?;
    save(&json, (summary + "\n").as_bytes())?;
    let page = out.join("report.html");
    save(&page, page_of(study, sections).html().as_bytes())?;
    Ok(page)
}

/// Judges a run folder: its path, depth, reliability, confidence and speed; errors where `sequence`, the frames it ran
/// on, knows the truth.
///
/// # Errors
/// [`ReportError`] if the folder cannot be read or does not fit the sequence.
pub fn judge_run(run: &Path, sequence: Option<&Sequence>) -> Result<Study, ReportError> {
    let truth = sequence.filter(|sequence| sequence.has_poses()).map(Sequence::trajectory).transpose()?;
    let truth = truth.map(|trajectory| Poses::from_trajectory(&trajectory)).transpose();
    let truth = truth.map_err(ReportError::evaluation("the truth"))?;
    let folder = RunFolder::open(run)?;
    let name = folder.facts.method.clone().unwrap_or_else(|| folder.name());
    let sequence_name = sequence.map_or_else(|| folder.name(), |sequence| sequence.name.clone());
    let method = MethodInput { name: name.clone(), poses: run_poses(run)?, run: Some(folder) };
    let input =
        SequenceInput { name: sequence_name.clone(), truth, sequence: sequence.cloned(), methods: vec![method] };
    judge_or_show(format!("{name} on {sequence_name}"), input)
}

/// Writes `report.html` into a run folder and returns the page.
///
/// # Errors
/// [`ReportError`] if a figure cannot be drawn or the page not be written.
pub fn write_run(study: &Study, run: &Path) -> Result<PathBuf, ReportError> {
    let page = run.join("report.html");
    save(&page, page_of(study, sections(study)?).html().as_bytes())?;
    Ok(page)
}

/// Judges a run; one whose path leaves an alignment open (too few frames, a straight line) is shown with the reason.
fn judge_or_show(title: String, input: SequenceInput) -> Result<Study, ReportError> {
    let unjudged = SequenceInput { truth: None, ..input.clone() };
    match judge(title.clone(), vec![input], &Settings::default()) {
        Err(ReportError::Evaluation { source, .. }) => {
            let mut study = judge(title, vec![unjudged], &Settings::default())?;
            for method in study.sequences.iter_mut().flat_map(|sequence| &mut sequence.methods) {
                method.notes.push(format!("the path is not judged: {source}"));
            }
            Ok(study)
        }
        other => other,
    }
}

/// The poses of a run; none if it wrote none, or lost every frame.
fn run_poses(run: &Path) -> Result<Option<Poses>, ReportError> {
    let path = run.join("trajectory.tum");
    let bytes = match std::fs::read(&path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(ReportError::file(&path, format!("cannot be read: {error}"), "check the file")),
    };
    match read::poses(&bytes, Some(TrajectoryFormat::Tum), Duplicates::Refuse) {
        Ok(poses) => Ok(Some(poses)),
        Err(endoscape_eval::EvalError::Empty) => Ok(None),
        Err(error) => Err(ReportError::evaluation(path.display().to_string())(error)),
    }
}

fn sections(study: &Study) -> Result<Vec<Section>, ReportError> {
    let section = |(position, sequence): (usize, &SequenceStudy)| {
        Ok(Section {
            name: sequence.name.clone(),
            verdict: verdict::of(sequence),
            notes: notes(sequence),
            tables: tables::of(sequence),
            figures: figures::of(sequence, position)?,
        })
    };
    study.sequences.iter().enumerate().map(section).collect()
}

fn notes(sequence: &SequenceStudy) -> Vec<String> {
    let of = |method: &crate::study::MethodStudy| {
        let name = method.name.clone();
        method.notes.iter().map(move |note| format!("{name}: {note}.")).collect::<Vec<_>>()
    };
    sequence.methods.iter().flat_map(of).collect()
}

fn page_of(study: &Study, sections: Vec<Section>) -> Page<'_> {
    let wins = wins::count(study);
    let methods = study.sequences.iter().map(|sequence| sequence.methods.len()).max().unwrap_or_default();
    let count = |number: usize, word: &str| format!("{number} {word}{}", if number == 1 { "" } else { "s" });
    let lead = format!(
        "{} on {}. Lengths in metres or millimetres, angles in degrees; best values in bold; trivial answers in italics.",
        count(methods, "method"),
        count(study.sequences.len(), "sequence")
    );
    Page {
        title: &study.title,
        lead,
        verdict: wins.as_ref().map_or_else(Vec::new, |wins| verdict::overall(study, wins)),
        overall: wins.as_ref().and_then(|wins| tables::wins(study, wins)).into_iter().collect(),
        sections,
        origin: vec![
            ("written by".to_owned(), format!("endoscape {}", env!("CARGO_PKG_VERSION"))),
            ("alignment".to_owned(), study.align.to_string()),
        ],
    }
}

/// Judges a run folder and writes its page, which is returned.
///
/// # Errors
/// As [`judge_run`] and [`write_run`].
pub fn run_report(run: &Path, sequence: Option<&Sequence>) -> Result<PathBuf, ReportError> {
    write_run(&judge_run(run, sequence)?, run)
}

fn create(folder: &Path) -> Result<(), ReportError> {
    std::fs::create_dir_all(folder)
        .map_err(|error| ReportError::file(folder, format!("cannot be made: {error}"), "choose another --out"))
}

/// Writes beside the place and moves there.
fn save(path: &Path, bytes: &[u8]) -> Result<(), ReportError> {
    let mut beside = path.as_os_str().to_owned();
    beside.push(".part");
    let beside = PathBuf::from(beside);
    std::fs::write(&beside, bytes).and_then(|()| std::fs::rename(&beside, path)).map_err(|error| {
        ReportError::file(path, format!("cannot be written: {error}"), "check the folder and its space")
    })
}
