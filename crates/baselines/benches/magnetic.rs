//! Time per magnetic reading: followed from the one before, and found from nothing. `cargo bench -p
//! endoscape-baselines --bench magnetic`

#![allow(clippy::unwrap_used, reason = "a benchmark fails by panicking")]

use divan::Bencher;
use divan::counter::ItemsCount;
use endoscape_baselines::{Magnetic, MagneticConfig};
use endoscape_core::magnetic::{HallArray, Magnet};
use endoscape_core::{MagneticReading, MagneticRig, Observation, Odometry as _, Pose};
use nalgebra::{Translation3, UnitQuaternion, Vector3};

const READINGS: usize = 200;

fn main() {
    divan::main();
}

fn rig() -> MagneticRig {
    let magnet =
        Magnet { moment_a_m2: 0.25, position_in_camera_m: [0.0, 0.0, -0.012], axis_in_camera: [0.0, 0.0, 1.0] };
    MagneticRig::new(magnet, HallArray::grid(8, 8, 0.03, &HallArray::TRIAXIAL, 4e-7), Pose::identity()).unwrap()
}

/// A screw through the volume at 100 readings per second, with uniform noise of the sensors' standard deviation.
fn readings(rig: &MagneticRig) -> Vec<Observation> {
    let mut random = fastrand::Rng::with_seed(1);
    let reading = |index: usize| {
        let s = 0.01 * index as f64;
        let place = Translation3::new(0.05 * s.cos(), 0.05 * s.sin(), 0.09 + 0.02 * (0.5 * s).sin());
        let pose = Pose::from_parts(place, UnitQuaternion::from_euler_angles(s, 0.7 * s, 0.2));
        let noise = |random: &mut fastrand::Rng| Vector3::from_fn(|_, _| (random.f64() - 0.5) * 12_f64.sqrt() * 4e-7);
        let field_tesla = rig.field_tesla(&pose).into_iter().map(|field| Some(field + noise(&mut random))).collect();
        Observation::Magnetic(MagneticReading { index, time_s: s, field_tesla })
    };
    (0..READINGS).map(reading).collect()
}

#[divan::bench]
fn follow(bencher: Bencher<'_, '_>) {
    let rig = rig();
    let readings = readings(&rig);
    bencher.counter(ItemsCount::new(READINGS)).bench_local(|| {
        let mut magnetic = Magnetic::new(MagneticConfig::default(), rig.clone()).unwrap();
        readings.iter().map(|reading| magnetic.track(reading).unwrap().confidence).sum::<f64>()
    });
}

#[divan::bench]
fn find(bencher: Bencher<'_, '_>) {
    let rig = rig();
    let first = readings(&rig).swap_remove(0);
    bencher.counter(ItemsCount::new(1_usize)).bench_local(|| {
        Magnetic::new(MagneticConfig::default(), rig.clone()).unwrap().track(&first).unwrap().confidence
    });
}
