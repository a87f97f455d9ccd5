//! Our own sequence folder, written in one piece.
//!
//! ```text
//! sequence.toml  name, scale of the depth maps, frame rate, licence, provenance
//! camera.toml    the camera, if it is known
//! frames.csv     index,time_s,file,depth,mask: one line per frame, paths inside the folder
//! frames/        NNNNNN.png
//! poses.tum      world_from_camera in metres; its times are those of frames.csv to the last digit
//! depth/         NNNNNN.png, 16 bits, 0 is unknown
//! masks/         NNNNNN.png, white is usable
//! magnet.toml    magnet, Hall array and their places; magnet.csv: its readings (see [`crate::magnet`])
//! ```
//! Everything is written into a hidden folder beside the destination, which gets its name only when it is complete:
//! whoever sees the destination sees all of it, and a failure leaves nothing behind. [`crate::formats`] reads it.

use crate::{FramesError, picture};
use endoscape_core::{Camera, DepthMap, Grid, Image, Mask, Pose, Size, TimedPose, trajectory};
use serde::{Deserialize, Serialize};
use std::fs::OpenOptions;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Version of the layout this code writes, and the newest it reads.
pub const VERSION: u32 = 1;
/// Largest stored depth.
const LARGEST_UNIT: f64 = u16::MAX as f64;

/// `sequence.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Manifest {
    pub version: u32,
    pub name: String,
    pub units: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth_metres_per_unit: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fps: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub license: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub provenance: Option<String>,
}

/// One line of `frames.csv`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Row {
    pub index: usize,
    pub time_s: f64,
    pub file: String,
    #[serde(default)]
    pub depth: Option<String>,
    #[serde(default)]
    pub mask: Option<String>,
}

/// What holds for the whole sequence.
#[derive(Clone, Debug, Default)]
pub struct Header {
    /// Short name.
    pub name: String,
    /// Frames per second, where it is known.
    pub fps: Option<f64>,
    /// The camera, of the size of the frames.
    pub camera: Option<Camera>,
    /// Licence of the data.
    pub license: Option<String>,
    /// Where the data come from and what was done to them.
    pub provenance: Option<String>,
    /// Metres per unit of the 16-bit depth maps; `None` chooses the finest that fits the largest depth.
    pub depth_metres_per_unit: Option<f64>,
}

/// One frame to be written.
#[derive(Clone, Copy, Debug)]
pub struct WrittenFrame<'a> {
    /// Its number, increasing.
    pub number: usize,
    /// Its time in seconds, increasing.
    pub time_s: f64,
    /// Its pixels.
    pub image: &'a Image,
    /// Its depth in metres.
    pub depth: Option<&'a DepthMap>,
    /// Its usable pixels.
    pub mask: Option<&'a Mask>,
    /// Its pose in metres.
    pub world_from_camera: Option<Pose>,
}

/// Writes a sequence folder frame by frame.
///
/// Dropped before [`Writer::finish`] it leaves nothing.
#[derive(Debug)]
pub struct Writer {
    out: PathBuf,
    /// Deleted with all it holds when dropped.
    _workshop: TempDir,
    /// The folder to be, inside the workshop.
    root: PathBuf,
    header: Header,
    size: Option<Size>,
    rows: Vec<Row>,
    poses: Vec<TimedPose>,
    largest_depth_m: f32,
}

impl Writer {
    /// Prepares to write the folder `out`, which must not exist or be empty; its parent folder must exist.
    ///
    /// # Errors
    /// [`FramesError`] if `out` holds something or its parent folder cannot be written.
    pub fn create(out: &Path, header: Header) -> Result<Self, FramesError> {
        refuse_occupied(out)?;
        let no_name = || FramesError::file(out, "is no name for a new folder", "give the name of a folder to create");
        let name = out.file_name().ok_or_else(no_name)?;
        // Beside the destination, so that the final renaming stays on one disk.
        let parent = out.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let prefix = format!(".{}.", name.to_string_lossy());
        let workshop = tempfile::Builder::new().prefix(&prefix).tempdir_in(parent);
        let workshop = workshop.map_err(|error| FramesError::io(out, "create", error))?;
        // One level down, so that the result has the permissions of any new folder, not those of a temporary one.
        let root = workshop.path().join("sequence");
        let writer = Self {
            out: out.to_path_buf(),
            _workshop: workshop,
            root,
            header,
            size: None,
            rows: Vec::new(),
            poses: Vec::new(),
            largest_depth_m: 0.0,
        };
        writer.create_folder("frames")?;
        Ok(writer)
    }

