//! EndoSLAM's rendered sequences (Mendeley cd2rtzm23r, `UnityCam/{Colon,Small Intestine,Stomach}`).
//!
//! `Frames/image_NNNN.png`, `Pixelwise Depths/aov_image_NNNN.png` (8 bit, brighter is nearer, no stated scale),
//! `Poses/*.csv` (see [`super::unity`]), optional `camera_intrinsics.txt`.

use super::{Probe, common, unity};
use crate::depth::DepthEncoding;
use crate::{Format, FramesError, Sequence, camera_file};
use endoscape_core::camera::{Intrinsics, Pinhole};
use endoscape_core::{Camera, Size};
use std::path::{Path, PathBuf};

/// The intrinsics published for UnityCam, for 320 x 320 pictures.
const PUBLISHED: Intrinsics = Intrinsics { fx: 156.0418, fy: 155.7529, cx: 178.5604, cy: 181.8043, skew: 0.0 };
const PUBLISHED_SIZE: Size = Size::new(320, 320);

/// Assumed depth of the brightest value. Users read the maps as 15 v/255, centimetres or millimetres; a centimetre is
/// the order at which a capsule sees the wall.
const NEAREST_M: f64 = 0.01;

/// Share of the picture by which a rendered picture's principal point may miss the centre without being doubtful.
const OFF_CENTRE: f64 = 0.02;

/// Answers whether `path` holds this format, and loads it.
pub fn probe(path: &Path) -> Probe {
    if !path.join("Frames").is_dir() {
        return None;
    }
    let tables = match common::list(&path.join("Poses"), |name| name.to_lowercase().ends_with(".csv")) {
        Ok(tables) => tables,
        Err(_) if !path.join("Poses").exists() => Vec::new(),
        Err(error) => return Some(Err(error)),
    };
    let mine = path.join("Pixelwise Depths").is_dir() || !tables.is_empty();
    mine.then(|| load(path, &tables))
}

fn load(path: &Path, tables: &[PathBuf]) -> Result<Sequence, FramesError> {
    let folder = path.join("Frames");
    let frames = common::frames_at(&common::numbered(&folder, "image_", &[".png", ".jpg"])?, unity::FPS);
    let size = common::first_size(&folder, &frames)?;
    let mut warnings = Vec::new();
    let camera = camera(path, size, &mut warnings)?;
    let mut sequence = Sequence {
        format: Format::EndoslamUnity,
        name: common::name_of(path),
        root: path.to_path_buf(),
        size,
        fps: Some(unity::FPS),
        camera: Some(camera),
        video: None,
        frames,
        license: None,
        warnings,
    };
    add_depth(&mut sequence, &path.join("Pixelwise Depths"))?;
    match tables {
        [] => sequence.warnings.push("no pose table (Poses/*.csv): the frames have no poses".into()),
        [table] => add_poses(&mut sequence, table, ',', unity::METRES_PER_UNIT)?,
        [_, second, ..] => {
            return Err(FramesError::file(second, "is a second pose table beside another", "move one of the two away"));
        }
    }
    Ok(sequence)
}

fn add_depth(sequence: &mut Sequence, folder: &Path) -> Result<(), FramesError> {
    if !folder.is_dir() {
        return Ok(());
    }
    let maps = common::numbered(folder, "aov_image_", &[".png"])?;
    let encoding = DepthEncoding::InverseLike { metres_per_unit: NEAREST_M };
    common::attach_depth(&mut sequence.frames, maps, &encoding, &mut sequence.warnings);
    if sequence.has_depth() {
        sequence.warnings.push(format!(
            "the depth maps have 8 bits and no stated scale: they are read as inverse depth with {} mm at the brightest \
             value, fit for comparison up to scale only",
            1000.0 * NEAREST_M
        ));
    }
    Ok(())
}

/// Gives frame `i` the pose in row `i` of a Unity table.
pub fn add_poses(sequence: &mut Sequence, table: &Path, separator: char, unit_m: f64) -> Result<(), FramesError> {
    let text = common::read_text(table)?;
    let poses = unity::parse_poses(&text, separator, unit_m).map_err(|error| error.at(table))?;
    let rows = &poses.world_from_camera;
    for frame in &mut sequence.frames {
        frame.world_from_camera = rows.get(frame.number).copied();
    }
    let matched = sequence.frames.iter().filter(|frame| frame.world_from_camera.is_some()).count();
    sequence.warnings.extend(poses.warnings(&common::name_of(table)));
    if let Some(warning) = common::pairing_warning(sequence.frames.len(), rows.len(), matched) {
        sequence.warnings.push(format!("{warning}; row i of {} was taken for frame i", common::name_of(table)));
    }
    sequence.warnings.push(format!("the unit of the positions is not certain: {unit_m} m was assumed"));
    Ok(())
}

