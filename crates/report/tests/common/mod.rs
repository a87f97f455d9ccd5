//! Run folders as a method would leave them, made from the truth of the repository's own sequence.

#![allow(dead_code, clippy::unwrap_used, reason = "each test file uses its own part and fails as tests do")]

use endoscape_core::trajectory::to_tum;
use endoscape_core::{DepthMap, Grid, TimedPose};
use endoscape_eval::poses::Poses;
use endoscape_frames::{Sequence, formats, picture};
use endoscape_report::{MethodInput, RunFolder, SequenceInput};
use nalgebra::Translation3;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Metres per unit of the maps below.
const UNIT_M: f64 = 1e-6;

/// The repository's own sequence.
pub fn tube() -> Sequence {
    formats::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/tube"), None).unwrap()
}

/// Its true path.
pub fn truth() -> Poses {
    Poses::from_trajectory(&tube().trajectory().unwrap()).unwrap()
}

/// Writes a run folder: half the true scale, each position off by up to `error` of the path's size, depth off by ripples
/// of that size, confidence that knows both, and frame 7 lost.
pub fn write_run(folder: &Path, error: f64) -> PathBuf {
    let sequence = tube();
    std::fs::create_dir_all(folder.join("depth")).unwrap();
    std::fs::create_dir_all(folder.join("reliability")).unwrap();
    let mut csv = "index,time_s,tracked,confidence,latency_ms,warning\n".to_owned();
    let mut poses = Vec::new();
    for (index, frame) in sequence.frames.iter().enumerate() {
        let wave = (2.3 * index as f64 + 1.0).sin();
        let pose = frame.world_from_camera.unwrap();
        let shift = error * 0.01 * wave;
        let position = (pose.translation.vector + nalgebra::Vector3::new(shift, -shift, 0.5 * shift)) * 0.5;
        let world_from_camera = endoscape_core::Pose::from_parts(Translation3::from(position), pose.rotation);
        if index != 7 {
            poses.push(TimedPose { time_s: frame.time_s, world_from_camera });
        }
        let (confidence, latency_ms) = (1.0 - 0.9 * wave.abs(), 20.0 + 5.0 * wave);
        let tracked = index != 7;
        writeln!(csv, "{index},{},{tracked},{confidence},{latency_ms},", frame.time_s).unwrap();
        let depth = sequence.read_depth(index).unwrap().unwrap();
        write_maps(folder, index, &depth, error);
    }
    std::fs::write(folder.join("trajectory.tum"), to_tum(&poses)).unwrap();
    std::fs::write(folder.join("frames.csv"), csv).unwrap();
    let facts = format!(
        "{{\"method\": \"made up\", \"model\": null, \"frames\": 12, \"tracked\": 11, \"lost_frames\": [7], \
         \"fps\": 50.0, \"device\": \"cpu\", \"depth_metres_per_unit\": {UNIT_M}}}"
    );
    std::fs::write(folder.join("run.json"), facts).unwrap();
    folder.to_owned()
}

fn write_maps(folder: &Path, index: usize, depth: &DepthMap, error: f64) {
    let ripple = |x: usize, y: usize| 1.0 + error * (0.1 * x as f64).sin() * (0.13 * y as f64).cos();
    let size = depth.size();
    let units = |x: usize, y: usize| {
        let metres = f64::from(depth.get(x, y).unwrap_or_default());
        (0.5 * metres * ripple(x, y) / UNIT_M).min(65_535.0) as u16
    };
    let name = format!("{index:06}.png");
    picture::write_gray16_png(&folder.join("depth").join(&name), &Grid::from_fn(size, units)).unwrap();
    let trusted = |x: usize, y: usize| (ripple(x, y) - 1.0).abs() < 0.5 * error;
    picture::write_mask_png(&folder.join("reliability").join(&name), &Grid::from_fn(size, trusted)).unwrap();
}

/// A run folder as input.
pub fn run_input(folder: &Path, name: &str, error: f64) -> MethodInput {
    let folder = write_run(&folder.join(format!("run-{error}")), error);
    let bytes = std::fs::read(folder.join("trajectory.tum")).unwrap();
    let poses = endoscape_eval::read::poses(&bytes, None, endoscape_eval::poses::Duplicates::Refuse).unwrap();
    MethodInput { name: name.to_owned(), poses: Some(poses), run: Some(RunFolder::open(&folder).unwrap()) }
}

/// Two runs on the repository's own sequence.
pub fn two_runs(folder: &Path, names: [&str; 2]) -> SequenceInput {
    let methods = vec![run_input(folder, names[0], 0.05), run_input(folder, names[1], 0.3)];
    SequenceInput { name: "tube".to_owned(), truth: Some(truth()), sequence: Some(tube()), methods }
}
