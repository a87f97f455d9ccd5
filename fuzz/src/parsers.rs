//! Every parser of foreign text and bytes with a valid input for it.

use endoscape_core::trajectory;
use endoscape_frames::formats::{colmap, endomapper, endoslam, scared, unity};
use endoscape_frames::{camera_file, picture};
use std::io::{Cursor, Write as _};

/// A parser that takes any bytes, and an input it accepts.
pub struct Parser {
    /// Name of the fuzz target.
    pub name: &'static str,
    /// Answers any bytes without a panic, in bounded time and memory.
    pub parse: fn(&[u8]),
    /// A valid input.
    pub seed: fn() -> Vec<u8>,
}

/// Rows of a parser of text; its answer does not matter.
macro_rules! text {
    ($name:literal, $seed:expr, $parse:expr) => {
        Parser {
            name: $name,
            parse: |bytes| {
                if let Ok(text) = std::str::from_utf8(bytes) {
                    drop($parse(text));
                }
            },
            seed: || Vec::from($seed),
        }
    };
}

/// Rows of a parser of bytes.
macro_rules! bytes {
    ($name:literal, $seed:expr, $parse:expr) => {
        Parser { name: $name, parse: |bytes| drop($parse(bytes)), seed: || $seed }
    };
}

/// The table.
pub const PARSERS: &[Parser] = &[
    text!("camera", CAMERA_YAML, camera_file::parse),
    text!("camera_toml", CAMERA_TOML, camera_file::parse),
    bytes!("colmap_cameras", colmap_cameras(), colmap::parse_cameras),
    bytes!("colmap_images", colmap_images(), colmap::parse_images),
    text!("endomapper_info", "{\"endoscope_number\": \"3\"}", endomapper::parse_endoscope),
    bytes!("endoslam_workbook", workbook(), endoslam::parse_workbook),
    bytes!("picture_jpeg", picture(image::ImageFormat::Jpeg), |bytes| read_picture(bytes, ".jpg")),
    bytes!("picture_png", picture(image::ImageFormat::Png), |bytes| read_picture(bytes, ".png")),
    bytes!("picture_tiff", picture(image::ImageFormat::Tiff), |bytes| read_picture(bytes, ".tiff")),
    bytes!("scared_archive", archive(), scared::parse_archive),
    bytes!("scared_frame_data", FRAME_DATA.into(), scared::parse_frame_data),
    text!("trajectory_euroc", "#t\n1000,1,2,3,1,0,0,0\n", trajectory::parse_euroc),
    text!("trajectory_kitti", "1 0 0 0 0 1 0 0 0 0 1 0\n", trajectory::parse_kitti),
    text!("trajectory_tum", "# t\n0.1 1 2 3 0 0 0 1\n", trajectory::parse_tum),
    text!("unity_poses", "tX,tY,tZ,rX,rY,rZ,rW,time(s)\n0,0,0,0,0,0,1,0\n0,0,1", |text| {
        unity::parse_poses(text, ',', unity::METRES_PER_UNIT)
    }),
];

const CAMERA_YAML: &str = "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   \
    cols: 3\n   dt: d\n   data: [ 500., 0., 320., 0., 500., 240., 0., 0., 1. ]\ndistortion_coefficients: [ 0.1, 0.01, 0., 0. ]\n\
    P2: 1 0 0 0 0 1 0 0 0 0 1 0\n";
const CAMERA_TOML: &str = "width = 640\nheight = 480\nmodel = \"kannala-brandt\"\nfx = 300.0\nfy = 300.0\ncx = 320.0\ncy = 240.0\n\
    k1 = 0.1\nk2 = 0.0\nk3 = 0.0\nk4 = 0.0\n";
const FRAME_DATA: &str = "{\"camera-pose\": [[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}";

fn colmap_cameras() -> Vec<u8> {
    let mut bytes = 1_u64.to_le_bytes().to_vec();
    bytes.extend([1_u32, 5].iter().flat_map(|value| value.to_le_bytes()));
    bytes.extend([1440_u64, 1080].iter().flat_map(|value| value.to_le_bytes()));
    bytes.extend([717.0_f64, 718.0, 735.0, 552.0, -0.1, 0.0, 0.0, 0.0].iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

fn colmap_images() -> Vec<u8> {
    let mut bytes = 1_u64.to_le_bytes().to_vec();
    bytes.extend(1_u32.to_le_bytes());
    bytes.extend([1.0_f64, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0].iter().flat_map(|value| value.to_le_bytes()));
    bytes.extend(1_u32.to_le_bytes());
    bytes.extend(b"out1.png\0");
    bytes.extend(1_u64.to_le_bytes());
    bytes.extend([0; 24]);
    bytes
}

fn workbook() -> Vec<u8> {
    let mut workbook = rust_xlsxwriter::Workbook::new();
    let sheet = workbook.add_worksheet();
    let names = ["ImageFrame", "Pose_Index", "trans_x", "trans_y", "trans_z", "quot_x", "quot_y", "quot_z", "quot_w"];
    let numbers = [3.0, 0.0, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0];
    for (column, (name, number)) in (0..).zip(names.into_iter().zip(numbers)) {
        sheet.write(0, column, name).and_then(|sheet| sheet.write(1, column, number)).expect("cells of a small sheet");
    }
    workbook.save_to_buffer().expect("a workbook in memory")
}

fn archive() -> Vec<u8> {
    let mut builder = tar::Builder::new(flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast()));
    let mut header = tar::Header::new_gnu();
    header.set_size(FRAME_DATA.len() as u64);
    builder.append_data(&mut header, "frame_data000000.json", FRAME_DATA.as_bytes()).expect("a file in memory");
    builder.into_inner().and_then(|encoder| encoder.finish()).expect("an archive in memory")
}

fn picture(format: image::ImageFormat) -> Vec<u8> {
    let pixels = image::RgbImage::from_fn(9, 7, |x, y| image::Rgb([x as u8 * 20, y as u8 * 30, 90]));
    let mut bytes = Cursor::new(Vec::new());
    pixels.write_to(&mut bytes, format).expect("a picture in memory");
    bytes.into_inner()
}

/// Pictures are read from files, as users have them.
fn read_picture(bytes: &[u8], ending: &str) -> Option<endoscape_core::Image> {
    let mut file = tempfile::Builder::new().suffix(ending).tempfile().ok()?;
    file.write_all(bytes).ok()?;
    picture::read(file.path()).ok()
}
