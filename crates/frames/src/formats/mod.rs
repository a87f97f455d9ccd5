//! Tells data sets apart by content.
//!
//! Each format has one file with one function `probe(path) -> Option<Result<Sequence, FramesError>>`: `None` is "not
//! mine", `Some(Err(..))` is "mine, and here is the first error with its file and line".

pub mod bronchoscope;
pub mod c3vd;
pub mod c3vd_v2;
pub mod colmap;
pub(crate) mod common;
pub mod endomapper;
pub mod endomapper_sim;
pub mod endoslam;
pub mod endoslam_unity;
pub mod euroc;
pub mod euroc_sensor;
#[cfg(test)]
pub(crate) mod fixtures;
pub mod hamlyn;
pub mod images;
pub mod kitti;
pub mod kitti_odometry;
pub mod kitti_oxts;
pub mod kitti_raw;
pub mod scared;
pub mod sequence_folder;
pub mod simcol3d;
pub mod tum;
pub mod unity;
mod video;
mod video_frames;

use crate::{FramesError, Sequence};
use std::fmt;
use std::path::Path;
use std::str::FromStr;

/// What a loader answers: not mine, or mine with the result.
pub type Probe = Option<Result<Sequence, FramesError>>;

/// The formats endoscape reads, by the names used on the command line and in reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Format {
    /// Our own sequence folder.
    Sequence,
    /// KITTI odometry benchmark sequence.
    KittiOdometry,
    /// KITTI raw drive.
    KittiRaw,
    /// C3VD, first release.
    C3vd,
    /// C3VD, second release.
    C3vdV2,
    /// EndoSLAM rendered in Unity.
    EndoslamUnity,
    /// EndoSLAM real cameras (poses in XLSX).
    Endoslam,
    /// SimCol3D.
    Simcol3d,
    /// SCARED.
    Scared,
    /// Hamlyn, rectified.
    Hamlyn,
    /// EndoMapper recordings.
    Endomapper,
    /// EndoMapper simulated.
    EndomapperSim,
    /// TUM RGB-D.
    Tum,
    /// EuRoC MAV.
    Euroc,
    /// Robot-driven bronchoscope clips (video with `state.csv`).
    Bronchoscope,
    /// A folder of pictures.
    Images,
    /// A video file or a live address.
    Video,
}

/// A loader with its format.
struct Loader {
    format: Format,
    name: &'static str,
    probe: fn(&Path) -> Probe,
}

/// Every loader. Those of plain pictures and videos come last: they take what no data set claims.
const LOADERS: &[Loader] = &[
    Loader { format: Format::Sequence, name: "sequence", probe: sequence_folder::probe },
    Loader { format: Format::KittiOdometry, name: "kitti-odometry", probe: kitti_odometry::probe },
    Loader { format: Format::KittiRaw, name: "kitti-raw", probe: kitti_raw::probe },
    Loader { format: Format::C3vd, name: "c3vd", probe: c3vd::probe },
    Loader { format: Format::C3vdV2, name: "c3vd-v2", probe: c3vd_v2::probe },
    Loader { format: Format::EndoslamUnity, name: "endoslam-unity", probe: endoslam_unity::probe },
    Loader { format: Format::Endoslam, name: "endoslam", probe: endoslam::probe },
    Loader { format: Format::Simcol3d, name: "simcol3d", probe: simcol3d::probe },
    Loader { format: Format::Scared, name: "scared", probe: scared::probe },
    Loader { format: Format::Hamlyn, name: "hamlyn", probe: hamlyn::probe },
    Loader { format: Format::Endomapper, name: "endomapper", probe: endomapper::probe },
    Loader { format: Format::EndomapperSim, name: "endomapper-sim", probe: endomapper_sim::probe },
    Loader { format: Format::Tum, name: "tum", probe: tum::probe },
    Loader { format: Format::Euroc, name: "euroc", probe: euroc::probe },
    Loader { format: Format::Bronchoscope, name: "bronchoscope", probe: bronchoscope::probe },
    Loader { format: Format::Images, name: "images", probe: images::probe },
    Loader { format: Format::Video, name: "video", probe: video::probe },
];

impl Format {
    /// Name on the command line and in reports.
    pub fn name(self) -> &'static str {
        LOADERS.iter().find(|loader| loader.format == self).map_or("unknown", |loader| loader.name)
    }

    /// All names, in the order the loaders are tried.
    pub fn names() -> impl Iterator<Item = &'static str> {
        LOADERS.iter().map(|loader| loader.name)
    }

    /// Whether any folder of pictures, or any video, is of this format.
    const fn is_generic(self) -> bool {
        matches!(self, Self::Images | Self::Video)
    }
}

impl fmt::Display for Format {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

impl FromStr for Format {
    type Err = FramesError;

    fn from_str(name: &str) -> Result<Self, FramesError> {
        LOADERS.iter().find(|loader| loader.name == name).map(|loader| loader.format).ok_or_else(|| {
            FramesError::Request {
                what: format!("`{name}` is no format endoscape knows"),
                remedy: format!("choose one of {}", Self::names().collect::<Vec<_>>().join(", ")),
            }
        })
    }
}

/// Opens whatever lies at `path`: a data-set sequence, one of our folders, a folder of pictures, a video or a live
/// address.
///
/// With `format` only that loader is asked.
///
/// # Errors
/// [`FramesError`]: nothing there, no loader knows it, two loaders claim it, or the loader's own first error.
pub fn open(path: &Path, format: Option<Format>) -> Result<Sequence, FramesError> {
    if !video::is_live_address(path) && !path.exists() {
        return Err(FramesError::Missing { path: path.to_path_buf() });
    }
    if path.is_dir() {
        std::fs::read_dir(path).map_err(|error| FramesError::io(path, "list", error))?;
    }
    match format {
        Some(format) => open_as(path, format),
        None => detect(path),
    }
}

fn open_as(path: &Path, format: Format) -> Result<Sequence, FramesError> {
    let loader = LOADERS.iter().find(|loader| loader.format == format);
    loader.and_then(|loader| (loader.probe)(path)).unwrap_or_else(|| {
        Err(FramesError::Unrecognised { path: path.to_path_buf(), reason: format!("holds no {format} data") })
    })
}

/// Asks every data set first; plain pictures and videos are what is left.
fn detect(path: &Path) -> Result<Sequence, FramesError> {
    let mut claims: Vec<(&Loader, Result<Sequence, FramesError>)> = LOADERS
        .iter()
        .filter(|loader| !loader.format.is_generic())
        .filter_map(|loader| (loader.probe)(path).map(|answer| (loader, answer)))
        .collect();
    if claims.len() > 1 {
        let formats = claims.iter().map(|(loader, _)| loader.name).collect::<Vec<_>>().join(", ");
        return Err(FramesError::Ambiguous { path: path.to_path_buf(), formats });
    }
    if let Some((_, answer)) = claims.pop() {
        return answer;
    }
    let generic = LOADERS.iter().filter(|loader| loader.format.is_generic());
    generic.filter_map(|loader| (loader.probe)(path)).next().unwrap_or_else(|| {
        let reason = if path.is_dir() { "no pictures and no known data set in this folder" } else { "not a video" };
        Err(FramesError::Unrecognised { path: path.to_path_buf(), reason: reason.into() })
    })
}
