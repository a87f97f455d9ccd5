//! Checkpoint folders: round trips, replacement, and every way to be broken.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use burn::tensor::{Device, Tensor, TensorData};
use endoscape_nets::{Checkpoint, DataSource, NetsConfig, NetsError, Network};
use std::fs;
use std::path::Path;

fn tiny() -> NetsConfig {
    let config = NetsConfig::paper();
    NetsConfig { disp: config.disp.with_width(0.01), pose: config.pose.with_width(0.05), ..config }
}

fn saved(folder: &Path) -> Checkpoint {
    let mut checkpoint = Checkpoint::init(tiny(), 0, &Device::flex()).unwrap();
    checkpoint.manifest.steps = 1200;
    checkpoint.manifest.seed = Some(9);
    checkpoint.manifest.data = vec![DataSource { name: "colon".into(), fingerprint: "ab12".into() }];
    checkpoint.manifest.validation = [("photometric".to_string(), 0.125), ("depth".to_string(), f64::NAN)].into();
    checkpoint.save(folder).unwrap();
    checkpoint
}

fn outputs(checkpoint: &Checkpoint) -> (TensorData, TensorData) {
    let image = Tensor::<4>::full([1, 3, 21, 34], 0.4, &Device::flex());
    let [disparity, ..] = checkpoint.disp.as_ref().unwrap().forward(image.clone()).scales;
    let pose = checkpoint.pose.as_ref().unwrap();
    (disparity.into_data(), pose.forward_motion(image.clone(), &[image.clone(), image]).into_data())
}

/// The sentence loading fails with.
fn load_error(folder: &Path) -> String {
    let message = Checkpoint::load(folder, &Device::flex()).unwrap_err().to_string();
    assert!(!message.contains('\n'), "{message}");
    message
}

