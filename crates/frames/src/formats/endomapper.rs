//! EndoMapper's recordings (Synapse syn26707219): colonoscopies as `Seq_NNN.mov`.
//!
//! `Seq_NNN_info.json` names the endoscope, `Endoscope_NN_geometrical.xml` (beside it, or in a calibration folder
//! here or above) is its calibration. A few procedures come with COLMAP reconstructions, `sparse/M/images.bin` or
//! `colmap/images.bin`; each has a frame and a unit of length of its own, so only the largest is used.

use super::{Probe, colmap, common, video_frames};
use crate::malformed::Malformed;
use crate::sequence::VideoFile;
use crate::{Format, FramesError, Sequence, camera_file, natural, video};
use colmap::ColmapImage;
use endoscape_core::{Camera, Size};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Largest reconstruction file read, in bytes.
const LARGEST_RECONSTRUCTION: u64 = 1 << 30;

/// Where calibrations lie: beside the recording or in the data set's own folder for them.
const CALIBRATIONS: [&str; 3] = ["", "Calibrations", "calibrations"];

/// Answers whether `path` (the recording or its folder) holds this format, and loads it.
pub fn probe(path: &Path) -> Probe {
    if path.is_file() {
        return is_recording(&common::name_of(path)).then(|| load(path, path));
    }
    let recordings = common::list(path, is_recording).ok()?;
    match recordings.as_slice() {
        [] => None,
        [recording] => Some(load(path, recording)),
        [_, ..] => {
            let reason = format!("holds {} recordings", recordings.len());
            Some(Err(FramesError::file(path, reason, "name one of its Seq_NNN.mov files")))
        }
    }
}

/// Whether a name is that of a recording: `Seq_001.mov`.
fn is_recording(name: &str) -> bool {
    let name = name.to_lowercase();
    let middle = name.strip_prefix("seq_").and_then(|rest| rest.strip_suffix(".mov"));
    middle.is_some_and(|middle| middle.starts_with(|c: char| c.is_ascii_digit()))
}

fn load(root: &Path, recording: &Path) -> Result<Sequence, FramesError> {
    let folder = recording.parent().unwrap_or(Path::new("."));
    let index = video::index(recording)?;
    let size = index.info.size;
    let mut sequence = Sequence {
        format: Format::Endomapper,
        name: recording.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default(),
        root: root.to_path_buf(),
        size,
        fps: index.info.fps,
        camera: None,
        video: Some(VideoFile { path: recording.to_path_buf(), crop: None }),
        frames: video_frames::frames_of(&index),
        license: Some("CC BY 4.0".into()),
        warnings: Vec::new(),
    };
    sequence.camera = camera(folder, &sequence.name, size, &mut sequence.warnings)?;
    if let Some((model, images)) = largest_reconstruction(folder)? {
        add_poses(&mut sequence, &model, &images);
    }
    Ok(sequence)
}

/// The calibration of the endoscope the recording was made with.
fn camera(folder: &Path, name: &str, frames: Size, warnings: &mut Vec<String>) -> Result<Option<Camera>, FramesError> {
    let info = folder.join(format!("{name}_info.json"));
    let endoscope = if info.is_file() {
        parse_endoscope(&common::read_text(&info)?).map_err(|error| error.at(&info))?
    } else {
        warnings.push(format!("no {name}_info.json: the endoscope is not known"));
        None
    };
    let Some(file) = calibration_file(folder, endoscope)? else {
        warnings.push("no calibration of this recording's endoscope was found: give one with --camera".into());
        return Ok(None);
    };
    camera_file::read_fitted(&file, frames, warnings).map(Some)
}

/// Reads the endoscope's number from `Seq_NNN_info.json`; it is a number, a text of digits, or "N/A".
///
/// # Errors
/// [`Malformed`] with the line if the text is no JSON.
pub fn parse_endoscope(text: &str) -> Result<Option<u32>, Malformed> {
    let info: serde_json::Value = serde_json::from_str(text)
        .map_err(|error| Malformed::line(error.line().max(1), format!("is no JSON ({error})")))?;
    let number = match info.get("endoscope_number") {
        Some(serde_json::Value::Number(number)) => number.as_u64().and_then(|number| u32::try_from(number).ok()),
        Some(serde_json::Value::String(text)) => text.trim().parse().ok(),
        _ => None,
    };
    Ok(number)
}

