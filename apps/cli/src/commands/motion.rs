//! `endoscape motion`: the motion network alone, on a handful of pictures.

use crate::device::DeviceArgs;
use crate::input::parse_size;
use crate::model;
use anyhow::bail;
use endoscape_core::{Image, Pose, Size, se3};
use endoscape_frames::picture;
use endoscape_frames::preprocess::resize;
use endoscape_odometry::networks::{MotionModel as _, MotionNetwork};
use serde::Serialize;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Motion between a few pictures in time order.
///
/// A model trained on snippets of three pictures takes A B C and says how the camera got from B to A and to C. Given A
/// and B alone, A also stands in for the picture before it, and the answer is the motion from A to B. A motion maps
/// points of the target's camera to the source's; its translation is in the unit of the training.
#[derive(clap::Args)]
#[command(after_help = "Example:
  endoscape motion 0001.png 0002.png 0003.png --model runs/phantom --json")]
pub struct Args {
    /// Pictures of one size in time order: as many as the model's snippets have, or two.
    #[arg(required = true, num_args = 2.., value_name = "IMAGE")]
    images: Vec<PathBuf>,
    /// Training run or checkpoint with a motion network.
    #[arg(long, value_name = "CKPT")]
    model: PathBuf,
    /// Size at which the network sees the pictures [default: that of the training].
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    size: Option<Size>,
    #[command(flatten)]
    device: DeviceArgs,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// The answer.
#[derive(Serialize)]
struct Motions {
    model: String,
    target: String,
    unit: &'static str,
    motions: Vec<Motion>,
}

/// The motion to one source.
#[derive(Serialize)]
struct Motion {
    source: String,
    translation: [f64; 3],
    /// Axis times angle.
    rotation_deg: [f64; 3],
    angle_deg: f64,
    /// Upper three rows, row by row.
    source_from_target: [[f64; 4]; 3],
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let device = args.device.device.open()?;
    let (checkpoint, config) = model::load(&args.model, args.size, &device)?;
    let network = MotionNetwork::new(checkpoint.pose, &device)?;
    let Window { target, sources } = window(args.images.len(), network.side())?;
    let pictures = read(&args.images, config.size)?;
    let seen = network.motions(&pictures[target], &sources.iter().map(|source| &pictures[*source]).collect::<Vec<_>>());
    let named = |index: usize| args.images[index].display().to_string();
    let motions = sources.iter().zip(&seen.source_from_target);
    // A picture that stands in for another has no motion to itself worth telling.
    let motions = motions.filter(|(source, _)| **source != target);
    write(
        args.json,
        &Motions {
            model: args.model.display().to_string(),
            target: named(target),
            unit: "of the training, not metres",
            motions: motions.map(|(source, pose)| motion(named(*source), pose)).collect(),
        },
    )
}

/// Which pictures are target and sources.
struct Window {
    target: usize,
    sources: Vec<usize>,
}

/// All pictures around the middle one, or the first and, on the far side of it, the second.
fn window(pictures: usize, side: usize) -> anyhow::Result<Window> {
    if pictures == 2 {
        return Ok(Window { target: 0, sources: [vec![0; side], vec![1; side]].concat() });
    }
    if pictures != 2 * side + 1 {
        bail!("the model looks at {} pictures but {pictures} were given; give that many or two", 2 * side + 1);
    }
    Ok(Window { target: side, sources: (0..pictures).filter(|picture| *picture != side).collect() })
}

/// Reads pictures of one size and brings them to that of the network.
fn read(paths: &[PathBuf], size: Size) -> anyhow::Result<Vec<Image>> {
    let mut first: Option<(&Path, Size)> = None;
    let mut pictures = Vec::with_capacity(paths.len());
    for path in paths {
        let image = picture::read(path)?;
        let (other, expected) = *first.get_or_insert((path, image.size()));
        if image.size() != expected {
            bail!(
                "{} is {} but {} is {expected}; give pictures of one camera",
                path.display(),
                image.size(),
                other.display()
            );
        }
        pictures.push(resize::image(&image, size)?);
    }
    Ok(pictures)
}

fn motion(source: String, source_from_target: &Pose) -> Motion {
    let matrix = source_from_target.to_homogeneous();
    let row = |row: usize| [0, 1, 2, 3].map(|column| matrix[(row, column)]);
    Motion {
        source,
        translation: source_from_target.translation.vector.into(),
        rotation_deg: source_from_target.rotation.scaled_axis().map(f64::to_degrees).into(),
        angle_deg: se3::rotation_angle_rad(source_from_target).to_degrees(),
        source_from_target: [row(0), row(1), row(2)],
    }
}

fn write(json: bool, motions: &Motions) -> anyhow::Result<()> {
    let mut stdout = std::io::stdout();
    if json {
        writeln!(stdout, "{}", serde_json::to_string_pretty(motions)?)?;
        return Ok(());
    }
    writeln!(stdout, "from {} (lengths in the unit {})", motions.target, motions.unit)?;
    for Motion { source, translation: [x, y, z], rotation_deg: [a, b, c], angle_deg, .. } in &motions.motions {
        writeln!(
            stdout,
            "  to {source}: translation {x:.5} {y:.5} {z:.5}, rotation {a:.3} {b:.3} {c:.3} deg ({angle_deg:.3} deg)"
        )?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_picture_is_the_target_and_two_are_enough() {
        let Window { target, sources } = window(5, 2).unwrap();
        assert_eq!((target, sources), (2, vec![0, 1, 3, 4]));
        let Window { target, sources } = window(2, 1).unwrap();
        assert_eq!((target, sources), (0, vec![0, 1]));
        assert!(window(4, 1).is_err());
    }
}
