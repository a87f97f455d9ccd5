//! `endoscape simulate`: a procedural patient with exact truth.

use crate::input::parse_size;
use crate::progress::Progress;
use endoscape_core::Size;
use endoscape_frames::camera_file;
use endoscape_sim::{Config, Effects, Hall, Organ, PathKind, Source, capsule_lens, simulate};
use std::io::Write as _;
use std::path::PathBuf;

/// Write a sequence folder of a simulated patient with exact depth, poses, masks, labels and surface flow.
#[derive(clap::Args)]
#[command(after_help = "Example:
  endoscape simulate patient --anatomy stomach --frames 200 --fps 15 --seed 7 --path steered-2 --effects default,fluid,no-jpeg

Paths: capsule, steered-1 to steered-4, insertion, withdrawal, retroflexion, survey.
Effects: none, default, all, or a list of names; no-NAME takes one away. docs/simulator.md shows each.")]
pub struct Args {
    /// Folder to write; it must not exist or be empty.
    out: PathBuf,
    /// The organ: colon, stomach or small-bowel; with --mesh, the organ whose mucosa and motion the mesh gets.
    #[arg(long, value_name = "ORGAN", default_value = "colon")]
    anatomy: Organ,
    /// Take the wall from an OBJ or PLY file.
    #[arg(long, value_name = "FILE")]
    mesh: Option<PathBuf>,
    /// Length of the unit of the mesh, in metres.
    #[arg(long, value_name = "METRES", default_value_t = 0.001, requires = "mesh")]
    mesh_unit: f64,
    /// Number of frames.
    #[arg(long, value_name = "N", default_value_t = 100)]
    frames: usize,
    /// Frames per second.
    #[arg(long, value_name = "F", default_value_t = 10.0)]
    fps: f64,
    /// Size of the frames.
    #[arg(long, value_name = "WxH", value_parser = parse_size, default_value = "320x320")]
    size: Size,
    /// Calibration file of the camera, scaled to --size; a capsule lens of 145 degrees if left out.
    #[arg(long, value_name = "FILE")]
    camera: Option<PathBuf>,
    /// Seed of everything random.
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    /// How the camera moves.
    #[arg(long, value_name = "NAME", default_value = "capsule")]
    path: PathKind,
    /// What is switched on.
    #[arg(long, value_name = "LIST", default_value = "default")]
    effects: Effects,
    /// Columns and rows of Hall sensors under the patient.
    #[arg(long, value_name = "WxH", value_parser = parse_size, default_value = "8x8")]
    hall: Size,
    /// Distance between neighbouring Hall sensors, in metres.
    #[arg(long, value_name = "METRES", default_value_t = 0.035)]
    hall_pitch: f64,
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let camera = match &args.camera {
        Some(file) => camera_file::read_camera(file, Some(args.size))?.scaled_to(args.size)?,
        None => capsule_lens(args.size)?,
    };
    let source = match &args.mesh {
        Some(path) => Source::Mesh { path: path.clone(), metres_per_unit: args.mesh_unit, like: args.anatomy },
        None => Source::Organ(args.anatomy),
    };
    let Args { frames, fps, seed, path, effects, .. } = *args;
    let hall = Hall { columns: args.hall.width, rows: args.hall.height, pitch_m: args.hall_pitch };
    let config = Config { source, frames, fps, seed, camera, path, effects, hall };
    let summary = simulate(&config, &args.out, &mut Progress::new())?;
    let rate = summary.frames as f64 / summary.elapsed_s.max(1e-9);
    let megarays = 1e-6 * summary.rays as f64;
    writeln!(
        std::io::stdout(),
        "{}: {} frames of {}, {rate:.1} per second, {megarays:.1} million rays",
        args.out.display(),
        summary.frames,
        args.size
    )?;
    Ok(())
}
