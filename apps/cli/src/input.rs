//! Arguments that several commands share: what to read and through which camera.

use anyhow::Context as _;
use endoscape_core::{Camera, Size};
use endoscape_frames::{Format, Sequence, camera_file, formats};
use std::ops::Range;
use std::path::PathBuf;

/// The input and what is known about its camera.
#[derive(clap::Args, Clone, Debug)]
pub struct InputArgs {
    /// Video file, folder of images, data-set sequence, sequence folder, or live address that ffmpeg understands.
    pub input: PathBuf,
    /// Read it as this format instead of finding out.
    #[arg(long, value_name = "NAME")]
    pub format: Option<Format>,
    /// Calibration file: our camera.toml, OpenCV YAML, KITTI calib.txt, calibu XML or JSON.
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
    /// How to read the camera matrix of SimCol3D, whose file most likely has fy and cx swapped.
    #[arg(long, value_name = "READING", default_value = "fixed")]
    pub simcol_k: SimcolMatrix,
}

/// The two readings of SimCol3D's `cam.txt`.
#[derive(clap::ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum SimcolMatrix {
    /// fx = fy = 227.604 and the principal point in the middle.
    Fixed,
    /// As the file stands.
    Literal,
}

impl InputArgs {
    /// Opens the input with the camera of `--camera`, if given.
    pub fn open(&self) -> anyhow::Result<Sequence> {
        let mut sequence = formats::open(&self.input, self.format)?;
        if self.simcol_k == SimcolMatrix::Literal && sequence.format == Format::Simcol3d {
            sequence.camera = Some(formats::simcol3d::literal_camera(sequence.size)?);
        }
        if let Some(file) = &self.camera {
            let camera = camera_file::read_camera(file, Some(sequence.size))?;
            set_camera(&mut sequence, camera)?;
        }
        Ok(sequence)
    }

    /// As [`InputArgs::open`]; an input without calibration gets a pinhole of the stated field of view.
    pub fn open_assuming(&self, horizontal_fov_deg: Option<f64>) -> anyhow::Result<Sequence> {
        let mut sequence = self.open()?;
        if let (None, Some(degrees)) = (&sequence.camera, horizontal_fov_deg) {
            let camera = Camera::from_field_of_view(sequence.size, degrees.to_radians())
                .with_context(|| format!("--hfov {degrees}"))?;
            sequence.camera = Some(camera);
            let assumed = format!("the camera is assumed: a pinhole of {degrees} degrees, as --hfov says");
            sequence.warnings.push(assumed);
        }
        Ok(sequence)
    }
}

/// Uses another calibration, scaled to the frames where its size differs.
fn set_camera(sequence: &mut Sequence, camera: Camera) -> anyhow::Result<()> {
    if camera.size() != sequence.size {
        sequence.warnings.push(format!(
            "the frames are {} but the camera file is for {}: its intrinsics were scaled to the frames",
            sequence.size,
            camera.size()
        ));
    }
    sequence.camera = Some(camera.scaled_to(sequence.size)?);
    Ok(())
}

/// Parses `WIDTHxHEIGHT`.
pub fn parse_size(text: &str) -> Result<Size, String> {
    let wrong = || format!("`{text}` is no size; write WIDTHxHEIGHT, such as 320x256");
    let (width, height) = text.split_once('x').ok_or_else(wrong)?;
    let extent = |text: &str| text.parse::<usize>().ok().filter(|value| (1..=16_384).contains(value)).ok_or_else(wrong);
    Ok(Size::new(extent(width)?, extent(height)?))
}

/// Parses `A..B`, frames A to B - 1 counted from 0; either end may be left out.
pub fn parse_range(text: &str) -> Result<Range<usize>, String> {
    let wrong = || format!("`{text}` is no range; write A..B, such as 0..120 for the first 120 frames");
    let (start, end) = text.split_once("..").ok_or_else(wrong)?;
    let start = if start.is_empty() { 0 } else { start.parse().map_err(|_| wrong())? };
    let end = if end.is_empty() { usize::MAX } else { end.parse().map_err(|_| wrong())? };
    if start < end { Ok(start..end) } else { Err(wrong()) }
}

/// Parses an angle in degrees that a pinhole can have.
pub fn parse_field_of_view(text: &str) -> Result<f64, String> {
    let degrees: f64 = text.parse().map_err(|_| format!("`{text}` is no angle in degrees"))?;
    if (1.0..=170.0).contains(&degrees) {
        Ok(degrees)
    } else {
        Err(format!("{text} degrees is outside the 1 to 170 a pinhole can have"))
    }
}