/// The endoscope's calibration beside the recording or in a calibration folder here or up to two folders above; one
/// beside the recording also counts when the endoscope is not known.
fn calibration_file(folder: &Path, endoscope: Option<u32>) -> Result<Option<PathBuf>, FramesError> {
    let full = folder.canonicalize().unwrap_or_else(|_| folder.to_path_buf());
    if let Some(number) = endoscope {
        let (name, file) = (format!("Endoscope_{number:02}"), format!("Endoscope_{number:02}_geometrical.xml"));
        let folders = full.ancestors().take(3).flat_map(|place| CALIBRATIONS.map(|sub| place.join(sub)));
        let files = folders.flat_map(|folder| [folder.join(&file), folder.join(&name).join(&file)]);
        return Ok(files.into_iter().find(|file| file.is_file()));
    }
    let beside = common::list(folder, |name| name.starts_with("Endoscope_") && name.ends_with("_geometrical.xml"))?;
    Ok(match beside.as_slice() {
        [file] => Some(file.clone()),
        _ => None,
    })
}

/// The reconstruction with the most pictures, and its folder.
fn largest_reconstruction(folder: &Path) -> Result<Option<(PathBuf, Vec<ColmapImage>)>, FramesError> {
    let mut models = vec![folder.join("colmap")];
    if let Ok(entries) = std::fs::read_dir(folder.join("sparse")) {
        models.extend(entries.filter_map(Result::ok).map(|entry| entry.path()));
    }
    models.sort_by(|a, b| natural::cmp(&a.to_string_lossy(), &b.to_string_lossy()));
    let mut largest: Option<(PathBuf, Vec<ColmapImage>)> = None;
    for model in models {
        let file = model.join("images.bin");
        if !file.is_file() {
            continue;
        }
        let bytes = common::read_bytes(&file, LARGEST_RECONSTRUCTION)?;
        let images = colmap::parse_images(&bytes).map_err(|error| error.at(&file))?;
        if largest.as_ref().is_none_or(|(_, most)| images.len() > most.len()) {
            largest = Some((model, images));
        }
    }
    Ok(largest)
}

fn add_poses(sequence: &mut Sequence, model: &Path, images: &[ColmapImage]) {
    let poses: BTreeMap<usize, _> =
        images.iter().filter_map(|image| Some((frame_of(&image.name)?, image.world_from_camera))).collect();
    for frame in &mut sequence.frames {
        frame.world_from_camera = poses.get(&frame.number).copied();
    }
    let matched = sequence.frames.iter().filter(|frame| frame.world_from_camera.is_some()).count();
    sequence.warnings.push(format!(
        "poses are those of the COLMAP reconstruction {}: they are in its own unit of length, not in metres",
        common::name_of(model)
    ));
    sequence.warnings.extend(common::pairing_warning(sequence.frames.len(), images.len(), matched));
}

