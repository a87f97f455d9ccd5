//! `endoscape inspect`: what a path holds and whether it is consistent.

use crate::input::{InputArgs, parse_field_of_view};
use crate::progress::Progress;
use endoscape_frames::inspect::{Inspection, contact_sheet, inspect};
use endoscape_frames::picture;
use std::io::Write as _;
use std::path::PathBuf;

/// Tell what was found and whether poses, depth and calibration agree.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  endoscape inspect recordings/c3vd/cecum_t1_a --preview sheet.png")]
pub struct Args {
    #[command(flatten)]
    input: InputArgs,
    /// Horizontal field of view to assume where no calibration is known.
    #[arg(long, value_name = "DEGREES", value_parser = parse_field_of_view)]
    hfov: Option<f64>,
    /// Print one JSON object instead of text.
    #[arg(long)]
    json: bool,
    /// Write a contact sheet: frames, depth in colours, field of view.
    #[arg(long, value_name = "FILE.png")]
    preview: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let sequence = args.input.open_assuming(args.hfov)?;
    let inspection = inspect(&sequence, &mut Progress::new())?;
    if let Some(file) = &args.preview {
        let mask = inspection.field_of_view.as_ref().map(|found| &found.mask);
        picture::write_png(file, &contact_sheet(&inspection.panels, mask))?;
    }
    let text = if args.json { serde_json::to_string_pretty(&inspection)? } else { describe(&inspection) };
    writeln!(std::io::stdout(), "{text}")?;
    Ok(())
}

/// The findings for a person.
fn describe(found: &Inspection) -> String {
    let mut lines = vec![format!("{}: {} frames of {}x{}, format {}", found.name, found.frames, found.width, found.height, found.format)];
    let mut row = |name: &str, value: String| lines.push(format!("  {name:<14}{value}"));
    row("frame rate", found.fps.map_or("unknown".into(), |fps| format!("{fps:.3} per second")));
    let degrees = found.horizontal_fov_deg.map_or(String::new(), |degrees| format!(", {degrees:.1} degrees wide"));
    row("camera", found.camera.map_or("no calibration".into(), |camera| format!("{}{degrees}", camera.model().name())));
    let share = 100.0 * found.field_of_view_share;
    row("field of view", if share < 100.0 { format!("{share:.1} % of the picture") } else { "the whole picture".into() });
    row("poses", found.path_length_m.map_or("none".into(), |metres| format!("path of {}", length(metres))));
    row("depth", if found.has_depth { "yes".into() } else { "none".into() });
    row("masks", if found.has_masks { "yes".into() } else { "none".into() });
    if let Some(license) = &found.license {
        row("licence", license.clone());
    }
    lines.extend(describe_check(found));
    lines.extend(found.warnings.iter().map(|warning| format!("  warning: {warning}")));
    lines.join("\n")
}

/// The depth check: the loader's convention and the runners-up.
fn describe_check(found: &Inspection) -> Vec<String> {
    let Some(check) = &found.depth_consistency else { return Vec::new() };
    let mut lines = vec![format!(
        "  depth of frame {} seen from frame {}: median off by {}, 90 % within {}, {:.1} % agree",
        check.frame_a,
        check.frame_b,
        length(check.median_m),
        length(check.p90_m),
        100.0 * check.inlier_share
    )];
    let mut scores: Vec<_> = found.conventions.iter().collect();
    scores.sort_by(|a, b| a.median_m.unwrap_or(f64::INFINITY).total_cmp(&b.median_m.unwrap_or(f64::INFINITY)));
    lines.extend(scores.iter().map(|score| {
        let value = score.median_m.map_or("no overlap".into(), length);
        format!("    {value:>12}  {}", score.name)
    }));
    lines
}

/// A length in the unit a reader expects at that size.
fn length(metres: f64) -> String {
    if metres < 1.0 { format!("{:.3} mm", 1e3 * metres) } else { format!("{metres:.3} m") }
}
