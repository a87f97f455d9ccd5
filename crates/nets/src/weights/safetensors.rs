//! The safetensors format, both ways.

use super::{Array, NamedArrays};
use crate::error::NetsError;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use std::collections::HashMap;
use std::path::Path;

/// Arrays of a safetensors file and the text metadata in its header.
///
/// # Errors
/// [`NetsError`] when the file is missing, damaged, or holds anything but 32- or 64-bit floating-point numbers.
pub(crate) fn read_safetensors(path: &Path) -> Result<(NamedArrays, HashMap<String, String>), NetsError> {
    let bytes = std::fs::read(path).map_err(|error| NetsError::io(path, "read", error))?;
    let damaged = |error| NetsError::corrupt(path, format!("is not a whole safetensors file ({error})"));
    let (_, header) = SafeTensors::read_metadata(&bytes).map_err(damaged)?;
    let tensors = SafeTensors::deserialize(&bytes).map_err(damaged)?;
    let arrays = tensors.iter().map(|(name, view)| {
        let values = floats(&view).ok_or_else(|| {
            let reason = format!("tensor {name} is stored as {:?}", view.dtype());
            NetsError::mismatch(path, reason, "convert the file to 32-bit floating point first")
        })?;
        Ok((name.to_string(), Array { shape: view.shape().to_vec(), values }))
    });
    Ok((arrays.collect::<Result<_, NetsError>>()?, header.metadata().clone().unwrap_or_default()))
}

fn floats(view: &TensorView) -> Option<Vec<f32>> {
    match view.dtype() {
        Dtype::F32 => Some(view.data().as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()),
        Dtype::F64 => Some(view.data().as_chunks().0.iter().map(|bytes| f64::from_le_bytes(*bytes) as f32).collect()),
        _ => None,
    }
}

/// Writes arrays and text metadata as one safetensors file, complete on disk when this returns.
///
/// # Errors
/// [`NetsError::Io`] when the file cannot be written.
pub(crate) fn write_safetensors(
    path: &Path,
    arrays: &NamedArrays,
    metadata: HashMap<String, String>,
) -> Result<(), NetsError> {
    let bytes: Vec<(&String, &Array, Vec<u8>)> = arrays
        .iter()
        .map(|(name, array)| (name, array, array.values.iter().flat_map(|value| value.to_le_bytes()).collect()))
        .collect();
    let views = bytes.iter().map(|(name, array, bytes)| {
        TensorView::new(Dtype::F32, array.shape.clone(), bytes).map(|view| (name.as_str(), view))
    });
    let refused = |error| NetsError::io(path, "write", std::io::Error::other(error));
    let views = views.collect::<Result<Vec<_>, _>>().map_err(refused)?;
    let file = safetensors::serialize(views, Some(metadata)).map_err(refused)?;
    crate::files::write_durably(path, &file)
}
