use super::*;
use endoscape_core::camera::{Intrinsics, Omnidirectional, Pinhole, RadialTangential};
use proptest::prelude::*;

fn distorted() -> Camera {
    let intrinsics = Intrinsics { fx: 150.0, fy: 152.0, cx: 161.0, cy: 118.0, skew: 0.0 };
    let lens =
        RadialTangential { intrinsics, k1: -0.25, k2: 0.06, p1: 1e-3, p2: -8e-4, k3: 0.0, k4: 0.0, k5: 0.0, k6: 0.0 };
    Camera::new(Size::new(320, 240), lens.into()).unwrap()
}

/// A lens like that of a wide colonoscope, at a quarter of its size.
fn omnidirectional() -> Camera {
    let polynomial = [192.0, 0.0, -3.25e-3, 1.0e-5, -7.66e-8];
    let lens = Omnidirectional { cx: 169.0, cy: 135.0, polynomial, stretch: [[1.0, 0.003], [-0.003, 1.0]] };
    Camera::new(Size::new(338, 270), lens.into()).unwrap()
}

fn noise(size: Size) -> Image {
    let byte = |x: usize, y: usize, c: usize| (((x * 7919 + y * 104_729 + c * 1_299_709) * 2_654_435) >> 7) as u8;
    Image::from_fn(size, |x, y| [byte(x, y, 0), byte(x, y, 1), byte(x, y, 2)])
}

#[test]
fn the_same_camera_changes_nothing() {
    for camera in [distorted(), omnidirectional()] {
        let rectifier = Rectifier::new(&camera, &camera);
        assert!(rectifier.valid().values().iter().all(|valid| *valid));
        let image = noise(camera.size());
        assert_eq!(rectifier.image(&image).unwrap(), image);
        let depth = DepthMap::new(Grid::from_fn(camera.size(), |x, y| ((x * y) % 7) as f32));
        assert_eq!(rectifier.depth(&depth).unwrap(), depth);
        let mask = Grid::from_fn(camera.size(), |x, y| (x ^ y) % 3 != 0);
        assert_eq!(rectifier.mask(&mask).unwrap(), mask);
    }
}

/// A straight world line seen through the lens is a smooth grey profile across it; its middle is found per row.
#[test]
fn straight_lines_become_straight() {
    for from in [distorted(), omnidirectional()] {
        let to = pinhole_for(&from, Size::new(300, 220), None).unwrap();
        let rectifier = Rectifier::new(&from, &to);
        for (slope, offset) in [(0.0, -0.4), (0.15, 0.1), (-0.2, 0.35)] {
            let brightness = |x: usize, y: usize| {
                let point = from.unproject_to_depth(&Point2::new(x as f64, y as f64), 1.0);
                let away = point.map_or(9.0, |p| (p.x - slope * p.y - offset) / 0.02);
                [(20.0 + 220.0 * (-0.5 * away * away).exp()).round() as u8; 3]
            };
            let picture = rectifier.image(&Image::from_fn(from.size(), brightness)).unwrap();
            let centres = (5..215).filter_map(|y| line_centre(&picture, y)).collect::<Vec<_>>();
            let deviation = largest_deviation(&centres);
            assert!(centres.len() > 150 && deviation < 0.1, "{deviation} px from straight, {} rows", centres.len());
        }
    }
}

/// Grey-weighted mean column of the bright line in one row, if the line lies whole in the picture.
fn line_centre(picture: &Image, y: usize) -> Option<(f64, f64)> {
    let weight = |x: usize| picture.get(x, y).map_or(0.0, |rgb| (f64::from(rgb[0]) - 24.0).max(0.0));
    let (sum, moment) = (0..300).fold((0.0, 0.0), |(sum, moment), x| (sum + weight(x), moment + x as f64 * weight(x)));
    let centre = moment / sum;
    (sum > 500.0 && centre > 20.0 && centre < 280.0).then_some((y as f64, centre))
}

fn largest_deviation(points: &[(f64, f64)]) -> f64 {
    let count = points.len() as f64;
    let (my, mx) = points.iter().fold((0.0, 0.0), |(my, mx), (y, x)| (my + y / count, mx + x / count));
    let slope = points.iter().map(|(y, x)| (y - my) * (x - mx)).sum::<f64>()
        / points.iter().map(|(y, _)| (y - my).powi(2)).sum::<f64>();
    points.iter().map(|(y, x)| (x - mx - slope * (y - my)).abs()).fold(0.0, f64::max)
}

#[test]
fn depth_keeps_to_one_side_of_an_edge_and_out_of_the_unknown() {
    let from = distorted();
    let rectifier = Rectifier::new(&from, &pinhole_for(&from, Size::new(200, 150), None).unwrap());
    let edge = DepthMap::new(Grid::from_fn(from.size(), |x, y| match (x, y) {
        (100..110, _) => DepthMap::UNKNOWN,
        (_, 0..100) => 0.05,
        _ => 0.09,
    }));
    let rectified = rectifier.depth(&edge).unwrap();
    let near = |depth: f32, other: f32| (depth - other).abs() < 1e-6;
    assert!(rectified.grid().values().iter().all(|d| *d == 0.0 || near(*d, 0.05) || near(*d, 0.09)));
    let coverage = rectified.coverage();
    assert!((0.9..1.0).contains(&coverage), "{coverage}");
}

