//! A comparison as a library call: `cargo run --example compare_files -- OUT TRUTH A B C`, all run folders, sequence
//! folders or trajectory files.

use endoscape_eval::poses::{Duplicates, Poses};
use endoscape_eval::trajectory::Settings;
use endoscape_frames::formats;
use endoscape_report::{MethodInput, RunFolder, SequenceInput, judge, write_comparison};
use std::error::Error;
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [out, truth, methods @ ..] = &arguments[..] else {
        return Err("give OUT TRUTH and at least one method".into());
    };
    let sequence = if Path::new(truth).is_dir() { Some(formats::open(Path::new(truth), None)?) } else { None };
    let methods = methods.iter().map(|method| input(method)).collect::<Result<_, _>>()?;
    let input = SequenceInput { name: truth.clone(), truth: Some(poses(truth)?), sequence, methods };
    let study = judge("A comparison".to_owned(), vec![input], &Settings::default())?;
    write_comparison(&study, Path::new(out))?;
    Ok(())
}

fn input(path: &str) -> Result<MethodInput, Box<dyn Error>> {
    let folder = Path::new(path).is_dir().then(|| RunFolder::open(Path::new(path))).transpose()?;
    let name = Path::new(path).file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
    Ok(MethodInput { name, poses: Some(poses(path)?), run: folder })
}

/// Poses of a file, of a run folder or of a sequence folder.
fn poses(path: &str) -> Result<Poses, Box<dyn Error>> {
    let inside = ["trajectory.tum", "poses.tum"].map(|name| Path::new(path).join(name));
    let file = inside.into_iter().find(|file| file.is_file()).unwrap_or_else(|| path.into());
    Ok(endoscape_eval::read::poses(&std::fs::read(file)?, None, Duplicates::Refuse)?)
}
