//! Each encoding against numbers put into a file of our own, and against real files where they are at hand.

use super::*;
use endoscape_core::CameraModel;
use endoscape_core::camera::{Intrinsics, Pinhole};
use image::{ImageBuffer, Rgb, Rgba};
use nalgebra::{Matrix3, Vector3};
use proptest::prelude::*;

const SIZE: Size = Size::new(3, 2);

fn file(folder: &tempfile::TempDir, name: &str, encoding: DepthEncoding) -> DepthFile {
    DepthFile { path: folder.path().join(name), encoding }
}

fn linear(metres_per_unit: f64, largest: u16) -> DepthEncoding {
    DepthEncoding::Linear { metres_per_unit, largest }
}

fn grey16(values: [u16; 6]) -> DynamicImage {
    DynamicImage::ImageLuma16(ImageBuffer::from_raw(3, 2, values.to_vec()).unwrap())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn linear_metres_are_exact(values in prop::array::uniform6(any::<u16>()), unit in 1e-6..1e-2) {
        let folder = tempfile::tempdir().unwrap();
        for name in ["depth.png", "depth.tiff"] {
            let depth = file(&folder, name, linear(unit, 65_534));
            grey16(values).save(&depth.path).unwrap();
            let read = depth.read(None, SIZE).unwrap();
            for (metres, value) in read.grid().values().iter().zip(values) {
                let expected = if value == 65_535 { 0.0 } else { (f64::from(value) * unit) as f32 };
                prop_assert_eq!(*metres, expected);
            }
        }
    }
}

#[test]
fn deflated_tiffs_read_like_plain_ones() {
    let folder = tempfile::tempdir().unwrap();
    let depth = file(&folder, "depth.tiff", linear(1e-3, u16::MAX));
    let mut encoder = tiff::encoder::TiffEncoder::new(std::fs::File::create(&depth.path).unwrap())
        .unwrap()
        .with_compression(tiff::encoder::Compression::Deflate(tiff::encoder::DeflateLevel::Balanced));
    encoder.write_image::<tiff::encoder::colortype::Gray16>(3, 2, &[0, 1, 2, 3, 4, 65_535]).unwrap();
    let read = depth.read(None, SIZE).unwrap();
    assert_eq!(read.grid().values(), [0.0, 0.001, 0.002, 0.003, 0.004, 65.535]);
}

#[test]
fn eight_bits_and_equal_channels_are_depth_but_colours_are_not() {
    let folder = tempfile::tempdir().unwrap();
    let depth = file(&folder, "grey.png", linear(0.5, 254));
    let grey = ImageBuffer::from_raw(3, 2, vec![0_u8, 1, 2, 3, 254, 255]).unwrap();
    DynamicImage::ImageLuma8(grey).save(&depth.path).unwrap();
    assert_eq!(depth.read(None, SIZE).unwrap().grid().values(), [0.0, 0.5, 1.0, 1.5, 127.0, 0.0]);

    let inverse = file(&folder, "rgba.png", DepthEncoding::InverseLike { metres_per_unit: 0.01 });
    let alike = |x: u32, _| [0_u8, 51, 255].map(|value| Rgba([value, value, value, 255]))[x as usize];
    ImageBuffer::from_fn(3, 2, alike).save(&inverse.path).unwrap();
    assert_eq!(inverse.read(None, SIZE).unwrap().grid().row(0), [0.0, 0.05, 0.01]);

    let colour = file(&folder, "colour.png", linear(1.0, 255));
    ImageBuffer::from_pixel(3, 2, Rgb([1_u8, 2, 1])).save(&colour.path).unwrap();
    assert!(colour.read(None, SIZE).unwrap_err().to_string().contains("is a colour picture"));
}

