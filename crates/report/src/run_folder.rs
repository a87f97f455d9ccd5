//! What a method left behind: the folder `endoscape run` writes, or as much of it as there is.

use crate::ReportError;
use crate::maps::{self, MILLIMETRES};
use endoscape_core::Camera;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// One line of `frames.csv`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct FrameRecord {
    /// Number of the frame, as depth maps are named.
    pub index: usize,
    /// Its time, seconds.
    pub time_s: f64,
    /// Whether it got a pose.
    #[serde(deserialize_with = "yes_or_no")]
    pub tracked: bool,
    /// Trust in the pose, 0 to 1, where the method gives one.
    #[serde(default)]
    pub confidence: Option<f64>,
    /// Time it took, milliseconds.
    #[serde(default)]
    pub latency_ms: Option<f64>,
    /// What the method said about it.
    #[serde(default)]
    pub warning: Option<String>,
}

/// `true`, `false`, `1` or `0`.
fn yes_or_no<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<bool, D::Error> {
    match String::deserialize(deserializer)?.trim() {
        "true" | "1" => Ok(true),
        "false" | "0" => Ok(false),
        other => Err(serde::de::Error::custom(format!("`{other}` is neither true nor false"))),
    }
}

/// How long frames took, milliseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Latency {
    /// Median.
    pub p50: f64,
    /// 95 of 100 frames are faster.
    pub p95: f64,
    /// 99 of 100 frames are faster.
    pub p99: f64,
    /// The slowest.
    pub max: f64,
}

/// The part of `run.json` a report shows; what is missing there is missing here.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RunFacts {
    /// Name of the method.
    pub method: Option<String>,
    /// Its weights.
    pub model: Option<String>,
    /// Frames it was given.
    pub frames: Option<usize>,
    /// Frames that got a pose.
    pub tracked: Option<usize>,
    /// Frames that got none.
    pub lost_frames: Vec<usize>,
    /// Frames per second.
    pub fps: Option<f64>,
    /// Time per frame.
    pub latency_ms: Option<Latency>,
    /// Largest memory, megabytes.
    pub peak_memory_mb: Option<f64>,
    /// What it computed on.
    pub device: Option<String>,
    /// Version of the program.
    pub version: Option<String>,
    /// Metres per unit of its 16-bit maps; `None` where its lengths are no metres.
    pub depth_metres_per_unit: Option<f64>,
    /// What its maps are in the method's own unit of length.
    pub depth: DepthFacts,
}

/// The part of `run.json` about depth maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct DepthFacts {
    /// Length of a step of 16-bit maps in the method's own unit.
    pub unit_per_step: Option<f64>,
    /// The camera at the size of the maps.
    pub camera: Option<Camera>,
}

/// A folder of results; pixels stay on disk.
#[derive(Clone, Debug, PartialEq)]
pub struct RunFolder {
    /// Where it is.
    pub path: PathBuf,
    /// `run.json`.
    pub facts: RunFacts,
    /// `frames.csv`, in order.
    pub frames: Vec<FrameRecord>,
    /// Depth maps by number of frame.
    pub depth: BTreeMap<usize, PathBuf>,
    /// Reliability maps by number of frame.
    pub reliability: BTreeMap<usize, PathBuf>,
}

impl RunFolder {
    /// Looks into a folder.
    ///
    /// # Errors
    /// [`ReportError::File`] for a folder that cannot be listed, or a `run.json` or `frames.csv` that cannot be read.
    pub fn open(path: &Path) -> Result<Self, ReportError> {
        let facts = facts(&path.join("run.json"))?.unwrap_or_default();
        let frames = frames(&path.join("frames.csv"))?;
        let maps = |name: &str| {
            let folder = path.join(name);
            if folder.is_dir() { maps::by_number(&folder) } else { Ok(BTreeMap::new()) }
        };
        Ok(Self { depth: maps("depth")?, reliability: maps("reliability")?, path: path.to_owned(), facts, frames })
    }

    /// Name for people: that of the folder.
    pub fn name(&self) -> String {
        let path = self.path.canonicalize().unwrap_or_else(|_| self.path.clone());
        path.file_name().map_or_else(|| "run".to_owned(), |name| name.to_string_lossy().into_owned())
    }

