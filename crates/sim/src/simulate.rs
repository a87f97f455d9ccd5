//! A sequence folder from a seed.
//!
//! ```text
//! out/  everything of `endoscape_frames::sequence_folder`: frames, camera, poses, depth, usable masks
//!       labels/NNNNNN.png     class of every pixel; labels.csv names them
//!       flow/NNNNNN.png       surface flow to the next frame, 16 bits as in KITTI: (value - 32768) / 64 pixels
//!       specular/, occluder/, defocus/   NNNNNN.png, white where that covers the wall
//!       magnet.toml, magnet.csv   the capsule's magnet and the Hall sensors' readings, one per frame
//!       simulation.toml       what was asked for
//! ```

use crate::anatomy::{Anatomy, Organ};
use crate::deformation::Deformation;
use crate::light::Lamps;
use crate::magnet::{Hall, Magnetometer};
use crate::medium::Medium;
use crate::mucosa::{Label, Mucosa};
use crate::path::{Flight, PathKind, WINDOW_M};
use crate::render::{Moment, Optics, Sample, Scene};
use crate::sensor::{Developed, Sensor, encode};
use crate::surface::Posed;
use crate::{Effect, Effects, SimError};
use endoscape_core::camera::{Intrinsics, KannalaBrandt};
use endoscape_core::magnetic::{READINGS_FILE, RIG_FILE, csv_header, csv_row};
use endoscape_core::{Camera, DepthMap, Event, EventSink, Grid, Image, Pose, Size};
use endoscape_frames::magnet::rig_to_toml;
use endoscape_frames::sequence_folder::{Header, Writer, WrittenFrame};
use nalgebra::Vector3;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Field of view of the capsule lens from the left to the right edge, radians; capsules have 140 to 170 degrees.
const CAPSULE_FOV_RAD: f64 = 145.0 / 180.0 * std::f64::consts::PI;
/// Share of the interval between frames that a rolling shutter takes to read all rows.
const READ_OUT: f64 = 0.6;
/// Most frames of one sequence.
const MOST_FRAMES: usize = 1_000_000;

/// Where the wall comes from.
#[derive(Clone, Debug, PartialEq)]
pub enum Source {
    /// Grown from the seed.
    Organ(Organ),
    /// An OBJ or PLY file.
    Mesh {
        /// The file.
        path: PathBuf,
        /// Length of its unit, metres.
        metres_per_unit: f64,
        /// The organ whose mucosa and motion it gets.
        like: Organ,
    },
}

/// What to simulate.
#[derive(Clone, Debug)]
pub struct Config {
    /// The organ.
    pub source: Source,
    /// Number of frames.
    pub frames: usize,
    /// Frames per second.
    pub fps: f64,
    /// Seed of everything random.
    pub seed: u64,
    /// The camera; see [`capsule_lens`].
    pub camera: Camera,
    /// How it moves.
    pub path: PathKind,
    /// What is switched on.
    pub effects: Effects,
    /// The Hall sensors under the table.
    pub hall: Hall,
}

/// What was done.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// Frames written.
    pub frames: usize,
    /// Camera rays cast, without those for shadows.
    pub rays: u64,
    /// Time taken, seconds.
    pub elapsed_s: f64,
    /// How much slower than wished the path was flown to stay within its limits; 1 if not.
    pub pace: f64,
}

/// The lens of a capsule: equidistant, 145 degrees wide.
///
/// # Errors
/// [`SimError::Camera`] for a size without pixels.
pub fn capsule_lens(size: Size) -> Result<Camera, SimError> {
    let f = size.width as f64 / CAPSULE_FOV_RAD;
    let (cx, cy) = (0.5 * size.width as f64 - 0.5, 0.5 * size.height as f64 - 0.5);
    let intrinsics = Intrinsics { fx: f, fy: f, cx, cy, skew: 0.0 };
    Ok(Camera::new(size, KannalaBrandt { intrinsics, k1: 0.0, k2: 0.0, k3: 0.0, k4: 0.0 }.into())?)
}

