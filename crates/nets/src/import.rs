//! Weights of others: PyTorch files of the SfMLearner port, and safetensors files of ours or of anybody.
//!
//! A file says nothing about its architecture beyond the shapes of its tensors, so the configuration is read off
//! those; what shapes cannot tell (alpha, beta, padding, the meaning of the rotation) is taken from the metadata our
//! own files carry, else from the port.

use crate::align_net::AlignNetConfig;
use crate::checkpoint::{Checkpoint, Manifest};
use crate::config::NetsConfig;
use crate::disp_net::DispNetConfig;
use crate::error::NetsError;
use crate::pose_mask_net::{MaskHead, PoseMaskNetConfig};
use crate::weights::{ImportReport, NamedArrays, read_pytorch, read_safetensors};
use burn::tensor::Device;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::io::Read;
use std::path::Path;

/// Key of our configuration in the metadata of our safetensors files.
pub(crate) const CONFIG_KEY: &str = "config";

/// One of the networks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Network {
    /// [`DispNet`](crate::DispNet).
    Disp,
    /// [`PoseMaskNet`](crate::PoseMaskNet).
    Pose,
    /// [`AlignNet`](crate::AlignNet).
    Align,
}

impl Network {
    pub(crate) const ALL: [Self; 3] = [Self::Disp, Self::Pose, Self::Align];

    /// What its tensors' names begin with in a file that holds several networks.
    pub(crate) fn prefix(self) -> &'static str {
        match self {
            Self::Disp => "disp.",
            Self::Pose => "pose.",
            Self::Align => "align.",
        }
    }
}

impl fmt::Display for Network {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Disp => "depth network",
            Self::Pose => "motion network",
            Self::Align => "alignment network",
        })
    }
}

impl Checkpoint {
    /// Reads a weight file: one network, or several if its names begin with `disp.`, `pose.` and `align.`.
    ///
    /// `only` demands one of them. The report lists every tensor that was taken over; there is an error unless
    /// that is every tensor of the file and of the network.
    ///
    /// # Errors
    /// [`NetsError`] when the file is missing or damaged, is no such network, or does not match tensor for tensor.
    pub fn import(path: &Path, only: Option<Network>, device: &Device) -> Result<(Self, ImportReport), NetsError> {
        let (mut arrays, declared) = read_weights(path)?;
        let mut checkpoint = Self::empty(declared.clone().unwrap_or_default(), Manifest::default());
        let mut report = ImportReport::default();
        for network in networks(path, &arrays, only)? {
            let part = take_network(&mut arrays, network);
            match network {
                _ if declared.is_some() => {}
                Network::Disp => checkpoint.config.disp = disp_config(path, &part)?,
                Network::Pose => checkpoint.config.pose = pose_config(path, &part)?,
                Network::Align => checkpoint.config.align = align_config(path, &part)?,
            }
            report.matched.extend(checkpoint.restore(network, path, part, REMEDY, device)?.matched);
        }
        // Whoever asked for one network knows of the other; anything else is a tensor nobody understands.
        arrays
            .retain(|name, _| only.is_none() || !Network::ALL.iter().any(|network| name.starts_with(network.prefix())));
        refuse_leftovers(path, &arrays, REMEDY)?;
        checkpoint.manifest.origin = path.file_name().map(|name| name.to_string_lossy().into_owned());
        Ok((checkpoint, report))
    }
}

const REMEDY: &str = "import weights of SfMLearner's PyTorch port or a file that endoscape exported";

/// Arrays of a weight file of either format, told apart by content, and the configuration it declares.
fn read_weights(path: &Path) -> Result<(NamedArrays, Option<NetsConfig>), NetsError> {
    let mut start = [0; 9];
    let file = std::fs::File::open(path).map_err(|error| NetsError::io(path, "read", error))?;
    file.take(9).read(&mut start).map_err(|error| NetsError::io(path, "read", error))?;
    // A safetensors file is a length of eight bytes, then JSON.
    if start[8] != b'{' {
        return Ok((read_pytorch(path)?, None));
    }
    let (arrays, metadata) = read_safetensors(path)?;
    let declared = metadata.get(CONFIG_KEY).map(|text| NetsConfig::from_toml(text)).transpose();
    let declared =
        declared.map_err(|error| NetsError::corrupt(path, format!("carries a wrong configuration ({error})")))?;
    Ok((arrays, declared))
}

