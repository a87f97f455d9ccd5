//! Depth of single pictures by the bundled model: how far the nearest, the middle and the farthest wall is.
//!
//! `cargo run --release -p endoscape --example depth -- PICTURE..`

#![allow(clippy::print_stdout, reason = "a program for people")]

use endoscape::prelude::*;
use std::error::Error;
use std::path::{Path, PathBuf};

fn main() -> Result<(), Box<dyn Error>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut pictures: Vec<PathBuf> = std::env::args().skip(1).map(PathBuf::from).collect();
    if pictures.is_empty() {
        pictures.push(root.join("fixtures/tube/frames/000000.png"));
    }
    let device = Device::flex();
    let checkpoint = Checkpoint::load(&root.join("models/capsule"), &device)?;
    let size = OdometryConfig::for_model(checkpoint.manifest.input.as_ref(), None).size;
    let network = LearnedDepth::new(&checkpoint, size, &device)?;
    for path in pictures {
        let depth = network.depth(&picture::read(&path)?)?;
        let mut values: Vec<f32> = depth.grid().values().iter().copied().filter(|depth| *depth > 0.0).collect();
        values.sort_by(f32::total_cmp);
        let share = |share: f64| values.get((share * (values.len() as f64 - 1.0)) as usize).copied().unwrap_or(0.0);
        println!("{}: {:.3} .. {:.3} .. {:.3}", path.display(), share(0.02), share(0.5), share(0.98));
    }
    println!("lengths are in the unit of the training");
    Ok(())
}
