//! EndoMapper's simulated sequences (Synapse syn26707219).
//!
//! `image_N.png`, `aov_image_N.exr` (depth in the R channel), `calibration.txt`, `info.txt` (states the unit),
//! `trajectory.csv` (semicolons, see [`super::unity`]).

use super::{Probe, common, endoslam_unity, unity};
use crate::depth::DepthEncoding;
use crate::{Format, FramesError, Sequence, camera_file};
use std::path::Path;

/// Answers whether `path` holds this format, and loads it.
pub fn probe(path: &Path) -> Probe {
    let mine = path.join("trajectory.csv").is_file() && path.join("calibration.txt").is_file();
    mine.then(|| load(path))
}

fn load(path: &Path) -> Result<Sequence, FramesError> {
    let frames = common::frames_at(&common::numbered(path, "image_", &[".png"])?, unity::FPS);
    let size = common::first_size(path, &frames)?;
    let mut warnings = Vec::new();
    let camera = camera_file::read_fitted(&path.join("calibration.txt"), size, &mut warnings)?;
    let mut sequence = Sequence {
        format: Format::EndomapperSim,
        name: common::name_of(path),
        root: path.to_path_buf(),
        size,
        fps: Some(unity::FPS),
        camera: Some(camera),
        video: None,
        frames,
        license: Some("CC BY 4.0".into()),
        warnings,
    };
    let info = path.join("info.txt");
    let metres_per_unit =
        if info.is_file() { metres_per_unit(&common::read_text(&info)?) } else { unity::METRES_PER_UNIT };
    let maps = common::numbered(path, "aov_image_", &[".exr"])?;
    common::attach_depth(&mut sequence.frames, maps, &DepthEncoding::Exr { metres_per_unit }, &mut sequence.warnings);
    endoslam_unity::add_poses(&mut sequence, &path.join("trajectory.csv"), ';', metres_per_unit)?;
    Ok(sequence)
}

/// The unit `info.txt` names, or Unity's usual one.
fn metres_per_unit(info: &str) -> f64 {
    const UNITS: [(&str, f64); 3] = [("dm", 0.1), ("cm", 0.01), ("mm", 0.001)];
    let names = |unit: &str| info.split(|c: char| !c.is_alphanumeric()).any(|word| word.eq_ignore_ascii_case(unit));
    UNITS.iter().find(|(unit, _)| names(unit)).map_or(unity::METRES_PER_UNIT, |(_, metres)| *metres)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::fixtures::{loaded, picture, refusal, text};
    use endoscape_core::Size;

    fn fixture() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for number in [0, 1, 2, 10] {
            picture(&folder.path().join(format!("image_{number}.png")), Size::new(96, 72));
            std::fs::write(folder.path().join(format!("aov_image_{number}.exr")), b"").unwrap();
        }
        text(&folder.path().join("calibration.txt"), "fx = 47.2\nfy = 47.2\ncx = 47.5\ncy = 35.5\n");
        text(&folder.path().join("info.txt"), "Translations in cm.\n");
        let rows = "0;0;1;0;0;0;1;0\n0;0;2;0;0;0;1;0.03\n0;0;3;0;0;0;1;0.07\n";
        text(&folder.path().join("trajectory.csv"), &format!("tX;tY;tZ;rX;rY;rZ;rW;time(s)\n{rows}"));
        folder
    }

    #[test]
    fn depth_and_poses_share_the_stated_unit() {
        let folder = fixture();
        let sequence = loaded(probe(folder.path()));
        let numbers: Vec<usize> = sequence.frames.iter().map(|frame| frame.number).collect();
        assert_eq!(numbers, [0, 1, 2, 10]);
        assert_eq!(sequence.frames[1].world_from_camera.unwrap().translation.z, 0.02);
        assert_eq!(sequence.frames[3].world_from_camera, None);
        let depth = sequence.frames[1].depth.as_ref().unwrap();
        assert_eq!(depth.encoding, DepthEncoding::Exr { metres_per_unit: 0.01 });
        assert!(sequence.warnings.iter().any(|warning| warning.contains("3 of 4 frames have a pose")));
        assert!(sequence.warnings.iter().any(|warning| warning.contains("unit of the positions")));
    }

    #[test]
    fn the_first_fault_is_named() {
        let folder = fixture();
        text(&folder.path().join("calibration.txt"), "fx = 0\nfy = 47.2\ncx = 47.5\ncy = 35.5\n");
        assert!(refusal(probe(folder.path())).contains("calibration.txt: camera parameter fx is 0"));
        assert!(probe(&folder.path().join("nothing")).is_none());
    }
}
