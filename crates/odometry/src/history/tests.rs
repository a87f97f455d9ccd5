use super::*;
use endoscape_core::{Mask, Size};

const SIZE: Size = Size::new(96, 64);

/// A picture that slides to the right; its first pixel's position is written into the pose.
fn frame(position: usize, pixels: f64) -> (View, Keyframe) {
    let image = Image::from_fn(SIZE, |x, y| {
        let (u, v) = (x as f64 - pixels, y as f64);
        let wave = |a: f64, b: f64, c: f64| (a * u + b * v + c).sin();
        let sum = wave(0.31, 0.12, 0.3) + wave(-0.17, 0.39, 1.0) + wave(0.23, -0.28, 2.0) + wave(0.61, 0.45, 0.7);
        [(110.0 + 25.0 * sum) as u8; 3]
    });
    let luma = Arc::new(image.luma());
    let thumbnail = Thumbnail::new(&image, &Mask::filled(SIZE, true));
    let world_from_camera = Pose::translation(pixels, position as f64, 0.0);
    let view = View { position, image: Arc::new(image), contrast: None, world_from_camera };
    let depth = Arc::new(Grid::filled(SIZE, 1.0));
    let keyframe = Keyframe::new(view.clone(), luma, thumbnail, depth, Scale::default());
    (view, keyframe)
}

/// Positions of the anchors that frames of a camera moving at `speed` pixels per frame are measured against, and the
/// positions of their windows' first sources.
fn follow(count: usize, speed: impl Fn(usize) -> f64, spacing: Spacing) -> Vec<(usize, usize, f64)> {
    let mut history = History::new(frame(0, 0.0).1, spacing);
    let (mut pixels, mut measured) = (0.0, Vec::new());
    let mut images = vec![history.anchor().view.image.clone()];
    for position in 1..count {
        pixels += speed(position);
        let (view, keyframe) = frame(position, pixels);
        let distance = history.distance(&keyframe.thumbnail, position);
        if distance == Distance::Far {
            history.advance();
        }
        let window = history.window(position, &view.image, distance == Distance::Far);
        assert_eq!(window.sources.len(), 2 * spacing.side);
        assert!(Arc::ptr_eq(window.sources.last().unwrap(), &view.image));
        images.push(view.image.clone());
        let first = images.iter().position(|image| Arc::ptr_eq(image, &window.sources[0])).unwrap();
        let previous = window.previous.map(|view| view.world_from_camera.translation.y as usize);
        assert!(previous.is_none_or(|previous| distance == Distance::Far && previous == first));
        let moved = pixels - history.anchor().view.world_from_camera.translation.x;
        measured.push((history.anchor().view.position, first, moved));
        history.remember(view, (distance == Distance::Far).then_some(keyframe));
        assert!(history.recent.len() <= REMEMBERED && history.anchor.before.len() <= REMEMBERED);
    }
    measured
}

const BY_DISPLACEMENT: Spacing = Spacing { side: 1, fixed_gap: 0, least_displacement: 0.02 };

#[test]
fn gap_one_is_the_sliding_window() {
    let spacing = Spacing { fixed_gap: 1, ..BY_DISPLACEMENT };
    for (index, (anchor, first, _)) in follow(12, |_| 0.0, spacing).into_iter().enumerate() {
        assert_eq!((anchor, first), (index, index.saturating_sub(1)));
    }
}

#[test]
fn slow_frames_are_measured_over_the_trained_displacement() {
    // 0.02 of 96 pixels are 1.9 pixels, four frames of half a pixel.
    for (index, (anchor, first, moved)) in follow(60, |_| 0.5, BY_DISPLACEMENT).into_iter().enumerate().skip(12) {
        let position = index + 1;
        assert!((1.4..=4.6).contains(&moved), "frame {position} is {moved} pixels from its anchor");
        assert!((anchor - first).abs_diff(position - anchor) <= 1, "the window of frame {position} is uneven");
    }
}

#[test]
fn a_camera_that_stops_keeps_its_anchor() {
    let measured = follow(120, |position| if position < 30 { 1.0 } else { 0.0 }, BY_DISPLACEMENT);
    let anchors: Vec<usize> = measured[40..].iter().map(|(anchor, ..)| *anchor).collect();
    assert!(anchors.windows(2).all(|pair| pair[0] == pair[1]), "{anchors:?}");
    assert!(measured[40..].iter().all(|(_, _, moved)| *moved >= 1.4));
}

#[test]
fn longer_windows_are_evenly_filled() {
    let spacing = Spacing { side: 2, fixed_gap: 2, least_displacement: 0.0 };
    let mut history = History::new(frame(0, 0.0).1, spacing);
    for position in 1..=20 {
        let (view, keyframe) = frame(position, position as f64);
        let distance = history.distance(&keyframe.thumbnail, position);
        if distance == Distance::Far {
            history.advance();
        }
        if position == 20 {
            let window = history.window(position, &view.image, false);
            let places: Vec<f64> = window.sources.iter().map(|image| slid(image)).collect();
            assert_eq!(history.anchor().view.position, 16);
            assert_eq!(places, [12.0, 14.0, 18.0, 20.0]);
        }
        history.remember(view, (distance == Distance::Far).then_some(keyframe));
    }
}

/// How far a picture of [`frame`] has slid.
fn slid(image: &Image) -> f64 {
    (0..=20).map(f64::from).find(|pixels| frame(0, *pixels).0.image.as_ref() == image).unwrap()
}

#[test]
fn black_stretches_are_bridged_at_the_usual_gap() {
    let history = History::new(frame(0, 0.0).1, BY_DISPLACEMENT);
    let black = Thumbnail::new(&Image::from_fn(SIZE, |_, _| [0; 3]), &Mask::filled(SIZE, true));
    assert_eq!(history.distance(&black, 1), Distance::Far);
    let near = frame(1, 0.3).1.thumbnail;
    assert!(matches!(history.distance(&near, 1), Distance::Near(Some(moved)) if moved < 0.02));
}
