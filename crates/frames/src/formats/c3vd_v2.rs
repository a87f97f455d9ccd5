//! C3VD, second release: `rgb/NNNN.png`, `depth/NNNN_depth.tiff`, `pose.txt` and `camera_intrinsics.txt` per sequence.
//!
//! Poses and depth are stored as in the first release ([`super::c3vd`]); deformation and screening sequences have no
//! depth. One of the published archives holds its sequence one folder deeper than the others, so a folder with
//! exactly one sequence inside stands for that sequence. M. Golhar et al., arXiv 2506.24074 (2025).

use super::{Format, Probe, c3vd, common};
use crate::{FramesError, Sequence};
use endoscape_core::camera::Omnidirectional;
use endoscape_core::{Camera, Size};
use std::path::Path;

const PICTURES: &[&str] = &[".png", ".jpg", ".jpeg"];
const DEPTH_MAPS: &[&str] = &["_depth.tiff", "_depth.tif"];

/// Answers whether `path` holds this format, and loads it.
pub fn probe(path: &Path) -> Probe {
    if recognised(path) { Some(load(path)) } else { common::only_sequence(path, recognised, load) }
}

fn recognised(path: &Path) -> bool {
    let own_files = || {
        path.join("pose.txt").is_file()
            || path.join("camera_intrinsics.txt").is_file()
            || common::holds_numbered(&path.join("depth"), "", DEPTH_MAPS)
    };
    common::holds_numbered(&path.join("rgb"), "", PICTURES) && own_files()
}

fn load(path: &Path) -> Result<Sequence, FramesError> {
    let mut warnings = Vec::new();
    let mut frames = common::frames_at(&common::numbered(&path.join("rgb"), "", PICTURES)?, c3vd::FPS);
    let size = common::first_size(path, &frames)?;
    let depth = path.join("depth");
    if depth.is_dir() {
        let maps = common::numbered(&depth, "", DEPTH_MAPS)?;
        common::attach_depth(&mut frames, maps, &c3vd::DEPTH, &mut warnings);
    }
    c3vd::attach_pose_file(path, &mut frames, &mut warnings)?;
    Ok(Sequence {
        format: Format::C3vdV2,
        name: common::name_of(path),
        root: path.to_path_buf(),
        size,
        fps: Some(c3vd::FPS),
        camera: Some(camera(path, size, &mut warnings)?),
        video: None,
        frames,
        license: Some(c3vd::LICENSE.into()),
        warnings,
    })
}

/// The calibration beside the frames where it is readable and plausible, else that of the first release, which was
/// made with the same colonoscope.
fn camera(folder: &Path, size: Size, warnings: &mut Vec<String>) -> Result<Camera, FramesError> {
    let file = folder.join("camera_intrinsics.txt");
    let stated = match file.is_file() {
        true => parse_intrinsics(&common::read_text(&file)?),
        false => Err("it does not exist".into()),
    };
    let fitted = match stated {
        Ok(camera) => common::fit_camera(camera, size, warnings),
        Err(reason) => {
            warnings.push(format!(
                "camera_intrinsics.txt is not used ({reason}): the camera is that of the first C3VD release; give \
                 --camera FILE if it is another"
            ));
            c3vd::camera_for(size, warnings)
        }
    };
    fitted.map_err(|error| common::camera_error(&file, &error))
}

/// Reads named numbers in any layout (`cx: 678.5`, `a0 = 769.2`, one or many to a line) into an omnidirectional camera.
///
/// `cx, cy, a0, a2, a3, a4` must be there; where they are not, `width` and `height` are 1350 and 1080, `a1` is 0 and
/// `c, d, e` are 1, 0, 0.
///
/// # Errors
/// Why not: a name that is missing, or numbers that are no camera with its centre on the picture.
pub fn parse_intrinsics(text: &str) -> Result<Camera, String> {
    let named = |name: &str| named_number(text, name);
    let needed = |name: &str| named(name).ok_or_else(|| format!("it holds no number named {name}"));
    let extent = |name: &str, recorded: usize| {
        let value = named(name).unwrap_or(recorded as f64);
        let pixels = (1.0..=65536.0).contains(&value).then_some(value as usize);
        pixels.ok_or_else(|| format!("its {name} is {value}"))
    };
    let size = Size::new(extent("width", c3vd::RECORDED.width)?, extent("height", c3vd::RECORDED.height)?);
    let model = Omnidirectional {
        cx: needed("cx")?,
        cy: needed("cy")?,
        polynomial: [needed("a0")?, named("a1").unwrap_or(0.0), needed("a2")?, needed("a3")?, needed("a4")?],
        stretch: [[named("c").unwrap_or(1.0), named("d").unwrap_or(0.0)], [named("e").unwrap_or(0.0), 1.0]],
    };
    let camera = Camera::new(size, model.into()).map_err(|error| error.to_string())?;
    let centre = nalgebra::Point2::new(model.cx, model.cy);
    if !camera.contains(&centre) || camera.horizontal_field_of_view_rad().is_none() {
        return Err("its numbers are not those of a camera that sees its whole middle row".into());
    }
    Ok(camera)
}

