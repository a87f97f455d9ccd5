//! From the path of a model to its networks and how to use them: the same for every command that takes `--model`.

use crate::progress::Progress;
use burn::tensor::Device;
use endoscape_core::{Event, EventSink as _, Size};
use endoscape_nets::Checkpoint;
use endoscape_odometry::OdometryConfig;
use endoscape_train::model_folder;
use std::path::Path;

/// Loads a training run or a checkpoint; `size` overrides the size of its pictures. What a checkpoint does not say
/// about its training is assumed, with a warning.
///
/// # Errors
/// If it cannot be loaded or the networks cannot see pictures of that size.
pub fn load(model: &Path, size: Option<Size>, device: &Device) -> anyhow::Result<(Checkpoint, OdometryConfig)> {
    let checkpoint = Checkpoint::load(&model_folder(model), device)?;
    let input = checkpoint.manifest.input.as_ref();
    let config = OdometryConfig::for_model(input, size);
    config.validate()?;
    if input.is_none() {
        Progress::new().event(Event::Warned(format!(
            "{} does not say how it was trained, so its networks see neighbouring frames at {}, as SfMLearner's \
             published weights do at 416x128; use --size WxH if it was trained at another size",
            model.display(),
            config.size
        )));
    }
    Ok((checkpoint, config))
}