    /// Writes one frame: picture, depth and mask to files; number, time and pose kept until the end.
    ///
    /// # Errors
    /// [`FramesError`] if numbers or times do not increase, sizes differ, a depth does not fit the given scale, or
    /// the disk refuses.
    pub fn write_frame(&mut self, frame: &WrittenFrame<'_>) -> Result<(), FramesError> {
        self.check(frame)?;
        let file = format!("frames/{:06}.png", frame.number);
        picture::write_png(&self.root.join(&file), frame.image).map_err(|error| self.in_place(error))?;
        let depth = frame.depth.map(|depth| self.write_depth(frame.number, depth)).transpose()?;
        let mask = frame.mask.map(|mask| self.write_mask(frame.number, mask)).transpose()?;
        let time_s = frame.time_s;
        self.rows.push(Row { index: frame.number, time_s, file, depth, mask });
        self.poses.extend(frame.world_from_camera.map(|world_from_camera| TimedPose { time_s, world_from_camera }));
        Ok(())
    }

    /// Adds a file of its own, such as `magnet.csv` or `labels/000000.png`; its folder is made if need be.
    ///
    /// # Errors
    /// [`FramesError::Io`] if the disk refuses.
    pub fn write_file(&self, name: &str, contents: impl AsRef<[u8]>) -> Result<(), FramesError> {
        let path = self.root.join(name);
        let folder = path.parent().map_or(Ok(()), std::fs::create_dir_all);
        folder
            .and_then(|()| std::fs::write(&path, contents))
            .map_err(|error| FramesError::io(&self.out.join(name), "write", error))
    }

    /// Adds to the end of a file that is too long to be kept until the sequence is complete.
    ///
    /// # Errors
    /// [`FramesError::Io`] if the disk refuses.
    pub fn append(&self, name: &str, contents: &str) -> Result<(), FramesError> {
        let file = OpenOptions::new().create(true).append(true).open(self.root.join(name));
        file.and_then(|mut file| file.write_all(contents.as_bytes()))
            .map_err(|error| FramesError::io(&self.out.join(name), "write", error))
    }

    /// Writes what holds for the whole sequence and gives the folder its name.
    ///
    /// # Errors
    /// [`FramesError`] if there is no frame, the destination has been taken meanwhile, or the disk refuses.
    pub fn finish(mut self) -> Result<(), FramesError> {
        if self.rows.is_empty() {
            return Err(FramesError::file(&self.out, "would hold no frame", "choose a range that has frames"));
        }
        let depth_metres_per_unit = self.encode_spooled_depth()?;
        self.write_tables(depth_metres_per_unit)?;
        refuse_occupied(&self.out)?;
        if self.out.is_dir() {
            std::fs::remove_dir(&self.out).map_err(|error| FramesError::io(&self.out, "replace", error))?;
        }
        std::fs::rename(&self.root, &self.out).map_err(|error| FramesError::io(&self.out, "create", error))
    }

    fn check(&mut self, frame: &WrittenFrame<'_>) -> Result<(), FramesError> {
        let refuse = |reason: String, remedy: &str| {
            Err(FramesError::file(&self.out, format!("cannot take frame {}: {reason}", frame.number), remedy))
        };
        let size = *self.size.get_or_insert(frame.image.size());
        let sizes = [
            ("picture", Some(frame.image.size())),
            ("depth map", frame.depth.map(DepthMap::size)),
            ("mask", frame.mask.map(Grid::size)),
            ("camera", self.header.camera.map(|camera| camera.size())),
        ];
        if let Some((what, Some(other))) = sizes.into_iter().find(|(_, other)| other.is_some_and(|other| other != size))
        {
            return refuse(format!("its {what} is {other} but the sequence is {size}"), "bring all to one size");
        }
        if !frame.time_s.is_finite() {
            return refuse(format!("its time is {}", frame.time_s), "correct the times of the source");
        }
        match self.rows.last() {
            Some(last) if frame.number <= last.index || frame.time_s <= last.time_s => {
                let (index, time_s) = (last.index, last.time_s);
                let reason = format!("at {} s it is not after frame {index} at {time_s} s", frame.time_s);
                refuse(reason, "correct the times of the source")
            }
            _ => Ok(()),
        }
    }

    /// Writes a depth map: encoded if the scale is given, else as it is until the largest depth is known.
    fn write_depth(&mut self, number: usize, depth: &DepthMap) -> Result<String, FramesError> {
        self.create_folder("depth")?;
        let file = format!("depth/{number:06}.png");
        let path = self.root.join(&file);
        let largest = depth.grid().values().iter().copied().fold(0.0, f32::max);
        match self.header.depth_metres_per_unit {
            Some(unit) if f64::from(largest) > (LARGEST_UNIT + 0.5) * unit => {
                let reason = format!("cannot hold the {largest} m of frame {number} at {unit} m per unit");
                return Err(FramesError::file(&self.out, reason, "choose a coarser depth scale"));
            }
            Some(unit) => write_units(&path, depth, unit),
            None => spool(&path, depth),
        }
        .map_err(|error| self.in_place(error))?;
        self.largest_depth_m = self.largest_depth_m.max(largest);
        Ok(file)
    }

