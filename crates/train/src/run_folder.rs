//! The folder of a training run: what it was, how it went, and where it stands.
//!
//! | file | what |
//! |---|---|
//! | `config.toml` | the complete [`TrainConfig`] |
//! | `run.json` | [`RunManifest`]: versions, seed, data with fingerprints |
//! | `metrics.csv`, `validation.csv` | a line per logged step and per validation |
//! | `tensorboard/` | the same as curves, an event file per sitting |
//! | `best/` | checkpoint with the best validation |
//! | `latest/` | checkpoint to resume from, with the optimiser's state |

use crate::config::TrainConfig;
use crate::error::TrainError;
use csv::{Reader, Writer, WriterBuilder};
use endoscape_nets::DataSource;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::fs::{self, File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};

const CONFIG: &str = "config.toml";
const MANIFEST: &str = "run.json";

/// What a run was made from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunManifest {
    /// Version of the program.
    pub endoscape_version: String,
    /// Where it computed.
    pub device: String,
    /// Seed of everything random.
    pub seed: u64,
    /// Snippets the data gave.
    pub snippets: usize,
    /// Frames of them that labels say something about.
    #[serde(default)]
    pub labelled_frames: usize,
    /// Training data.
    pub data: Vec<DataSource>,
    /// Validation data; the training data if it is the same.
    pub validation: Vec<DataSource>,
    /// Checkpoint the weights were taken from.
    pub init: Option<String>,
}

/// The folder of a run.
#[derive(Clone, Debug)]
pub struct RunFolder {
    root: PathBuf,
}

impl RunFolder {
    /// The place of a new run; nothing is written before [`RunFolder::describe`].
    ///
    /// # Errors
    /// [`TrainError::Run`] if something is there already.
    pub fn fresh(root: &Path) -> Result<Self, TrainError> {
        let occupied = root.is_file() || fs::read_dir(root).is_ok_and(|mut entries| entries.next().is_some());
        if occupied {
            let remedy = "choose another folder, or continue the run in it with --resume";
            return Err(TrainError::run(root, "is not an empty folder", remedy));
        }
        Ok(Self { root: root.to_path_buf() })
    }

    /// The folder of a run that has begun.
    ///
    /// # Errors
    /// [`TrainError::Run`] if it is none.
    pub fn open(root: &Path) -> Result<Self, TrainError> {
        let folder = Self { root: root.to_path_buf() };
        if root.join(CONFIG).is_file() && root.join(MANIFEST).is_file() {
            return Ok(folder);
        }
        let remedy = "name the --out folder of an earlier run, or start one without --resume";
        Err(TrainError::run(root, "holds no training run to resume", remedy))
    }

    /// The folder itself.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The checkpoint to resume from.
    pub fn latest(&self) -> PathBuf {
        self.root.join("latest")
    }

    /// The checkpoint with the best validation.
    pub fn best(&self) -> PathBuf {
        self.root.join("best")
    }

    /// The file that the complete configuration of the run is in.
    pub(crate) fn config_file(&self) -> PathBuf {
        self.root.join(CONFIG)
    }

    /// The complete configuration of the run.
    ///
    /// # Errors
    /// [`TrainError::Run`] if it cannot be read.
    pub fn config(&self) -> Result<TrainConfig, TrainError> {
        TrainConfig::default().overlaid(&self.config_file())
    }

    /// What the run was made from.
    ///
    /// # Errors
    /// [`TrainError::Run`] if it cannot be read.
    pub fn manifest(&self) -> Result<RunManifest, TrainError> {
        let path = self.root.join(MANIFEST);
        let text = fs::read_to_string(&path).map_err(|error| TrainError::io(&path, "be read", &error))?;
        serde_json::from_str(&text).map_err(|error| {
            TrainError::run(&path, format!("is no run manifest ({error})"), "restore the file or start a new run")
        })
    }

    /// Writes configuration and manifest, making the folder if need be.
    ///
    /// # Errors
    /// [`TrainError::Run`] if they cannot be written.
    pub fn describe(&self, config: &TrainConfig, manifest: &RunManifest) -> Result<(), TrainError> {
        self.describe_as(&config.to_toml()?, manifest)
    }

    /// As [`Self::describe`], for the configuration of any training as text.
    pub(crate) fn describe_as(&self, config: &str, manifest: &RunManifest) -> Result<(), TrainError> {
        fs::create_dir_all(&self.root).map_err(|error| TrainError::io(&self.root, "be made", &error))?;
        write_whole(&self.root.join(CONFIG), config.as_bytes())?;
        write_whole(&self.root.join(MANIFEST), &to_json(manifest)?)
    }
}

/// The folder to load a model from: `best` or `latest` of a run, or the checkpoint itself.
pub fn model_folder(path: &Path) -> PathBuf {
    let candidates = [path.join("best"), path.join("latest")];
    let is_run = path.join(MANIFEST).is_file();
    candidates.into_iter().find(|folder| is_run && folder.is_dir()).unwrap_or_else(|| path.to_path_buf())
}

