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

/// How the arrays of a file compare with the tensors of a network.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ImportReport {
    /// Names found in both, with the same shape.
    pub matched: Vec<String>,
    /// Names the network needs but the file lacks.
    pub missing: Vec<String>,
    /// Names in the file that no tensor of the network bears.
    pub unused: Vec<String>,
    /// `NAME is [4, 3, 7, 7] but should be [8, 3, 7, 7]`.
    pub misshapen: Vec<String>,
}

impl ImportReport {
    /// Whether file and network agree tensor for tensor.
    pub fn is_complete(&self) -> bool {
        self.missing.is_empty() && self.unused.is_empty() && self.misshapen.is_empty()
    }

    /// The first disagreement and how many there are, as part of a sentence; empty if there is none.
    pub(crate) fn disagreement(&self) -> String {
        let all = [
            ("holds no", self.missing.as_slice()),
            ("holds a tensor whose shape does not fit:", self.misshapen.as_slice()),
            ("holds an unknown tensor", self.unused.as_slice()),
        ];
        let parts = all.iter().filter_map(|(what, names)| {
            let others = match names.len() {
                0 => return None,
                1 => String::new(),
                count => format!(" (and {} more)", count - 1),
            };
            Some(format!("{what} {}{others}", names[0]))
        });
        parts.collect::<Vec<_>>().join(" and ")
    }
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

/// Replaces the tensors of a module by the arrays that `rename` matches to their paths; the report says which were.
///
/// The module changes only where names and shapes agree.
pub(crate) fn apply<M: Module>(
    module: &mut M,
    mut arrays: NamedArrays,
    rename: impl Fn(&str) -> String,
) -> ImportReport {
    let mut report = ImportReport::default();
    let mut fitting = Vec::new();
    for tensor in module.collect(None, None, true) {
        let name = rename(&tensor.name);
        match arrays.remove(&name) {
            None => report.missing.push(name),
            Some(array) if array.shape[..] != tensor.shape[..] => {
                let (found, wanted) = (array.shape, tensor.shape.to_vec());
                report.misshapen.push(format!("{name} is {found:?} but should be {wanted:?}"));
            }
            Some(array) => {
                let data = TensorData::new(array.values, array.shape);
                fitting.push(bridge::from_data(data, tensor.name.clone(), None));
                report.matched.push(name);
            }
        }
    }
    let applied = module.apply(fitting, None, None, true);
    report.misshapen.extend(applied.errors.iter().map(ToString::to_string));
    report.unused = arrays.into_keys().collect();
    report
}