#[test]
fn a_checkpoint_comes_back_as_it_was() {
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("runs/best");
    let before = saved(&folder);
    let after = Checkpoint::load(&folder, &Device::flex()).unwrap();
    assert_eq!(after.config, before.config);
    assert_eq!(outputs(&after), outputs(&before));
    assert_eq!(after.manifest.networks, [Network::Disp, Network::Pose]);
    assert_eq!((after.manifest.steps, after.manifest.seed), (1200, Some(9)));
    assert_eq!(after.manifest.data, before.manifest.data);
    assert_eq!(after.manifest.validation, [("photometric".to_string(), 0.125)].into());
    let names: Vec<_> =
        fs::read_dir(root.path().join("runs")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(names, ["best"], "nothing is left beside it");
}

#[test]
fn an_alignment_network_comes_back_and_asks_for_a_newer_program() {
    let (root, device) = (tempfile::tempdir().unwrap(), Device::flex());
    let (folder, [first, second, third]) =
        (root.path().join("best"), ["1", "2", "3"].map(|name| root.path().join(name)));
    let mut before = saved(&folder);
    assert_eq!(Checkpoint::load(&folder, &device).unwrap().manifest.format, 1);
    before.config.align.encoder = [3, 4, 5, 6, 7];
    before.align = Some(before.config.align.init(5, &device).unwrap());
    before.save(&folder).unwrap();
    before.export_safetensors(&first).unwrap();
    let after = Checkpoint::load(&folder, &device).unwrap();
    assert_eq!((after.manifest.format, &after.config), (2, &before.config));
    assert_eq!(after.manifest.networks, [Network::Disp, Network::Pose, Network::Align]);
    after.export_safetensors(&second).unwrap();
    let (imported, _) = Checkpoint::import(&first, None, &device).unwrap();
    imported.export_safetensors(&third).unwrap();
    let [first, second, third] = [first, second, third].map(|file| fs::read(file).unwrap());
    assert!(first == second, "not what was saved");
    assert!(first == third, "not what was exported");
}

#[test]
fn running_statistics_are_part_of_a_checkpoint() {
    let root = tempfile::tempdir().unwrap();
    let device = Device::flex().autodiff();
    let trained = Checkpoint::init(tiny(), 0, &device).unwrap();
    let _ = trained.disp.as_ref().unwrap().forward(Tensor::full([2, 3, 16, 16], 0.5, &device));
    trained.save(&root.path().join("best")).unwrap();
    let plain = Checkpoint::load(&root.path().join("best"), &Device::flex()).unwrap();
    let fresh = Checkpoint::init(tiny(), 0, &Device::flex()).unwrap();
    let statistics = |checkpoint: &Checkpoint| {
        let path = tempfile::NamedTempFile::new().unwrap().into_temp_path();
        checkpoint.export_safetensors(&path).unwrap();
        let bytes = fs::read(&path).unwrap();
        let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
        file.tensor("disp.conv1.0.norm.running_var").unwrap().data().to_vec()
    };
    assert_ne!(statistics(&plain), statistics(&fresh));
    assert_eq!(statistics(&plain), statistics(&trained));
}

#[test]
fn saving_replaces_a_checkpoint_with_everything_in_it_or_not_at_all() {
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("best");
    let first = saved(&folder);
    let second = Checkpoint::init(tiny(), 0, &Device::flex()).unwrap();
    let failure = second.save_with(&folder, |draft| {
        fs::write(draft.join("optimizer"), "half").unwrap();
        Err(NetsError::Missing { path: draft.to_path_buf(), what: "disk" })
    });
    assert!(failure.is_err());
    assert_eq!(outputs(&Checkpoint::load(&folder, &Device::flex()).unwrap()), outputs(&first));
    second
        .save_with(&folder, |draft| {
            fs::write(draft.join("optimizer"), "whole").unwrap();
            Ok::<_, NetsError>(())
        })
        .unwrap();
    assert_eq!(fs::read_to_string(folder.join("optimizer")).unwrap(), "whole");
    assert_eq!(outputs(&Checkpoint::load(&folder, &Device::flex()).unwrap()), outputs(&second));
    assert_eq!(fs::read_dir(root.path()).unwrap().count(), 1);
}

#[test]
fn an_interrupted_replacement_leaves_the_previous_checkpoint_to_load() {
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("best");
    let first = saved(&folder);
    // What a program killed between the two renames leaves behind.
    fs::rename(&folder, root.path().join(".best.previous")).unwrap();
    fs::create_dir(root.path().join(".best.incomplete")).unwrap();
    assert_eq!(outputs(&Checkpoint::load(&folder, &Device::flex()).unwrap()), outputs(&first));
    first.save(&folder).unwrap();
    assert_eq!(fs::read_dir(root.path()).unwrap().count(), 1);
}

#[test]
fn a_folder_that_is_no_checkpoint_is_never_replaced() {
    let root = tempfile::tempdir().unwrap();
    fs::write(root.path().join("thesis.tex"), "years of work").unwrap();
    let message = Checkpoint::init(tiny(), 0, &Device::flex()).unwrap().save(root.path()).unwrap_err().to_string();
    assert!(message.contains("is not a checkpoint; choose another folder"), "{message}");
    assert_eq!(fs::read_to_string(root.path().join("thesis.tex")).unwrap(), "years of work");
}

#[test]
fn what_is_broken_is_named_in_one_sentence() {
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("best");
    assert!(load_error(&folder).contains("no such checkpoint folder"));
    fs::create_dir(&folder).unwrap();
    assert!(load_error(&folder).contains("holds no manifest.json"));

    let break_file = |name: &str, change: &dyn Fn(Vec<u8>) -> Vec<u8>| {
        saved(&folder);
        let path = folder.join(name);
        fs::write(&path, change(fs::read(&path).unwrap())).unwrap();
        load_error(&folder)
    };
    let replace =
        |bytes: Vec<u8>, from: &str, to: &str| String::from_utf8(bytes).unwrap().replacen(from, to, 1).into_bytes();
    let weights = "weights.safetensors";
    for (message, fragment) in [
        (break_file(weights, &|bytes| bytes[..bytes.len() / 2].to_vec()), "is not a whole safetensors file"),
        (break_file(weights, &|_| Vec::new()), "is not a whole safetensors file"),
        (break_file("manifest.json", &|bytes| bytes[..bytes.len() - 9].to_vec()), "is not a whole manifest"),
        (break_file("manifest.json", &|_| vec![0xff; 40]), "is not a text file"),
        (break_file("manifest.json", &|bytes| replace(bytes, "\"format\": 1", "\"format\": 7")), "update endoscape"),
        (break_file("config.toml", &|bytes| replace(bytes, "alpha = 10", "alpha = -1")), "`disp.alpha` is -1"),
        (break_file("config.toml", &|bytes| replace(bytes, "alpha", "alfa")), "unknown field `alfa`"),
        (break_file("config.toml", &|_| vec![b'#'; 2 << 20]), "is longer than a megabyte"),
        (
            break_file("config.toml", &|bytes| replace(bytes, "snippet_length = 3", "snippet_length = 5")),
            "conv1.0.weight is [1, 9, 7, 7] but should be [1, 15, 7, 7]",
        ),
        (
            break_file("config.toml", &|bytes| replace(bytes, "batch_norm = true", "batch_norm = false")),
            "unknown tensor conv1.0.norm.bias (and ",
        ),
    ] {
        assert!(message.contains(fragment), "{message}");
    }
    for name in [weights, "config.toml"] {
        saved(&folder);
        fs::remove_file(folder.join(name)).unwrap();
        assert!(load_error(&folder).contains(&format!("{name}: no such file")));
    }
}

#[test]
fn a_configuration_far_beyond_the_weights_costs_no_memory() {
    let root = tempfile::tempdir().unwrap();
    saved(root.path());
    let mut config = tiny();
    config.disp.encoder = [4096; 7];
    fs::write(root.path().join("config.toml"), config.to_toml().unwrap()).unwrap();
    assert!(load_error(root.path()).contains("where the configured network has"));
}
