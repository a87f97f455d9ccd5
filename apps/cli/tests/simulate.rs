//! `endoscape simulate`: a patient from a seed, read back by the other commands.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "test helpers fail by panicking and say what they skip"
)]

mod common;
use common::{endoscape, fail, json, succeed};
use std::fs;

#[test]
fn a_simulated_patient_is_a_consistent_sequence() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("patient");
    let out = out.to_str().unwrap();
    let effects = "default,no-peristalsis,no-breathing,no-contraction";
    let said = succeed(&[
        "simulate",
        out,
        "--anatomy",
        "small-bowel",
        "--frames",
        "4",
        "--size",
        "96x96",
        "--effects",
        effects,
    ]);
    assert!(said.contains("4 frames of 96x96"), "{said}");
    let found = json(&["inspect", out, "--json"]);
    assert_eq!((&found["frames"], &found["has_depth"], &found["has_poses"]), (&4.into(), &true.into(), &true.into()));
    assert_eq!(found["camera"]["model"], "kannala-brandt");
    assert!(found["depth_consistency"]["median_m"].as_f64().unwrap() < 2e-5, "{found}");
    for file in ["labels/000003.png", "flow/000003.png", "magnet.csv", "magnet.toml", "simulation.toml"] {
        assert!(fs::exists(format!("{out}/{file}")).unwrap(), "{file}");
    }
}

#[test]
fn nonsense_is_refused_and_nothing_is_left() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let out = out.to_str().unwrap();
    for wrong_call in [
        &["--anatomy", "heart"][..],
        &["--effects", "glitter"],
        &["--path", "teleport"],
        &["--size", "0x0"],
        &["--frames", "-3"],
        &["--mesh-unit", "0.001"],
    ] {
        let output = endoscape(&[&["simulate", out], wrong_call].concat());
        assert_eq!(output.status.code(), Some(2), "{wrong_call:?}");
    }
    assert!(fail(&["simulate", out, "--frames", "0"]).contains("0 frames"));
    assert!(fail(&["simulate", out, "--fps", "0"]).contains("frames per second"));
    assert!(fail(&["simulate", out, "--mesh", "/no/such/mesh.obj"]).contains("mesh.obj"));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    fs::write(folder.path().join("precious.txt"), "mine").unwrap();
    assert!(fail(&["simulate", folder.path().to_str().unwrap(), "--frames", "1"]).contains("already holds something"));
}
