//! The `images` format: any folder of pictures, in natural order of their names.
//!
//! Pictures say nothing about time, so 30 per second are assumed and a warning says so.

use super::{Format, Probe, common};
use crate::{FramesError, Sequence, natural, picture};
use endoscape_core::Size;
use rayon::prelude::*;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Frames per second assumed for pictures without times.
const ASSUMED_FPS: f64 = 30.0;

/// Takes any folder with pictures in it; says what to do about a single picture.
pub fn probe(path: &Path) -> Probe {
    if path.is_file() && picture::is_picture(path) {
        return Some(Err(FramesError::file(path, "is a single picture", "give the folder that holds the sequence")));
    }
    if !path.is_dir() {
        return None;
    }
    // Hidden files are what file managers leave behind (`._0001.png`).
    match common::list(path, |name| !name.starts_with('.') && common::is_picture(name)) {
        Ok(pictures) if pictures.is_empty() => None,
        Ok(pictures) => Some(load(path, &pictures)),
        Err(error) => Some(Err(error)),
    }
}

fn load(root: &Path, pictures: &[PathBuf]) -> Result<Sequence, FramesError> {
    let size = common_size(pictures)?;
    let stem = |path: &PathBuf| natural::number(&path.file_stem().unwrap_or_default().to_string_lossy());
    let named: Option<Vec<usize>> = pictures.iter().map(stem).collect();
    // Names of several patterns (left_0, right_0) repeat numbers; then the frames are counted.
    let named = named.filter(|numbers| numbers.is_sorted_by(|a, b| a < b));
    let numbers = named.unwrap_or_else(|| (0..pictures.len()).collect());
    let frame = |(index, (path, number)): (usize, (&PathBuf, usize))| {
        common::frame_of(path, number, index as f64 / ASSUMED_FPS)
    };
    Ok(Sequence {
        format: Format::Images,
        name: common::name_of(root),
        root: root.to_path_buf(),
        size,
        fps: None,
        camera: None,
        video: None,
        frames: pictures.iter().zip(numbers).enumerate().map(frame).collect(),
        license: None,
        warnings: vec![format!("the pictures have no times: {ASSUMED_FPS} frames per second are assumed")],
    })
}

/// The size of all pictures; the first one of another size than most is named.
fn common_size(pictures: &[PathBuf]) -> Result<Size, FramesError> {
    let sizes: Vec<Size> = pictures.par_iter().map(|path| picture::size(path)).collect::<Result<_, _>>()?;
    let mut counts: HashMap<Size, usize> = HashMap::new();
    for size in &sizes {
        *counts.entry(*size).or_default() += 1;
    }
    let usual = sizes.iter().copied().rev().max_by_key(|size| counts[size]).unwrap_or(Size::new(0, 0));
    match sizes.iter().zip(pictures).find(|(size, _)| **size != usual) {
        None => Ok(usual),
        Some((size, path)) => {
            let reason = format!("is {size} while {} of the {} pictures are {usual}", counts[&usual], sizes.len());
            Err(FramesError::file(path, reason, "move it out of the folder or bring it to that size"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::open;
    use endoscape_core::Image;

    fn write(folder: &Path, name: &str, size: Size) {
        picture::write_png(&folder.join(name), &Image::from_fn(size, |x, y| [x as u8, y as u8, 0])).unwrap();
    }

    #[test]
    fn names_are_taken_in_natural_order_and_the_rest_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["10.png", "9.png", "100.png"] {
            write(folder.path(), name, Size::new(4, 3));
        }
        write(folder.path(), ".hidden.png", Size::new(9, 9));
        std::fs::write(folder.path().join("notes.txt"), "x").unwrap();
        let sequence = open(folder.path(), None).unwrap();
        assert_eq!((sequence.format, sequence.size, sequence.fps), (Format::Images, Size::new(4, 3), None));
        assert_eq!(sequence.frames.iter().map(|frame| frame.number).collect::<Vec<_>>(), [9, 10, 100]);
        assert_eq!(sequence.frames[2].time_s, 2.0 / 30.0);
        assert!(sequence.warnings[0].contains("30 frames per second are assumed"));
    }

    #[test]
    fn interleaved_patterns_are_counted() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["left_0.png", "left_1.png", "right_0.png", "right_1.png"] {
            write(folder.path(), name, Size::new(4, 3));
        }
        let sequence = open(folder.path(), None).unwrap();
        assert_eq!(sequence.frames.iter().map(|frame| frame.number).collect::<Vec<_>>(), [0, 1, 2, 3]);
    }

    #[test]
    fn the_odd_picture_is_named() {
        let folder = tempfile::tempdir().unwrap();
        for (name, size) in [("0.png", Size::new(5, 3)), ("1.png", Size::new(4, 3)), ("2.png", Size::new(4, 3))] {
            write(folder.path(), name, size);
        }
        let error = open(folder.path(), None).unwrap_err().to_string();
        assert!(error.contains("0.png: is 5x3 while 2 of the 3 pictures are 4x3"), "{error}");
    }

    #[test]
    fn a_single_picture_and_an_empty_folder_say_what_to_give() {
        let folder = tempfile::tempdir().unwrap();
        assert!(open(folder.path(), None).unwrap_err().to_string().contains("no pictures"));
        write(folder.path(), "0.png", Size::new(5, 3));
        let error = open(&folder.path().join("0.png"), None).unwrap_err().to_string();
        assert!(error.contains("is a single picture; give the folder"), "{error}");
    }
}
