//! Files and folders that are either complete or not there.

use crate::error::NetsError;
use std::fs::{self, File};
use std::io::{ErrorKind, Read, Write};
use std::path::{Path, PathBuf};

/// Writes a file and waits until it is on disk.
///
/// # Errors
/// [`NetsError::Io`].
pub(crate) fn write_durably(path: &Path, bytes: &[u8]) -> Result<(), NetsError> {
    let write = || {
        let mut file = File::create(path)?;
        file.write_all(bytes)?;
        file.sync_all()
    };
    write().map_err(|error| NetsError::io(path, "write", error))
}

/// Lets `write` write a file beside its final place and renames it there, so that no reader ever sees a part of it.
///
/// # Errors
/// Those of `write`, and [`NetsError::Io`]; an older file is untouched after either.
pub(crate) fn replace_with(path: &Path, write: impl FnOnce(&Path) -> Result<(), NetsError>) -> Result<(), NetsError> {
    let draft = sibling(path, "incomplete")?;
    let rename = |()| fs::rename(&draft, path).map_err(|error| NetsError::io(path, "write", error));
    write(&draft).and_then(rename).inspect_err(|_| {
        // The first error is the one to tell; a draft that cannot be removed either is overwritten next time.
        let _ = fs::remove_file(&draft);
    })
}

/// Fills a new folder beside `path` and then puts it in the place of whatever was there.
///
/// A folder cannot be exchanged in one step, so the old one first moves to `.NAME.previous`; [`current`] finds it
/// there if the program dies in between.
///
/// # Errors
/// Those of `fill`, and [`NetsError::Io`]; the old folder is untouched after either.
pub(crate) fn replace_folder<E: From<NetsError>>(
    path: &Path,
    fill: impl FnOnce(&Path) -> Result<(), E>,
) -> Result<(), E> {
    let refused = |error| NetsError::io(path, "write", error);
    let (draft, previous) = (sibling(path, "incomplete")?, sibling(path, "previous")?);
    remove_folder(&draft).map_err(refused)?;
    fs::create_dir_all(&draft).map_err(refused)?;
    fill(&draft).inspect_err(|_| {
        // The first error is the one to tell; a draft left behind is removed next time.
        let _ = fs::remove_dir_all(&draft);
    })?;
    if path.exists() {
        remove_folder(&previous).map_err(refused)?;
        fs::rename(path, &previous).map_err(refused)?;
    }
    fs::rename(&draft, path).map_err(refused)?;
    Ok(remove_folder(&previous).map_err(refused)?)
}

/// Where the folder's last complete contents are: at `path`, or beside it if a replacement was interrupted.
pub(crate) fn current(path: &Path) -> PathBuf {
    match sibling(path, "previous") {
        Ok(previous) if !path.exists() && previous.exists() => previous,
        _ => path.to_path_buf(),
    }
}

/// Text of a file that has no business being longer than a megabyte.
///
/// # Errors
/// [`NetsError`] when it is missing, longer, or no text.
pub(crate) fn read_text(path: &Path) -> Result<String, NetsError> {
    const LIMIT: u64 = 1 << 20;
    let mut text = String::new();
    let file = File::open(path).map_err(|error| NetsError::io(path, "read", error))?;
    match file.take(LIMIT + 1).read_to_string(&mut text) {
        Ok(length) if length as u64 > LIMIT => Err(NetsError::corrupt(path, "is longer than a megabyte")),
        Ok(_) => Ok(text),
        Err(error) if error.kind() == ErrorKind::InvalidData => Err(NetsError::corrupt(path, "is not a text file")),
        Err(error) => Err(NetsError::io(path, "read", error)),
    }
}

fn remove_folder(path: &Path) -> std::io::Result<()> {
    match fs::remove_dir_all(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        outcome => outcome,
    }
}

/// The hidden `.NAME.SUFFIX` beside `path`.
fn sibling(path: &Path, suffix: &str) -> Result<PathBuf, NetsError> {
    let unnamed = || NetsError::io(path, "write", std::io::Error::new(ErrorKind::InvalidInput, "it has no name"));
    let name = path.file_name().ok_or_else(unnamed)?;
    Ok(path.with_file_name(format!(".{}.{suffix}", name.to_string_lossy())))
}
