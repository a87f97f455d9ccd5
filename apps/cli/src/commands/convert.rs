//! `endoscape convert`: anything to a clean sequence folder.

use crate::input::{InputArgs, parse_field_of_view, parse_range, parse_size};
use crate::progress::Progress;
use endoscape_core::{Event, EventSink as _, Size};
use endoscape_frames::convert::{ConvertOptions, convert};
use std::io::Write as _;
use std::ops::Range;
use std::path::PathBuf;

/// Write a sequence folder; frames, intrinsics, masks, poses and depth are changed together.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  endoscape convert recordings/c3vd/cecum_t1_a cecum --rectify --size 320x256")]
pub struct Args {
    #[command(flatten)]
    input: InputArgs,
    /// Folder to write; it must not exist or be empty.
    out: PathBuf,
    /// Remap to a pinhole camera along the same axis.
    #[arg(long)]
    rectify: bool,
    /// Horizontal field of view: of the rectified camera, or of the one assumed where no calibration is known.
    #[arg(long, value_name = "DEGREES", value_parser = parse_field_of_view)]
    hfov: Option<f64>,
    /// Size of the written frames.
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    size: Option<Size>,
    /// Frames A to B - 1 only, counted from 0.
    #[arg(long, value_name = "A..B", value_parser = parse_range)]
    range: Option<Range<usize>>,
    /// Every N-th frame only.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let sequence = args.input.open_assuming(args.hfov)?;
    // An open end means the last frame, which only a live input does not have.
    let last = sequence.frames.len();
    let options = ConvertOptions {
        rectify: args.rectify,
        horizontal_fov_rad: args.hfov.map(f64::to_radians),
        size: args.size,
        range: args.range.clone().map(|range| range.start..if range.end == usize::MAX { last } else { range.end }),
        every: args.every as usize,
    };
    let mut progress = Progress::new();
    for warning in &sequence.warnings {
        progress.event(Event::Warned(warning.clone()));
    }
    let written = convert(&sequence, &args.out, &options, &mut progress)?;
    writeln!(std::io::stdout(), "{}: {} frames of {}", args.out.display(), written.frames, written.size)?;
    Ok(())
}
