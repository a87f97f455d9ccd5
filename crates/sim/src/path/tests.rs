use super::*;
use crate::Effects;
use crate::anatomy::Organ;

fn positions(flight: &Flight<'_>, step_s: f64, count: i64) -> Vec<Vector3<f64>> {
    (0..count).map(|i| flight.pose(i as f64 * step_s).translation.vector).collect()
}

#[test]
fn every_kind_keeps_its_limits_and_its_distance() {
    let anatomy = Anatomy::grow(Organ::SmallBowel, 4);
    let still = anatomy.deformation(Effects::none());
    for kind in PathKind::ALL {
        let flight = Flight::plan(kind, &anatomy, &still, Effects::none().with(Effect::Contact), (60.0, 4)).unwrap();
        let (step_s, habits) = (0.02, kind.habits());
        let places = positions(&flight, step_s, 3000);
        for triple in places.windows(3) {
            let speed = (triple[1] - triple[0]).norm() / step_s;
            let acceleration = (triple[2] - triple[1] * 2.0 + triple[0]).norm() / (step_s * step_s);
            assert!(speed <= 1.02 * habits.fastest_m_s, "{kind:?} {speed}");
            assert!(acceleration <= 1.15 * habits.hardest_m_s2, "{kind:?} {acceleration}");
        }
        for place in places.iter().step_by(100) {
            let nearest = anatomy.wall.vertices.iter().map(|v| (v.rest - place).norm()).fold(f64::INFINITY, f64::min);
            assert!(nearest >= 0.99 * WINDOW_M, "{kind:?} {nearest}");
        }
        assert!(places.iter().any(|place| (place - places[0]).norm() > 0.002), "{kind:?} stands still");
    }
}

#[test]
fn seeds_and_kinds_differ_and_names_read_back() {
    let anatomy = Anatomy::grow(Organ::SmallBowel, 4);
    let still = anatomy.deformation(Effects::none());
    let pose = |kind, seed| Flight::plan(kind, &anatomy, &still, Effects::none(), (5.0, seed)).unwrap().pose(1.0);
    assert_eq!(pose(PathKind::Capsule, 1), pose(PathKind::Capsule, 1));
    assert_ne!(pose(PathKind::Capsule, 1), pose(PathKind::Capsule, 2));
    assert_ne!(pose(PathKind::Capsule, 1), pose(PathKind::Survey, 1));
    for kind in PathKind::ALL {
        assert_eq!(kind.name().parse::<PathKind>().unwrap(), kind);
    }
    assert!("loop-the-loop".parse::<PathKind>().is_err());
}
