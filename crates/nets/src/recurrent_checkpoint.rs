//! The checkpoint folder of a recurrent network: the same three files as [`Checkpoint`](crate::Checkpoint)'s.
//!
//! | file | what |
//! |---|---|
//! | `weights.safetensors` | tensors under their paths in [`RecurrentVo`] |
//! | `config.toml` | [`RecurrentVoConfig`], with the length of the unit of translation |
//! | `manifest.json` | [`Manifest`] of kind [`ModelKind::Recurrent`] |

use crate::checkpoint::{
    CONFIG, MANIFEST, Manifest, ModelKind, WEIGHTS, check_finite, check_replaceable, check_size, open_folder,
};
use crate::error::NetsError;
use crate::files;
use crate::recurrent_vo::{RecurrentVo, RecurrentVoConfig};
use crate::weights::{apply, collect, read_safetensors, write_safetensors};
use burn::tensor::Device;
use std::collections::HashMap;
use std::path::Path;

const REMEDY: &str = "restore the files of one checkpoint or train again";

/// A trained recurrent network.
#[derive(Debug, Clone)]
pub struct RecurrentCheckpoint {
    /// What the network is made of, and its unit of length.
    pub config: RecurrentVoConfig,
    /// The network.
    pub net: RecurrentVo,
    /// Where the model comes from.
    pub manifest: Manifest,
}

impl RecurrentCheckpoint {
    /// The untrained network of `seed`.
    ///
    /// # Errors
    /// [`NetsError::Config`] when a setting is impossible.
    pub fn init(config: RecurrentVoConfig, seed: u64, device: &Device) -> Result<Self, NetsError> {
        Ok(Self { net: config.init(seed, device)?, config, manifest: Manifest::default() })
    }

    /// Writes the folder, replacing an older checkpoint there, with more files in it as `extra` wants; all of them are
    /// complete or absent together.
    ///
    /// # Errors
    /// [`NetsError::Io`] when it cannot be written, [`NetsError::Mismatch`] when the folder exists, is not empty and is
    /// no checkpoint, and those of `extra`; what was there stays as it was.
    pub fn save_with<E: From<NetsError>>(
        &self,
        path: &Path,
        extra: impl FnOnce(&Path) -> Result<(), E>,
    ) -> Result<(), E> {
        check_replaceable(path)?;
        files::replace_folder(path, |folder| {
            let weights = folder.join(WEIGHTS);
            let unreadable = |reason: String| NetsError::io(&weights, "write", std::io::Error::other(reason));
            let arrays = collect(&self.net, str::to_owned).map_err(unreadable)?;
            write_safetensors(&weights, &arrays, HashMap::new())?;
            files::write_durably(&folder.join(CONFIG), self.config.to_toml()?.as_bytes())?;
            let manifest = self.manifest.text(ModelKind::Recurrent, Vec::new(), path)?;
            files::write_durably(&folder.join(MANIFEST), manifest.as_bytes())?;
            extra(folder)
        })
    }

    /// Reads a folder.
    ///
    /// # Errors
    /// [`NetsError`] naming what is missing, damaged, newer than this program, of another kind, or at odds with the rest.
    pub fn load(path: &Path, device: &Device) -> Result<Self, NetsError> {
        let (folder, manifest) = open_folder(path)?;
        if manifest.kind != ModelKind::Recurrent {
            let reason = "holds networks for depth and motion, not a recurrent one";
            let remedy = "use it with endoscape run --method learned, or train one with endoscape train --supervised";
            return Err(NetsError::mismatch(&folder, reason, remedy));
        }
        let (config_path, weights) = (folder.join(CONFIG), folder.join(WEIGHTS));
        let config = RecurrentVoConfig::from_toml(&files::read_text(&config_path)?);
        let config = config.map_err(|error| NetsError::mismatch(&config_path, error.to_string(), REMEDY))?;
        let (arrays, _) = read_safetensors(&weights)?;
        check_finite(&weights, &arrays)?;
        let mismatch = |reason| NetsError::mismatch(&weights, reason, REMEDY);
        check_size(config.parameter_count(), &arrays).map_err(mismatch)?;
        let mut net = config.init(0, device)?;
        apply(&mut net, arrays, str::to_owned).map_err(mismatch)?;
        Ok(Self { config, net, manifest })
    }

    /// Whether the folder at `path` says that it holds a recurrent network.
    pub fn is_at(path: &Path) -> bool {
        open_folder(path).is_ok_and(|(_, manifest)| manifest.kind == ModelKind::Recurrent)
    }
}
