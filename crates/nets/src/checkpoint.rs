//! The checkpoint folder: everything a trained model is, in three files.
//!
//! | file | what |
//! |---|---|
//! | `weights.safetensors` | tensors named `disp.NAME` and `pose.NAME`, with SfMLearner's names, and `align.NAME` |
//! | `config.toml` | [`NetsConfig`] |
//! | `manifest.json` | [`Manifest`] |
//!
//! A folder is written beside its place and then renamed, so there is always a complete one to load.

use crate::align_net::AlignNet;
use crate::config::NetsConfig;
use crate::disp_net::DispNet;
use crate::error::NetsError;
use crate::files;
use crate::import::{CONFIG_KEY, Network, refuse_leftovers, take_network};
use crate::pose_mask_net::PoseMaskNet;
use crate::weights::{ImportReport, NamedArrays, apply, collect, naming, read_safetensors, write_safetensors};
use burn::tensor::Device;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

/// The newest checkpoint format this program reads. It writes the oldest that holds what there is: 1, or 2 with an
/// alignment network.
pub const FORMAT: u32 = 2;
const WITHOUT_ALIGNMENT: u32 = 1;

pub(crate) const WEIGHTS: &str = "weights.safetensors";
pub(crate) const CONFIG: &str = "config.toml";
pub(crate) const MANIFEST: &str = "manifest.json";
const REMEDY: &str = "restore the files of one checkpoint or import the weights again";

/// What a checkpoint folder holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ModelKind {
    /// Depth and motion networks, a [`Checkpoint`].
    #[default]
    DepthMotion,
    /// A recurrent network, a [`RecurrentCheckpoint`](crate::RecurrentCheckpoint).
    Recurrent,
}

/// Where a model comes from and how good it was.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Version of the folder's layout; set when saving.
    pub format: u32,
    /// Version of the program that wrote it; set when saving.
    pub endoscape_version: String,
    /// What the folder holds; set when saving.
    #[serde(default)]
    pub kind: ModelKind,
    /// The networks in the weight file; set when saving.
    pub networks: Vec<Network>,
    /// Training steps taken.
    #[serde(default)]
    pub steps: u64,
    /// Seed of the training.
    #[serde(default)]
    pub seed: Option<u64>,
    /// What it was trained on.
    #[serde(default)]
    pub data: Vec<DataSource>,
    /// How it saw its pictures, so that it can be run as it was trained.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub input: Option<TrainedInput>,
    /// Validation figures by name; those that are not finite are left out when saving.
    #[serde(default)]
    pub validation: BTreeMap<String, f64>,
    /// The file or checkpoint the weights were taken from, if training did not start from scratch.
    #[serde(default)]
    pub origin: Option<String>,
}

impl Default for Manifest {
    fn default() -> Self {
        Self {
            format: WITHOUT_ALIGNMENT,
            endoscape_version: env!("CARGO_PKG_VERSION").to_string(),
            kind: ModelKind::default(),
            networks: Vec::new(),
            steps: 0,
            seed: None,
            data: Vec::new(),
            input: None,
            validation: BTreeMap::new(),
            origin: None,
        }
    }
}

impl Manifest {
    /// The text of `manifest.json` for a folder of `kind` with `networks`, as this program writes it now.
    ///
    /// # Errors
    /// [`NetsError::Io`] about the folder at `path`.
    pub(crate) fn text(&self, kind: ModelKind, networks: Vec<Network>, path: &Path) -> Result<String, NetsError> {
        let format = if networks.contains(&Network::Align) { FORMAT } else { WITHOUT_ALIGNMENT };
        let mut manifest = Self { kind, networks, format, ..self.clone() };
        manifest.endoscape_version = env!("CARGO_PKG_VERSION").to_string();
        // JSON has no NaN: a figure that is none would make the folder unreadable.
        manifest.validation.retain(|_, figure| figure.is_finite());
        serde_json::to_string_pretty(&manifest)
            .map_err(|error| NetsError::io(path, "write", std::io::Error::other(error)))
    }
}

/// The snippets a model was trained on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TrainedInput {
    /// Width of the pictures, pixels.
    pub width: usize,
    /// Height of the pictures, pixels.
    pub height: usize,
    /// Frames from one frame of a snippet to the next; 0 where the gap was chosen by displacement.
    pub fixed_gap: usize,
    /// Smallest median displacement between neighbours, as a share of the width, where the gap was chosen by it.
    pub least_displacement: f64,
}

/// A sequence a model was trained on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DataSource {
    /// The sequence's name.
    pub name: String,
    /// Hash of its contents, so that training data can be recognised in an evaluation.
    pub fingerprint: String,
}

/// A trained model: depth and motion network, or one of them after the import of a single file, and perhaps the
/// alignment network.
#[derive(Debug, Clone)]
pub struct Checkpoint {
    /// What the networks are made of; the part of an absent network is the default.
    pub config: NetsConfig,
    /// The depth network.
    pub disp: Option<DispNet>,
    /// The motion and reliability network.
    pub pose: Option<PoseMaskNet>,
    /// The alignment network: only models that have learned from labels have one.
    pub align: Option<AlignNet>,
    /// Where the model comes from.
    pub manifest: Manifest,
}