impl Config {
    /// Refuses what cannot be simulated, before any work.
    ///
    /// # Errors
    /// [`SimError::Parameter`] with the first parameter that cannot be.
    pub fn validate(&self) -> Result<(), SimError> {
        let refuse = |what: String, remedy: &str| Err(SimError::parameter(what, remedy));
        if !(1..=MOST_FRAMES).contains(&self.frames) {
            return refuse(format!("{} frames are no sequence", self.frames), "ask for 1 to 1000000 frames");
        }
        if !(0.1..=1000.0).contains(&self.fps) {
            return refuse(format!("{} frames per second are no video", self.fps), "ask for 0.1 to 1000");
        }
        let size = self.camera.size();
        if size.width < 8 || size.height < 8 || size.area() > 1 << 24 {
            return refuse(format!("{size} is no size of a frame"), "ask for 8x8 to 4096x4096 pixels");
        }
        match &self.source {
            Source::Mesh { metres_per_unit, .. } if !(metres_per_unit.is_finite() && *metres_per_unit > 0.0) => {
                refuse(format!("a mesh unit of {metres_per_unit} m is no length"), "give metres above zero")
            }
            _ => Ok(()),
        }
    }

    /// Grows or reads the organ.
    ///
    /// # Errors
    /// [`SimError::Mesh`] for a mesh that is no wall.
    pub fn anatomy(&self) -> Result<Anatomy, SimError> {
        match &self.source {
            Source::Organ(organ) => Ok(Anatomy::grow(*organ, self.seed)),
            Source::Mesh { path, metres_per_unit, like } => Anatomy::import(path, *metres_per_unit, *like, self.seed),
        }
    }
}

/// Simulates a sequence and writes it to the folder `out`, which must not exist or be empty.
///
/// # Errors
/// [`SimError`] for parameters that cannot be, a mesh that is no wall, a path that touches the wall, or a folder that
/// cannot be written. Nothing is left behind then.
pub fn simulate(config: &Config, out: &Path, sink: &mut dyn EventSink) -> Result<Summary, SimError> {
    config.validate()?;
    let started = Instant::now();
    let magnetometer = Magnetometer::new(config.hall, config.effects, config.seed)?;
    let anatomy = config.anatomy()?;
    let mut writer = Writer::create(out, header(config, &anatomy))?;
    let patient = Patient::new(config, &anatomy);
    let mut session = Session::start(&patient)?;
    writer.append(READINGS_FILE, &csv_header(magnetometer.rig().array().positions_m.len()))?;
    sink.event(Event::Started { stage: "simulating".into(), total: Some(config.frames as u64) });
    let mut frame = session.next_frame()?;
    for number in 0..config.frames {
        let more = number + 1 < config.frames;
        // One frame is written while the next is made.
        let (written, next) =
            rayon::join(|| write(&mut writer, number, &frame), || more.then(|| session.next_frame()).transpose());
        written?;
        let reading = magnetometer.read(number, frame.time_s, &frame.world_from_camera);
        writer.append(READINGS_FILE, &csv_row(&reading))?;
        sink.event(Event::Advanced { done: number as u64 + 1 });
        let Some(next) = next? else { break };
        frame = next;
    }
    sink.event(Event::Finished);
    writer.write_file(RIG_FILE, rig_to_toml(magnetometer.rig())?)?;
    writer.write_file("labels.csv", label_names())?;
    writer.write_file("simulation.toml", description(config))?;
    let pace = session.flight.pace();
    writer.finish()?;
    let rays = (config.frames * config.camera.size().area()) as u64;
    Ok(Summary { frames: config.frames, rays, elapsed_s: started.elapsed().as_secs_f64(), pace })
}

/// An organ with everything that is worked out once for a sequence.
#[derive(Debug)]
pub struct Patient<'a> {
    config: &'a Config,
    anatomy: &'a Anatomy,
    deformation: Deformation,
    mucosa: Mucosa,
    optics: Optics,
    lamps: Lamps,
}

impl<'a> Patient<'a> {
    /// Prepares an organ for the camera.
    pub fn new(config: &'a Config, anatomy: &'a Anatomy) -> Self {
        Self {
            config,
            anatomy,
            deformation: anatomy.deformation(config.effects),
            mucosa: Mucosa::new(&anatomy.look, config.seed),
            optics: Optics::new(config.camera),
            // Four diodes around the lens, as in most capsules.
            lamps: Lamps::ring(4, 0.0020, 1.0),
        }
    }
}

/// A frame with all its truth.
#[derive(Clone, Debug)]
pub struct Rendered {
    /// Seconds since the first frame.
    pub time_s: f64,
    /// Pose of the camera at the frame's middle row.
    pub world_from_camera: Pose,
    /// What every pixel sees, row after row.
    pub samples: Vec<Sample>,
    /// The picture and its masks.
    pub developed: Developed,
}