/// The finite number that follows `name` as a word of its own, in whatever case.
fn named_number(text: &str, name: &str) -> Option<f64> {
    let separates = |c: char| c.is_whitespace() || ":=,;()[]{}\"'".contains(c);
    let mut words = text.split(separates).filter(|word| !word.is_empty());
    words.find(|word| word.eq_ignore_ascii_case(name))?;
    words.next()?.parse().ok().filter(|value: &f64| value.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::fixtures::{lines, loaded, picture, refusal, text};
    use proptest::prelude::*;

    const INTRINSICS: &str = "width: 1350\nheight: 1080\ncx: 678.5\ncy: 542.9\na0: 769.2\na1: 0\na2: -8.1e-4\n\
                              a3: 6.3e-7\na4: -1.2e-9\nc: 1.0\nd: 0.0029\ne: -0.003\n";

    fn sequence(folder: &Path) {
        for number in 0..3 {
            picture(&folder.join(format!("rgb/{number:04}.png")), Size::new(135, 108));
            text(&folder.join(format!("depth/{number:04}_depth.tiff")), "");
        }
        text(&folder.join("pose.txt"), &lines(3, |k| format!("1,0,0,0,0,1,0,0,0,0,1,0,0,0,{k},1")));
        text(&folder.join("camera_intrinsics.txt"), INTRINSICS);
    }

    #[test]
    fn a_sequence_loads_also_from_one_folder_above() {
        let folder = tempfile::tempdir().unwrap();
        let inner = folder.path().join("c1_cecum_t1_v3");
        sequence(&inner);
        for path in [folder.path(), &inner] {
            let sequence = loaded(probe(path));
            assert_eq!((sequence.frames.len(), sequence.name.as_str()), (3, "c1_cecum_t1_v3"));
            assert!(sequence.frames.iter().all(|frame| frame.depth.is_some()));
            assert!((sequence.trajectory().unwrap().path_length_m() - 0.002).abs() < 1e-12);
            assert!(sequence.warnings.iter().all(|warning| warning.contains("scaled")), "{:?}", sequence.warnings);
        }
        sequence(&folder.path().join("c1_cecum_t1_v2"));
        let error = refusal(probe(folder.path()));
        assert!(error.contains("2 sequences (c1_cecum_t1_v2, c1_cecum_t1_v3)"), "{error}");
    }

    #[test]
    fn an_unreadable_calibration_falls_back_with_a_warning() {
        let folder = tempfile::tempdir().unwrap();
        sequence(folder.path());
        text(&folder.path().join("camera_intrinsics.txt"), "fx 800\n");
        let sequence = loaded(probe(folder.path()));
        assert_eq!(sequence.camera.unwrap().model().name(), "omnidirectional");
        assert!(sequence.warnings.iter().any(|warning| warning.contains("first C3VD release")));
    }

    #[test]
    fn a_wrong_pose_is_named_by_line_and_plain_pictures_are_not_claimed() {
        let folder = tempfile::tempdir().unwrap();
        sequence(folder.path());
        text(&folder.path().join("pose.txt"), "1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1\nx\n");
        assert!(refusal(probe(folder.path())).contains("pose.txt, line 2: "));
        let plain = tempfile::tempdir().unwrap();
        picture(&plain.path().join("rgb/0001.png"), Size::new(8, 8));
        assert!(probe(plain.path()).is_none());
    }

    #[test]
    fn layouts_of_the_calibration_do_not_matter() {
        let one_line = INTRINSICS.replace(": ", "=").replace('\n', ", ").to_uppercase();
        assert_eq!(parse_intrinsics(&one_line), parse_intrinsics(INTRINSICS));
        assert!(parse_intrinsics(&INTRINSICS.replace("678.5", "9678.5")).is_err());
        assert!(parse_intrinsics(&INTRINSICS.replace("width: 1350", "width: 1e300")).is_err());
    }

    proptest! {
        #[test]
        fn any_text_is_answered(text in "[-0-9eE.:, \nacdehiwtxy]{0,200}") {
            let _ = parse_intrinsics(&text);
        }
    }
}
