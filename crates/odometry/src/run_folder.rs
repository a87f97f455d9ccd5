//! The results of a run on disk.
//!
//! ```text
//! trajectory.tum     time tx ty tz qx qy qz qw, world_from_camera, one line per frame
//! trajectory.kitti   the same without times, 12 numbers per line
//! live.tum           the poses as they were told at their time, where later frames have revised some
//! frames.csv         index,time_s,tracked,confidence,latency_ms,warning
//! depth/             NNNNNN.png (16 bits, 0 is unknown) or NNNNNN.npy (f32), named by the numbers of the frames
//! reliability/       NNNNNN.png (8 bits, white is reliable), where the method says it
//! run.json           what ran, how it went; written last
//! ```
//! Everything is streamed into a hidden folder beside the destination, which gets its name only when it is complete:
//! whoever sees the destination sees all of it, and a failure leaves nothing behind.

use crate::OdometryError;
use crate::pipeline::{Step, StepSink};
use endoscape_core::{DepthMap, Grid, Pose, Size, TimedPose, trajectory};
use endoscape_frames::picture;
use serde::Serialize;
use std::collections::HashMap;
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use tempfile::TempDir;

/// How often the middle depth of the first map fits into its largest value: far walls of a lumen are some ten times
/// farther than the middle, and what is nearer than a twentieth is still told to one per cent.
const MEDIANS_IN_RANGE: f64 = 32.0;
/// Largest value of a 16-bit map.
const LARGEST_STEP: f64 = u16::MAX as f64;

/// How depth maps are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum DepthFormat {
    /// 16-bit PNG, one step for the whole run; farther depths are stored as the farthest.
    Png,
    /// NumPy, 32-bit floating point, nothing lost.
    Npy,
    /// Not at all.
    None,
}

impl FromStr for DepthFormat {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "png" => Ok(Self::Png),
            "npy" => Ok(Self::Npy),
            "none" => Ok(Self::None),
            _ => Err(format!("`{text}` is no way to store depth; choose png, npy or none")),
        }
    }
}

/// A folder that appears as a whole.
#[derive(Debug)]
pub struct Draft {
    out: PathBuf,
    /// Deleted with all it holds when dropped.
    _workshop: TempDir,
    /// The folder to be, inside the workshop.
    root: PathBuf,
}

impl Draft {
    /// Prepares the folder `out`, which must not exist or be empty; its parent folder must exist.
    ///
    /// # Errors
    /// [`OdometryError::Output`] if `out` holds something or its parent cannot be written.
    pub fn create(out: &Path) -> Result<Self, OdometryError> {
        refuse_occupied(out)?;
        let no_name = || OdometryError::output(out, "is no name for a new folder", "name a folder to create");
        let name = out.file_name().ok_or_else(no_name)?;
        // Beside the destination, so that the final renaming stays on one disk.
        let parent = out.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let prefix = format!(".{}.", name.to_string_lossy());
        let workshop = tempfile::Builder::new().prefix(&prefix).tempdir_in(parent);
        let workshop = workshop.map_err(|error| OdometryError::io(out, &error))?;
        // One level down, so that the result has the permissions of any new folder, not those of a temporary one.
        let root = workshop.path().join("run");
        std::fs::create_dir(&root).map_err(|error| OdometryError::io(out, &error))?;
        Ok(Self { out: out.to_path_buf(), _workshop: workshop, root })
    }

    /// Makes a folder inside.
    ///
    /// # Errors
    /// [`OdometryError::Output`] if the disk refuses.
    pub fn folder(&self, name: &str) -> Result<(), OdometryError> {
        std::fs::create_dir_all(self.root.join(name)).map_err(|error| OdometryError::io(&self.out, &error))
    }

    /// Writes a file inside.
    ///
    /// # Errors
    /// [`OdometryError::Output`] if the disk refuses.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<(), OdometryError> {
        std::fs::write(self.root.join(name), bytes).map_err(|error| OdometryError::io(&self.out.join(name), &error))
    }

    /// Gives the folder its name.
    ///
    /// # Errors
    /// [`OdometryError::Output`] if the name has been taken meanwhile or the disk refuses.
    pub fn finish(self) -> Result<(), OdometryError> {
        refuse_occupied(&self.out)?;
        if self.out.is_dir() {
            std::fs::remove_dir(&self.out).map_err(|error| OdometryError::io(&self.out, &error))?;
        }
        std::fs::rename(&self.root, &self.out).map_err(|error| OdometryError::io(&self.out, &error))
    }

    fn open(&self, name: &str) -> Result<BufWriter<File>, OdometryError> {
        let file = File::create(self.root.join(name));
        file.map(BufWriter::new).map_err(|error| OdometryError::io(&self.out.join(name), &error))
    }
}

