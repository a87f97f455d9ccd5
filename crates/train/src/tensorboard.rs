//! Curves of a training as TensorBoard reads them: `RUN/tensorboard/events.out.tfevents.*`.
//!
//! A file is a sequence of records, each framed as TensorFlow's `TFRecord` (length, its checksum, the bytes, their
//! checksum) around one protocol buffer of `tensorflow/core/util/event.proto`, of which the few fields a curve needs
//! are spelled out here. A resumed run adds a file of its own, which tells TensorBoard to forget every point after the
//! checkpoint it went on from.

use crate::error::TrainError;
use crate::run_folder::RunFolder;
use prost::{Enumeration, Message, Oneof};
use std::fs::{self, File};
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// Folder of the event files inside a run.
const FOLDER: &str = "tensorboard";
/// What the first event of every file says.
const FILE_VERSION: &str = "brain.Event:2";

/// A point in time of a log.
#[derive(Clone, PartialEq, Message)]
struct LogEvent {
    /// Seconds since 1970.
    #[prost(double, tag = "1")]
    wall_time: f64,
    #[prost(int64, tag = "2")]
    step: i64,
    #[prost(oneof = "Content", tags = "3, 5, 7")]
    content: Option<Content>,
}

#[derive(Clone, PartialEq, Oneof)]
enum Content {
    #[prost(string, tag = "3")]
    FileVersion(String),
    #[prost(message, tag = "5")]
    Summary(Summary),
    #[prost(message, tag = "7")]
    SessionLog(SessionLog),
}

#[derive(Clone, PartialEq, Message)]
struct Summary {
    #[prost(message, repeated, tag = "1")]
    values: Vec<Scalar>,
}

#[derive(Clone, PartialEq, Message)]
struct Scalar {
    /// Name of the curve; what stands before a slash groups curves.
    #[prost(string, tag = "1")]
    tag: String,
    #[prost(float, optional, tag = "2")]
    value: Option<f32>,
}

#[derive(Clone, PartialEq, Message)]
struct SessionLog {
    #[prost(enumeration = "SessionStatus", tag = "1")]
    status: i32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Enumeration)]
#[repr(i32)]
enum SessionStatus {
    Unspecified = 0,
    /// Points at this step and later are from before an interruption and no longer count.
    Start = 1,
}

/// A growing event file.
pub struct EventFile {
    path: PathBuf,
    file: File,
}

impl EventFile {
    /// Starts the file of a sitting that goes on from `step`, 0 for a fresh run.
    ///
    /// # Errors
    /// [`TrainError::Run`] if it cannot be written.
    pub fn create(run: &RunFolder, step: u64) -> Result<Self, TrainError> {
        let folder = run.root().join(FOLDER);
        fs::create_dir_all(&folder).map_err(|error| TrainError::io(&folder, "be made", &error))?;
        let (path, file) = new_file(&folder)?;
        let mut events = Self { path, file };
        events.add(0, Content::FileVersion(FILE_VERSION.to_owned()))?;
        if step > 0 {
            events.add(step + 1, Content::SessionLog(SessionLog { status: SessionStatus::Start.into() }))?;
        }
        Ok(events)
    }

    /// Adds a point to each of the curves; it is on its way to the disk when this returns.
    ///
    /// # Errors
    /// [`TrainError::Run`] if it cannot be written.
    pub fn add_scalars(&mut self, step: u64, scalars: &[(String, f64)]) -> Result<(), TrainError> {
        let scalar = |(tag, value): &(String, f64)| Scalar { tag: tag.clone(), value: Some(*value as f32) };
        self.add(step, Content::Summary(Summary { values: scalars.iter().map(scalar).collect() }))
    }

    fn add(&mut self, step: u64, content: Content) -> Result<(), TrainError> {
        let event = LogEvent { wall_time: seconds_since_1970(), step: step as i64, content: Some(content) };
        // In one piece, so that a reader meanwhile sees whole records or the start of one.
        let written = self.file.write_all(&record(&event.encode_to_vec()));
        written.map_err(|error| TrainError::io(&self.path, "be written", &error))
    }
}

