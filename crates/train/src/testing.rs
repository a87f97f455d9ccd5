//! Small clips for the tests of this crate.

use crate::clip::{Clip, ClipFrame};
use endoscape_core::{Camera, Grid, Image, Size};

/// A clip of the given pictures, all of one size, seen through a pinhole of 70 degrees.
pub(crate) fn clip_of(images: Vec<Image>) -> Clip {
    let size = images[0].size();
    let frame = |(position, image)| ClipFrame {
        position,
        image,
        usable: Grid::filled(size, true),
        world_from_camera: None,
        depth: None,
        label: None,
    };
    let frames = images.into_iter().enumerate().map(frame).collect();
    let camera = Camera::from_field_of_view(size, 70_f64.to_radians()).unwrap();
    Clip { name: "test".into(), frames, camera, fingerprint: "none".into() }
}

/// A texture of 96x64 that slides by a constant number of pixels per frame.
pub(crate) fn sliding_clip(frames: usize, pixels_per_frame: f64) -> Clip {
    let picture = |frame: usize| {
        let shift = pixels_per_frame * frame as f64;
        Image::from_fn(Size::new(96, 64), |x, y| {
            let (u, v) = (x as f64 - shift, y as f64);
            let wave = |a: f64, b: f64, c: f64| (a * u + b * v + c).sin();
            let sum = wave(0.31, 0.12, 0.3) + wave(-0.17, 0.39, 1.0) + wave(0.23, -0.28, 2.0) + wave(0.61, 0.45, 0.7);
            [(128.0 + 28.0 * sum) as u8, (100.0 + 20.0 * sum) as u8, 90]
        })
    };
    clip_of((0..frames).map(picture).collect())
}