impl Checkpoint {
    /// The untrained depth and motion network of `seed`.
    ///
    /// # Errors
    /// [`NetsError::Config`] when a setting is impossible.
    pub fn init(config: NetsConfig, seed: u64, device: &Device) -> Result<Self, NetsError> {
        let (disp, pose) = (Some(config.disp.init(seed, device)?), Some(config.pose.init(seed, device)?));
        Ok(Self { config, disp, pose, align: None, manifest: Manifest::default() })
    }

    /// Takes over the networks `other` has, with their configuration.
    pub fn absorb(&mut self, other: Self) {
        if other.disp.is_some() {
            (self.disp, self.config.disp) = (other.disp, other.config.disp);
        }
        if other.pose.is_some() {
            (self.pose, self.config.pose) = (other.pose, other.config.pose);
        }
        if other.align.is_some() {
            (self.align, self.config.align) = (other.align, other.config.align);
        }
        self.manifest.origin = other.manifest.origin.or_else(|| self.manifest.origin.take());
    }

    /// Writes the folder, replacing an older checkpoint there.
    ///
    /// # Errors
    /// [`NetsError::Io`] when it cannot be written, and [`NetsError::Mismatch`] when the folder exists, is not empty
    /// and is no checkpoint; what was there stays as it was after either.
    pub fn save(&self, path: &Path) -> Result<(), NetsError> {
        self.save_with(path, |_| Ok(()))
    }

    /// [`Self::save`] with more files in the same folder, complete or absent together with the rest: the trainer's
    /// optimiser state, say. `extra` gets the folder to write them into.
    ///
    /// # Errors
    /// As [`Self::save`], and those of `extra`.
    pub fn save_with<E: From<NetsError>>(
        &self,
        path: &Path,
        extra: impl FnOnce(&Path) -> Result<(), E>,
    ) -> Result<(), E> {
        check_replaceable(path)?;
        files::replace_folder(path, |folder| {
            self.write_weights(&folder.join(WEIGHTS))?;
            files::write_durably(&folder.join(CONFIG), self.config.to_toml()?.as_bytes())?;
            let manifest = self.manifest.text(ModelKind::DepthMotion, self.networks(), path)?;
            files::write_durably(&folder.join(MANIFEST), manifest.as_bytes())?;
            extra(folder)
        })
    }

    /// The networks it has.
    fn networks(&self) -> Vec<Network> {
        let has = |network: &Network| match network {
            Network::Disp => self.disp.is_some(),
            Network::Pose => self.pose.is_some(),
            Network::Align => self.align.is_some(),
        };
        Network::ALL.into_iter().filter(has).collect()
    }

    /// Where the last complete checkpoint of `path` is: there, or beside it if a replacement was interrupted.
    pub fn folder(path: &Path) -> PathBuf {
        files::current(path)
    }

    /// Reads a folder.
    ///
    /// # Errors
    /// [`NetsError`] naming what is missing, damaged, newer than this program, or at odds with the rest.
    pub fn load(path: &Path, device: &Device) -> Result<Self, NetsError> {
        let (folder, manifest) = open_folder(path)?;
        if manifest.kind == ModelKind::Recurrent {
            let reason = "holds a recurrent network, not networks for depth and motion";
            return Err(NetsError::mismatch(&folder, reason, "use it with endoscape run --method recurrent"));
        }
        let config_path = folder.join(CONFIG);
        let config = NetsConfig::from_toml(&files::read_text(&config_path)?);
        let config = config.map_err(|error| NetsError::mismatch(&config_path, error.to_string(), REMEDY))?;
        let weights = folder.join(WEIGHTS);
        let (mut arrays, _) = read_safetensors(&weights)?;
        let mut checkpoint = Self::empty(config, manifest);
        for network in checkpoint.manifest.networks.clone() {
            let part = take_network(&mut arrays, network);
            checkpoint.restore(network, &weights, part, REMEDY, device)?;
        }
        refuse_leftovers(&weights, &arrays, REMEDY)?;
        Ok(checkpoint)
    }

    /// A checkpoint without networks yet.
    pub(crate) fn empty(config: NetsConfig, manifest: Manifest) -> Self {
        Self { config, disp: None, pose: None, align: None, manifest }
    }

