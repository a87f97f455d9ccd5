//! Hamlyn, rectified: laparoscopic stereo video, `rectifiedNN/{image01, depth01}` with `intrinsics.txt`.
//!
//! The left camera is read. Depth is the stereo depth published with the frames, 16-bit millimetres; there are no
//! poses. Rectified and given depth by D. Recasens et al., "Endo-Depth-and-Motion", IEEE RA-L 6 (2021).

use super::{Format, Probe, common};
use crate::depth::DepthEncoding;
use crate::{FramesError, Sequence};
use endoscape_core::camera::{Intrinsics, Pinhole};
use endoscape_core::trajectory::{TextError, numbers, records};
use endoscape_core::{Camera, Size};
use std::path::Path;

/// The rate usually taken for these recordings; the data set states none.
const ASSUMED_FPS: f64 = 30.0;

const DEPTH: DepthEncoding = DepthEncoding::Linear { metres_per_unit: 1e-3, largest: u16::MAX };

const PICTURES: &[&str] = &[".jpg", ".jpeg", ".png"];

/// Answers whether `path` holds this format, and loads it.
pub fn probe(path: &Path) -> Probe {
    if recognised(path) { Some(load(path)) } else { common::only_sequence(path, recognised, load) }
}

fn recognised(path: &Path) -> bool {
    common::holds_numbered(&path.join("image01"), "", PICTURES)
        && (path.join("depth01").is_dir() || path.join("intrinsics.txt").is_file())
}

fn load(path: &Path) -> Result<Sequence, FramesError> {
    let mut warnings = vec![format!("no frame rate is stated: frames are put in time at {ASSUMED_FPS} per second")];
    let mut frames = common::frames_at(&common::numbered(&path.join("image01"), "", PICTURES)?, ASSUMED_FPS);
    let size = common::first_size(path, &frames)?;
    let depth = path.join("depth01");
    if depth.is_dir() {
        common::attach_depth(&mut frames, common::numbered(&depth, "", &[".png"])?, &DEPTH, &mut warnings);
    }
    Ok(Sequence {
        format: Format::Hamlyn,
        name: common::name_of(path),
        root: path.to_path_buf(),
        size,
        fps: Some(ASSUMED_FPS),
        camera: camera(&path.join("intrinsics.txt"), size, &mut warnings)?,
        video: None,
        frames,
        license: None,
        warnings,
    })
}

fn camera(file: &Path, size: Size, warnings: &mut Vec<String>) -> Result<Option<Camera>, FramesError> {
    if !file.exists() {
        warnings.push("there is no intrinsics.txt: give the camera with --camera FILE or --hfov".into());
        return Ok(None);
    }
    let intrinsics = parse_intrinsics(&common::read_text(file)?).map_err(|error| (file, error))?;
    warnings.extend(common::centre_warning(&intrinsics, size));
    Camera::new(size, Pinhole { intrinsics }.into()).map(Some).map_err(|error| common::camera_error(file, &error))
}

/// Reads `intrinsics.txt`: three rows of a 3x4 projection (the fourth column, if there, is zero).
///
/// # Errors
/// [`TextError`] at the first of the three rows that does not begin with three finite numbers.
pub fn parse_intrinsics(text: &str) -> Result<Intrinsics, TextError> {
    let mut rows = records(text).map(|(line, record)| {
        let fields = record.split(|c: char| c.is_whitespace() || c == ',').filter(|field| !field.is_empty());
        numbers::<3>(line, fields.take(3), "a row of a 3x4 matrix")
    });
    let line = text.lines().count().max(1);
    let short = || Err(TextError { line, reason: "the file ends before the third row of its matrix".into() });
    let mut row = || rows.next().unwrap_or_else(short);
    let ([fx, skew, cx], [_, fy, cy], _) = (row()?, row()?, row()?);
    Ok(Intrinsics { fx, fy, cx, cy, skew })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::fixtures::{loaded, picture, refusal, text};
    use proptest::prelude::*;

    const INTRINSICS: &str = "38.3 0 16.1 0\n0 38.3 11.9 0\n0 0 1 0\n";

    fn sequence(folder: &Path) {
        for number in [3, 4, 5] {
            picture(&folder.join(format!("image01/{number:010}.jpg")), Size::new(32, 24));
            picture(&folder.join(format!("image02/{number:010}.jpg")), Size::new(32, 24));
            picture(&folder.join(format!("depth01/{number:010}.png")), Size::new(32, 24));
        }
        text(&folder.join("intrinsics.txt"), INTRINSICS);
    }

    #[test]
    fn frames_depth_and_camera_load() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("rectified01");
        sequence(&folder);
        let sequence = loaded(probe(&folder));
        assert_eq!((sequence.frames.len(), sequence.frames[0].number, sequence.fps), (3, 3, Some(30.0)));
        assert!(sequence.frames.iter().all(|frame| frame.depth.is_some()) && !sequence.has_poses());
        let pixel = sequence.camera.unwrap().project(&nalgebra::Point3::new(0.0, 0.0, 1.0)).unwrap();
        assert_eq!((pixel.x, pixel.y), (16.1, 11.9));
        assert_eq!(sequence.warnings.len(), 1, "{:?}", sequence.warnings);
    }

    #[test]
    fn wrong_rows_are_named_and_a_foreign_calibration_is_doubted() {
        let folder = tempfile::tempdir().unwrap();
        sequence(folder.path());
        let file = folder.path().join("intrinsics.txt");
        text(&file, "38.3 0 16.1 0\n0 x 11.9 0\n");
        assert!(refusal(probe(folder.path())).contains("intrinsics.txt, line 2: `x` is not a finite number"));
        text(&file, "38.3 0 16.1 0\n");
        assert!(refusal(probe(folder.path())).contains("line 1: the file ends before the third row"));
        text(&file, "0 0 16.1 0\n0 0 11.9 0\n0 0 1 0\n");
        assert!(refusal(probe(folder.path())).contains("fx is 0"));
        text(&file, "380 0 160 0\n0 380 120 0\n0 0 1 0\n");
        assert!(loaded(probe(folder.path())).warnings.iter().any(|warning| warning.contains("resized")));
    }

    proptest! {
        #[test]
        fn any_text_is_answered(text in "[-0-9eE., \n]{0,100}") {
            let _ = parse_intrinsics(&text);
        }
    }
}
