//! The truth of a simulated sequence agrees with itself, with its pictures and with `inspect`.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr, reason = "tests fail by panicking")]

use endoscape_core::event::NullSink;
use endoscape_core::{Pose, Size};
use endoscape_frames::{formats, inspect};
use endoscape_sim::light::Lamps;
use endoscape_sim::mucosa::Mucosa;
use endoscape_sim::render::{Moment, Optics, Scene};
use endoscape_sim::sensor::Sensor;
use endoscape_sim::surface::Posed;
use endoscape_sim::{
    Anatomy, Config, Effect, Effects, Flight, Hall, Organ, PathKind, Patient, Session, SimError, Source, capsule_lens,
    simulate,
};
use nalgebra::Point3;
use std::path::Path;

fn config(organ: Organ, side: usize, effects: Effects) -> Config {
    Config {
        source: Source::Organ(organ),
        frames: 4,
        fps: 10.0,
        seed: 5,
        camera: capsule_lens(Size::new(side, side)).unwrap(),
        path: PathKind::Survey,
        effects,
        hall: Hall::default(),
    }
}

#[test]
fn the_flow_leads_to_the_next_frames_depth() {
    const SIDE: usize = 144;
    let moving = Effects::none().with(Effect::Peristalsis).with(Effect::Breathing).with(Effect::Contraction);
    let config = config(Organ::SmallBowel, SIDE, moving);
    let anatomy = config.anatomy().unwrap();
    let patient = Patient::new(&config, &anatomy);
    let mut session = Session::start(&patient).unwrap();
    let (a, b) = (session.next_frame().unwrap(), session.next_frame().unwrap());
    // Where the flow leads, a place of the wall stands at a depth; seen again there, it must be that depth.
    let (optics, poses) = (Optics::new(config.camera), first_poses(&config, &anatomy));
    let deformation = anatomy.deformation(config.effects);
    let (mut now, mut next) = (Posed::new(&anatomy.wall), Posed::new(&anatomy.wall));
    now.repose(|vertex| deformation.at(0.0).position(vertex));
    next.repose(|vertex| deformation.at(1.0 / config.fps).position(vertex));
    let mut errors = Vec::new();
    for (at, sample) in a.samples.iter().enumerate() {
        let Some([dx, dy]) = sample.flow else { continue };
        let (x, y) = ((at % SIDE) as f64 + dx, (at / SIDE) as f64 + dy);
        if !(1.0..SIDE as f64 - 2.0).contains(&x) || !(1.0..SIDE as f64 - 2.0).contains(&y) {
            continue;
        }
        let corner = |i: usize, j: usize| b.samples[(y as usize + j) * SIDE + x as usize + i].depth_m;
        let corners = [corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1)];
        let (low, high) = corners.iter().fold((f64::MAX, 0.0_f64), |(low, high), d| (low.min(*d), high.max(*d)));
        if low <= 0.0 || high - low > 0.03 * low {
            continue;
        }
        let (u, v) = (x.fract(), y.fract());
        let depth =
            (1.0 - v) * ((1.0 - u) * corners[0] + u * corners[1]) + v * ((1.0 - u) * corners[2] + u * corners[3]);
        let ray = poses[0].rotation * optics.ray(at).unwrap();
        let hit = now.cast(&poses[0].translation.vector, &ray, 1.0).unwrap();
        let posed_depth = (poses[1].inverse() * Point3::from(next.point(hit.site))).z;
        errors.push((posed_depth - depth).abs());
    }
    errors.sort_by(f64::total_cmp);
    assert!(errors.len() > 2000, "{}", errors.len());
    assert!(errors[errors.len() / 2] < 1e-5, "median {} m", errors[errors.len() / 2]);
    assert!(errors[errors.len() * 8 / 10] < 1e-4, "80 % {} m", errors[errors.len() * 8 / 10]);
}

/// Poses of the first two frames.
fn first_poses(config: &Config, anatomy: &Anatomy) -> [Pose; 2] {
    let deformation = anatomy.deformation(config.effects);
    let duration_s = config.frames as f64 / config.fps;
    let flight = Flight::plan(config.path, anatomy, &deformation, config.effects, (duration_s, config.seed)).unwrap();
    [flight.pose(0.0), flight.pose(1.0 / config.fps)]
}

