//! Round trips, refusals, and nothing left behind.

use super::*;
use crate::formats::open;
use crate::{Format, Sequence};
use endoscape_core::camera::{Intrinsics, KannalaBrandt, RadialTangential};
use endoscape_core::{CameraModel, se3};
use nalgebra::Vector6;
use proptest::prelude::*;

const SIZE: Size = Size::new(6, 4);

fn image(seed: usize) -> Image {
    Image::from_fn(SIZE, |x, y| [(40 * x + seed) as u8, (60 * y + seed) as u8, (seed * 7) as u8])
}

fn frame(number: usize, image: &Image) -> WrittenFrame<'_> {
    WrittenFrame { number, time_s: 0.1 * number as f64, image, depth: None, mask: None, world_from_camera: None }
}

fn header() -> Header {
    Header { name: "test".into(), ..Header::default() }
}

/// A folder of three plain frames.
fn written(parent: &Path) -> PathBuf {
    let out = parent.join("out");
    let mut writer = Writer::create(&out, header()).unwrap();
    for number in 0..3 {
        let pose = Some(Pose::translation(number as f64, 0.0, 0.0));
        writer.write_frame(&WrittenFrame { world_from_camera: pose, ..frame(number, &image(number)) }).unwrap();
    }
    writer.finish().unwrap();
    out
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn what_is_written_reads_back(
        twists in prop::collection::vec(prop::array::uniform6(-2.0..2.0_f64), 1..4),
        lens in prop::array::uniform8(-0.3..0.3_f64),
        depths in prop::collection::vec(prop_oneof![Just(0.0_f32), 1e-4..0.3_f32], SIZE.area()),
        start in -10.0..1e9_f64,
        given in any::<bool>(),
    ) {
        let parent = tempfile::tempdir().unwrap();
        let out = parent.path().join("out");
        let intrinsics = Intrinsics { fx: 3.0 + lens[0], fy: 3.0 + lens[1], cx: 2.5 + lens[2], cy: 1.5, skew: 0.0 };
        let model = RadialTangential { p1: 0.01 * lens[3], ..RadialTangential::from_opencv(intrinsics, &lens[4..]) };
        let camera = Camera::new(SIZE, CameraModel::RadialTangential(model)).unwrap();
        let fps = Some(1.0 / 0.3);
        let header = Header { camera: Some(camera), fps, depth_metres_per_unit: given.then_some(1e-5), ..header() };
        let depth = DepthMap::new(Grid::new(SIZE, depths).unwrap());
        let mask = Grid::from_fn(SIZE, |x, y| x > y);
        let times: Vec<f64> = (0..twists.len()).map(|index| start + index as f64 / 29.97).collect();
        let mut writer = Writer::create(&out, header).unwrap();
        for (number, twist) in twists.iter().enumerate() {
            let pose = (number != 1).then(|| se3::exp(&Vector6::from(*twist)));
            let (time_s, image) = (times[number], image(number));
            let frame = frame(3 * number, &image);
            let frame = WrittenFrame { time_s, depth: Some(&depth), mask: Some(&mask), world_from_camera: pose, ..frame };
            writer.write_frame(&frame).unwrap();
        }
        writer.finish().unwrap();

        let read = open(&out, None).unwrap();
        prop_assert_eq!((read.format, read.size, read.fps), (Format::Sequence, SIZE, fps));
        prop_assert_eq!(read.camera, Some(camera));
        let mut source = read.open_frames(0..read.frames.len()).unwrap();
        for (index, entry) in read.frames.iter().enumerate() {
            let frame = source.next_frame().unwrap().unwrap();
            prop_assert_eq!((frame.index, frame.time_s, entry.number), (index, times[index], 3 * index));
            prop_assert_eq!(&*frame.image, &image(index));
            prop_assert_eq!(frame.usable.as_deref(), Some(&mask));
            let stored = read.read_depth(index).unwrap().unwrap();
            let unit = stored_unit(&read);
            prop_assert_eq!(stored.known(), depth.known());
            for (a, b) in stored.grid().values().iter().zip(depth.grid().values()) {
                // Half a unit, and the rounding of the metres to f32; the smallest depths stay known at one unit.
                let smallest = f64::from(*b) < unit;
                prop_assert!(smallest || f64::from((a - b).abs()) <= 0.5 * unit + 1e-7 * f64::from(*b));
            }
            match entry.world_from_camera {
                None => prop_assert_eq!(index, 1),
                Some(pose) => prop_assert!(se3::log(&(pose.inverse() * se3::exp(&Vector6::from(twists[index])))).norm() < 1e-9),
            }
        }
        prop_assert!(source.next_frame().unwrap().is_none());
    }
}

fn stored_unit(sequence: &Sequence) -> f64 {
    let depth = sequence.frames[0].depth.as_ref().unwrap();
    let crate::depth::DepthEncoding::Linear { metres_per_unit, .. } = depth.encoding else { return f64::NAN };
    metres_per_unit
}

#[test]
fn the_whole_range_of_depth_is_used() {
    let parent = tempfile::tempdir().unwrap();
    let out = parent.path().join("out");
    let mut writer = Writer::create(&out, header()).unwrap();
    for (number, metres) in [0.05_f32, 0.2, 0.1].into_iter().enumerate() {
        let depth = DepthMap::new(Grid::filled(SIZE, metres));
        writer.write_frame(&WrittenFrame { depth: Some(&depth), ..frame(number, &image(0)) }).unwrap();
    }
    writer.finish().unwrap();
    let read = open(&out, None).unwrap();
    assert!((stored_unit(&read) - f64::from(0.2_f32) / 65_535.0).abs() < 1e-18);
    assert_eq!(names(&out.join("depth")), ["000000.png", "000001.png", "000002.png"]);
}

