//! Checkpoint folders of recurrent networks, and those of another kind.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use burn::tensor::{Device, Tensor, TensorData};
use endoscape_nets::{Checkpoint, NetsConfig, NetsError, RecurrentCheckpoint, RecurrentVoConfig};
use std::fs;
use std::path::Path;

fn saved(path: &Path) -> RecurrentCheckpoint {
    let config = RecurrentVoConfig { stem: [4, 4], hidden: 6, grid: 2, unit_m: 0.0012, ..RecurrentVoConfig::default() };
    let mut checkpoint = RecurrentCheckpoint::init(config, 5, &Device::flex()).unwrap();
    checkpoint.manifest.steps = 7;
    checkpoint.save_with(path, |_| Ok::<(), NetsError>(())).unwrap();
    checkpoint
}

fn motion(checkpoint: &RecurrentCheckpoint) -> TensorData {
    checkpoint.net.forward(Tensor::full([1, 2, 6, 32, 40], 0.3, &Device::flex()), None).0.into_data()
}

#[test]
fn a_checkpoint_comes_back_as_it_was() {
    let root = tempfile::tempdir().unwrap();
    let path = root.path().join("best");
    let before = saved(&path);
    let after = RecurrentCheckpoint::load(&path, &Device::flex()).unwrap();
    assert_eq!((&after.config, after.manifest.steps), (&before.config, 7));
    assert_eq!(motion(&after), motion(&before));
    assert!(RecurrentCheckpoint::is_at(&path) && !RecurrentCheckpoint::is_at(root.path()));
}

#[test]
fn the_wrong_kind_of_model_is_one_sentence() {
    let root = tempfile::tempdir().unwrap();
    let (recurrent, joint) = (root.path().join("recurrent"), root.path().join("joint"));
    saved(&recurrent);
    let fast = NetsConfig::fast();
    let tiny = NetsConfig { disp: fast.disp.with_width(0.05), pose: fast.pose.with_width(0.1), ..fast };
    Checkpoint::init(tiny, 0, &Device::flex()).unwrap().save(&joint).unwrap();
    let sentence = Checkpoint::load(&recurrent, &Device::flex()).unwrap_err().to_string();
    assert!(sentence.contains("holds a recurrent network") && sentence.contains("--method recurrent"), "{sentence}");
    let sentence = RecurrentCheckpoint::load(&joint, &Device::flex()).unwrap_err().to_string();
    assert!(sentence.contains("not a recurrent one") && sentence.contains("--supervised"), "{sentence}");
}

#[test]
fn damage_is_named() {
    let root = tempfile::tempdir().unwrap();
    let path = root.path().join("best");
    let sentence = || RecurrentCheckpoint::load(&path, &Device::flex()).unwrap_err().to_string();
    assert!(sentence().contains("no such checkpoint folder"));
    saved(&path);
    let config = fs::read_to_string(path.join("config.toml")).unwrap();
    fs::write(path.join("config.toml"), config.replace("hidden = 6", "hidden = 9")).unwrap();
    assert!(sentence().contains("weights.safetensors") && sentence().contains("should be"), "{}", sentence());
    fs::write(path.join("config.toml"), config.replace("hidden = 6", "hidden = 4096")).unwrap();
    assert!(sentence().contains("numbers where the configured network has"), "{}", sentence());
    fs::write(path.join("config.toml"), &config).unwrap();
    let weights = fs::read(path.join("weights.safetensors")).unwrap();
    fs::write(path.join("weights.safetensors"), &weights[..weights.len() / 2]).unwrap();
    assert!(sentence().contains("not a whole safetensors file"), "{}", sentence());
}
