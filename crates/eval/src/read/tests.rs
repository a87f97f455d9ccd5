use super::*;
use crate::poses::Stamps;
use proptest::prelude::*;
use std::io::Write as _;

fn read(bytes: &[u8]) -> Result<Poses, EvalError> {
    poses(bytes, None, Duplicates::Refuse)
}

/// A version 1.0 `.npy` file.
fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
    let length = u16::try_from(header.len()).unwrap().to_le_bytes();
    [numpy::NPY_MAGIC, &[1, 0], &length, header.as_bytes(), data].concat()
}

fn doubles(numbers: &[f64]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

#[test]
fn formats_are_told_apart_by_content() {
    assert_eq!(detect(b"# time\n0 1 2 3 0 0 0 1\n"), Ok(TrajectoryFormat::Tum));
    assert_eq!(detect(b"1 0 0 0 0 1 0 0 0 0 1 0\n"), Ok(TrajectoryFormat::Kitti));
    assert_eq!(detect(b"7 1 0 0 0 0 1 0 0 0 0 1 0\n"), Ok(TrajectoryFormat::Kitti));
    assert_eq!(detect(b"#t\n1403715524907143168,1,2,3,1,0,0,0,9\n"), Ok(TrajectoryFormat::Euroc));
    assert_eq!(detect(b"time,x,y,z,qx,qy,qz,qw\n0,1,2,3,0,0,0,1\n"), Ok(TrajectoryFormat::Csv));
    assert_eq!(detect(&npy("<f8", "(0, 8)", &[])), Ok(TrajectoryFormat::Npy));
    assert_eq!(detect(b"\n# nothing\n"), Err(EvalError::Empty));
    for wrong in [&b"To whom it may concern"[..], b"1 2 3", b"1,2,3", b"\xff\xfe\x00"] {
        assert!(matches!(detect(wrong), Err(EvalError::NoTrajectory { .. })));
    }
}

#[test]
fn every_format_gives_the_same_pose() {
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    let options = zip::write::SimpleFileOptions::default();
    let matrix = [1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 2.0, 0.0, 0.0, 1.0, 3.0];
    for (name, array) in
        [("times.npy", npy("<f8", "(1,)", &doubles(&[5.0]))), ("poses.npy", npy("<f8", "(1, 3, 4)", &doubles(&matrix)))]
    {
        archive.start_file(name, options).unwrap();
        archive.write_all(&array).unwrap();
    }
    let inputs: [(&[u8], bool); 7] = [
        (b"5 1 2 3 0 0 0 1", true),
        (b"1 0 0 1 0 1 0 2 0 0 1 3", false),
        (b"5000000000000000000,1,2,3,1,0,0,0", false),
        (b"qw,qx,qy,qz,z,y,x,time_s\n1,0,0,0,3,2,1,5", true),
        (&npy("<f8", "(1, 8)", &doubles(&[5.0, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0])), true),
        (&npy("<f8", "(1, 12)", &doubles(&matrix)), false),
        (&archive.finish().unwrap().into_inner(), true),
    ];
    for (bytes, timed) in inputs {
        let poses = read(bytes).unwrap();
        assert_eq!(poses.world_from_camera()[0].translation.vector.as_slice(), [1.0, 2.0, 3.0]);
        if timed {
            assert_eq!(poses.stamps(), &Stamps::Seconds(vec![5.0]));
        }
    }
}

#[test]
fn frame_numbers_of_kitti_files_are_kept() {
    let poses = read(b"3 1 0 0 0 0 1 0 0 0 0 1 0\n9 1 0 0 0 0 1 0 0 0 0 1 0").unwrap();
    assert_eq!(poses.stamps(), &Stamps::Frames(vec![3, 9]));
}

#[test]
fn bad_files_get_one_sentence_with_the_line() {
    let sentence = |bytes: &[u8]| read(bytes).unwrap_err().to_string();
    assert!(sentence(b"0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 0").starts_with("line 2: the quaternion has norm"));
    assert!(sentence(b"0 0 0 0 0 0 0 1\n1 nan 0 0 0 0 0 1").starts_with("line 2: `nan` is not a finite number"));
    assert!(sentence(b"1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0").starts_with("line 2: found 4 numbers"));
    assert!(sentence(b"1 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1").starts_with("the stamps are not sorted"));
    assert!(sentence(b"1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1").contains("same stamp"));
    assert!(sentence(b"time,x,y,z,qx,qy,qz,qw\n0,1,2,3,0,0,0").contains("line 2"));
    assert!(sentence(b"time,x,y,qx,qy,qz,qw\n0,1,2,0,0,0,1").contains("names no column tz"));
    assert!(sentence(b"PK\x03\x04 but not really").contains("archive"));
    let kept = poses(b"1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1", None, Duplicates::Keep).unwrap();
    assert_eq!(kept.len(), 2);
}

#[test]
fn arrays_that_lie_are_refused() {
    let all = "(18446744073709551615, 18446744073709551615)";
    for (descr, shape) in [("<f8", all), ("<f8", "(1000000000000, 8)"), ("|O", "(1, 8)"), ("<f8", "(1, 5"), ("<f8", "")]
    {
        assert!(matches!(read(&npy(descr, shape, &[0; 64])), Err(EvalError::NoTrajectory { .. })), "{descr} {shape}");
    }
    assert!(read(&npy("<f8", "(1, 3)", &[0; 24])).unwrap_err().to_string().contains("holds no poses"));
    assert!(read(b"\x93NUMPY\x02\x00\xff\xff\xff\xff").is_err());
    assert_eq!(numpy::array(&npy("<f4", "(2, 1)", &[0, 0, 128, 63, 0, 0, 0, 64])).unwrap().values, [1.0, 2.0]);
}

proptest! {
    #[test]
    fn any_bytes_are_answered(head in 0..4_usize, bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let heads: [&[u8]; 4] = [b"", numpy::NPY_MAGIC, b"PK\x03\x04", b"0 0 0 0 0 0 0 1\n"];
        // An answer either way; the property is that none panics.
        let _ = read(&[heads[head], &bytes].concat());
    }

    #[test]
    fn any_header_is_answered(header in "[{}'a-z:(), 0-9<]{0,80}") {
        let length = u16::try_from(header.len()).unwrap().to_le_bytes();
        let _ = read(&[numpy::NPY_MAGIC, &[1, 0], &length, header.as_bytes(), &[0; 96]].concat());
    }
}