/// Stores depth maps of one run in one unit.
#[derive(Debug)]
pub struct DepthWriter {
    format: DepthFormat,
    /// Length of a step of 16-bit maps, in the unit of the depth; known with the first map.
    unit: Option<f64>,
    size: Option<Size>,
}

impl DepthWriter {
    /// Stores in the given form.
    pub const fn new(format: DepthFormat) -> Self {
        Self { format, unit: None, size: None }
    }

    /// Length of a step of 16-bit maps, in the unit of the depth; `None` before the first map and for other forms.
    pub const fn unit(&self) -> Option<f64> {
        self.unit
    }

    /// Size of the maps; `None` before the first.
    pub const fn size(&self) -> Option<Size> {
        self.size
    }

    /// Writes a map as `NAME.png` or `NAME.npy`.
    ///
    /// # Errors
    /// [`OdometryError::Output`] if the disk refuses.
    pub fn write(&mut self, draft: &Draft, name: &str, depth: &DepthMap) -> Result<(), OdometryError> {
        self.size.get_or_insert(depth.size());
        match self.format {
            DepthFormat::None => Ok(()),
            DepthFormat::Npy => draft.write(&format!("{name}.npy"), &npy(depth.grid())),
            DepthFormat::Png => {
                // A map without any depth says nothing about the unit; any will do for it.
                let known = depth.median_m().map(|median| MEDIANS_IN_RANGE * f64::from(median) / LARGEST_STEP);
                self.unit = self.unit.or(known);
                let unit = self.unit.unwrap_or(1.0);
                let steps = depth.grid().map(|depth| steps(*depth, unit));
                let file = format!("{name}.png");
                picture::write_gray16_png(&draft.root.join(&file), &steps)
                    .map_err(|error| in_place(draft, &file, error))
            }
        }
    }
}

/// A known depth stays known, however near or far.
fn steps(depth: f32, unit: f64) -> u16 {
    if depth == DepthMap::UNKNOWN { 0 } else { (f64::from(depth) / unit).round().clamp(1.0, LARGEST_STEP) as u16 }
}

/// A two-dimensional array in NumPy's format 1.0 (`numpy.lib.format`).
fn npy(grid: &Grid<f32>) -> Vec<u8> {
    let Size { width, height } = grid.size();
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({height}, {width}), }}");
    // Magic, version and length are ten bytes; the data begin at a multiple of 64, after a line feed.
    let padding = 64 - (10 + header.len() + 1) % 64;
    let length = u16::try_from(header.len() + padding + 1).unwrap_or(u16::MAX);
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend(length.to_le_bytes());
    bytes.extend(header.into_bytes());
    bytes.extend(std::iter::repeat_n(b' ', padding));
    bytes.push(b'\n');
    bytes.extend(grid.values().iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

/// One line of `frames.csv`.
#[derive(Serialize)]
struct Row<'a> {
    index: usize,
    time_s: f64,
    tracked: bool,
    confidence: f64,
    latency_ms: f64,
    warning: &'a str,
}

/// Writes a run folder frame by frame. Dropped before [`RunWriter::finish`] it leaves nothing.
pub struct RunWriter {
    draft: Draft,
    tum: BufWriter<File>,
    kitti: BufWriter<File>,
    frames: csv::Writer<BufWriter<File>>,
    depth: DepthWriter,
    has_reliability: bool,
    /// Poses that replace those written, by the bits of their times.
    revised: HashMap<u64, Pose>,
}