#[test]
fn every_camera_model_survives_to_the_last_bit() {
    let parent = tempfile::tempdir().unwrap();
    let intrinsics = Intrinsics { fx: 717.690_818_1, fy: 1.0 / 3.0, cx: 2.1, cy: -0.0, skew: 1e-300 };
    let model = KannalaBrandt { intrinsics, k1: 0.1, k2: -1e-17, k3: 0.0, k4: 5e-324 };
    let camera = Camera::new(SIZE, CameraModel::KannalaBrandt(model)).unwrap();
    let out = parent.path().join("out");
    let mut writer = Writer::create(&out, Header { camera: Some(camera), ..header() }).unwrap();
    writer.write_frame(&frame(0, &image(0))).unwrap();
    writer.finish().unwrap();
    assert_eq!(open(&out, None).unwrap().camera, Some(camera));
}

#[test]
fn an_occupied_destination_is_refused_and_an_empty_one_filled() {
    let parent = tempfile::tempdir().unwrap();
    let out = parent.path().join("out");
    std::fs::create_dir(&out).unwrap();
    assert_eq!(written(parent.path()), out);
    let error = Writer::create(&out, header()).unwrap_err().to_string();
    assert!(error.contains("already holds something"), "{error}");
    assert!(Writer::create(Path::new("/"), header()).is_err());
    let orphan = parent.path().join("no/such/place");
    assert!(Writer::create(&orphan, header()).unwrap_err().to_string().contains("parent folder"));
}

#[test]
fn nothing_is_left_of_a_writer_that_stops_or_fails() {
    let parent = tempfile::tempdir().unwrap();
    let out = parent.path().join("out");
    let mut writer = Writer::create(&out, header()).unwrap();
    writer.write_frame(&frame(0, &image(0))).unwrap();
    assert!(!out.exists());
    drop(writer);
    assert!(names(parent.path()).is_empty());
    assert!(Writer::create(&out, header()).unwrap().finish().unwrap_err().to_string().contains("no frame"));
    assert!(names(parent.path()).is_empty());
}

#[test]
fn a_refused_write_names_the_destination_not_the_workshop() {
    let parent = tempfile::tempdir().unwrap();
    let out = parent.path().join("out");
    let mut writer = Writer::create(&out, header()).unwrap();
    std::fs::remove_dir_all(&writer.root).unwrap();
    let error = writer.write_frame(&frame(0, &image(0))).unwrap_err().to_string();
    assert!(error.starts_with(&out.join("frames/000000.png").display().to_string()), "{error}");
}

#[test]
fn frames_that_do_not_fit_are_refused() {
    let parent = tempfile::tempdir().unwrap();
    let mut writer = Writer::create(&parent.path().join("out"), header()).unwrap();
    let picture = image(0);
    writer.write_frame(&frame(4, &picture)).unwrap();
    let earlier = writer.write_frame(&frame(4, &picture)).unwrap_err().to_string();
    assert!(earlier.contains("is not after frame 4"), "{earlier}");
    let other = Image::from_fn(Size::new(2, 2), |_, _| [0; 3]);
    assert!(writer.write_frame(&frame(5, &other)).unwrap_err().to_string().contains("its picture is 2x2"));
    let timeless = WrittenFrame { time_s: f64::NAN, ..frame(6, &picture) };
    assert!(writer.write_frame(&timeless).is_err());
    let far = DepthMap::new(Grid::filled(SIZE, 9.0));
    writer.header.depth_metres_per_unit = Some(1e-4);
    let deep = WrittenFrame { depth: Some(&far), ..frame(7, &picture) };
    assert!(writer.write_frame(&deep).unwrap_err().to_string().contains("coarser depth scale"));
}

#[test]
fn damaged_folders_name_file_and_line() {
    let cases = [
        ("sequence.toml", "version = 1\nname = ", "sequence.toml, line 2"),
        ("sequence.toml", "version = 9\nname = 'x'\nunits = ''", "version 9"),
        ("frames.csv", "index,time_s,file\n0,0.0,frames/000000.png\n1,soon,frames/000001.png\n", "frames.csv, line 3"),
        ("frames.csv", "index,time_s,file\n0,0.0\n", "frames.csv, line 2"),
        ("frames.csv", "index,time_s,file\n0,0.0,frames/000009.png\n", "no file `frames/000009.png`"),
        ("frames.csv", "index,time_s,file\n0,0.0,../out/frames/000000.png\n", "does not lie inside"),
        ("frames.csv", "index,time_s,file\n1,1.0,frames/000000.png\n0,2.0,frames/000001.png\n", "frames.csv, line 3"),
        ("frames.csv", "index,time_s,file\n", "lists no frame"),
        ("poses.tum", "# t\n0.7 0 0 0 0 0 0 1\n", "poses.tum, line 2: no frame"),
        ("poses.tum", "0 0 0 0 0 0 0\n", "poses.tum, line 1"),
        ("camera.toml", "width = 6\nheight = 4\nmodel = 'teapot'\n", "camera.toml, line"),
        (
            "camera.toml",
            "width = 7\nheight = 4\nmodel = 'pinhole'\nfx = 1.0\nfy = 1.0\ncx = 0.0\ncy = 0.0\n",
            "is for 7x4",
        ),
    ];
    for (name, text, expected) in cases {
        let parent = tempfile::tempdir().unwrap();
        let out = written(parent.path());
        std::fs::write(out.join(name), text).unwrap();
        let error = open(&out, None).unwrap_err().to_string();
        assert!(error.contains(expected) && !error.contains('\n'), "{name}: {error}");
    }
}
