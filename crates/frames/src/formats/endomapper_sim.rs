//! EndoMapper's simulated sequences (Synapse syn26707219).
//!
//! `image_N.png`, `aov_image_N.exr` (depth in the R channel), `calibration.txt`, `info.txt` (states the unit),
//! `trajectory.csv` (semicolons, see [`super::unity`]).

use super::{Probe, common, endoslam_unity, numbered, unity};
use crate::depth::{DepthEncoding, DepthFile};
use crate::{Format, FramesError, Sequence, camera_file, picture};
use std::path::{Path, PathBuf};

/// Answers whether `path` holds this format, and loads it.
pub fn probe(path: &Path) -> Probe {
    let mine = path.join("trajectory.csv").is_file() && path.join("calibration.txt").is_file();
    mine.then(|| load(path))
}

fn load(path: &Path) -> Result<Sequence, FramesError> {
    let pictures = numbered::list(path, "image_", &["png"])?;
    let first = pictures.values().next().ok_or_else(|| numbered::none_found(path, "image_0.png"))?;
    let size = picture::size(first)?;
    let mut warnings = Vec::new();
    let calibration = path.join("calibration.txt");
    let camera = camera_file::read_camera(&calibration, Some(size))?;
    let camera = common::fit_camera(camera, size, &mut warnings)
        .map_err(|error| FramesError::file(&calibration, error.to_string(), "correct it"))?;
    let frame = |(number, picture): (&usize, &PathBuf)| common::frame_of(picture, *number, *number as f64 / unity::FPS);
    let mut sequence = Sequence {
        format: Format::EndomapperSim,
        name: common::name_of(path),
        root: path.to_path_buf(),
        size,
        fps: Some(unity::FPS),
        camera: Some(camera),
        video: None,
        frames: pictures.iter().map(frame).collect(),
        license: Some("CC BY 4.0".into()),
        warnings,
    };
    let info = path.join("info.txt");
    let metres_per_unit =
        if info.is_file() { metres_per_unit(&common::read_text(&info)?) } else { unity::METRES_PER_UNIT };
    let mut maps = numbered::list(path, "aov_image_", &["exr"])?;
    for frame in &mut sequence.frames {
        let encoding = DepthEncoding::Exr { metres_per_unit };
        frame.depth = maps.remove(&frame.number).map(|path| DepthFile { path, encoding });
    }
    endoslam_unity::add_poses(&mut sequence, &path.join("trajectory.csv"), ';', metres_per_unit)?;
    Ok(sequence)
}

/// The unit `info.txt` names, or Unity's usual one.
fn metres_per_unit(info: &str) -> f64 {
    const UNITS: [(&str, f64); 3] = [("dm", 0.1), ("cm", 0.01), ("mm", 0.001)];
    let names = |unit: &str| info.split(|c: char| !c.is_alphanumeric()).any(|word| word.eq_ignore_ascii_case(unit));
    UNITS.iter().find(|(unit, _)| names(unit)).map_or(unity::METRES_PER_UNIT, |(_, metres)| *metres)
}