/// Which networks the names in the file belong to.
fn networks(path: &Path, arrays: &NamedArrays, only: Option<Network>) -> Result<Vec<Network>, NetsError> {
    let holds = |start: &str| arrays.keys().any(|name| name.starts_with(start));
    let mut found = Vec::new();
    if holds(Network::Disp.prefix()) || holds("predict_disp") || holds("iconv") {
        found.push(Network::Disp);
    }
    if holds(Network::Pose.prefix()) || holds("pose_pred") {
        found.push(Network::Pose);
    }
    if holds(Network::Align.prefix()) {
        found.push(Network::Align);
    }
    if found.is_empty() {
        return Err(NetsError::mismatch(path, "holds neither a depth network nor a motion network", REMEDY));
    }
    match only {
        Some(network) if !found.contains(&network) => {
            Err(NetsError::mismatch(path, format!("holds a {} but no {network}", found[0]), "ask for the other kind"))
        }
        Some(network) => Ok(vec![network]),
        None => Ok(found),
    }
}

/// Removes one network's arrays and strips their prefix; in a file without prefixes that is all of them.
pub(crate) fn take_network(arrays: &mut NamedArrays, network: Network) -> NamedArrays {
    let prefix = network.prefix();
    if !arrays.keys().any(|name| name.starts_with(prefix)) {
        return std::mem::take(arrays);
    }
    let (taken, left) = std::mem::take(arrays).into_iter().partition(|(name, _)| name.starts_with(prefix));
    *arrays = left;
    let taken: NamedArrays = taken;
    taken.into_iter().map(|(name, array)| (name[prefix.len()..].to_string(), array)).collect()
}

/// # Errors
/// [`NetsError::Mismatch`] naming an array that belongs to no network.
pub(crate) fn refuse_leftovers(path: &Path, arrays: &NamedArrays, remedy: &'static str) -> Result<(), NetsError> {
    match arrays.keys().next() {
        Some(name) => Err(NetsError::mismatch(path, format!("holds an unknown tensor {name}"), remedy)),
        None => Ok(()),
    }
}

/// Reads the configuration of the depth network off its shapes.
fn disp_config(path: &Path, arrays: &NamedArrays) -> Result<DispNetConfig, NetsError> {
    let mut config = DispNetConfig { batch_norm: has_norm(arrays), ..DispNetConfig::default() };
    for stage in 0..7 {
        config.encoder[stage] = extent(path, arrays, &format!("conv{}.0.weight", 1 + stage), 0)?;
        config.decoder[stage] = extent(path, arrays, &format!("iconv{}.0.weight", 7 - stage), 0)?;
    }
    Ok(config)
}

/// Reads the configuration of the motion network off its shapes.
fn pose_config(path: &Path, arrays: &NamedArrays) -> Result<PoseMaskNetConfig, NetsError> {
    let snippet_length = extent(path, arrays, "conv1.0.weight", 1)? / 3;
    let mut config = PoseMaskNetConfig { snippet_length, batch_norm: has_norm(arrays), ..PoseMaskNetConfig::default() };
    for stage in 0..5 {
        config.encoder[stage] = extent(path, arrays, &format!("conv{}.0.weight", 1 + stage), 0)?;
    }
    for stage in 0..2 {
        config.motion[stage] = extent(path, arrays, &format!("conv{}.0.weight", 6 + stage), 0)?;
    }
    config.mask = match arrays.get("predict_mask1.weight").and_then(|array| array.shape.first()) {
        None => MaskHead::None,
        Some(&channels) if channels == MaskHead::Softmax.channels(config.sources()) => MaskHead::Softmax,
        Some(_) => MaskHead::Sigmoid,
    };
    if config.mask != MaskHead::None {
        for stage in 0..5 {
            let name = format!("upconv{}.0.weight", 5 - stage);
            config.mask_decoder[stage] = extent(path, arrays, &name, 1)?;
            config.mask_kernels[stage] = extent(path, arrays, &name, 2)?;
        }
    }
    Ok(config)
}

/// Reads the configuration of the alignment network off its shapes.
fn align_config(path: &Path, arrays: &NamedArrays) -> Result<AlignNetConfig, NetsError> {
    let mut config = AlignNetConfig::default();
    for stage in 0..5 {
        config.encoder[stage] = extent(path, arrays, &format!("encoder.{stage}.conv.weight"), 0)?;
    }
    Ok(config)
}

fn has_norm(arrays: &NamedArrays) -> bool {
    arrays.contains_key("conv1.0.norm.weight")
}

fn extent(path: &Path, arrays: &NamedArrays, name: &str, axis: usize) -> Result<usize, NetsError> {
    let extent = arrays.get(name).and_then(|array| array.shape.get(axis).copied());
    extent.ok_or_else(|| NetsError::mismatch(path, format!("holds no {name} of the expected shape"), REMEDY))
}