impl RunWriter {
    /// Prepares the folder `out`, which must not exist or be empty.
    ///
    /// # Errors
    /// [`OdometryError::Output`] if it cannot be written.
    pub fn create(out: &Path, depth: DepthFormat) -> Result<Self, OdometryError> {
        let draft = Draft::create(out)?;
        if depth != DepthFormat::None {
            draft.folder("depth")?;
        }
        Ok(Self {
            tum: draft.open("trajectory.tum")?,
            kitti: draft.open("trajectory.kitti")?,
            frames: csv::Writer::from_writer(draft.open("frames.csv")?),
            depth: DepthWriter::new(depth),
            has_reliability: false,
            revised: HashMap::new(),
            draft,
        })
    }

    /// How depth is stored.
    pub const fn depth(&self) -> &DepthWriter {
        &self.depth
    }

    /// Completes the folder with `run.json`.
    ///
    /// # Errors
    /// [`OdometryError::Output`] if the disk refuses.
    pub fn finish(mut self, summary: &impl Serialize) -> Result<(), OdometryError> {
        let out = self.draft.out.clone();
        let flushed = self.tum.flush().and_then(|()| self.kitti.flush()).and_then(|()| self.frames.flush());
        flushed.map_err(|error| OdometryError::io(&out, &error))?;
        self.put_revisions()?;
        let json = serde_json::to_vec_pretty(summary).map_err(|error| OdometryError::io(&out, &error.into()))?;
        self.draft.write("run.json", &json)?;
        self.draft.finish()
    }

    /// Puts revised poses in their places; what was told at the time stays beside them.
    fn put_revisions(&self) -> Result<(), OdometryError> {
        if self.revised.is_empty() {
            return Ok(());
        }
        let path = self.draft.root.join("trajectory.tum");
        let told = std::fs::read_to_string(&path).map_err(|error| OdometryError::io(&path, &error))?;
        let unreadable = |_| OdometryError::output(&path, "was changed while it was written", "run again");
        let mut poses = trajectory::parse_tum(&told).map_err(unreadable)?;
        for pose in &mut poses {
            let revised = self.revised.get(&pose.time_s.to_bits());
            pose.world_from_camera = revised.copied().unwrap_or(pose.world_from_camera);
        }
        let places: Vec<Pose> = poses.iter().map(|pose| pose.world_from_camera).collect();
        self.draft.write("live.tum", told.as_bytes())?;
        self.draft.write("trajectory.tum", trajectory::to_tum(&poses).as_bytes())?;
        self.draft.write("trajectory.kitti", trajectory::to_kitti(&places).as_bytes())
    }

    fn line(&mut self, step: &Step) -> std::io::Result<()> {
        self.tum.write_all(trajectory::to_tum(&[step.pose]).as_bytes())?;
        self.kitti.write_all(trajectory::to_kitti(&[step.pose.world_from_camera]).as_bytes())?;
        Ok(self.frames.serialize(Row {
            index: step.number,
            time_s: step.pose.time_s,
            tracked: step.is_tracked,
            confidence: (step.tracked.confidence * 1e4).round() * 1e-4,
            latency_ms: (step.latency.as_secs_f64() * 1e6).round() * 1e-3,
            warning: step.tracked.warning.as_deref().unwrap_or_default(),
        })?)
    }

    fn reliability(&mut self, number: usize, reliability: &Grid<f32>) -> Result<(), OdometryError> {
        if !self.has_reliability {
            self.draft.folder("reliability")?;
            self.has_reliability = true;
        }
        let bytes: Vec<u8> = reliability.values().iter().map(|value| (value * 255.0).round() as u8).collect();
        let file = format!("reliability/{number:06}.png");
        let Size { width, height } = reliability.size();
        let picture = image::GrayImage::from_raw(width as u32, height as u32, bytes);
        let encoded = picture.map(|picture| {
            let mut encoded = std::io::Cursor::new(Vec::new());
            picture.write_to(&mut encoded, image::ImageFormat::Png).map(|()| encoded.into_inner())
        });
        match encoded {
            Some(Ok(encoded)) => self.draft.write(&file, &encoded),
            _ => Err(OdometryError::output(&self.draft.out.join(file), "cannot be a PNG", "choose a smaller --size")),
        }
    }
}

