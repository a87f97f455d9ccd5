//! A simulated capsule found by its magnet: the array's readings alone, in metres, beside the truth.
//!
//! `cargo run --release -p endoscape --example magnet -- NEW_FOLDER`

#![allow(clippy::print_stdout, reason = "a program for people")]

use endoscape::baselines::{Magnetic, MagneticConfig};
use endoscape::core::event::NullSink;
use endoscape::frames::magnet;
use endoscape::prelude::*;
use endoscape::sim::{Config, Effects, Hall, Organ, PathKind, Source, capsule_lens, simulate};
use std::error::Error;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn Error>> {
    let folder: PathBuf = std::env::args().nth(1).ok_or("name a folder that does not exist yet")?.into();
    let config = Config {
        source: Source::Organ(Organ::Stomach),
        frames: 40,
        fps: 10.0,
        seed: 1,
        camera: capsule_lens(Size::new(64, 64))?,
        path: PathKind::Capsule,
        effects: Effects::default(),
        hall: Hall::default(),
    };
    simulate(&config, &folder, &mut NullSink)?;

    let (rig, readings) = magnet::read(&folder)?.ok_or("the folder holds no readings")?;
    let mut magnetic = Magnetic::new(MagneticConfig::default(), rig)?;
    let truth = formats::open(&folder, None)?;
    for (reading, frame) in readings.into_iter().zip(&truth.frames) {
        let tracked = magnetic.track(&Observation::Magnetic(reading))?;
        if let Some((found, truth)) = tracked.world_from_camera.zip(frame.world_from_camera) {
            let error_m = (found.translation.vector - truth.translation.vector).norm();
            println!("{:.1} s: {:.2} mm off", frame.time_s, 1e3 * error_m);
        }
    }
    Ok(())
}
