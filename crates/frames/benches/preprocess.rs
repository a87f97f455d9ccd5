//! What preparing one frame costs: `cargo bench -p endoscape-frames --bench preprocess`.

use divan::Bencher;
use endoscape_core::camera::Omnidirectional;
use endoscape_core::{Camera, CameraError, DepthMap, Grid, Image, Size};
use endoscape_frames::preprocess::{field_of_view, rectify::Rectifier, resize, specular};

fn main() {
    divan::main();
}

/// A wide colonoscope (C3VD's published calibration, rounded) and the pinhole it is usually read through.
fn cameras() -> Result<(Camera, Camera), CameraError> {
    let polynomial = [769.24, 0.0, -8.128e-4, 6.257e-7, -1.1966e-9];
    let lens = Omnidirectional { cx: 678.54, cy: 542.98, polynomial, stretch: [[1.0, 0.00288], [-0.00296, 1.0]] };
    let from = Camera::new(Size::new(1350, 1080), lens.into())?;
    let to = Camera::from_field_of_view(Size::new(640, 512), 2.0 * (320.0_f64 / 360.0).atan())?;
    Ok((from, to))
}

/// A round field of view with texture.
fn picture(index: usize) -> Image {
    Image::from_fn(Size::new(1350, 1080), |x, y| {
        let inside = (x as f64 - 675.0).hypot(y as f64 - 540.0) < 600.0;
        let texture = (x * 31 + y * 17 + index * 7 + (x * y) % 251) % 120;
        if inside { [120 + texture as u8, texture as u8, 40] } else { [0; 3] }
    })
}

#[divan::bench]
fn rectification_table(bencher: Bencher<'_, '_>) {
    if let Ok((from, to)) = cameras() {
        bencher.bench(|| Rectifier::new(&from, &to));
    }
}

#[divan::bench]
fn rectify_image(bencher: Bencher<'_, '_>) {
    if let Ok((from, to)) = cameras() {
        let (rectifier, image) = (Rectifier::new(&from, &to), picture(0));
        bencher.bench(|| rectifier.image(&image));
    }
}

#[divan::bench]
fn rectify_depth(bencher: Bencher<'_, '_>) {
    if let Ok((from, to)) = cameras() {
        let depth = DepthMap::new(Grid::from_fn(from.size(), |x, y| 0.03 + (x + y) as f32 * 1e-5));
        let rectifier = Rectifier::new(&from, &to);
        bencher.bench(|| rectifier.depth(&depth));
    }
}

#[divan::bench]
fn resize_image(bencher: Bencher<'_, '_>) {
    let image = picture(0);
    bencher.bench(|| resize::image(&image, Size::new(320, 256)));
}

#[divan::bench]
fn resize_depth(bencher: Bencher<'_, '_>) {
    let depth = DepthMap::new(Grid::from_fn(Size::new(1350, 1080), |x, y| 0.03 + (x + y) as f32 * 1e-5));
    bencher.bench(|| resize::depth(&depth, Size::new(320, 256)));
}

#[divan::bench]
fn field_of_view_of_eight_frames(bencher: Bencher<'_, '_>) {
    let frames: Vec<Image> = (0..8).map(picture).collect();
    bencher.bench(|| field_of_view::find(&frames));
}

#[divan::bench]
fn specular_mask(bencher: Bencher<'_, '_>) {
    let image = picture(0);
    bencher.bench(|| specular::mask(&image, &specular::SpecularConfig::default()));
}