    /// Builds one network as configured and fills it with the arrays of the file at `path`.
    ///
    /// # Errors
    /// [`NetsError`] unless configuration and arrays are possible and agree tensor for tensor.
    pub(crate) fn restore(
        &mut self,
        network: Network,
        path: &Path,
        arrays: NamedArrays,
        remedy: &'static str,
        device: &Device,
    ) -> Result<ImportReport, NetsError> {
        let impossible = |error: NetsError| NetsError::mismatch(path, error.to_string(), remedy);
        let mismatch = |reason| NetsError::mismatch(path, reason, remedy);
        check_finite(path, &arrays)?;
        match network {
            Network::Disp => {
                self.config.disp.validate().map_err(impossible)?;
                check_size(self.config.disp.parameter_count(), &arrays).map_err(mismatch)?;
                let net = self.disp.insert(self.config.disp.build(None, device)?);
                apply(net, arrays, naming::disp_net).map_err(mismatch)
            }
            Network::Pose => {
                self.config.pose.validate().map_err(impossible)?;
                check_size(self.config.pose.parameter_count(), &arrays).map_err(mismatch)?;
                let net = self.pose.insert(self.config.pose.build(None, device)?);
                apply(net, arrays, naming::pose_mask_net).map_err(mismatch)
            }
            Network::Align => {
                self.config.align.validate().map_err(impossible)?;
                check_size(self.config.align.parameter_count(), &arrays).map_err(mismatch)?;
                let net = self.align.insert(self.config.align.build(None, device)?);
                apply(net, arrays, str::to_owned).map_err(mismatch)
            }
        }
    }

    /// Writes the weights as one safetensors file, with the configuration in its metadata; [`Self::import`] reads it.
    ///
    /// # Errors
    /// [`NetsError::Io`].
    pub fn export_safetensors(&self, path: &Path) -> Result<(), NetsError> {
        files::replace_with(path, |draft| self.write_weights(draft))
    }

    fn write_weights(&self, path: &Path) -> Result<(), NetsError> {
        let mut arrays = NamedArrays::new();
        let unreadable = |reason: String| NetsError::io(path, "write", std::io::Error::other(reason));
        if let Some(disp) = &self.disp {
            let rename = |name: &str| format!("{}{}", Network::Disp.prefix(), naming::disp_net(name));
            arrays.extend(collect(disp, rename).map_err(unreadable)?);
        }
        if let Some(pose) = &self.pose {
            let rename = |name: &str| format!("{}{}", Network::Pose.prefix(), naming::pose_mask_net(name));
            arrays.extend(collect(pose, rename).map_err(unreadable)?);
        }
        if let Some(align) = &self.align {
            arrays.extend(collect(align, |name| format!("{}{name}", Network::Align.prefix())).map_err(unreadable)?);
        }
        write_safetensors(path, &arrays, HashMap::from([(CONFIG_KEY.to_string(), self.config.to_toml()?)]))
    }
}

/// The last complete folder of `path` and its manifest.
///
/// # Errors
/// [`NetsError`] when there is none, or it is damaged or newer than this program.
pub(crate) fn open_folder(path: &Path) -> Result<(PathBuf, Manifest), NetsError> {
    let folder = files::current(path);
    if !folder.exists() {
        return Err(NetsError::Missing { path: folder, what: "checkpoint folder" });
    }
    let manifest = read_manifest(&folder)?;
    Ok((folder, manifest))
}

/// Refuses a configuration far larger than the file before memory is spent on it; exact checks come with the names.
pub(crate) fn check_size(wanted: usize, arrays: &NamedArrays) -> Result<(), String> {
    let held: usize = arrays.values().map(|array| array.values.len()).sum();
    if wanted > 2 * held + 1024 {
        return Err(format!("holds {held} numbers where the configured network has {wanted}"));
    }
    Ok(())
}

pub(crate) fn check_finite(path: &Path, arrays: &NamedArrays) -> Result<(), NetsError> {
    match arrays.iter().find(|(_, array)| array.values.iter().any(|value| !value.is_finite())) {
        Some((name, _)) => Err(NetsError::corrupt(path, format!("tensor {name} holds a number that is not finite"))),
        None => Ok(()),
    }
}

fn read_manifest(folder: &Path) -> Result<Manifest, NetsError> {
    #[derive(Deserialize)]
    struct Version {
        format: u32,
    }
    let path = folder.join(MANIFEST);
    if folder.is_dir() && !path.exists() {
        let reason = format!("holds no {MANIFEST}, so it is not a checkpoint");
        return Err(NetsError::mismatch(folder, reason, "name a folder that endoscape train or import wrote"));
    }
    let text = files::read_text(&path)?;
    let damaged = |error| NetsError::corrupt(&path, format!("is not a whole manifest ({error})"));
    // The version comes first: a newer manifest may have other fields.
    let Version { format } = serde_json::from_str(&text).map_err(damaged)?;
    if format > FORMAT {
        return Err(NetsError::Newer { path, found: format, supported: FORMAT });
    }
    serde_json::from_str(&text).map_err(damaged)
}

/// Only a checkpoint or an empty folder may be replaced: a mistyped path must not cost anybody their files.
pub(crate) fn check_replaceable(path: &Path) -> Result<(), NetsError> {
    if !path.exists() || path.join(MANIFEST).exists() {
        return Ok(());
    }
    let entries = std::fs::read_dir(path).map_err(|error| NetsError::io(path, "write", error))?.count();
    if entries == 0 {
        return Ok(());
    }
    Err(NetsError::mismatch(path, "exists and is not a checkpoint", "choose another folder or empty this one"))
}
