//! Recordings as the Rerun viewer reads them.

#![cfg(feature = "rerun")]
#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests fail as tests do")]

mod common;

use common::{tube, two_runs};
use endoscape_eval::trajectory::Settings;
use endoscape_report::judge;
use endoscape_report::recording::Recording;
use re_sdk::external::re_log_encoding::Decoder;
use re_sdk::log::{Chunk, LogMsg};
use std::collections::BTreeMap;
use std::path::Path;

/// Frames of the fixture.
const FRAMES: usize = 12;

/// Rows of each component by entity, of the recording and not of its layout; `true` beside those that hold at all times.
type Rows = BTreeMap<(String, String), (usize, bool)>;

fn rows(path: &Path) -> (Rows, Vec<Chunk>) {
    let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
    let (mut rows, mut chunks) = (Rows::new(), Vec::new());
    for message in Decoder::<LogMsg>::decode_lazy(file) {
        let LogMsg::ArrowMsg(store, message) = message.unwrap() else { continue };
        if !store.is_recording() {
            continue;
        }
        let chunk = Chunk::from_arrow_msg(&message).unwrap();
        for component in chunk.components_identifiers() {
            let key = (chunk.entity_path().to_string(), component.to_string());
            let entry = rows.entry(key).or_insert((0, chunk.is_static()));
            entry.0 += chunk.num_events_for_component(component).unwrap() as usize;
        }
        chunks.push(chunk);
    }
    (rows, chunks)
}

fn recorded(folder: &Path) -> std::path::PathBuf {
    let study = judge("Two runs".into(), vec![two_runs(folder, ["ours", "their run"])], &Settings::default()).unwrap();
    let path = folder.join("session.rrd");
    Recording::create(&path).unwrap().write(&study, &[Some(&tube())]).unwrap()
}

#[test]
fn cameras_pictures_maps_points_and_paths_are_on_one_time_line() {
    let folder = tempfile::tempdir().unwrap();
    let (rows, chunks) = rows(&recorded(folder.path()));
    let count = |entity: &str, component: &str| {
        rows.get(&(format!("/tube/{entity}"), component.to_owned())).copied().unwrap_or_else(|| {
            panic!("{entity} has no {component}: {:?}", rows.keys().collect::<Vec<_>>());
        })
    };
    for method in ["ours", "their\\ run"] {
        let of = |entity: &str, component: &str| count(&format!("{method}/{entity}"), component);
        // Frame 7 was lost and has no pose.
        assert_eq!(of("camera", "Transform3D:translation"), (FRAMES - 1, false));
        assert_eq!(of("path", "LineStrips3D:strips"), (1, true));
        assert_eq!(of("camera/picture", "Pinhole:image_from_camera"), (1, true));
        assert_eq!(of("camera/depth", "DepthImage:buffer"), (FRAMES, false));
        assert_eq!(of("camera/depth", "DepthImage:meter"), (FRAMES, false));
        assert_eq!(of("camera/reliability", "Image:buffer"), (FRAMES, false));
        assert_eq!(of("camera/points", "Points3D:positions"), (FRAMES, false));
        assert_eq!(of("confidence", "Scalars:scalars"), (FRAMES, false));
        assert_eq!(of("error_mm", "Scalars:scalars"), (FRAMES - 1, false));
    }
    assert_eq!(count("truth/path", "LineStrips3D:strips"), (1, true));
    assert_eq!(count("truth/camera", "Transform3D:translation"), (FRAMES - 1, false));
    assert_eq!(count("ours/camera/picture", "EncodedImage:blob"), (FRAMES, false));
    for chunk in chunks.iter().filter(|chunk| !chunk.is_static()) {
        let mut lines: Vec<String> = chunk.timelines().keys().map(ToString::to_string).collect();
        lines.sort();
        assert_eq!(lines, ["frame", "time"], "{}", chunk.entity_path());
    }
}

/// Paths and points are in the frame and scale of the truth: the estimate of the fixture has half its scale.
#[test]
fn lengths_are_those_of_the_truth() {
    let folder = tempfile::tempdir().unwrap();
    let (_, chunks) = rows(&recorded(folder.path()));
    let truth = tube();
    let first = |entity: &str, component: &str| -> Vec<[f32; 3]> {
        let of = |chunk: &&Chunk| chunk.entity_path().to_string() == format!("/tube/{entity}");
        let has = |chunk: &&Chunk| chunk.components_identifiers().any(|id| id.to_string() == component);
        let chunk = chunks.iter().filter(of).find(has).unwrap();
        let id = chunk.components_identifiers().find(|id| id.to_string() == component).unwrap();
        chunk.iter_slices::<[f32; 3]>(id).next().unwrap().to_vec()
    };
    let position = first("ours/camera", "Transform3D:translation")[0];
    let true_position = truth.frames[0].world_from_camera.unwrap().translation.vector;
    let off: f64 = (0..3).map(|axis| (f64::from(position[axis]) - true_position[axis]).powi(2)).sum();
    assert!(off.sqrt() < 2e-3, "{position:?} is not {true_position}");
    let depth = truth.read_depth(0).unwrap().unwrap();
    let farthest = depth.grid().values().iter().copied().fold(0.0, f32::max);
    let points = first("ours/camera/points", "Points3D:positions");
    let reach = points.iter().map(|point| point[2]).fold(0.0, f32::max);
    assert!((0.8..1.25).contains(&(reach / farthest)), "{reach} and {farthest}");
    assert!(points.len() > 1000 && points.len() <= 6000, "{}", points.len());
}

#[test]
fn a_name_that_is_none_is_one_sentence_and_a_failure_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    assert!(Recording::create(folder.path()).unwrap_err().to_string().contains("is no name for a recording"));
    let lost = folder.path().join("no/such/folder.rrd");
    assert!(Recording::create(&lost).unwrap_err().to_string().contains("cannot be written"));
    let study = judge("Two runs".into(), vec![two_runs(folder.path(), ["a", "b"])], &Settings::default()).unwrap();
    let run = study.sequences[0].methods[0].run.clone().unwrap();
    std::fs::write(&run.depth[&3], "no map").unwrap();
    let path = folder.path().join("broken.rrd");
    let error = Recording::create(&path).unwrap().write(&study, &[Some(&tube())]).unwrap_err().to_string();
    assert!(error.contains("000003.png"), "{error}");
    let left = std::fs::read_dir(folder.path())
        .unwrap()
        .filter(|entry| entry.as_ref().unwrap().file_name().to_string_lossy().contains("broken"));
    assert_eq!(left.count(), 0);
}
