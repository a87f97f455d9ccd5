//! Weight files of others: what is recognised, what is refused, and how that is said.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

mod common;

use burn::tensor::Device;
use common::golden;
use endoscape_nets::{Checkpoint, MaskHead, NetsConfig, Network, Padding};
use proptest::prelude::*;
use safetensors::SafeTensors;
use safetensors::tensor::TensorView;
use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::path::Path;

type Change = dyn Fn(&mut Tensors);
/// Shape and bytes by name.
type Tensors = BTreeMap<String, (Vec<usize>, Vec<u8>)>;

fn import_error(path: &Path, only: Option<Network>) -> String {
    let message = Checkpoint::import(path, only, &Device::flex()).unwrap_err().to_string();
    assert!(!message.contains('\n') && message.contains("; "), "{message}");
    message
}

/// Copies a safetensors file without its metadata, letting `change` edit names, shapes and bytes.
fn rewrite(from: &Path, to: &Path, change: impl Fn(&mut Tensors)) {
    let bytes = fs::read(from).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let mut tensors: Tensors =
        file.iter().map(|(n, v)| (n.to_string(), (v.shape().to_vec(), v.data().to_vec()))).collect();
    change(&mut tensors);
    let views = tensors
        .iter()
        .map(|(name, (shape, bytes))| (name, TensorView::new(safetensors::Dtype::F32, shape.clone(), bytes).unwrap()));
    fs::write(to, safetensors::serialize(views, None::<HashMap<String, String>>).unwrap()).unwrap();
}

#[test]
fn the_configuration_is_read_off_a_pytorch_file() {
    let (checkpoint, report) = Checkpoint::import(&golden("port_disp.pth.tar"), None, &Device::flex()).unwrap();
    let disp = checkpoint.config.disp;
    assert_eq!((disp.encoder, disp.decoder), ([3, 4, 5, 6, 6, 5, 4], [5, 6, 5, 4, 4, 3, 2]));
    assert_eq!((disp.alpha, disp.beta, disp.batch_norm, disp.padding), (10.0, 0.01, false, Padding::Symmetric));
    assert_eq!(report.matched.len(), 64);
    assert!(checkpoint.pose.is_none());
    assert_eq!(checkpoint.manifest.origin.as_deref(), Some("port_disp.pth.tar"));

    let (checkpoint, _) =
        Checkpoint::import(&golden("port_pose.pth.tar"), Some(Network::Pose), &Device::flex()).unwrap();
    let pose = checkpoint.config.pose;
    assert_eq!((pose.snippet_length, pose.mask, pose.mask_kernels), (3, MaskHead::Sigmoid, [4; 5]));
    assert_eq!((pose.encoder, pose.motion), ([3, 4, 4, 5, 6], [5, 4]));
}

#[test]
fn the_configuration_is_read_off_the_shapes_of_a_bare_safetensors_file() {
    let root = tempfile::tempdir().unwrap();
    let path = root.path().join("bare.safetensors");
    rewrite(&golden("paper_weights.safetensors"), &path, |_| {});
    let (checkpoint, _) = Checkpoint::import(&path, None, &Device::flex()).unwrap();
    let (declared, _) = Checkpoint::import(&golden("paper_weights.safetensors"), None, &Device::flex()).unwrap();
    let mut expected: NetsConfig = declared.config;
    // No shape tells these.
    (expected.disp.beta, expected.disp.padding, expected.pose.padding) = (0.01, Padding::Symmetric, Padding::Symmetric);
    assert_eq!(checkpoint.config, expected);
}

