use super::*;

const SIZE: Size = Size::new(200, 160);

/// Tissue inside, black outside with noise of a few grey levels, a dark lumen in the middle and a mark in the corner.
fn frames(inside: impl Fn(f64, f64) -> bool) -> Vec<Image> {
    let frame = |index: usize| {
        Image::from_fn(SIZE, |x, y| {
            let lumen = (x as f64 - 95.0 - index as f64).hypot(y as f64 - 80.0) < 25.0;
            let mark = (190..194).contains(&x) && (150..154).contains(&y);
            let noise = ((x * 7 + y * 13 + index * 5) % 4) as u8;
            match (inside(x as f64, y as f64), lumen, mark) {
                (true, false, _) => [120 + noise, 60, 50],
                (false, _, true) => [200; 3],
                _ => [noise; 3],
            }
        })
    };
    (0..4).map(frame).collect()
}

fn agreement(mask: &Mask, inside: impl Fn(f64, f64) -> bool) -> (f64, usize) {
    let truth = Grid::from_fn(SIZE, |x, y| inside(x as f64, y as f64));
    let kept = mask.values().iter().filter(|usable| **usable).count();
    let outside = mask.values().iter().zip(truth.values()).filter(|(usable, inside)| **usable && !**inside).count();
    (kept as f64 / truth.values().iter().filter(|inside| **inside).count() as f64, outside)
}

#[test]
fn a_circle_cut_by_the_picture_is_found() {
    let inside = |x: f64, y: f64| (x - 98.0).hypot(y - 82.0) < 90.0;
    let found = find(&frames(inside)).unwrap();
    let Shape::Circle { centre, radius } = found.shape else { unreachable!("{:?}", found.shape) };
    assert!((centre[0] - 98.0).abs() < 0.5 && (centre[1] - 82.0).abs() < 0.5 && (radius - 90.0).abs() < 1.0);
    let (kept, outside) = agreement(&found.mask, inside);
    assert!(kept > 0.93 && outside == 0, "{kept} kept, {outside} outside");
    assert_eq!(found.mask.get(98, 80), Some(&true), "the lumen stays");
}

#[test]
fn an_octagon_is_found() {
    let inside = |x: f64, y: f64| (x - 100.0).abs() + (y - 80.0).abs() < 130.0;
    let found = find(&frames(inside)).unwrap();
    assert!(matches!(&found.shape, Shape::Polygon { corners } if corners.len() == 8), "{:?}", found.shape);
    let (kept, outside) = agreement(&found.mask, inside);
    assert!(kept > 0.93 && outside == 0, "{kept} kept, {outside} outside");
    assert_eq!(found.mask.get(192, 152), Some(&false), "the mark is out");
    assert_eq!(found.mask.get(100, 0), Some(&true), "the picture's own edge is no rim");
}

#[test]
fn bars_beside_the_picture_leave_a_rectangle() {
    let inside = |x: f64, _: f64| (20.0..=170.0).contains(&x);
    let found = find(&frames(inside)).unwrap();
    assert_eq!(found.shape, Shape::Rectangle(Rect { x: 20, y: 0, size: Size::new(151, 160) }));
    let (kept, outside) = agreement(&found.mask, inside);
    assert!(kept > 0.96 && outside == 0, "{kept} kept, {outside} outside");
}

#[test]
fn full_dark_and_broken_pictures_have_none() {
    assert!(find(&[]).is_none());
    assert!(find(&frames(|_, _| true)).is_none());
    assert!(find(&frames(|_, _| false)).is_none());
    assert!(find(&[Image::from_fn(Size::new(3, 3), |_, _| [0; 3])]).is_none());
    let mut mixed = frames(|x, y| (x - 98.0).hypot(y - 82.0) < 70.0);
    mixed.push(Image::from_fn(Size::new(30, 30), |_, _| [9; 3]));
    assert!(find(&mixed).is_none());
    // Dark corners around something with a bay are dark tissue.
    assert!(
        find(&frames(|x, y| (x - 98.0).hypot(y - 82.0) < 70.0 && !((60.0..100.0).contains(&y) && x > 80.0))).is_none()
    );
}