#[test]
fn a_smooth_depth_is_interpolated() {
    let from = distorted();
    let to = pinhole_for(&from, Size::new(200, 150), None).unwrap();
    // A tilted plane z = 0.05 / (1 - 0.3 x/z), seen by both cameras.
    let plane = |camera: &Camera, x: usize, y: usize| {
        let ray = camera.unproject_to_depth(&Point2::new(x as f64, y as f64), 1.0).unwrap();
        0.05 / (1.0 - 0.3 * ray.x)
    };
    let seen = DepthMap::new(Grid::from_fn(from.size(), |x, y| plane(&from, x, y) as f32));
    let rectified = Rectifier::new(&from, &to).depth(&seen).unwrap();
    for (x, y) in [(20, 20), (100, 75), (180, 130), (50, 140)] {
        let (got, truth) = (f64::from(rectified.get(x, y).unwrap()), plane(&to, x, y));
        assert!((got / truth - 1.0).abs() < 1e-4, "{got} instead of {truth} at ({x}, {y})");
    }
}

#[test]
fn the_widest_pinhole_is_full_and_no_wider_one_is() {
    for from in [distorted(), omnidirectional()] {
        let to = pinhole_for(&from, Size::new(128, 96), None).unwrap();
        assert!(Rectifier::new(&from, &to).valid().values().iter().all(|valid| *valid));
        let wider = to.horizontal_field_of_view_rad().unwrap() + 0.02;
        let wider = pinhole_for(&from, Size::new(128, 96), Some(wider)).unwrap();
        assert!(!Rectifier::new(&from, &wider).valid().values().iter().all(|valid| *valid));
    }
}

#[test]
fn refusals_are_sentences() {
    let from = distorted();
    let rectifier = Rectifier::new(&from, &from);
    let error = rectifier.image(&noise(Size::new(4, 4))).unwrap_err();
    assert_eq!(
        FramesError::from(error).to_string(),
        "the picture is 4x4 but the camera to rectify from has 320x240; give the camera of these frames or resize first"
    );
    let off = Intrinsics { fx: 100.0, fy: 100.0, cx: 500.0, cy: 50.0, skew: 0.0 };
    let off = Camera::new(Size::new(100, 100), Pinhole { intrinsics: off }.into()).unwrap();
    assert!(matches!(pinhole_for(&off, Size::new(64, 48), None), Err(RectifyError::AxisOutside(_))));
    assert!(matches!(pinhole_for(&from, Size::new(64, 48), Some(f64::NAN)), Err(RectifyError::Camera(_))));
}

proptest! {
    /// Positions in 256ths move a value by up to 255 / 512 per axis, and it is rounded twice.
    #[test]
    fn weights_are_bilinear(x in -0.5..6.5_f64, y in -0.5..4.5_f64) {
        let size = Size::new(7, 5);
        let tap = Tap::at(&Point2::new(x, y), size).unwrap();
        prop_assert_eq!(tap.weights().iter().sum::<u32>(), 1 << 16);
        let image = noise(size);
        let mut out = [0; 3];
        remap_row(&mut out, &[tap], image.rgb(), 3 * size.width);
        let (cx, cy) = (x.clamp(0.0, 6.0), y.clamp(0.0, 4.0));
        let value = |x: f64, y: f64| f64::from(image.get(x as usize, y as usize).map_or(0, |rgb| rgb[1]));
        let (x0, y0) = (cx.floor(), cy.floor());
        let (fx, fy) = (cx - x0, cy - y0);
        let top = (1.0 - fx) * value(x0, y0) + fx * value(x0 + 1.0, y0);
        let low = (1.0 - fx) * value(x0, y0 + 1.0) + fx * value(x0 + 1.0, y0 + 1.0);
        let exact = (1.0 - fy) * top + fy * low;
        prop_assert!((f64::from(out[1]) - exact).abs() <= 2.5, "{} instead of {exact}", out[1]);
    }

    /// A rectified mask never claims more than every pixel it rests on, and one unusable pixel spreads to its taps.
    #[test]
    fn masks_only_shrink(seed in 0_usize..1000) {
        let from = distorted();
        let rectifier = Rectifier::new(&from, &pinhole_for(&from, Size::new(60, 40), Some(1.9)).unwrap());
        let smaller = Grid::from_fn(from.size(), |x, y| (x * 31 + y * 17 + seed) % 11 != 0);
        let full = rectifier.mask(&Grid::filled(from.size(), true)).unwrap();
        prop_assert_eq!(&full, rectifier.valid());
        let shrunk = rectifier.mask(&smaller).unwrap();
        prop_assert!(shrunk.values().iter().zip(full.values()).all(|(shrunk, full)| !shrunk || *full));
    }
}