#[test]
fn two_imports_make_one_checkpoint_and_an_export_brings_it_back() {
    let (device, root) = (Device::flex(), tempfile::tempdir().unwrap());
    let (mut checkpoint, _) = Checkpoint::import(&golden("port_disp.pth.tar"), None, &device).unwrap();
    let (pose, _) = Checkpoint::import(&golden("port_pose.pth.tar"), None, &device).unwrap();
    checkpoint.save(&root.path().join("model")).unwrap();
    let mut checkpoint_again = Checkpoint::load(&root.path().join("model"), &device).unwrap();
    assert!(checkpoint_again.pose.is_none());
    checkpoint_again.absorb(pose.clone());
    checkpoint.absorb(pose);
    checkpoint_again.save(&root.path().join("model")).unwrap();

    let path = root.path().join("both.safetensors");
    Checkpoint::load(&root.path().join("model"), &device).unwrap().export_safetensors(&path).unwrap();
    let (back, report) = Checkpoint::import(&path, None, &device).unwrap();
    assert_eq!(back.config, checkpoint.config);
    assert_eq!(report.matched.len(), 64 + 34);
    let other = root.path().join("other.safetensors");
    back.export_safetensors(&other).unwrap();
    assert_eq!(fs::read(path).unwrap(), fs::read(other).unwrap());
}

#[test]
fn a_file_of_another_kind_is_refused() {
    let root = tempfile::tempdir().unwrap();
    let write = |bytes: &[u8]| {
        let path = root.path().join("weights.pth");
        fs::write(&path, bytes).unwrap();
        path
    };
    assert!(import_error(&root.path().join("absent.pth"), None).contains("no such file"));
    assert!(import_error(root.path(), None).contains("a file was expected there"));
    assert!(import_error(&write(b""), None).contains("is not a whole PyTorch weight file"));
    assert!(import_error(&write(b"PK\x03\x04 not really"), None).contains("is not a whole PyTorch weight file"));
    assert!(import_error(&write(&[0x42; 4000]), None).contains("is not a whole PyTorch weight file"));
    assert!(import_error(&golden("port_expected.safetensors"), None).contains("holds neither"));
    let message = import_error(&golden("port_disp.pth.tar"), Some(Network::Pose));
    assert!(message.contains("holds a depth network but no motion network"), "{message}");
}

fn zeros(shape: &[usize]) -> (Vec<usize>, Vec<u8>) {
    (shape.to_vec(), vec![0; 4 * shape.iter().product::<usize>()])
}

#[test]
fn a_tensor_that_does_not_match_is_named() {
    let root = tempfile::tempdir().unwrap();
    let path = root.path().join("changed.safetensors");
    let cases: [(&Change, &str); 6] = [
        (&|t| drop(t.insert("epoch".into(), zeros(&[1]))), "holds an unknown tensor epoch"),
        (&|t| drop(t.remove("disp.conv3.2.bias")), "holds no conv3.2.bias"),
        (&|t| drop(t.remove("disp.iconv7.0.weight")), "holds no iconv7.0.weight"),
        (&|t| drop(t.insert("disp.extra".into(), zeros(&[2]))), "holds an unknown tensor extra"),
        (&|t| drop(t.insert("disp.conv3.2.bias".into(), zeros(&[9]))), "conv3.2.bias is [9] but should be [4]"),
        (
            &|t| drop(t.insert("pose.pose_pred.bias".into(), (vec![24], [0, 0, 0xc0, 0x7f].repeat(24)))),
            "tensor pose_pred.bias holds a number that is not finite",
        ),
    ];
    for (change, fragment) in cases {
        rewrite(&golden("paper_weights.safetensors"), &path, change);
        let message = import_error(&path, None);
        assert!(message.contains(fragment), "{message}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Damage anywhere either goes unnoticed (in a number) or is one sentence; it is never a panic.
    #[test]
    fn damaged_files_are_refused_in_one_sentence(file in 0..3usize, at in 0.0..1.0f64, value: u8, cut: bool) {
        let name = ["port_disp.pth.tar", "port_pose.pth.tar", "paper_weights.safetensors"][file];
        let mut bytes = fs::read(golden(name)).unwrap();
        let position = (at * bytes.len() as f64) as usize;
        if cut { bytes.truncate(position) } else { bytes[position] = value }
        let path = tempfile::NamedTempFile::new().unwrap().into_temp_path();
        fs::write(&path, bytes).unwrap();
        if let Err(error) = Checkpoint::import(&path, None, &Device::flex()) {
            prop_assert!(!error.to_string().contains('\n'), "{}", error);
        }
    }
}
