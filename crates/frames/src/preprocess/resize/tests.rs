use super::*;
use endoscape_core::Camera;
use nalgebra::Point2;
use proptest::prelude::*;

/// By how many new pixels, on the mean over the interior, a ramp lands beside where the resized camera says.
///
/// One colour rises and one falls by the same steps, so that what rounding to bytes adds to both cancels.
fn ramp_error_px(old: Size, new: Size) -> f64 {
    let ramp = |x: usize| 0.8 * x as f64;
    let picture = Image::from_fn(old, |x, _| [(20.0 + ramp(x)).round() as u8, (235.0 - ramp(x)).round() as u8, 0]);
    let resized = image(&picture, new).unwrap();
    let camera = Camera::from_field_of_view(old, 1.0).unwrap();
    let scaled = camera.scaled_to(new).unwrap();
    let error = |x: usize| {
        let ray = scaled.unproject(&Point2::new(x as f64, 9.0)).unwrap();
        let rgb = resized.get(x, 9).unwrap();
        (f64::from(rgb[0]) - f64::from(rgb[1]) + 215.0) / 1.6 - camera.project(&ray.into()).unwrap().x
    };
    let interior = 5..new.width - 5;
    let count = interior.len() as f64;
    (interior.map(error).sum::<f64>() / count).abs() * new.width as f64 / old.width as f64
}

#[test]
fn a_ramp_lands_where_the_scaled_camera_says() {
    for (old, new) in [((200, 160), (100, 80)), ((200, 160), (64, 48)), ((211, 173), (90, 70)), ((90, 70), (211, 173))]
    {
        let (old, new) = (Size::new(old.0, old.1), Size::new(new.0, new.1));
        let error = ramp_error_px(old, new);
        // Corners instead of centres at integer coordinates would be off by up to half a pixel.
        assert!(error < 0.05, "{old} to {new}: {error} new pixels");
    }
}

#[test]
fn depth_never_averages_across_an_edge() {
    let old = Size::new(101, 67);
    let map = DepthMap::new(Grid::from_fn(old, |x, y| {
        if x < 50 {
            0.03
        } else if y < 20 {
            0.0
        } else {
            0.2
        }
    }));
    for new in [Size::new(40, 30), Size::new(101, 67), Size::new(33, 200), Size::new(300, 201)] {
        let resized = depth(&map, new);
        assert!(resized.grid().values().iter().all(|d| [0.0, 0.03, 0.2].contains(d)));
        assert!((resized.coverage() - map.coverage()).abs() < 0.03);
    }
    assert_eq!(depth(&map, old), map);
}

#[test]
fn one_unusable_pixel_takes_every_pixel_that_touches_it() {
    let old = Grid::from_fn(Size::new(10, 10), |x, y| (x, y) != (5, 5));
    let unusable = |new: usize| mask(&old, Size::new(new, new)).values().iter().filter(|usable| !**usable).count();
    assert_eq!([unusable(10), unusable(5), unusable(4), unusable(1), unusable(20)], [1, 1, 1, 1, 4]);
    assert_eq!(unusable(3), 1);
    assert_eq!(unusable(9), 4);
}

#[test]
fn nothing_and_too_much_are_refused_or_empty() {
    let none = Size::new(0, 5);
    let picture = Image::from_fn(Size::new(4, 4), |_, _| [1; 3]);
    let sentence = image(&picture, none).unwrap_err().to_string();
    assert_eq!(
        sentence,
        "a picture of 4x4 cannot be resized to 0x5 (no pixels); choose a size with at least one and at most 2^31 pixels per side"
    );
    assert_eq!(depth(&DepthMap::new(Grid::filled(none, 1.0)), Size::new(3, 3)).coverage(), 0.0);
    assert!(mask(&Grid::filled(none, true), Size::new(3, 3)).values().iter().all(|usable| !usable));
    assert!(mask(&Grid::filled(Size::new(3, 3), true), none).values().is_empty());
}

proptest! {
    #[test]
    fn constant_rasters_stay_constant(w in 1_usize..40, h in 1_usize..40, nw in 1_usize..40, nh in 1_usize..40, grey: u8) {
        let (old, new) = (Size::new(w, h), Size::new(nw, nh));
        let picture = image(&Image::from_fn(old, |_, _| [grey; 3]), new).unwrap();
        prop_assert!(picture.rgb().iter().all(|value| *value == grey));
        prop_assert!(depth(&DepthMap::new(Grid::filled(old, 0.1)), new).grid().values().iter().all(|d| *d == 0.1));
        prop_assert!(mask(&Grid::filled(old, true), new).values().iter().all(|usable| *usable));
    }
}