/// A running simulation: frames come one after another.
pub struct Session<'a> {
    patient: &'a Patient<'a>,
    flight: Flight<'a>,
    medium: Medium,
    sensor: Sensor,
    now: Posed<'a>,
    next: Posed<'a>,
    number: usize,
}

impl<'a> Session<'a> {
    /// Plans the flight and brings the organ into its first shape.
    ///
    /// # Errors
    /// [`SimError::Parameter`] if no camera fits into the organ.
    pub fn start(patient: &'a Patient<'a>) -> Result<Self, SimError> {
        let Patient { config, anatomy, deformation, .. } = patient;
        let duration_s = config.frames as f64 / config.fps;
        let flight = Flight::plan(config.path, anatomy, deformation, config.effects, (duration_s, config.seed))?;
        let mut now = Posed::new(&anatomy.wall);
        if !deformation.is_still() {
            let first = deformation.at(0.0);
            now.repose(|vertex| first.position(vertex));
        }
        let sensor = Sensor::new(config.effects, config.seed, anatomy.usual_distance_m());
        let medium = Medium::new(config.effects, config.seed);
        Ok(Self { patient, flight, medium, sensor, next: now.clone(), now, number: 0 })
    }

    /// The next frame.
    ///
    /// # Errors
    /// [`SimError::Wall`] if the camera would touch the wall.
    pub fn next_frame(&mut self) -> Result<Rendered, SimError> {
        let Patient { config, anatomy, deformation, mucosa, optics, lamps } = self.patient;
        let interval_s = 1.0 / config.fps;
        let (time_s, next_s) = (self.number as f64 * interval_s, (self.number + 1) as f64 * interval_s);
        if !deformation.is_still() {
            let shape = deformation.at(next_s);
            self.next.repose(|vertex| shape.position(vertex));
        }
        let now = Moment { wall: &self.now, world_from_camera: self.rows(time_s) };
        let next = Moment { wall: &self.next, world_from_camera: self.rows(next_s) };
        let world_from_camera = self.flight.pose(time_s);
        self.check_clearance(&world_from_camera)?;
        let scene = Scene { anatomy, mucosa, optics, lamps, effects: config.effects };
        let samples = scene.render(&now, &next);
        let veil = self.medium.veil(&scene, &now, &samples, time_s);
        let number = self.number as u64;
        let developed = self.sensor.develop(number, interval_s, optics, &samples, veil.as_ref())?;
        std::mem::swap(&mut self.now, &mut self.next);
        self.number += 1;
        Ok(Rendered { time_s, world_from_camera, samples, developed })
    }

    /// Pose of the camera while each row is read.
    fn rows(&self, time_s: f64) -> Vec<Pose> {
        let height = self.patient.optics.size().height;
        if !self.patient.config.effects.has(Effect::RollingShutter) {
            return vec![self.flight.pose(time_s); height];
        }
        let row_s = READ_OUT / self.patient.config.fps / height as f64;
        (0..height).map(|y| self.flight.pose(time_s + (y as f64 - (height / 2) as f64) * row_s)).collect()
    }

    /// Looks all around: the wall must be there, and not too near.
    fn check_clearance(&self, world_from_camera: &Pose) -> Result<(), SimError> {
        const LOOKS: usize = 64;
        let place = world_from_camera.translation.vector;
        let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
        let look = |i: usize| {
            let z = 1.0 - (2.0 * i as f64 + 1.0) / LOOKS as f64;
            let across = (1.0 - z * z).sqrt();
            let direction = Vector3::new(across * (golden * i as f64).cos(), across * (golden * i as f64).sin(), z);
            self.now.cast(&place, &direction, 2.0).map(|hit| hit.distance_m)
        };
        let seen: Vec<f64> = (0..LOOKS).filter_map(look).collect();
        // A mesh may have a few holes, but most views must end at a wall.
        let outside = 2 * seen.len() < LOOKS;
        let clearance_m = if outside { 0.0 } else { seen.into_iter().fold(f64::INFINITY, f64::min) };
        // The plan keeps the whole window free of vertices; between them the wall may be a little nearer.
        let least_m = 0.75 * WINDOW_M;
        if clearance_m < least_m {
            let (clearance_mm, least_mm) = (1e3 * clearance_m, 1e3 * least_m);
            return Err(SimError::Wall { frame: self.number, clearance_mm, least_mm });
        }
        Ok(())
    }
}

