//! The pictures of docs/simulator.md: every anatomy along its path, and every effect on and off.
//!
//! `cargo run --release -p endoscape-sim --example contact_sheets -- docs/images`

use endoscape_core::{Image, Size};
use endoscape_sim::simulate::sheet;
use endoscape_sim::{Config, Effect, Effects, Hall, Organ, PathKind, Patient, Session, SimError, Source, capsule_lens};
use std::path::Path;

/// Frames of a short simulation, every `step`-th.
fn frames(
    organ: Organ,
    path: PathKind,
    effects: Effects,
    seed: u64,
    range: (usize, usize),
) -> Result<Vec<Image>, SimError> {
    let camera = capsule_lens(Size::new(224, 224))?;
    let config = Config {
        source: Source::Organ(organ),
        frames: 400,
        fps: 5.0,
        seed,
        camera,
        path,
        effects,
        hall: Hall::default(),
    };
    let anatomy = config.anatomy()?;
    let patient = Patient::new(&config, &anatomy);
    let mut session = Session::start(&patient)?;
    let (step, count) = range;
    let mut kept = Vec::new();
    for number in 0..=step * (count - 1) {
        let frame = session.next_frame()?;
        if number % step == 0 {
            kept.push(frame.developed.image);
        }
    }
    Ok(kept)
}

fn write(folder: &Path, name: &str, pictures: &[Image], columns: usize) -> Result<(), Box<dyn std::error::Error>> {
    let sheet = sheet(pictures, columns);
    let (width, height) = (sheet.size().width as u32, sheet.size().height as u32);
    let file = std::fs::File::create(folder.join(format!("{name}.jpg")))?;
    let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(std::io::BufWriter::new(file), 85);
    Ok(encoder.encode(sheet.rgb(), width, height, image::ExtendedColorType::Rgb8)?)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::args().nth(1).ok_or("usage: contact_sheets FOLDER")?;
    let folder = Path::new(&folder);
    std::fs::create_dir_all(folder)?;
    for organ in Organ::ALL {
        let mut pictures = frames(organ, PathKind::Survey, Effects::default(), 1, (8, 5))?;
        pictures.extend(frames(organ, PathKind::Capsule, Effects::default(), 2, (8, 5))?);
        write(folder, organ.name(), &pictures, 5)?;
    }
    let plain = Effects::none().with(Effect::Gamma).with(Effect::Exposure);
    let mut pictures = frames(Organ::Colon, PathKind::Survey, plain, 1, (4, 2))?.split_off(1);
    for effect in
        Effect::ALL.iter().filter(|effect| !plain.has(**effect) && !matches!(effect, Effect::Hall | Effect::Actuation))
    {
        pictures.extend(frames(Organ::Colon, PathKind::Survey, plain.with(*effect), 1, (4, 2))?.split_off(1));
    }
    write(folder, "effects", &pictures, 6)
}
