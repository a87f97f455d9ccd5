use super::*;
use crate::formats;
use crate::picture::write_gray16_png;
use endoscape_core::Grid;
use std::fs;
use std::path::PathBuf;
use tempfile::TempDir;

const MAP: Size = Size::new(8, 6);

fn tube() -> Sequence {
    formats::open(&PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/tube"), None).unwrap()
}

/// What `endoscape run` writes about the first three frames, of which it lost the second.
fn run_over(sequence: &Sequence, maps: &str) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    let (mut rows, mut poses) = ("index,time_s,tracked,confidence,latency_ms,warning\n".to_owned(), String::new());
    fs::create_dir(folder.path().join("depth")).unwrap();
    for (index, frame) in sequence.frames[..3].iter().enumerate() {
        rows += &format!("{},{},{},0.5,1.0,\n", frame.number, frame.time_s, index != 1);
        poses += &format!("{} 0 0 {index} 0 0 0 1\n", frame.time_s);
        let steps = Grid::filled(MAP, 100 * (index as u16 + 1));
        write_gray16_png(&folder.path().join(format!("depth/{:06}.png", frame.number)), &steps).unwrap();
    }
    write("frames.csv", &rows);
    write("trajectory.tum", &poses);
    write("run.json", maps);
    folder
}

const PNG: &str = r#"{"depth": {"format": "png", "unit_per_step": 0.01, "size": {"width": 8, "height": 6}}}"#;

#[test]
fn answers_take_the_place_of_the_truth() {
    let sequence = tube();
    assert!(sequence.has_poses() && sequence.frames.len() > 3);
    let run = run_over(&sequence, PNG);
    let labelled = of_run(&sequence, run.path()).unwrap();
    let places: Vec<Option<f64>> =
        labelled.frames.iter().map(|frame| frame.world_from_camera.map(|pose| pose.translation.z)).collect();
    assert_eq!(places[..3], [Some(0.0), None, Some(2.0)]);
    assert!(places[3..].iter().all(Option::is_none), "a pose of the sequence itself was left");
    let depth = labelled.read_depth(2).unwrap().unwrap();
    assert_eq!((depth.size(), depth.get(3, 3)), (MAP, Some(3.0)));
    assert!(labelled.read_depth(3).unwrap().is_none());
}

#[test]
fn folders_that_say_nothing_are_refused_in_a_sentence() {
    let sequence = tube();
    let refusal = |folder: &Path| of_run(&sequence, folder).unwrap_err().to_string();
    let no_maps = run_over(&sequence, r#"{"depth": {"format": "npy", "unit_per_step": null, "size": null}}"#);
    assert!(refusal(no_maps.path()).contains("run again with --depth png"));
    let damaged = run_over(&sequence, "{");
    assert!(refusal(damaged.path()).contains("is not what a run writes"));
    let shortened = run_over(&sequence, PNG);
    fs::write(shortened.path().join("trajectory.tum"), "0 0 0 0 0 0 0 1\n").unwrap();
    assert!(refusal(shortened.path()).contains("has 1 poses but frames.csv 3 frames"));
    let mut other = tube();
    other.frames.iter_mut().for_each(|frame| frame.number += 1000);
    let run = run_over(&tube(), PNG);
    assert!(
        of_run(&other, run.path()).unwrap_err().to_string().contains("give the folder of a run over the same input")
    );
}