#[test]
fn another_size_is_an_error_that_names_both() {
    let folder = tempfile::tempdir().unwrap();
    let depth = file(&folder, "depth.png", linear(1.0, u16::MAX));
    grey16([1; 6]).save(&depth.path).unwrap();
    let error = depth.read(None, Size::new(4, 2)).unwrap_err().to_string();
    assert!(error.contains("the depth map is 3x2 but its frame is 4x2"), "{error}");
}

#[test]
fn points_give_their_third_coordinate_of_the_left_half() {
    let folder = tempfile::tempdir().unwrap();
    let depth = file(&folder, "points.tiff", DepthEncoding::PointsTiff { first_row: 1, rows: 2 });
    let point = |x: u32, y: u32| Rgb([f32::NAN, 7.0, if (x, y) == (0, 1) { f32::NAN } else { (100 * y + x) as f32 }]);
    DynamicImage::ImageRgb32F(ImageBuffer::from_fn(3, 4, point)).save(&depth.path).unwrap();
    assert_eq!(depth.read(None, SIZE).unwrap().grid().values(), [0.0, 0.101, 0.102, 0.2, 0.201, 0.202]);
    let beyond = DepthFile { encoding: DepthEncoding::PointsTiff { first_row: 3, rows: 2 }, ..depth.clone() };
    assert!(beyond.read(None, SIZE).unwrap_err().to_string().contains("has 4 rows but rows 3 to 5"));
    grey16([1; 6]).save(&depth.path).unwrap();
    assert!(depth.read(None, SIZE).is_err());
}

#[test]
fn exr_prefers_red_and_knows_z() {
    use exr::prelude::*;
    let folder = tempfile::tempdir().unwrap();
    let write = |path: &Path, names: [&str; 2]| {
        let channels = names.iter().enumerate().map(|(index, name)| {
            AnyChannel::new(*name, FlatSamples::F32((0..6).map(|i| (10 * index + i) as f32).collect()))
        });
        let layer = Layer::new(
            (3, 2),
            LayerAttributes::named("depth"),
            Encoding::FAST_LOSSLESS,
            AnyChannels::sort(channels.collect()),
        );
        Image::from_layer(layer).write().to_file(path).unwrap();
    };
    let depth = file(&folder, "depth.exr", DepthEncoding::Exr { metres_per_unit: 0.1 });
    write(&depth.path, ["B", "R"]);
    assert_eq!(depth.read(None, SIZE).unwrap().grid().values(), [1.0, 1.1, 1.2, 1.3, 1.4, 1.5]);
    write(&depth.path, ["A", "Z"]);
    assert_eq!(depth.read(None, SIZE).unwrap().grid().values()[5], 1.5);
    write(&depth.path, ["A", "B"]);
    assert!(depth.read(None, SIZE).unwrap_err().to_string().contains("none of the channels"));
    assert!(depth.read(None, Size::new(2, 2)).unwrap_err().to_string().contains("3x2"));
    let whole = std::fs::read(&depth.path).unwrap();
    for length in 0..whole.len() {
        std::fs::write(&depth.path, &whole[..length]).unwrap();
        assert!(depth.read(None, SIZE).is_err());
    }
}

#[test]
fn of_laser_points_on_one_pixel_the_nearest_wins() {
    let folder = tempfile::tempdir().unwrap();
    let depth = file(&folder, "scan.bin", DepthEncoding::Velodyne { camera_from_velodyne: Pose::identity() });
    let points: [[f32; 4]; 5] = [
        [0.0, 0.0, 8.0, 0.5],
        [0.0, 0.0, 4.0, 0.5],
        [0.0, 0.0, 6.0, 0.5],
        [0.0, 0.0, -2.0, 0.5],
        [f32::NAN, 0.0, 2.0, 0.5],
    ];
    let bytes: Vec<u8> = points.as_flattened().iter().flat_map(|value| value.to_le_bytes()).collect();
    std::fs::write(&depth.path, &bytes).unwrap();
    let intrinsics = Intrinsics { fx: 2.0, fy: 2.0, cx: 1.0, cy: 1.0, skew: 0.0 };
    let camera = Camera::new(SIZE, CameraModel::Pinhole(Pinhole { intrinsics })).unwrap();
    assert_eq!(depth.read(Some(&camera), SIZE).unwrap().grid().values(), [0.0, 0.0, 0.0, 0.0, 4.0, 0.0]);
    assert!(depth.read(None, SIZE).unwrap_err().to_string().contains("without a camera"));
    std::fs::write(&depth.path, &bytes[1..]).unwrap();
    assert!(depth.read(Some(&camera), SIZE).unwrap_err().to_string().contains("middle of a point"));
}

