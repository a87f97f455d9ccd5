//! What several tests share: golden files and comparison with them.
#![allow(dead_code, clippy::unwrap_used, clippy::print_stderr, reason = "every test binary uses its own part")]

use burn::tensor::{Device, Tensor, TensorData};
use safetensors::SafeTensors;
use std::path::{Path, PathBuf};

/// The repository's golden numbers.
pub fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../golden/nets").join(name)
}

/// A larger golden set beside the workspace, where there is one.
pub fn shared_golden(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/golden").join(name);
    // Worktrees lie one folder deeper than the main checkout.
    let deeper = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../../shared/golden").join(name);
    let found = [path, deeper].into_iter().find(|path| path.exists());
    if found.is_none() {
        eprintln!("skipped: no shared golden file {name}");
    }
    found
}

/// Tensors of a safetensors file.
pub struct Expected(Vec<u8>);

impl Expected {
    pub fn read(path: &Path) -> Self {
        Self(std::fs::read(path).unwrap())
    }

    pub fn has(&self, name: &str) -> bool {
        SafeTensors::deserialize(&self.0).unwrap().tensor(name).is_ok()
    }

    pub fn tensor<const D: usize>(&self, name: &str, device: &Device) -> Tensor<D> {
        let file = SafeTensors::deserialize(&self.0).unwrap();
        let view = file.tensor(name).unwrap();
        let values: Vec<f32> = view.data().as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
        Tensor::from_data(TensorData::new(values, view.shape().to_vec()), device)
    }

    /// Largest difference from the named tensor, relative to that tensor's largest value.
    pub fn error<const D: usize>(&self, name: &str, actual: Tensor<D>) -> f64 {
        let expected: Tensor<D> = self.tensor(name, &actual.device());
        assert_eq!(actual.dims(), expected.dims(), "{name}");
        let largest = expected.clone().abs().max().into_scalar::<f32>();
        f64::from((actual - expected).abs().max().into_scalar::<f32>() / largest)
    }

    pub fn assert_close<const D: usize>(&self, name: &str, actual: Tensor<D>) {
        let error = self.error(name, actual);
        assert!(error < 1e-4, "{name} differs by {error:.2e} relative");
    }
}
