//! Runs a method over a sequence and writes its poses: `track direct SEQUENCE OUT.tum [FIRST..LAST]`, with the feature
//! `orb` also `track orb-endo` and `track orb-ordinary`, or `track magnetic FOLDER OUT.tum`.

use endoscape_baselines::{Direct, DirectConfig, Magnetic, MagneticConfig};
#[cfg(feature = "orb")]
use endoscape_baselines::{Orb, OrbConfig};
use endoscape_core::{Camera, Observation, Odometry, TimedPose, trajectory};
use endoscape_frames::{formats, magnet};
use std::error::Error;
use std::io::Write as _;
use std::path::Path;
use std::time::Instant;

type Outcome<T> = Result<T, Box<dyn Error>>;

fn main() -> Outcome<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [method, input, out, rest @ ..] = arguments.as_slice() else {
        return Err("usage: track direct|orb-endo|orb-ordinary|magnetic INPUT OUT.tum [FIRST..LAST]".into());
    };
    let poses = match method.as_str() {
        "magnetic" => magnetic(Path::new(input))?,
        visual => follow(visual, Path::new(input), rest.first().map(String::as_str))?,
    };
    std::fs::write(out, trajectory::to_tum(&poses))?;
    Ok(())
}

fn follow(method: &str, input: &Path, range: Option<&str>) -> Outcome<Vec<TimedPose>> {
    let sequence = formats::open(input, None)?;
    let camera = sequence.camera.ok_or("the sequence has no camera")?;
    let mut range_of = 0..sequence.frames.len();
    if let Some((first, last)) = range.and_then(|range| range.split_once("..")) {
        range_of = first.parse()?..last.parse()?;
    }
    let mut frames = sequence.open_frames(range_of)?;
    let mut method = visual(method, &camera)?;
    let mut observations = std::iter::from_fn(move || frames.next_frame().transpose());
    observe(method.as_mut(), &mut observations.by_ref().map(|frame| Ok(Observation::Frame(frame?))))
}

fn visual(name: &str, camera: &Camera) -> Outcome<Box<dyn Odometry>> {
    Ok(match name {
        "direct" => Box::new(Direct::new(DirectConfig::default(), camera)?),
        #[cfg(feature = "orb")]
        "orb-endo" => Box::new(Orb::new(OrbConfig::endoscopic(), camera)?),
        #[cfg(feature = "orb")]
        "orb-ordinary" => Box::new(Orb::new(OrbConfig::ordinary(), camera)?),
        other => return Err(format!("there is no method {other} in this build").into()),
    })
}

fn magnetic(input: &Path) -> Outcome<Vec<TimedPose>> {
    let (rig, readings) = magnet::read(input)?.ok_or("the folder has no magnetic readings")?;
    let mut method = Magnetic::new(MagneticConfig::default(), rig)?;
    observe(&mut method, &mut readings.into_iter().map(|reading| Ok(Observation::Magnetic(reading))))
}

fn observe(method: &mut dyn Odometry, all: &mut dyn Iterator<Item = Outcome<Observation>>) -> Outcome<Vec<TimedPose>> {
    let mut poses = Vec::new();
    let mut errors = std::io::stderr().lock();
    for (index, observation) in all.enumerate() {
        let observation = observation?;
        let start = Instant::now();
        let tracked = method.track(&observation)?;
        let (ms, confidence) = (1e3 * start.elapsed().as_secs_f64(), tracked.confidence);
        writeln!(errors, "{index}: {confidence:.2} {ms:.0} ms {}", tracked.warning.as_deref().unwrap_or(""))?;
        let time_s = observation.time_s();
        let believed = tracked.world_from_camera.filter(|_| confidence > 0.0);
        poses.extend(believed.map(|world_from_camera| TimedPose { time_s, world_from_camera }));
    }
    Ok(poses)
}
