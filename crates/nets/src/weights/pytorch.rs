//! PyTorch files (`.pth`, `.pth.tar`), read by Burn's reader, which interprets the pickle without running it.

use super::{Array, NamedArrays};
use crate::error::NetsError;
use burn::store::pytorch_reader::{DType, PytorchError, PytorchReader, Tensor};
use std::path::Path;

/// Where training scripts, the port's among them, keep the weights inside the file.
const STATE_DICT: &str = "state_dict";

/// Prefix that `torch.nn.DataParallel` puts before every name.
const DATA_PARALLEL: &str = "module.";

/// Arrays of the file's `state_dict`, or of its root if it has none.
///
/// # Errors
/// [`NetsError`] when the file is missing, damaged, or holds anything but 32- or 64-bit floating-point weights.
pub(crate) fn read_pytorch(path: &Path) -> Result<NamedArrays, NetsError> {
    let size = std::fs::metadata(path).map_err(|error| NetsError::io(path, "read", error))?.len();
    let reader = match PytorchReader::with_top_level_key(path, STATE_DICT) {
        Err(PytorchError::KeyNotFound(_)) => PytorchReader::new(path),
        outcome => outcome,
    };
    let tensors = reader.map_err(|error| damaged(path, &error))?.into_tensors();
    // A view may repeat one stored number, so sizes must be compared before anything is read.
    let claimed = tensors.values().map(|tensor| byte_length(tensor).unwrap_or(u64::MAX)).fold(0, u64::saturating_add);
    if claimed > size {
        return Err(NetsError::corrupt(path, format!("declares {claimed} bytes of weights but is {size} bytes long")));
    }
    let weights = tensors.into_iter().filter(|(name, _)| !name.ends_with("num_batches_tracked"));
    weights
        .map(|(name, tensor)| {
            let array = Array { shape: tensor.shape().to_vec(), values: floats(path, &name, &tensor)? };
            Ok((name.strip_prefix(DATA_PARALLEL).unwrap_or(&name).to_string(), array))
        })
        .collect()
}

fn byte_length(tensor: &Tensor) -> Option<u64> {
    let count = tensor.shape().iter().try_fold(1u64, |count, &extent| count.checked_mul(extent as u64))?;
    count.checked_mul(tensor.dtype().size() as u64)
}

fn floats(path: &Path, name: &str, tensor: &Tensor) -> Result<Vec<f32>, NetsError> {
    let bytes = tensor.read().map_err(|error| damaged(path, &error))?;
    match tensor.dtype() {
        DType::F32 => Ok(bytes.as_chunks().0.iter().map(|bytes| f32::from_ne_bytes(*bytes)).collect()),
        DType::F64 => Ok(bytes.as_chunks().0.iter().map(|bytes| f64::from_ne_bytes(*bytes) as f32).collect()),
        other => {
            let reason = format!("tensor {name} is stored as {other:?}");
            Err(NetsError::mismatch(path, reason, "convert the file to 32-bit floating point first"))
        }
    }
}

fn damaged(path: &Path, error: &dyn std::fmt::Display) -> NetsError {
    let cause = error.to_string().replace('\n', " ");
    NetsError::corrupt(path, format!("is not a whole PyTorch weight file ({cause})"))
}
