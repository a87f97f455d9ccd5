//! Order, dress and errors of the stream, for pictures and for a video.

use super::*;
use crate::formats::{Format, open};
use endoscape_core::{CameraModel, Grid};
use std::path::PathBuf;
use std::process::Command;

const SIZE: Size = Size::new(16, 12);

fn image(value: usize) -> Image {
    Image::from_fn(SIZE, |_, _| [value as u8; 3])
}

fn pictures(folder: &Path, count: usize) -> Sequence {
    for index in 0..count {
        picture::write_png(&folder.join(format!("{index}.png")), &image(index)).unwrap();
    }
    open(folder, None).unwrap()
}

#[test]
fn pictures_come_in_order_dressed_with_camera_time_and_mask() {
    let folder = tempfile::tempdir().unwrap();
    let mut sequence = pictures(folder.path(), 40);
    let camera = Camera::from_field_of_view(SIZE, 1.0).unwrap();
    sequence.camera = Some(camera);
    let (mask, mask_file) = (Grid::from_fn(SIZE, |x, _| x > 3), folder.path().join("mask.png"));
    picture::write_mask_png(&mask_file, &mask).unwrap();
    sequence.frames[7].mask = Some(mask_file);
    let mut source = sequence.open_frames(5..40).unwrap();
    for index in 5..40 {
        let frame = source.next_frame().unwrap().unwrap();
        assert_eq!((frame.index, frame.time_s, &*frame.image), (index, sequence.frames[index].time_s, &image(index)));
        assert!(matches!(frame.camera.unwrap().model(), CameraModel::Pinhole(_)));
        assert_eq!(frame.usable.as_deref(), (index == 7).then_some(&mask));
    }
    assert!(source.next_frame().unwrap().is_none());
    assert!(source.next_frame().unwrap().is_none());
}

#[test]
fn after_a_bad_picture_the_others_follow() {
    let folder = tempfile::tempdir().unwrap();
    let sequence = pictures(folder.path(), 10);
    std::fs::write(folder.path().join("3.png"), "no picture").unwrap();
    picture::write_png(&folder.path().join("6.png"), &Image::from_fn(Size::new(2, 2), |_, _| [0; 3])).unwrap();
    std::fs::remove_file(folder.path().join("8.png")).unwrap();
    let mut source = sequence.open_frames(0..10).unwrap();
    let results: Vec<_> = (0..10).map(|_| source.next_frame()).collect();
    assert!(source.next_frame().unwrap().is_none());
    for (index, result) in results.into_iter().enumerate() {
        match (index, result) {
            (3 | 8, Err(error)) => assert!(error.to_string().contains(&format!("{index}.png"))),
            (6, Err(error)) => {
                assert!(error.to_string().contains("6.png: the picture is 2x2 but the sequence is 16x12"), "{error}");
            }
            (_, result) => assert_eq!(result.unwrap().unwrap().index, index),
        }
    }
}

#[test]
fn pictures_are_read_in_the_order_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let sequence = pictures(folder.path(), 5);
    assert_eq!(sequence.read_images(&[4, 0, 4]).unwrap(), [image(4), image(0), image(4)]);
    assert_eq!(sequence.read_image(2).unwrap(), image(2));
    let error = sequence.read_image(5).unwrap_err().to_string();
    assert!(error.contains("it has 5 frames"), "{error}");
    assert!(sequence.read_images(&[usize::MAX]).is_err());
    assert!(sequence.open_frames(3..6).is_err());
    assert!(sequence.read_depth(0).unwrap().is_none() && sequence.read_mask(0).unwrap().is_none());
}

#[test]
fn a_reader_dropped_early_leaves_its_threads_nothing_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let sequence = pictures(folder.path(), 40);
    let mut source = sequence.open_frames(0..40).unwrap();
    source.next_frame().unwrap();
    drop(source);
}

/// A video whose frames are told apart by their brightness: 8, 16, 24, ...
fn video(folder: &Path) -> Option<PathBuf> {
    let path = folder.join("a.mkv");
    let source = "color=black:size=16x12:rate=10:duration=2,format=gray,geq=lum=8*(N+1)";
    let options = ["-v", "error", "-f", "lavfi", "-i", source, "-c:v", "ffv1"];
    match Command::new("ffmpeg").args(options).arg(&path).status() {
        Ok(status) => assert!(status.success()),
        Err(_) => {
            eprintln!("skipped: no ffmpeg");
            return None;
        }
    }
    Some(path)
}

#[test]
fn a_sequence_may_use_some_frames_of_a_video() {
    let folder = tempfile::tempdir().unwrap();
    let Some(path) = video(folder.path()) else { return };
    let mut sequence = open(&path, None).unwrap();
    assert_eq!((sequence.format, sequence.frames.len()), (Format::Video, 20));
    // Every third frame, on a clock of its own.
    sequence.frames = sequence.frames.into_iter().step_by(3).collect();
    for (index, frame) in sequence.frames.iter_mut().enumerate() {
        frame.time_s = 100.0 + index as f64;
    }
    let mut source = sequence.open_frames(1..5).unwrap();
    for index in 1..5 {
        let frame = source.next_frame().unwrap().unwrap();
        assert_eq!((frame.index, frame.time_s), (index, 100.0 + index as f64));
        assert_eq!(frame.image.get(3, 3), Some([8 * (3 * index as u8 + 1); 3]));
    }
    assert!(source.next_frame().unwrap().is_none());
    let images = sequence.read_images(&[4, 1, 4]).unwrap();
    let shades: Vec<u8> = images.iter().map(|image| image.rgb()[0]).collect();
    assert_eq!(shades, [8 * 13, 8 * 4, 8 * 13]);
    assert!(sequence.read_images(&[]).unwrap().is_empty());
}
