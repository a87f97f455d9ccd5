//! Starting from the weights of another training.
//!
//! Sizes and cameras may differ freely: both networks are convolutional and see no camera. Another snippet length
//! changes the first layer of the motion network and its outputs; those start fresh, everything between is kept.

use crate::error::TrainError;
use burn::store::{ModuleSnapshot, bridge};
use burn::tensor::Device;
use endoscape_nets::{Checkpoint, NetsConfig, PoseMaskNet};
use std::collections::HashMap;
use std::path::Path;

/// The weights at `path` for networks as `wanted`, and a sentence if not all of them could be used.
///
/// The architecture is the checkpoint's; of `wanted` only the snippet length counts, and a network the checkpoint does
/// not have. Layers without weights start with those of `seed`.
///
/// # Errors
/// [`TrainError::Nets`] if the checkpoint cannot be read or the networks cannot be built.
pub fn initial_weights(
    path: &Path,
    wanted: &NetsConfig,
    seed: u64,
    device: &Device,
) -> Result<(Checkpoint, Option<String>), TrainError> {
    let mut loaded = Checkpoint::load(path, device)?;
    let mut message = None;
    if let Some(old) = loaded.pose.take() {
        let length = wanted.pose.snippet_length;
        let old_length = loaded.config.pose.snippet_length;
        loaded.config.pose.snippet_length = length;
        loaded.pose = Some(if length == old_length {
            old
        } else {
            let (pose, fresh) = transplant(&old, loaded.config.pose.init(seed, device)?)?;
            message = Some(format!(
                "{} was trained on snippets of {old_length} frames: for {length} these layers of the motion network \
                 start fresh: {}",
                path.display(),
                fresh.join(", ")
            ));
            pose
        });
    }
    let mut checkpoint = Checkpoint::init(wanted.clone(), seed, device)?;
    checkpoint.absorb(loaded);
    checkpoint.manifest.origin = Some(path.display().to_string());
    Ok((checkpoint, message))
}

/// Copies every tensor whose shape fits; returns the names of the layers whose tensors did not.
fn transplant(old: &PoseMaskNet, mut new: PoseMaskNet) -> Result<(PoseMaskNet, Vec<String>), TrainError> {
    let unreadable = |error: &dyn std::fmt::Display| TrainError::config("init", format!("cannot be copied: {error}"));
    let mut donors = HashMap::new();
    for tensor in old.collect(None, None, true) {
        donors.insert(tensor.name.clone(), tensor);
    }
    let (mut fitting, mut fresh) = (Vec::new(), Vec::new());
    for tensor in new.collect(None, None, true) {
        match donors.remove(&tensor.name) {
            Some(donor) if donor.shape == tensor.shape => {
                let data = bridge::into_data(donor).map_err(|error| unreadable(&error))?;
                fitting.push(bridge::from_data(data, tensor.name.clone(), None));
            }
            _ => fresh.push(tensor.name.rsplit_once('.').map_or(tensor.name.as_str(), |(layer, _)| layer).to_owned()),
        }
    }
    let applied = new.apply(fitting, None, None, true);
    if let Some(error) = applied.errors.first() {
        return Err(unreadable(error));
    }
    fresh.dedup();
    Ok((new, fresh))
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::Tensor;

    fn saved(config: &NetsConfig, folder: &Path, device: &Device) {
        Checkpoint::init(config.clone(), 0, device).unwrap().save(folder).unwrap();
    }

    fn tiny(snippet_length: usize) -> NetsConfig {
        let mut config = NetsConfig::fast();
        config.disp = config.disp.with_width(0.2);
        config.pose = config.pose.with_width(0.2);
        config.pose.snippet_length = snippet_length;
        config
    }

    #[test]
    fn equal_lengths_take_everything_over() {
        let (folder, device) = (tempfile::tempdir().unwrap(), Device::flex());
        let path = folder.path().join("first");
        saved(&tiny(3), &path, &device);
        let (checkpoint, message) = initial_weights(&path, &NetsConfig::paper(), 0, &device).unwrap();
        assert_eq!((message, checkpoint.config), (None, tiny(3)));
        let picture = Tensor::<4>::ones([1, 3, 40, 56], &device) * 0.3;
        let old = Checkpoint::load(&path, &device).unwrap().disp.unwrap().forward(picture.clone());
        let new = checkpoint.disp.unwrap().forward(picture);
        assert_eq!(old.scales[0].to_data(), new.scales[0].to_data());
    }

    #[test]
    fn another_length_keeps_the_layers_between() {
        let (folder, device) = (tempfile::tempdir().unwrap(), Device::flex());
        let path = folder.path().join("first");
        saved(&tiny(3), &path, &device);
        let (checkpoint, message) = initial_weights(&path, &tiny(5), 0, &device).unwrap();
        let message = message.unwrap();
        assert!(message.contains("snippets of 3 frames: for 5"), "{message}");
        assert!(message.contains("encoder.0.conv") && message.contains("motion_head"), "{message}");
        assert!(!message.contains("encoder.1"), "{message}");
        let picture = || Tensor::<4>::ones([1, 3, 40, 56], &device);
        let motion = checkpoint.pose.unwrap().forward_motion(picture(), &[(); 4].map(|()| picture()));
        assert_eq!(motion.dims(), [1, 4, 6]);
    }
}