/// Median depth of real files in metres, found from the same files with OpenCV and NumPy.
#[test]
fn real_files_read_in_metres() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    if !root.exists() {
        eprintln!("skipped: no real data at {}", root.display());
        return;
    }
    let c3vd = linear(0.1 / 65_535.0, 65_534);
    let unity = DepthEncoding::InverseLike { metres_per_unit: 0.01 };
    for (name, encoding, size, median_m) in [
        ("c3vd/cecum_t1_a/0030_depth.tiff", c3vd.clone(), Size::new(1350, 1080), 0.028_644_235_9),
        ("c3vd/cecum_t1_a_original_files/0000_depth.tiff", c3vd, Size::new(1350, 1080), 0.031_624_322_9),
        ("tum/freiburg1_rpy/depth/1305031236.207190.png", linear(1.0 / 5000.0, 65_535), Size::new(640, 480), 0.779),
        ("simcol3d/Frames/Depth_0001.png", linear(0.2 / 65_280.0, 65_535), Size::new(475, 475), 0.016_470_588_2),
        ("endoslam/UnityCam/Stomach/Pixelwise Depths/aov_image_0000.png", unity, Size::new(320, 320), 0.318_75),
    ] {
        let read = DepthFile { path: root.join(name), encoding }.read(None, size).unwrap();
        let median = f64::from(read.median_m().unwrap());
        assert!((median / median_m - 1.0).abs() < 1e-6, "{name}: {median} m, expected {median_m} m");
    }
}

/// As above for a laser scan: KITTI calibration of 2011-09-26, projected by NumPy to 16377 pixels.
#[test]
fn a_real_laser_scan_falls_on_the_same_pixels() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/kitti-raw/2011_09_26/lidar_excerpt");
    if !root.exists() {
        eprintln!("skipped: no real data at {}", root.display());
        return;
    }
    let rotation = Matrix3::new(
        0.000_234_773_530_296_994_44,
        -0.999_944_177_353_392,
        -0.010_563_477_573_105_431,
        0.010_449_406_624_274_545,
        0.010_565_354_242_127_74,
        -0.999_889_585_499_778_6,
        0.999_945_375_899_398_8,
        0.000_124_365_535_367_121_33,
        0.010_451_303_776_255_558,
    );
    let translation = Vector3::new(-0.002_796_816_854_378_727, -0.075_108_794_403_375_06, -0.272_132_805_226_054_5);
    let camera_from_velodyne = endoscape_core::se3::from_matrix(&rotation, &translation).unwrap();
    let intrinsics = Intrinsics { fx: 721.5377, fy: 721.5377, cx: 609.5593, cy: 172.854, skew: 0.0 };
    let camera = Camera::new(Size::new(1242, 375), CameraModel::Pinhole(Pinhole { intrinsics })).unwrap();
    let path = root.join("velodyne_points/data/0000000000.bin");
    let depth = DepthFile { path, encoding: DepthEncoding::Velodyne { camera_from_velodyne } };
    let read = depth.read(Some(&camera), camera.size()).unwrap();
    let pixels = read.known().values().iter().filter(|known| **known).count();
    assert_eq!(pixels, 16_377);
    assert!((f64::from(read.median_m().unwrap()) - 8.096_210_353).abs() < 1e-6);
}