/// The camera of `camera_intrinsics.txt` in the folder or above it, else the published one.
fn camera(path: &Path, frames: Size, warnings: &mut Vec<String>) -> Result<Camera, FramesError> {
    let candidates =
        [Some(path), path.parent()].into_iter().flatten().map(|folder| folder.join("camera_intrinsics.txt"));
    let camera = match candidates.into_iter().find(|file| file.is_file()) {
        Some(file) => camera_file::read_fitted(&file, frames, warnings)?,
        None => {
            warnings.push("no camera_intrinsics.txt: the intrinsics published for UnityCam are used".into());
            Camera::new(PUBLISHED_SIZE, Pinhole { intrinsics: PUBLISHED }.into())
                .and_then(|published| common::fit_camera(published, frames, warnings))
                .map_err(|error| common::camera_error(path, &error))?
        }
    };
    warnings.extend(off_centre(&camera));
    Ok(camera)
}

/// A sentence if the principal point of a rendered picture is not in its middle.
fn off_centre(camera: &Camera) -> Option<String> {
    let endoscape_core::CameraModel::Pinhole(Pinhole { intrinsics: Intrinsics { cx, cy, .. } }) = *camera.model()
    else {
        return None;
    };
    let size = camera.size();
    let misses = |value: f64, extent: usize| (value - 0.5 * (extent as f64 - 1.0)).abs() > OFF_CENTRE * extent as f64;
    (misses(cx, size.width) || misses(cy, size.height)).then(|| {
        format!(
            "the principal point ({cx:.1}, {cy:.1}) is off the centre of a rendered {size} picture: the published \
             intrinsics may be those of another camera"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::fixtures::{lines, loaded, picture, refusal, shared, text};

    fn fixture(rows: usize) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for number in 0..3 {
            picture(&folder.path().join(format!("Frames/image_{number:04}.png")), Size::new(32, 32));
            picture(&folder.path().join(format!("Pixelwise Depths/aov_image_{number:04}.png")), Size::new(32, 32));
        }
        let rows = lines(rows, |row| format!("{row},0,0,0,0,0,1,{}", row as f64 / 30.0));
        text(&folder.path().join("Poses/p.csv"), &format!("tX,tY,tZ,rX,rY,rZ,rW,time(s)\n{rows}"));
        text(&folder.path().join("camera_intrinsics.txt"), "15.6,0,15.5,0,15.5,15.5,0,0,1\n");
        folder
    }

    #[test]
    fn frames_meet_their_rows_and_maps() {
        let folder = fixture(3);
        let sequence = loaded(probe(folder.path()));
        assert_eq!((sequence.frames.len(), sequence.fps, sequence.size), (3, Some(30.0), Size::new(32, 32)));
        assert_eq!(sequence.frames[2].world_from_camera.unwrap().translation.x, 0.2);
        assert!(sequence.frames[1].depth.as_ref().unwrap().path.ends_with("aov_image_0001.png"));
        assert!(sequence.trajectory().unwrap().len() == 3 && sequence.camera.unwrap().size() == sequence.size);
        assert!(!sequence.warnings.iter().any(|warning| warning.contains("frames have a pose")));
    }

    #[test]
    fn surplus_rows_are_told() {
        let folder = fixture(7);
        let sequence = loaded(probe(folder.path()));
        let told = "3 of 3 frames have a pose; 4 of 7 poses belong to no frame; row i of p.csv was taken for frame i";
        assert!(sequence.warnings.iter().any(|warning| warning == told), "{:?}", sequence.warnings);
    }

    #[test]
    fn the_published_camera_steps_in() {
        let folder = fixture(3);
        std::fs::remove_file(folder.path().join("camera_intrinsics.txt")).unwrap();
        let sequence = loaded(probe(folder.path()));
        assert!(sequence.warnings.iter().any(|warning| warning.contains("is off the centre")));
        assert_eq!(sequence.camera.unwrap().size(), Size::new(32, 32));
    }

    #[test]
    fn the_first_bad_row_is_named() {
        let folder = fixture(3);
        text(&folder.path().join("Poses/p.csv"), "tX,tY\n0,0,0,0,0,0,1,0\n0,0,nan,0,0,0,1,0\n0,0,0,0,0,0,1,0\n");
        let sentence = refusal(probe(folder.path()));
        assert!(sentence.contains("p.csv, line 3: tZ is `nan`"), "{sentence}");
    }

    #[test]
    fn real_frames_load() {
        let Some(path) = shared("endoslam/UnityCam/Stomach") else { return };
        let sequence = loaded(probe(&path));
        assert_eq!((sequence.frames.len(), sequence.size), (270, Size::new(320, 320)));
        assert!(sequence.frames.iter().all(|frame| frame.depth.is_some() && frame.world_from_camera.is_some()));
        for told in ["line 1545: the last row breaks off", "poses belong to no frame", "off the centre", "8 bits"] {
            assert!(sequence.warnings.iter().any(|warning| warning.contains(told)), "{told}: {:?}", sequence.warnings);
        }
    }
}