/// A file that did not exist before. TensorBoard reads files in the order of their names, which therefore begin with
/// the time; two sittings within a second are told apart by a number.
fn new_file(folder: &Path) -> Result<(PathBuf, File), TrainError> {
    let second = seconds_since_1970() as u64;
    let mut number = 0;
    loop {
        let path = folder.join(format!("events.out.tfevents.{second:010}.endoscape.{number}"));
        match File::create_new(&path) {
            Ok(file) => return Ok((path, file)),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => number += 1,
            Err(error) => return Err(TrainError::io(&path, "be written", &error)),
        }
    }
}

fn seconds_since_1970() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |duration| duration.as_secs_f64())
}

/// A `TFRecord` around `bytes`.
fn record(bytes: &[u8]) -> Vec<u8> {
    let length = (bytes.len() as u64).to_le_bytes();
    [&length[..], &checksum(&length), bytes, &checksum(bytes)].concat()
}

/// CRC-32C, turned and shifted so that checksums of data that holds checksums stay good ones (TensorFlow's
/// `tensorflow/core/lib/hash/crc32c.h`).
fn checksum(bytes: &[u8]) -> [u8; 4] {
    crc32c::crc32c(bytes).rotate_right(15).wrapping_add(0xa282_ead8).to_le_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run() -> (tempfile::TempDir, RunFolder) {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder::fresh(&folder.path().join("run")).unwrap();
        (folder, run)
    }

    /// All events of all files in the order of their names, with every length and checksum checked.
    fn events(run: &RunFolder) -> Vec<LogEvent> {
        let mut files: Vec<_> =
            fs::read_dir(run.root().join(FOLDER)).unwrap().map(|entry| entry.unwrap().path()).collect();
        files.sort();
        let mut events = Vec::new();
        for file in files {
            let bytes = fs::read(file).unwrap();
            let mut rest = bytes.as_slice();
            while !rest.is_empty() {
                let (length, after) = rest.split_at(8);
                let count = u64::from_le_bytes(length.try_into().unwrap()) as usize;
                let (content, end) = (&after[4..4 + count], &after[4 + count..]);
                assert_eq!((&after[..4], &end[..4]), (&checksum(length)[..], &checksum(content)[..]));
                events.push(LogEvent::decode(content).unwrap());
                rest = &end[4..];
            }
        }
        events
    }

    #[test]
    fn a_record_is_tensorflows() {
        // How the files that TensorFlow itself writes begin: a length of 24 and its checksum.
        let version = Content::FileVersion(FILE_VERSION.to_owned());
        let event = LogEvent { wall_time: 1.0, step: 0, content: Some(version) };
        let bytes = record(&event.encode_to_vec());
        assert_eq!(bytes[..12], [24, 0, 0, 0, 0, 0, 0, 0, 0xa3, 0x7f, 0x4b, 0x22]);
        assert_eq!(bytes[12..21], [0x09, 0, 0, 0, 0, 0, 0, 0xf0, 0x3f]);
        assert_eq!(&bytes[21..36], b"\x1a\x0dbrain.Event:2");
    }

    #[test]
    fn curves_are_read_back() {
        let (_folder, run) = run();
        let mut file = EventFile::create(&run, 0).unwrap();
        file.add_scalars(10, &[("loss/total".into(), 0.5), ("learning_rate".into(), 2e-4)]).unwrap();
        let events = events(&run);
        assert_eq!(events[0].content, Some(Content::FileVersion(FILE_VERSION.into())));
        let scalar = |tag: &str, value| Scalar { tag: tag.into(), value: Some(value) };
        let values = vec![scalar("loss/total", 0.5), scalar("learning_rate", 2e-4)];
        assert_eq!((events[1].step, events[1].content.clone()), (10, Some(Content::Summary(Summary { values }))));
        assert_eq!(events.len(), 2);
    }

    #[test]
    fn a_second_sitting_writes_a_later_file_and_takes_back_what_came_after_its_step() {
        let (_folder, run) = run();
        for step in [0, 20] {
            EventFile::create(&run, step).unwrap();
        }
        let events = events(&run);
        assert_eq!(events.len(), 3);
        let start = SessionLog { status: SessionStatus::Start.into() };
        assert_eq!((events[2].step, events[2].content.clone()), (21, Some(Content::SessionLog(start))));
    }
}