#[test]
fn without_effects_pictures_are_the_light_model() {
    let config = config(Organ::Stomach, 64, Effects::none());
    let anatomy = config.anatomy().unwrap();
    let (mucosa, optics) = (Mucosa::new(&anatomy.look, config.seed), Optics::new(config.camera));
    let lamps = Lamps::at_lens();
    let scene = Scene { anatomy: &anatomy, mucosa: &mucosa, optics: &optics, lamps: &lamps, effects: config.effects };
    let posed = Posed::new(&anatomy.wall);
    let [pose, _] = first_poses(&config, &anatomy);
    let moment = || Moment { wall: &posed, world_from_camera: vec![pose; 64] };
    let samples = scene.render(&moment(), &moment());
    let mut sensor = Sensor::new(config.effects, config.seed, anatomy.usual_distance_m());
    let developed = sensor.develop(0, 0.1, &optics, &samples, None).unwrap();
    let mut checked = 0;
    for (at, sample) in samples.iter().enumerate().filter(|(_, sample)| sample.is_wall()) {
        let ray = pose.rotation * optics.ray(at).unwrap();
        let hit = posed.cast(&pose.translation.vector, &ray, 1.0).unwrap();
        let cosine = -hit.normal.dot(&ray);
        // The paint is filtered over the part of the wall that the pixel covers.
        let footprint_m = hit.distance_m * optics.pixel_rad() / cosine.max(0.25).sqrt();
        let albedo = mucosa.material(&anatomy, &hit, footprint_m).albedo;
        for (channel, albedo) in albedo.into_iter().enumerate() {
            // Radiance of a Lambertian wall under a lamp at the lens: albedo cos / r^2.
            let model = albedo * cosine / (hit.distance_m * hit.distance_m);
            assert!((sample.diffuse[channel] / model - 1.0).abs() < 0.01 || cosine < 1e-6);
            let value = f64::from(developed.image.rgb()[3 * at + channel]) / 255.0;
            let expected = (model * developed.gain).min(1.0);
            assert!((value - expected).abs() < 0.01 * expected + 0.51 / 255.0, "{value} {expected}");
        }
        assert_eq!(sample.specular, 0.0);
        checked += 1;
    }
    assert!(checked > 2000);
}

/// All files of a folder with their bytes.
fn contents(folder: &Path) -> Vec<(std::path::PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(contents(&path));
        } else {
            found.push((path.file_name().unwrap().into(), std::fs::read(&path).unwrap()));
        }
    }
    found.sort();
    found
}

#[test]
fn one_thread_or_many_give_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(Organ::SmallBowel, 48, Effects::all());
    for (threads, name) in [(1, "one"), (3, "three")] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| simulate(&config, &folder.path().join(name), &mut NullSink)).unwrap();
    }
    assert!(contents(&folder.path().join("one")) == contents(&folder.path().join("three")));
    let other = Config { seed: 6, ..config };
    simulate(&other, &folder.path().join("other"), &mut NullSink).unwrap();
    assert!(contents(&folder.path().join("one")) != contents(&folder.path().join("other")));
}

#[test]
fn inspect_finds_a_rigid_sequence_consistent() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("rigid");
    let rigid = Effects::default().without(Effect::Peristalsis).without(Effect::Breathing).without(Effect::Contraction);
    simulate(&config(Organ::Colon, 160, rigid), &out, &mut NullSink).unwrap();
    let sequence = formats::open(&out, None).unwrap();
    let found = inspect::inspect(&sequence, &mut NullSink).unwrap();
    let median_m = found.depth_consistency.unwrap().median_m;
    assert!(median_m < 2e-5, "{median_m} m");
    assert!(found.has_masks && found.has_poses && found.warnings.is_empty(), "{:?}", found.warnings);
    let (rig, readings) = endoscape_frames::magnet::read(&out).unwrap().unwrap();
    assert_eq!((readings.len(), rig.array().positions_m.len()), (4, 64));
}

#[test]
fn every_pixel_in_the_field_of_view_meets_the_wall() {
    for organ in Organ::ALL {
        let config = config(organ, 96, Effects::default());
        let anatomy = config.anatomy().unwrap();
        let patient = Patient::new(&config, &anatomy);
        let frame = Session::start(&patient).unwrap().next_frame().unwrap();
        let optics = Optics::new(config.camera);
        let seen = (0..96 * 96).filter(|at| optics.ray(*at).is_some()).count();
        let missed = (0..96 * 96).filter(|at| optics.ray(*at).is_some() && !frame.samples[*at].is_wall()).count();
        assert_eq!(missed, 0, "{organ:?}: {missed} of {seen} rays met nothing");
    }
}

#[test]
fn nonsense_is_one_sentence() {
    let good = config(Organ::SmallBowel, 16, Effects::none());
    let refused = |config: Config| {
        let folder = tempfile::tempdir().unwrap();
        let error = simulate(&config, &folder.path().join("out"), &mut NullSink).unwrap_err();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "something was left behind");
        let sentence = error.to_string();
        assert!(!sentence.contains('\n'), "{sentence}");
        sentence
    };
    assert!(refused(Config { frames: 0, ..good.clone() }).contains("0 frames"));
    assert!(refused(Config { fps: f64::NAN, ..good.clone() }).contains("NaN frames per second"));
    assert!(refused(Config { hall: Hall { pitch_m: -1.0, ..Hall::default() }, ..good.clone() }).contains("array"));
    let mesh = |name: &str, text: &str, metres_per_unit: f64| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        let source = Source::Mesh { path, metres_per_unit, like: Organ::Colon };
        refused(Config { source, ..good.clone() })
    };
    assert!(mesh("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", 0.001).contains("has no faces"));
    assert!(mesh("nan.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", 0.001).contains("not a number"));
    assert!(mesh("small.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", 0.001).contains("--mesh-unit"));
    assert!(mesh("flat.obj", "v 0 0 0\nv 90 0 0\nv 0 90 0\nf 1 2 3\n", 0.001).contains("no inside"));
    assert!(mesh("minus.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", -1.0).contains("is no length"));
    assert!(mesh("noise.ply", "ply\nhello", 0.001).contains("PLY"));
    assert!(mesh("scan.stl", "solid", 0.001).contains("neither an OBJ nor a PLY"));
    let unwritable = simulate(&good, Path::new("/proc/no/such/place"), &mut NullSink);
    assert!(matches!(unwritable, Err(SimError::Frames(_))));
}
