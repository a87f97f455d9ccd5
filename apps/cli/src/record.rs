//! `--record FILE.rrd`: results over time for the Rerun viewer, in builds that have it (feature `rerun`).

#[cfg(not(feature = "rerun"))]
use absent::Recording;
#[cfg(feature = "rerun")]
use endoscape_report::recording::Recording;

use endoscape_frames::Sequence;
use endoscape_report::Study;
use std::path::PathBuf;

/// The recording of a command, if one is asked for.
#[derive(clap::Args)]
pub struct RecordArgs {
    /// Also write a recording for the Rerun viewer: cameras, pictures, depth, reliability, points and paths over time.
    #[arg(long, value_name = "FILE.rrd")]
    record: Option<PathBuf>,
}

impl RecordArgs {
    /// Prepares the file before any work is done, so that a wrong name costs no time.
    pub fn open(&self) -> anyhow::Result<Recorder> {
        Ok(Recorder(self.record.as_deref().map(Recording::create).transpose()?))
    }
}

/// Where the recording goes; nowhere if none is asked for.
pub struct Recorder(Option<Recording>);

impl Recorder {
    /// Whether there is anything to write.
    pub const fn is_wanted(&self) -> bool {
        self.0.is_some()
    }

    /// Writes a study with the frames of its sequences, where they are known; the path of the file, if there is one.
    pub fn write(self, study: &Study, sequences: &[Option<&Sequence>]) -> anyhow::Result<Option<PathBuf>> {
        Ok(self.0.map(|recording| recording.write(study, sequences)).transpose()?)
    }
}

/// What builds without the feature have in its place.
#[cfg(not(feature = "rerun"))]
mod absent {
    use super::{PathBuf, Sequence, Study};
    use endoscape_report::ReportError;
    use std::path::Path;

    /// There is none.
    pub enum Recording {}

    impl Recording {
        /// Says how to get it.
        pub fn create(path: &Path) -> anyhow::Result<Self> {
            anyhow::bail!(
                "{}: this build of endoscape cannot write recordings; build one that can with `cargo build --release \
                 -p endoscape-cli --features rerun`, or leave --record out",
                path.display()
            )
        }

        pub fn write(self, _: &Study, _: &[Option<&Sequence>]) -> Result<PathBuf, ReportError> {
            match self {}
        }
    }
}