    /// Time per frame, from `run.json` or else from the frames; `None` if neither says.
    pub fn latency(&self) -> Option<Latency> {
        let mut sorted: Vec<f64> = self.frames.iter().filter_map(|frame| frame.latency_ms).collect();
        sorted.sort_by(f64::total_cmp);
        // The nearest rank: the smallest value that enough others do not exceed.
        let at = |share: f64| sorted[((share * sorted.len() as f64).ceil() as usize).clamp(1, sorted.len()) - 1];
        let counted =
            || (!sorted.is_empty()).then(|| Latency { p50: at(0.5), p95: at(0.95), p99: at(0.99), max: at(1.0) });
        self.facts.latency_ms.or_else(counted)
    }

    /// Length of a step of 16-bit maps: in metres, or else in the method's own unit, or else a millimetre.
    pub fn depth_unit(&self) -> f64 {
        self.facts.depth_metres_per_unit.or(self.facts.depth.unit_per_step).unwrap_or(MILLIMETRES)
    }

    /// Frames given and frames tracked; `None` if nothing says.
    pub fn counts(&self) -> Option<(usize, usize)> {
        let counted = || {
            let tracked = self.frames.iter().filter(|frame| frame.tracked).count();
            (!self.frames.is_empty()).then_some((self.frames.len(), tracked))
        };
        self.facts.frames.zip(self.facts.tracked).or_else(counted)
    }
}

fn facts(path: &Path) -> Result<Option<RunFacts>, ReportError> {
    let Some(text) = optional(path)? else { return Ok(None) };
    serde_json::from_str(&text).map(Some).map_err(|error| {
        ReportError::file(path, format!("is no description of a run: {error}"), "run the method again")
    })
}

fn frames(path: &Path) -> Result<Vec<FrameRecord>, ReportError> {
    let Some(text) = optional(path)? else { return Ok(Vec::new()) };
    let mut reader = csv::ReaderBuilder::new().flexible(true).trim(csv::Trim::All).from_reader(text.as_bytes());
    let frames: Result<Vec<FrameRecord>, csv::Error> = reader.deserialize().collect();
    let frames = frames
        .map_err(|error| ReportError::file(path, format!("is no list of frames: {error}"), "run the method again"))?;
    let poison = |frame: &FrameRecord| {
        !frame.time_s.is_finite()
            || frame.confidence.into_iter().chain(frame.latency_ms).any(|value| !value.is_finite())
    };
    match frames.iter().find(|frame| poison(frame)) {
        Some(frame) => {
            let what = format!("frame {} holds a number that is not finite", frame.index);
            Err(ReportError::file(path, what, "correct that line"))
        }
        None => Ok(frames),
    }
}

/// The text of a file that may be missing.
fn optional(path: &Path) -> Result<Option<String>, ReportError> {
    match std::fs::read_to_string(path) {
        Ok(text) => Ok(Some(text)),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(ReportError::file(path, format!("cannot be read: {error}"), "check the file")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(files: &[(&str, &str)]) -> (tempfile::TempDir, Result<RunFolder, ReportError>) {
        let folder = tempfile::tempdir().unwrap();
        for (name, contents) in files {
            std::fs::write(folder.path().join(name), contents).unwrap();
        }
        let run = RunFolder::open(folder.path());
        (folder, run)
    }

    #[test]
    fn what_is_missing_stays_missing() {
        let (_folder, run) = folder(&[]);
        let run = run.unwrap();
        assert_eq!((run.latency(), run.counts(), run.depth.len()), (None, None, 0));
    }

    #[test]
    fn latency_is_counted_where_nothing_states_it() {
        let lines: String = (0..100).map(|i| format!("{i},{i},{},0.5,{},\n", i != 7, i + 1)).collect();
        let csv = format!("index,time_s,tracked,confidence,latency_ms,warning\n{lines}");
        let run = folder(&[("frames.csv", &csv)]).1.unwrap();
        assert_eq!(run.latency(), Some(Latency { p50: 50.0, p95: 95.0, p99: 99.0, max: 100.0 }));
        assert_eq!(run.counts(), Some((100, 99)));
    }

    #[test]
    fn poison_is_one_sentence() {
        let csv = "index,time_s,tracked,confidence,latency_ms,warning\n0,0,true,NaN,1,\n";
        assert!(folder(&[("frames.csv", csv)]).1.unwrap_err().to_string().contains("frame 0 holds a number"));
        assert!(folder(&[("run.json", "[1")]).1.unwrap_err().to_string().contains("run.json: is no description"));
        let csv = "index,time_s,tracked\n0,0,perhaps\n";
        assert!(folder(&[("frames.csv", csv)]).1.unwrap_err().to_string().contains("neither true nor false"));
    }
}
