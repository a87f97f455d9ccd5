//! Every parser of foreign text and bytes with a valid input for it.

use endoscape_core::camera::{Intrinsics, Pinhole};
use endoscape_core::{Camera, Pose, Size, trajectory};
use endoscape_frames::depth::{DepthEncoding, DepthFile};
use endoscape_frames::formats::{
    bronchoscope, c3vd, c3vd_v2, colmap, endomapper, endoslam, euroc, euroc_sensor, hamlyn, kitti, kitti_oxts,
    kitti_raw, scared, simcol3d, tum, unity,
};
use endoscape_frames::{Format, Sequence, camera_file, formats, picture};
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
                    let _ = $parse(text);
                }
            },
            seed: || Vec::from($seed),
        }
    };
}

/// Rows of a parser of bytes.
macro_rules! bytes {
    ($name:literal, $seed:expr, $parse:expr) => {
        Parser {
            name: $name,
            parse: |bytes| {
                let _ = $parse(bytes);
            },
            seed: || $seed,
        }
    };
}

/// The table.
pub const PARSERS: &[Parser] = &[
    text!("bronchoscope_state", "time,bend,rotation,insertion\n0,1,2,3\n", bronchoscope::parse_state),
    text!("c3vd_poses", "1,0,0,0,0,1,0,0,0,0,1,0,5,6,7,1\n", c3vd::parse_poses),
    text!("c3vd_v2_intrinsics", C3VD_V2, c3vd_v2::parse_intrinsics),
    text!("camera", CAMERA_YAML, camera_file::parse),
    text!("camera_toml", CAMERA_TOML, camera_file::parse),
    bytes!("colmap_cameras", colmap_cameras(), colmap::parse_cameras),
    bytes!("colmap_images", colmap_images(), colmap::parse_images),
    bytes!("depth_points", points(), |bytes| {
        read_depth(bytes, ".tiff", DepthEncoding::PointsTiff { first_row: 0, rows: DEPTH_SIZE.height })
    }),
    bytes!("depth_velodyne", scan(), |bytes| {
        read_depth(bytes, ".bin", DepthEncoding::Velodyne { camera_from_velodyne: Pose::identity() })
    }),
    text!("endomapper_info", "{\"endoscope_number\": \"3\"}", endomapper::parse_endoscope),
    bytes!("endoslam_workbook", workbook(), endoslam::parse_workbook),
    text!("euroc_frames", "#timestamp [ns],filename\n1000,1000.png\n", euroc::parse_frames),
    text!("euroc_sensor", SENSOR, euroc_sensor::parse_sensor),
    text!("hamlyn_intrinsics", "10 0 5 0\n0 11 6 0\n0 0 1 0\n", hamlyn::parse_intrinsics),
    text!("kitti_calibration", "P2: 1 0 0 0 0 1 0 0 0 0 1 0\nTr: 1 0 0 0 0 1 0 0 0 0 1 0\n", kitti_calibration),
    text!("kitti_oxts", OXTS, kitti_oxts::parse_packet),
    text!("kitti_timestamps", "2011-09-26 13:02:25.964389445\n", kitti_raw::parse_timestamps),
    bytes!("picture_jpeg", picture(image::ImageFormat::Jpeg), |bytes| read_picture(bytes, ".jpg")),
    bytes!("picture_png", picture(image::ImageFormat::Png), |bytes| read_picture(bytes, ".png")),
    bytes!("picture_tiff", picture(image::ImageFormat::Tiff), |bytes| read_picture(bytes, ".tiff")),
    bytes!("scared_archive", archive(), scared::parse_archive),
    bytes!("scared_frame_data", FRAME_DATA.into(), scared::parse_frame_data),
    text!("sequence_frames", "index,time_s,file\n0,0.0,frames/000000.png\n", |text| open_folder("frames.csv", text)),
    text!("sequence_toml", SEQUENCE_TOML, |text| open_folder("sequence.toml", text)),
    text!("simcol3d_camera", "227.6 0 227.6 0 237.5 237.5 0 0 1\n", simcol3d::parse_camera),
    text!("simcol3d_poses", "0 0 0 1\n", |text| (simcol3d::parse_positions(text), simcol3d::parse_rotations(text))),
    text!("trajectory_euroc", "#t\n1000,1,2,3,1,0,0,0\n", trajectory::parse_euroc),
    text!("trajectory_kitti", "1 0 0 0 0 1 0 0 0 0 1 0\n", trajectory::parse_kitti),
    text!("trajectory_tum", "# t\n0.1 1 2 3 0 0 0 1\n", trajectory::parse_tum),
    text!("tum_list", "# timestamp filename\n1305031907.5 rgb/1305031907.5.png\n", tum::parse_list),
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

const C3VD_V2: &str = "width: 1350\nheight: 1080\ncx: 678.5\ncy: 543.0\na0: 769.2\na1: 0\na2: -8.1e-4\na3: 6.3e-7\na4: -1.2e-9\n\
    c: 1\nd: 0\ne: 0\n";
const SENSOR: &str = "sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [1, 0, 0, 0,\n         0, 1, 0, 0,\n         0, 0, 1, 0,\n \
            0, 0, 0, 1]\nrate_hz: 20\nresolution: [752, 480]\ncamera_model: pinhole\nintrinsics: [458.6, 457.3, 367.2, 248.4]\n\
    distortion_model: radial-tangential\ndistortion_coefficients: [-0.28, 0.07, 0.0002, 0.00002]\n";
const OXTS: &str = "49.0 8.4 112.8 0.02 0.001 -2.4 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 4 8 4 4 0\n";

/// A calibration file's lines are understood when they are asked for.
fn kitti_calibration(text: &str) -> Option<bool> {
    let calibration = kitti::parse_calibration(text).ok()?;
    Some(calibration.projection("P2").is_ok() && calibration.rigid("R", "T").is_ok())
}

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

/// Size of the depth maps made here.
const DEPTH_SIZE: Size = Size::new(9, 7);
const SEQUENCE_TOML: &str = "version = 1\nname = \"seed\"\nunits = \"metres\"\nfps = 25.0\n";

/// Three floating-point channels, as SCARED stores points.
fn points() -> Vec<u8> {
    let pixels =
        image::Rgb32FImage::from_pixel(DEPTH_SIZE.width as u32, DEPTH_SIZE.height as u32, image::Rgb([1.0, 2.0, 30.0]));
    let mut bytes = Cursor::new(Vec::new());
    image::DynamicImage::from(pixels).write_to(&mut bytes, image::ImageFormat::Tiff).expect("a picture in memory");
    bytes.into_inner()
}

/// Two points of a laser scan.
fn scan() -> Vec<u8> {
    [0.1_f32, 0.2, 3.0, 0.5, 0.0, 0.0, 2.0, 0.1].iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn read_depth(bytes: &[u8], ending: &str, encoding: DepthEncoding) -> Option<endoscape_core::DepthMap> {
    let mut file = tempfile::Builder::new().suffix(ending).tempfile().ok()?;
    file.write_all(bytes).ok()?;
    let intrinsics = Intrinsics { fx: 5.0, fy: 5.0, cx: 4.0, cy: 3.0, skew: 0.0 };
    let camera = Camera::new(DEPTH_SIZE, Pinhole { intrinsics }.into()).ok()?;
    DepthFile { path: file.path().to_path_buf(), encoding }.read(Some(&camera), DEPTH_SIZE).ok()
}

/// Opens a sequence folder in which one file holds this text.
fn open_folder(name: &str, text: &str) -> Option<Sequence> {
    let folder = tempfile::tempdir().ok()?;
    let root = folder.path();
    std::fs::create_dir(root.join("frames")).ok()?;
    std::fs::write(root.join("frames/000000.png"), picture(image::ImageFormat::Png)).ok()?;
    std::fs::write(root.join("sequence.toml"), SEQUENCE_TOML).ok()?;
    std::fs::write(root.join("frames.csv"), "index,time_s,file\n0,0.0,frames/000000.png\n").ok()?;
    std::fs::write(root.join(name), text).ok()?;
    formats::open(root, Some(Format::Sequence)).ok()
}
