//! A study as a recording for the Rerun viewer (<https://rerun.io>): the cameras with their pictures, depth and
//! reliability, the paths beside the truth and the points each frame sees, on one time line.
//!
//! ```text
//! SEQUENCE/truth/path                        line, static
//! SEQUENCE/truth/camera                      pose and frustum
//! SEQUENCE/METHOD/path                       line, static
//! SEQUENCE/METHOD/camera                     pose, in the frame and scale of the truth where that is known
//! SEQUENCE/METHOD/camera/picture             frustum, and the picture (of the first method alone)
//! SEQUENCE/METHOD/camera/depth, reliability  maps, each with its own intrinsics
//! SEQUENCE/METHOD/camera/points              what the depth map says, in the camera's axes
//! SEQUENCE/METHOD/confidence, error_mm       series
//! SEQUENCE/METHOD/log                        warnings
//! ```
//! Time lines are `frame`, the number of the frame, and `time`, in seconds. Nothing is kept per frame but poses: pictures
//! and maps are read, written and forgotten one frame at a time. The file gets its name when it is complete.

mod layout;
mod moment;
mod motion;
mod optics;
mod view;

use crate::ReportError;
use crate::study::Study;
use endoscape_frames::Sequence;
use moment::Moment;
use re_sdk::{AsComponents, EntityPath, RecordingStream, RecordingStreamBuilder};
use std::fmt::Display;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Name under which the viewer keeps layouts.
const APPLICATION: &str = "endoscape";

/// A recording to be, which appears as a whole.
#[derive(Debug)]
pub struct Recording {
    path: PathBuf,
    /// Beside the destination, so that the final renaming stays on one disk; deleted with what it holds when dropped.
    workshop: TempDir,
}

impl Recording {
    /// Prepares the file `path`, whose folder must exist; a file that is there is replaced when the new one is complete.
    ///
    /// # Errors
    /// [`ReportError::File`] if `path` is no name for a file or its folder cannot be written.
    pub fn create(path: &Path) -> Result<Self, ReportError> {
        let name = path.file_name().filter(|_| !path.is_dir());
        let no_name = || ReportError::file(path, "is no name for a recording", "name a file that ends in .rrd");
        let prefix = format!(".{}.", name.ok_or_else(no_name)?.to_string_lossy());
        let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let workshop = tempfile::Builder::new().prefix(&prefix).tempdir_in(parent).map_err(|error| {
            ReportError::file(path, format!("cannot be written: {error}"), "choose a folder that can be written")
        })?;
        Ok(Self { path: path.to_owned(), workshop })
    }

    /// Writes a study; `sequences` holds, in the order of the study, the frames that methods ran on, where they are
    /// known and not live.
    ///
    /// # Errors
    /// [`ReportError`] for maps that cannot be read, or a file that cannot be written.
    pub fn write(self, study: &Study, sequences: &[Option<&Sequence>]) -> Result<PathBuf, ReportError> {
        let draft = self.workshop.path().join("recording.rrd");
        let scenes = layout::scenes(study, sequences);
        let stream = RecordingStreamBuilder::new(APPLICATION)
            .recording_name(study.title.as_str())
            .with_blueprint(layout::blueprint(&scenes))
            // Whatever the environment says: the user asked for this file.
            .enabled(true)
            .save(&draft)
            .map_err(|error| unwritten(&self.path, &error))?;
        // The moment at which a row was written says nothing about the video.
        stream.set_log_time_enabled(false);
        stream.set_log_tick_enabled(false);
        let log = Log { stream, path: &self.path };
        for scene in &scenes {
            motion::record(scene, &log)?;
            view::record(scene, &log)?;
        }
        log.flush()?;
        // Ends the file.
        drop(log);
        std::fs::rename(&draft, &self.path).map_err(|error| unwritten(&self.path, &error))?;
        Ok(self.path)
    }
}

fn unwritten(path: &Path, error: &dyn Display) -> ReportError {
    ReportError::file(path, format!("cannot be written: {error}"), "check the folder and its space")
}

/// Where rows go.
struct Log<'a> {
    stream: RecordingStream,
    path: &'a Path,
}

impl Log<'_> {
    /// Sets the time of the rows to come.
    fn at(&self, moment: Moment) {
        self.stream.reset_time();
        if let Some(frame) = moment.frame {
            self.stream.set_time_sequence("frame", i64::try_from(frame).unwrap_or(i64::MAX));
        }
        if let Some(time_s) = moment.time_s {
            self.stream.set_duration_secs("time", time_s);
        }
    }

    /// A row at the time set.
    fn put(&self, entity: &EntityPath, what: &dyn AsComponents) -> Result<(), ReportError> {
        self.stream.log(entity.clone(), what).map_err(|error| unwritten(self.path, &error))
    }

    /// Something true at all times.
    fn put_static(&self, entity: &EntityPath, what: &dyn AsComponents) -> Result<(), ReportError> {
        self.stream.log_static(entity.clone(), what).map_err(|error| unwritten(self.path, &error))
    }

    /// Waits until all rows are in the file, which bounds those in memory and finds out about a full disk.
    fn flush(&self) -> Result<(), ReportError> {
        self.stream.flush_blocking().map_err(|error| unwritten(self.path, &error))
    }
}