    fn write_mask(&self, number: usize, mask: &Mask) -> Result<String, FramesError> {
        self.create_folder("masks")?;
        let file = format!("masks/{number:06}.png");
        picture::write_mask_png(&self.root.join(&file), mask).map_err(|error| self.in_place(error))?;
        Ok(file)
    }

    /// Encodes the depth maps that waited for their scale; returns the scale, or `None` without any depth.
    fn encode_spooled_depth(&mut self) -> Result<Option<f64>, FramesError> {
        let files: Vec<&String> = self.rows.iter().filter_map(|row| row.depth.as_ref()).collect();
        let (Some(size), false) = (self.size, files.is_empty()) else { return Ok(None) };
        if let Some(unit) = self.header.depth_metres_per_unit {
            return Ok(Some(unit));
        }
        let unit = f64::from(self.largest_depth_m).max(f64::MIN_POSITIVE * LARGEST_UNIT) / LARGEST_UNIT;
        for file in files {
            let path = self.root.join(file);
            unspool(&path, size)
                .and_then(|depth| write_units(&path, &depth, unit))
                .map_err(|error| self.in_place(error))?;
        }
        Ok(Some(unit))
    }

    fn write_tables(&self, depth_metres_per_unit: Option<f64>) -> Result<(), FramesError> {
        let mut table = csv::Writer::from_writer(Vec::new());
        let written = self.rows.iter().try_for_each(|row| table.serialize(row));
        let (Ok(()), Ok(table)) = (written, table.into_inner()) else {
            return Err(FramesError::file(&self.out, "cannot hold its list of frames", "choose fewer frames"));
        };
        self.write_file("frames.csv", table)?;
        let Header { name, fps, license, provenance, .. } = self.header.clone();
        let units = "metres, seconds".into();
        let manifest = Manifest { version: VERSION, name, units, depth_metres_per_unit, fps, license, provenance };
        self.write_toml("sequence.toml", &manifest)?;
        if let Some(camera) = &self.header.camera {
            self.write_toml("camera.toml", camera)?;
        }
        if self.poses.is_empty() { Ok(()) } else { self.write_file("poses.tum", trajectory::to_tum(&self.poses)) }
    }

    fn write_toml(&self, name: &str, value: &impl Serialize) -> Result<(), FramesError> {
        let text = toml::to_string(value)
            .map_err(|error| FramesError::file(&self.out.join(name), error.to_string(), "correct the value"))?;
        self.write_file(name, text)
    }

    fn create_folder(&self, name: &str) -> Result<(), FramesError> {
        std::fs::create_dir_all(self.root.join(name)).map_err(|error| FramesError::io(&self.out, "create", error))
    }

    /// The same error about the destination: the workshop is nothing the user knows.
    fn in_place(&self, error: FramesError) -> FramesError {
        let place = |path: PathBuf| path.strip_prefix(&self.root).map(|inside| self.out.join(inside)).unwrap_or(path);
        match error {
            FramesError::Io { path, action, source, remedy } => {
                FramesError::Io { path: place(path), action, source, remedy }
            }
            FramesError::File { path, reason, remedy } => FramesError::File { path: place(path), reason, remedy },
            other => other,
        }
    }
}

fn refuse_occupied(out: &Path) -> Result<(), FramesError> {
    let occupied = match std::fs::read_dir(out) {
        Ok(mut entries) => entries.next().is_some(),
        Err(_) => out.exists(),
    };
    let error = || FramesError::file(out, "already holds something", "choose a new folder or remove this one");
    if occupied { Err(error()) } else { Ok(()) }
}

/// Stores metres as multiples of `unit`; a known depth stays known, however small.
fn write_units(path: &Path, depth: &DepthMap, unit: f64) -> Result<(), FramesError> {
    let units = |metres: &f32| match *metres {
        DepthMap::UNKNOWN => 0,
        metres => (f64::from(metres) / unit).round().clamp(1.0, LARGEST_UNIT) as u16,
    };
    picture::write_gray16_png(path, &depth.grid().map(units))
}

/// Stores a depth map bit by bit.
fn spool(path: &Path, depth: &DepthMap) -> Result<(), FramesError> {
    let write = |file| {
        let mut file = BufWriter::new(file);
        depth.grid().values().iter().try_for_each(|metres| file.write_all(&metres.to_le_bytes()))?;
        file.flush()
    };
    std::fs::File::create(path).and_then(write).map_err(|error| FramesError::io(path, "write", error))
}

fn unspool(path: &Path, size: Size) -> Result<DepthMap, FramesError> {
    let bytes = std::fs::read(path).map_err(|error| FramesError::io(path, "read", error))?;
    let metres = bytes.as_chunks().0.iter().copied().map(f32::from_le_bytes).collect();
    let grid = Grid::new(size, metres).map_err(|error| FramesError::file(path, error.to_string(), "try again"))?;
    Ok(DepthMap::new(grid))
}

#[cfg(test)]
mod tests;