impl StepSink for RunWriter {
    fn step(&mut self, step: &Step) -> Result<(), OdometryError> {
        self.line(step).map_err(|error| OdometryError::io(&self.draft.out, &error))?;
        if let Some(depth) = &step.tracked.depth {
            self.depth.write(&self.draft, &format!("depth/{:06}", step.number), depth)?;
        }
        if let Some(reliability) = &step.tracked.reliability {
            self.reliability(step.number, reliability)?;
        }
        Ok(())
    }

    fn revise(&mut self, revisions: &[TimedPose]) {
        self.revised.extend(revisions.iter().map(|pose| (pose.time_s.to_bits(), pose.world_from_camera)));
    }
}

/// The same error about the destination: the workshop is nothing the user knows.
fn in_place(draft: &Draft, file: &str, error: endoscape_frames::FramesError) -> OdometryError {
    match error {
        endoscape_frames::FramesError::Io { source, .. } => OdometryError::io(&draft.out.join(file), &source),
        other => other.into(),
    }
}

fn refuse_occupied(out: &Path) -> Result<(), OdometryError> {
    let occupied = match std::fs::read_dir(out) {
        Ok(mut entries) => entries.next().is_some(),
        Err(_) => out.exists(),
    };
    let error = || OdometryError::output(out, "already holds something", "choose a new folder or remove this one");
    if occupied { Err(error()) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use endoscape_core::Tracked;
    use std::time::Duration;

    #[test]
    fn arrays_are_what_numpy_writes() {
        let bytes = npy(&Grid::from_fn(Size::new(3, 2), |x, y| (10 * y + x) as f32));
        assert_eq!(bytes.len(), 128 + 4 * 6);
        assert_eq!(&bytes[..10], b"\x93NUMPY\x01\x00\x76\x00");
        assert_eq!(bytes[127], b'\n');
        assert_eq!(&bytes[128 + 16..128 + 20], &11.0_f32.to_le_bytes());
    }

    #[test]
    fn a_known_depth_stays_known() {
        assert_eq!((steps(0.0, 0.1), steps(1e-9, 0.1), steps(5.0, 0.1), steps(1e9, 0.1)), (0, 1, 50, u16::MAX));
    }

    #[test]
    fn a_draft_appears_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("run");
        let draft = Draft::create(&out).unwrap();
        draft.write("a", b"1").unwrap();
        assert!(!out.exists());
        drop(draft);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        let draft = Draft::create(&out).unwrap();
        draft.write("a", b"1").unwrap();
        draft.finish().unwrap();
        assert_eq!(std::fs::read(out.join("a")).unwrap(), b"1");
        let sentence = Draft::create(&out).unwrap_err().to_string();
        assert!(sentence.contains("already holds something"), "{sentence}");
        let sentence = Draft::create(&folder.path().join("none/run")).unwrap_err().to_string();
        assert!(sentence.contains("check that its parent folder exists"), "{sentence}");
    }

    #[test]
    fn revised_poses_are_written_beside_those_told() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("run");
        let mut writer = RunWriter::create(&out, DepthFormat::None).unwrap();
        let at = |frame: usize, x: f64| TimedPose {
            time_s: frame as f64 / 30.0,
            world_from_camera: Pose::translation(x, 0.0, 0.0),
        };
        for number in 0..4 {
            let pose = at(number, 1.0);
            let tracked = Tracked {
                world_from_camera: Some(pose.world_from_camera),
                confidence: 1.0,
                depth: None,
                reliability: None,
                warning: None,
            };
            writer.step(&Step { number, pose, is_tracked: true, tracked, latency: Duration::ZERO }).unwrap();
        }
        writer.revise(&[at(1, 2.0), at(2, 3.0)]);
        writer.revise(&[at(2, 4.0)]);
        writer.finish(&()).unwrap();
        let ways = |file: &str| -> Vec<f64> {
            let poses = trajectory::parse_tum(&std::fs::read_to_string(out.join(file)).unwrap()).unwrap();
            poses.iter().map(|pose| pose.world_from_camera.translation.x).collect()
        };
        assert_eq!(ways("trajectory.tum"), [1.0, 2.0, 4.0, 1.0]);
        assert_eq!(ways("live.tum"), [1.0; 4]);
        let kitti = std::fs::read_to_string(out.join("trajectory.kitti")).unwrap();
        assert_eq!(kitti.lines().nth(2), Some("1 0 0 4 0 1 0 0 0 0 1 0"));
    }
}
