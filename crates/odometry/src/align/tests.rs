use super::*;
use endoscape_nets::AlignNetConfig;

const SIZE: Size = Size::new(64, 48);

fn picture(shift: f64) -> Image {
    let wave = |x: f64, y: f64| (127.0 + 60.0 * (0.5 * x + 0.2 * y).sin() + 40.0 * (0.3 * y - 0.1 * x).cos()) as u8;
    Image::from_fn(SIZE, |x, y| [wave(x as f64 + shift, y as f64); 3])
}

/// An untrained network, which says of every motion that nothing is left.
fn aligner() -> (Aligner, Alignment) {
    let device = Device::flex();
    let aligner = Aligner::new(AlignNetConfig::default().init(0, &device).unwrap(), device);
    let camera = Camera::from_field_of_view(SIZE, 80_f64.to_radians()).unwrap();
    let camera = aligner.camera(&camera, SIZE).unwrap();
    let target = aligner.target(&picture(0.0), &Grid::filled(SIZE, 1.0), &camera);
    (aligner, target)
}

#[test]
fn the_guess_that_explains_the_picture_is_taken() {
    let (aligner, target) = aligner();
    // Two pixels to the left of 64 at 80 degrees and depth 1.
    let focal_px = 32.0 / 40_f64.to_radians().tan();
    let right = Pose::translation(-2.0 / focal_px, 0.0, 0.0);
    for guesses in [[Pose::identity(), right], [right, Pose::identity()]] {
        let found = aligner.aligned(&target, &picture(2.0), &guesses).unwrap();
        assert!((found.translation.vector - right.translation.vector).norm() < 1e-6, "{found}");
        let found = aligner.aligned(&target, &picture(0.0), &guesses).unwrap();
        assert!(found.translation.vector.norm() < 1e-6, "{found}");
    }
}

#[test]
fn looking_away_explains_nothing() {
    let (aligner, target) = aligner();
    let away = Pose::translation(50.0, 0.0, 0.0);
    let found = aligner.aligned(&target, &picture(0.0), &[away, Pose::identity()]).unwrap();
    assert!(found.translation.vector.norm() < 1e-6, "{found}");
}

#[test]
fn nothing_comes_of_nothing_and_of_no_number() {
    let (aligner, target) = aligner();
    assert!(aligner.aligned(&target, &picture(0.0), &[]).is_none());
    let none = Pose::translation(f64::NAN, 0.0, 0.0);
    assert!(aligner.aligned(&target, &picture(0.0), &[none]).is_none());
}
