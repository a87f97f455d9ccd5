//! Tiny made-up data sets for the tests of the loaders.

use super::Probe;
use crate::{FramesError, Sequence};
use endoscape_core::Size;
use std::path::{Path, PathBuf};

/// Lines of a pose file, or of any other text made line by line.
pub fn lines(count: usize, line: impl Fn(usize) -> String) -> String {
    (0..count).map(|index| line(index) + "\n").collect()
}

/// Writes a text file and the folders above it.
pub fn text(path: &Path, text: &str) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, text).unwrap();
}

/// Writes a grey picture and the folders above it; the ending of the name decides the format.
pub fn picture(path: &Path, size: Size) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    image::GrayImage::new(size.width as u32, size.height as u32).save(path).unwrap();
}

/// The sequence a loader made, or the test fails with its error.
pub fn loaded(answer: Probe) -> Sequence {
    answer.expect("recognised").expect("loads")
}

/// The sentence a loader refused its own data with.
pub fn refusal(answer: Probe) -> String {
    let error: FramesError = answer.expect("recognised").expect_err("refused");
    error.to_string()
}

/// Real data beside the repository, where there is any.
pub fn shared(path: &str) -> Option<PathBuf> {
    let full = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data").join(path);
    if !full.exists() {
        eprintln!("skipped: no {path} beside the repository");
    }
    full.exists().then_some(full)
}