pub(crate) fn to_json<T: Serialize>(value: &T) -> Result<Vec<u8>, TrainError> {
    serde_json::to_vec_pretty(value)
        .map_err(|error| TrainError::config("run", format!("cannot be written as JSON: {error}")))
}

/// Writes a file beside its place, waits for the disk, and renames it.
pub(crate) fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), TrainError> {
    let draft = path.with_extension("incomplete");
    let write = || {
        let mut file = File::create(&draft)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(&draft, path)
    };
    write().map_err(|error| TrainError::io(path, "be written", &error))
}

/// A growing table on disk.
pub struct Table<Row> {
    path: PathBuf,
    writer: Writer<File>,
    row: std::marker::PhantomData<Row>,
}

impl<Row: Serialize + DeserializeOwned> Table<Row> {
    /// Opens the table `name` of a run; lines for which `keep` is false are dropped. A resumed run drops what came
    /// after its checkpoint.
    ///
    /// # Errors
    /// [`TrainError::Run`] if it cannot be read or written.
    pub fn open(run: &RunFolder, name: &str, keep: impl Fn(&Row) -> bool) -> Result<Self, TrainError> {
        let path = run.root.join(name);
        // A last line that was cut off by a crash does not parse and is dropped too.
        let rows: Vec<Row> = match Reader::from_path(&path) {
            Ok(mut reader) => reader.deserialize().filter_map(Result::ok).filter(keep).collect(),
            Err(_) => Vec::new(),
        };
        let refused =
            |error: &csv::Error| TrainError::run(&path, format!("cannot be written: {error}"), "check the disk");
        let mut kept = Writer::from_writer(Vec::new());
        for row in &rows {
            kept.serialize(row).map_err(|error| refused(&error))?;
        }
        let bytes = kept.into_inner().map_err(|error| TrainError::io(&path, "be written", error.error()))?;
        write_whole(&path, &bytes)?;
        let file = OpenOptions::new().append(true).open(&path);
        let file = file.map_err(|error| TrainError::io(&path, "be written", &error))?;
        let writer = WriterBuilder::new().has_headers(rows.is_empty()).from_writer(file);
        Ok(Self { path, writer, row: std::marker::PhantomData })
    }

    /// Adds a line; it is on its way to the disk when this returns.
    ///
    /// # Errors
    /// [`TrainError::Run`] if it cannot be written.
    pub fn add(&mut self, row: &Row) -> Result<(), TrainError> {
        let written = self.writer.serialize(row).map_err(std::io::Error::from).and_then(|()| self.writer.flush());
        written.map_err(|error| TrainError::io(&self.path, "be written", &error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Row {
        step: u64,
        loss: f32,
    }

    fn run() -> (tempfile::TempDir, RunFolder) {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder::fresh(&folder.path().join("run")).unwrap();
        fs::create_dir(run.root()).unwrap();
        (folder, run)
    }

    fn lines(run: &RunFolder) -> Vec<String> {
        fs::read_to_string(run.root().join("m.csv")).unwrap().lines().map(str::to_owned).collect()
    }

    #[test]
    fn a_table_grows_and_forgets_what_came_after_the_checkpoint() {
        let (_folder, run) = run();
        let mut table = Table::open(&run, "m.csv", |_: &Row| true).unwrap();
        for step in [10, 20, 30] {
            table.add(&Row { step, loss: 0.5 }).unwrap();
        }
        drop(table);
        fs::write(run.root().join("m.csv"), format!("{}\n40,0.", lines(&run).join("\n"))).unwrap();
        let mut table = Table::open(&run, "m.csv", |row: &Row| row.step <= 20).unwrap();
        table.add(&Row { step: 21, loss: 0.25 }).unwrap();
        assert_eq!(lines(&run), ["step,loss", "10,0.5", "20,0.5", "21,0.25"]);
    }

    #[test]
    fn a_folder_in_use_is_not_taken() {
        let (_folder, run) = run();
        assert!(RunFolder::open(run.root()).unwrap_err().to_string().contains("no training run to resume"));
        fs::write(run.root().join("notes.txt"), "mine").unwrap();
        let message = RunFolder::fresh(run.root()).unwrap_err().to_string();
        assert!(message.contains("not an empty folder") && message.contains("--resume"), "{message}");
    }

    #[test]
    fn a_run_tells_what_it_was() {
        let (_folder, run) = run();
        let manifest = RunManifest {
            endoscape_version: "1".into(),
            device: "cpu".into(),
            seed: 3,
            labelled_frames: 0,
            snippets: 9,
            data: vec![DataSource { name: "a@0..9".into(), fingerprint: "sha256:0".into() }],
            validation: Vec::new(),
            init: None,
        };
        run.describe(&TrainConfig::paper(), &manifest).unwrap();
        let again = RunFolder::open(run.root()).unwrap();
        assert_eq!((again.config().unwrap(), again.manifest().unwrap()), (TrainConfig::paper(), manifest));
        assert_eq!(model_folder(run.root()), run.root());
        fs::create_dir(run.latest()).unwrap();
        assert_eq!(model_folder(run.root()), run.latest());
    }
}
