//! Which networks to build: their configurations, their presets and their TOML form.

use crate::align_net::AlignNetConfig;
use crate::disp_net::DispNetConfig;
use crate::error::NetsError;
use crate::layers::Padding;
use crate::pose_mask_net::{MaskHead, PoseMaskNetConfig};
use serde::{Deserialize, Serialize};

/// More channels than any published network of this family has; a number beyond is a slip or a damaged file.
const MAX_CHANNELS: usize = 4096;

/// Configuration of the networks, saved as `config.toml` in a checkpoint folder.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NetsConfig {
    /// The depth network.
    pub disp: DispNetConfig,
    /// The motion and reliability network.
    pub pose: PoseMaskNetConfig,
    /// The alignment network, where a model has one.
    pub align: AlignNetConfig,
}

impl NetsConfig {
    /// The paper (Turan et al. 2018, section III): beta 0.1, batch normalisation everywhere but the outputs, softmax
    /// pairs for reliability, and the padding and mask kernels of the TensorFlow original it builds on.
    pub fn paper() -> Self {
        let (batch_norm, padding) = (true, Padding::Same);
        Self {
            disp: DispNetConfig { beta: 0.1, batch_norm, padding, ..DispNetConfig::default() },
            pose: PoseMaskNetConfig {
                mask: MaskHead::Softmax,
                mask_kernels: [3, 3, 3, 5, 7],
                batch_norm,
                padding,
                ..PoseMaskNetConfig::default()
            },
            align: AlignNetConfig::default(),
        }
    }

    /// A slim network for two CPU cores: a quarter of the channels in the depth network, half in the motion network.
    ///
    /// By `benches/widths.rs` a quarter makes depth five to six times faster than full width and gradients three to
    /// four times; the motion network is cheap at any width. Provisional until training decides what quality it costs.
    pub fn fast() -> Self {
        Self {
            disp: DispNetConfig::default().with_width(0.25),
            pose: PoseMaskNetConfig::default().with_width(0.5),
            align: AlignNetConfig::default(),
        }
    }

    /// Our best guess, provisional until results decide: the full width of SfMLearner's PyTorch port, whose published
    /// weights it can therefore start from.
    pub fn endo() -> Self {
        Self::default()
    }

    /// The preset of that name: `paper`, `fast` or `endo`.
    pub fn preset(name: &str) -> Option<Self> {
        match name {
            "paper" => Some(Self::paper()),
            "fast" => Some(Self::fast()),
            "endo" => Some(Self::endo()),
            _ => None,
        }
    }

    /// # Errors
    /// [`NetsError::Config`] naming the setting no network can be built from.
    pub fn validate(&self) -> Result<(), NetsError> {
        self.disp.validate()?;
        self.pose.validate()?;
        self.align.validate()
    }

    /// The TOML form of the configuration.
    ///
    /// # Errors
    /// [`NetsError::Config`] when a number has no TOML form.
    pub fn to_toml(&self) -> Result<String, NetsError> {
        toml::to_string(self).map_err(|error| NetsError::config("config", format!("cannot be written: {error}")))
    }

    /// Reads and validates the TOML form; settings left out keep their defaults.
    ///
    /// # Errors
    /// [`NetsError::Config`] naming the line or setting that is wrong.
    pub fn from_toml(text: &str) -> Result<Self, NetsError> {
        let config: Self = toml::from_str(text).map_err(|error| toml_error(&error, text))?;
        config.validate()?;
        Ok(config)
    }
}

/// One sentence instead of the parser's excerpt of several lines.
pub(crate) fn toml_error(error: &toml::de::Error, text: &str) -> NetsError {
    let before = error.span().and_then(|span| text.get(..span.start)).unwrap_or_default();
    let line = before.matches('\n').count() + 1;
    NetsError::config(format!("line {line}"), format!("cannot be read: {}", error.message().replace('\n', " ")))
}

/// # Errors
/// [`NetsError::Config`] when a count is 0 or beyond reason.
pub(crate) fn check_channels(setting: &str, channels: &[usize]) -> Result<(), NetsError> {
    match channels.iter().find(|&&count| count == 0 || count > MAX_CHANNELS) {
        Some(count) => {
            Err(NetsError::config(setting, format!("holds {count} but channel counts go from 1 to {MAX_CHANNELS}")))
        }
        None => Ok(()),
    }
}

/// # Errors
/// [`NetsError::Config`] when a kernel is too small to double a picture, or beyond reason.
pub(crate) fn check_kernels(setting: &str, kernels: &[usize]) -> Result<(), NetsError> {
    match kernels.iter().find(|kernel| !(2..=15).contains(*kernel)) {
        Some(kernel) => Err(NetsError::config(setting, format!("holds {kernel} but kernels go from 2 to 15"))),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_survive_a_round_trip_through_toml() {
        for name in ["paper", "fast", "endo"] {
            let config = NetsConfig::preset(name).unwrap();
            assert_eq!(NetsConfig::from_toml(&config.to_toml().unwrap()).unwrap(), config, "{name}");
        }
        assert_eq!(NetsConfig::preset("best"), None);
    }

    #[test]
    fn a_wrong_setting_is_one_sentence_that_names_it() {
        for (text, fragment) in [
            ("[disp]\nalpha = -1.0", "`disp.alpha` is -1"),
            ("[disp]\nencoder = [0, 1, 1, 1, 1, 1, 1]", "`disp.encoder` holds 0"),
            ("[pose]\nsnippet_length = 4", "`pose.snippet_length` is 4"),
            ("[pose]\nmask_kernels = [1, 3, 3, 3, 3]", "`pose.mask_kernels` holds 1"),
            ("[align]\nencoder = [0, 1, 1, 1, 1]", "`align.encoder` holds 0"),
            ("[disp]\nencoder = 3", "`line 2`"),
            ("[disp]\ndepth = 3", "`line 2`"),
            ("[disp", "`line 1`"),
        ] {
            let message = NetsConfig::from_toml(text).unwrap_err().to_string();
            assert!(message.contains(fragment) && !message.contains('\n'), "{message}");
        }
    }
}
