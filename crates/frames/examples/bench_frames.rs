//! The Rust half of `scripts/bench_frames.py`: does what a line on standard input says, answers with the seconds.
//!
//! `rectify PICTURE N` rectifies a 1350x1080 picture N times, `decode FOLDER` decodes every picture of a folder to
//! planes of f32 in 0..=1. Answers are one JSON list of seconds per line, so that two programs can take turns.

use endoscape_core::camera::Omnidirectional;
use endoscape_core::{Camera, Image, Size};
use endoscape_frames::preprocess::rectify::Rectifier;
use std::error::Error;
use std::hint::black_box;
use std::io::{BufRead, Write};
use std::path::{Path, PathBuf};
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        let seconds = match line.split_whitespace().collect::<Vec<_>>()[..] {
            ["rectify", picture, count] => rectify(Path::new(picture), count.parse()?)?,
            ["decode", folder] => decode(Path::new(folder))?,
            _ => return Err(format!("unknown request: {line}").into()),
        };
        writeln!(std::io::stdout(), "{seconds:?}")?;
    }
    Ok(())
}

fn rectify(picture: &Path, count: usize) -> Result<Vec<f64>, Box<dyn Error>> {
    let decoded = image::open(picture)?.into_rgb8();
    let image = Image::new(Size::new(1350, 1080), decoded.into_raw())?;
    let polynomial = [769.24, 0.0, -8.128e-4, 6.257e-7, -1.1966e-9];
    let lens = Omnidirectional { cx: 678.54, cy: 542.98, polynomial, stretch: [[1.0, 0.00288], [-0.00296, 1.0]] };
    let from = Camera::new(image.size(), lens.into())?;
    let to = Camera::from_field_of_view(Size::new(640, 512), 2.0 * (320.0_f64 / 360.0).atan())?;
    let rectifier = Rectifier::new(&from, &to);
    let once = || {
        let start = Instant::now();
        black_box(rectifier.image(black_box(&image)))?;
        Ok(start.elapsed().as_secs_f64())
    };
    (0..count).map(|_| once()).collect()
}

/// Seconds per picture of one pass over the folder.
fn decode(folder: &Path) -> Result<Vec<f64>, Box<dyn Error>> {
    let mut files =
        std::fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect::<std::io::Result<Vec<PathBuf>>>()?;
    files.sort();
    let once = |path: &PathBuf| {
        let start = Instant::now();
        let decoded = image::open(path)?.into_rgb8();
        black_box(planes(decoded.as_raw()));
        Ok(start.elapsed().as_secs_f64())
    };
    files.iter().map(once).collect()
}

/// Interleaved bytes to planes of red, green and blue in 0..=1.
fn planes(rgb: &[u8]) -> Vec<f32> {
    let mut planes = vec![0.0; rgb.len()];
    for (channel, plane) in planes.chunks_exact_mut(rgb.len() / 3).enumerate() {
        for (value, pixel) in plane.iter_mut().zip(rgb.chunks_exact(3)) {
            *value = f32::from(pixel[channel]) / 255.0;
        }
    }
    planes
}
