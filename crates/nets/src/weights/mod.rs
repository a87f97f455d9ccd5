//! Weights as plain named arrays: the one form between modules, safetensors and PyTorch files.
//!
//! Names are those of the PyTorch port of SfMLearner (see [`naming`]), in every file this crate reads or writes.
//! Files are treated as hostile: nothing is allocated by a number in a file that the file's own size does not back.

pub(crate) mod naming;
mod pytorch;
mod safetensors;

pub(crate) use pytorch::read_pytorch;
pub(crate) use safetensors::{read_safetensors, write_safetensors};

use burn::module::Module;
use burn::store::{ModuleSnapshot, bridge};
use burn::tensor::TensorData;
use std::collections::BTreeMap;

/// An array of a weight file.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Array {
    pub shape: Vec<usize>,
    pub values: Vec<f32>,
}

/// Arrays by name, sorted.
pub(crate) type NamedArrays = BTreeMap<String, Array>;

/// What an import took over.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ImportReport {
    /// Names of the tensors, which are all of the file's and all of the network's.
    pub matched: Vec<String>,
}

/// The tensors of a module under the names `rename` gives their paths.
pub(crate) fn collect<M: Module>(module: &M, rename: impl Fn(&str) -> String) -> Result<NamedArrays, String> {
    // A normalisation layer keeps its latest statistics aside until somebody asks; `valid` asks, `collect` does not.
    let tensors = module.valid().collect(None, None, true).into_iter();
    tensors
        .map(|tensor| {
            let name = rename(&tensor.name);
            let data = bridge::into_data(tensor).map_err(|error| format!("cannot read tensor {name}: {error}"))?;
            Ok((name, Array { shape: data.shape().to_vec(), values: data.iter::<f32>().collect() }))
        })
        .collect()
}

/// Replaces the tensors of a module by the arrays that `rename` matches to their paths.
///
/// # Errors
/// Which arrays are missing, misshapen or unknown, as part of a sentence.
pub(crate) fn apply<M: Module>(
    module: &mut M,
    mut arrays: NamedArrays,
    rename: impl Fn(&str) -> String,
) -> Result<ImportReport, String> {
    let mut report = ImportReport::default();
    let (mut fitting, mut missing, mut misshapen) = (Vec::new(), Vec::new(), Vec::new());
    for tensor in module.collect(None, None, true) {
        let name = rename(&tensor.name);
        match arrays.remove(&name) {
            None => missing.push(name),
            Some(array) if array.shape[..] != tensor.shape[..] => {
                misshapen.push(format!("{name} is {:?} but should be {:?}", array.shape, tensor.shape.to_vec()));
            }
            Some(array) => {
                let data = TensorData::new(array.values, array.shape);
                fitting.push(bridge::from_data(data, tensor.name.clone(), None));
                report.matched.push(name);
            }
        }
    }
    let unknown: Vec<String> = arrays.into_keys().collect();
    let complaints: Vec<String> = [
        complaint("holds no", &missing),
        complaint("holds a tensor of another shape:", &misshapen),
        complaint("holds an unknown tensor", &unknown),
    ]
    .into_iter()
    .flatten()
    .collect();
    if !complaints.is_empty() {
        return Err(complaints.join(" and "));
    }
    let applied = module.apply(fitting, None, None, true);
    applied.errors.first().map_or(Ok(report), |error| Err(format!("cannot be used ({error})")))
}

/// The first of several names and how many more there are.
fn complaint(what: &str, names: &[String]) -> Option<String> {
    let (first, rest) = names.split_first()?;
    let more = if rest.is_empty() { String::new() } else { format!(" (and {} more)", rest.len()) };
    Some(format!("{what} {first}{more}"))
}