impl Rendered {
    /// Depth along the optical axis.
    pub fn depth(&self) -> DepthMap {
        let size = self.developed.image.size();
        DepthMap::new(Grid::from_fn(size, |x, y| self.samples[y * size.width + x].depth_m as f32))
    }
}

fn header(config: &Config, anatomy: &Anatomy) -> Header {
    let name = match &config.source {
        Source::Organ(organ) => organ.name().to_string(),
        Source::Mesh { path, .. } => path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
    };
    // Of a mesh only the pictures are ours to give away.
    let license = matches!(config.source, Source::Organ(_)).then(|| "MIT OR Apache-2.0".to_string());
    Header {
        name: format!("simulated {name}, seed {}", config.seed),
        fps: Some(config.fps),
        camera: Some(config.camera),
        license,
        provenance: Some(format!(
            "endoscape simulate {}, path {}, effects {}",
            name,
            config.path.name(),
            config.effects
        )),
        // The farthest view fits, so the scale is known before the first frame.
        depth_metres_per_unit: Some(1.02 * anatomy.extent_m() / f64::from(u16::MAX)),
    }
}

fn write(writer: &mut Writer, number: usize, frame: &Rendered) -> Result<(), SimError> {
    let Rendered { time_s, world_from_camera, samples, developed } = frame;
    let (size, depth) = (developed.image.size(), frame.depth());
    writer.write_frame(&WrittenFrame {
        number,
        time_s: *time_s,
        image: &developed.image,
        depth: Some(&depth),
        mask: Some(&developed.usable),
        world_from_camera: Some(*world_from_camera),
    })?;
    let labels: Vec<u8> = samples.iter().map(|sample| sample.label).collect();
    writer.write_file(&format!("labels/{number:06}.png"), encode::gray_png(size, &labels)?)?;
    writer.write_file(&format!("flow/{number:06}.png"), encode::flow_png(size, samples.iter().map(|s| s.flow))?)?;
    for (name, mask) in
        [("specular", &developed.specular), ("occluder", &developed.occluder), ("defocus", &developed.defocus)]
    {
        if mask.values().contains(&true) {
            writer.write_file(&format!("{name}/{number:06}.png"), encode::mask_png(mask)?)?;
        }
    }
    Ok(())
}

fn label_names() -> String {
    let line = |(value, name): (usize, &&str)| format!("{value},{name}\n");
    format!("value,name\n{}", Label::NAMES.iter().enumerate().map(line).collect::<String>())
}

fn description(config: &Config) -> String {
    let Config { source, frames, fps, seed, path, effects, .. } = config;
    let source = match source {
        Source::Organ(organ) => format!("anatomy = \"{}\"", organ.name()),
        Source::Mesh { path, metres_per_unit, like } => {
            let file = path.file_name().unwrap_or_default().to_string_lossy().replace(['"', '\\'], "_");
            format!("mesh = \"{file}\"\nmesh_unit = {metres_per_unit:?}\nanatomy = \"{}\"", like.name())
        }
    };
    let (path, version) = (path.name(), env!("CARGO_PKG_VERSION"));
    format!(
        "version = \"{version}\"\n{source}\nframes = {frames}\nfps = {fps:?}\nseed = {seed}\npath = \"{path}\"\neffects = \"{effects}\"\n"
    )
}

/// Pictures side by side, `columns` to a row, with a white gap: a contact sheet.
pub fn sheet(pictures: &[Image], columns: usize) -> Image {
    const GAP: usize = 4;
    let Some(first) = pictures.first() else { return Image::from_fn(Size::new(1, 1), |_, _| [255; 3]) };
    let (cell, columns) = (first.size(), columns.clamp(1, pictures.len()));
    let rows = pictures.len().div_ceil(columns);
    let size = Size::new(columns * (cell.width + GAP) - GAP, rows * (cell.height + GAP) - GAP);
    Image::from_fn(size, |x, y| {
        let (column, row) = (x / (cell.width + GAP), y / (cell.height + GAP));
        let picture = pictures.get(row * columns + column);
        picture.and_then(|p| p.get(x % (cell.width + GAP), y % (cell.height + GAP))).unwrap_or([255; 3])
    })
}
