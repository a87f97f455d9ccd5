use super::*;
use crate::surface::Posed;

const ORGANS: [Organ; 3] = [Organ::Colon, Organ::Stomach, Organ::SmallBowel];

#[test]
fn organs_have_the_size_of_organs_and_room_inside() {
    for organ in ORGANS {
        let anatomy = Anatomy::grow(organ, 11);
        let length_m = anatomy.axis.length_m();
        assert!((0.2..1.6).contains(&length_m), "{organ:?} {length_m}");
        let (from_m, to_m) = anatomy.axis.passable(0.0025).unwrap();
        assert!(to_m - from_m > 0.5 * length_m, "{organ:?}: {from_m} to {to_m} of {length_m}");
        assert!(anatomy.extent_m() < 0.65, "{organ:?}");
    }
}

#[test]
fn no_view_leaves_an_organ() {
    for organ in ORGANS {
        let anatomy = Anatomy::grow(organ, 3);
        let posed = Posed::new(&anatomy.wall);
        let middle = anatomy.axis.point(0.5 * anatomy.axis.length_m());
        for i in 0..1500 {
            let mut series = Key::new(1).at(i).series();
            let mut part = || series.range(-1.0, 1.0);
            let direction = Vector3::new(part(), part(), part()).normalize();
            assert!(posed.cast(&middle, &direction, 2.0).is_some(), "{organ:?}: a hole towards {direction}");
        }
    }
}

#[test]
fn seeds_differ_and_repeat() {
    let rest = |seed| Anatomy::grow(Organ::SmallBowel, seed).wall.vertices[5000].rest;
    assert_eq!(rest(1), rest(1));
    assert_ne!(rest(1), rest(2));
}