/// Position in the video of a picture of the reconstruction: `out7199.png` is the frame at 7198, because the data
/// set's script numbers the extracted pictures from 1 (endomapper/EM_Dataset-ColmapValidation).
fn frame_of(name: &str) -> Option<usize> {
    let stem = Path::new(name).file_stem()?.to_str()?;
    let number = natural::number(stem)?;
    if stem.starts_with("out") { number.checked_sub(1) } else { Some(number) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::fixtures::text;
    use endoscape_core::Pose;

    #[test]
    fn recordings_are_known_by_name() {
        assert!(is_recording("Seq_001.mov") && is_recording("seq_12_a.MOV"));
        assert!(!is_recording("Seq_.mov") && !is_recording("clip.mov") && !is_recording("Seq_001.mp4"));
        assert!(probe(Path::new("no/such/folder")).is_none());
    }

    #[test]
    fn endoscopes_are_numbers_texts_or_not_recorded() {
        assert_eq!(parse_endoscope(r#"{"endoscope_number": 3}"#), Ok(Some(3)));
        assert_eq!(parse_endoscope(r#"{"endoscope_number": "12"}"#), Ok(Some(12)));
        assert_eq!(parse_endoscope(r#"{"endoscope_number": "N/A"}"#), Ok(None));
        assert_eq!(parse_endoscope("{\n,").unwrap_err().line, Some(2));
    }

    #[test]
    fn calibrations_lie_beside_or_above() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("Sequences/Seq_001");
        text(&folder.join("Seq_001_info.json"), "{}");
        let above = root.path().join("Calibrations/Endoscope_03/Endoscope_03_geometrical.xml");
        assert_eq!(calibration_file(&folder, Some(3)).unwrap(), None);
        text(&above, "");
        let found = calibration_file(&folder, Some(3)).unwrap().unwrap();
        assert_eq!(found, above.canonicalize().unwrap());
        text(&folder.join("Endoscope_07_geometrical.xml"), "");
        assert_eq!(calibration_file(&folder, None).unwrap(), Some(folder.join("Endoscope_07_geometrical.xml")));
    }

    #[test]
    fn names_of_the_reconstruction_count_from_one() {
        assert_eq!(frame_of("out7199.png"), Some(7198));
        assert_eq!(frame_of("out0.png"), None);
        assert_eq!(frame_of("000012.png"), Some(12));
    }

    #[test]
    fn the_largest_reconstruction_gives_the_poses() {
        let folder = tempfile::tempdir().unwrap();
        for (model, names) in [("0", &["out1.png"][..]), ("10", &["out2.png", "out3.png"][..])] {
            let file = folder.path().join("sparse").join(model).join("images.bin");
            text(&file, "");
            std::fs::write(&file, images_file(names)).unwrap();
        }
        let (model, images) = largest_reconstruction(folder.path()).unwrap().unwrap();
        assert!(model.ends_with("sparse/10"));
        assert_eq!((images.len(), images[1].name.as_str()), (2, "out3.png"));
        assert_eq!(images[0].world_from_camera, Pose::translation(-1.0, -2.0, -3.0));
    }

    /// `images.bin` of pictures one observed point each, with `camera_from_world` moving by (1, 2, 3).
    fn images_file(names: &[&str]) -> Vec<u8> {
        let mut bytes = (names.len() as u64).to_le_bytes().to_vec();
        for (number, name) in (1_u32..).zip(names) {
            bytes.extend(number.to_le_bytes());
            bytes.extend([1.0_f64, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0].iter().flat_map(|value| value.to_le_bytes()));
            bytes.extend(1_u32.to_le_bytes());
            bytes.extend(name.bytes().chain([0]));
            bytes.extend(1_u64.to_le_bytes());
            bytes.extend([0_u8; 24]);
        }
        bytes
    }

    #[test]
    fn a_recording_meets_its_calibration_and_poses() {
        let root = tempfile::tempdir().unwrap();
        let recording = root.path().join("Seq_001.mov");
        if !video_frames::tests::make_video(&recording, "72x54", 3) {
            return;
        }
        text(&root.path().join("Seq_001_info.json"), "{\"endoscope_number\": 1}");
        let calibration = "<rig><camera><camera_model type=\"calibu_fu_fv_u0_v0_kb4\"><width>1440</width><height>1080</height>\
            <params>[717; 717; 735; 552; -0.13; 0; 0; 0]</params></camera_model></camera></rig>";
        text(&root.path().join("Endoscope_01_geometrical.xml"), calibration);
        text(&root.path().join("sparse/0/images.bin"), "");
        std::fs::write(root.path().join("sparse/0/images.bin"), images_file(&["out2.png"])).unwrap();
        for path in [root.path(), &recording] {
            let sequence = probe(path).unwrap().unwrap();
            assert_eq!((sequence.frames.len(), sequence.camera.unwrap().size()), (3, Size::new(72, 54)));
            assert!(sequence.frames[1].world_from_camera.is_some() && sequence.frames[0].world_from_camera.is_none());
            assert!(sequence.warnings.iter().any(|warning| warning.contains("own unit of length")));
        }
        text(&root.path().join("Endoscope_01_geometrical.xml"), &calibration.replace("717;", "x;"));
        let sentence = probe(root.path()).unwrap().unwrap_err().to_string();
        assert!(sentence.contains("Endoscope_01_geometrical.xml, line 1: params is `x`"), "{sentence}");
    }
}
