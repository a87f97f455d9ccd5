//! Videos made on the spot by ffmpeg; without it the tests say so and pass.

use super::decoder::{Decoder, Selection};
use super::*;
use crate::{FrameSource, Sequence, formats};
use endoscape_core::{Frame, Rect, Size};
use std::io::{BufRead as _, Write as _};
use std::net::TcpListener;
use std::path::PathBuf;

const FRAMES: usize = 30;

/// A folder to make videos in, or `None` with a line on standard error where there is no ffmpeg.
fn studio() -> Option<tempfile::TempDir> {
    if Command::new("ffmpeg").arg("-version").output().is_err() {
        eprintln!("skipped: no ffmpeg");
        return None;
    }
    Some(tempfile::tempdir().unwrap())
}

/// A test picture of 64x48 that changes from frame to frame.
fn video(folder: &tempfile::TempDir, name: &str, options: &[&str]) -> PathBuf {
    let path = folder.path().join(name);
    let source = format!("testsrc=size=64x48:rate=30:duration={}", FRAMES as f64 / 30.0);
    let status = Command::new("ffmpeg")
        .args(["-v", "error", "-f", "lavfi", "-i", &source, "-pix_fmt", "yuv420p"])
        .args(options)
        .arg(&path)
        .status();
    assert!(status.unwrap().success());
    path
}

/// All frames and all errors.
fn drain(source: &mut dyn FrameSource) -> (Vec<Frame>, Vec<String>) {
    let (mut frames, mut errors) = (Vec::new(), Vec::new());
    loop {
        match source.next_frame() {
            Ok(Some(frame)) => frames.push(frame),
            Ok(None) => return (frames, errors),
            Err(error) => errors.push(error.to_string()),
        }
    }
}

fn read_all(path: &Path) -> (Vec<Frame>, Vec<String>) {
    drain(&mut VideoReader::open(path, None, None).unwrap())
}

#[test]
fn every_frame_comes_with_its_time() {
    let Some(folder) = studio() else { return };
    for (name, options) in [
        ("h264.mp4", ["-c:v", "libx264", "-bf", "2"]),
        ("mpeg4.avi", ["-c:v", "mpeg4", "-bf", "0"]),
        ("b-frames.avi", ["-c:v", "mpeg4", "-bf", "2"]),
        ("mjpeg.mkv", ["-c:v", "mjpeg", "-q:v", "5"]),
        ("stream.ts", ["-c:v", "mpeg2video", "-bf", "2"]),
    ] {
        let path = video(&folder, name, &options);
        let info = probe(&path).unwrap();
        assert_eq!((info.size, info.fps), (Size::new(64, 48), Some(30.0)), "{name}");
        let (frames, errors) = read_all(&path);
        assert_eq!((frames.len(), errors.len()), (FRAMES, 0), "{name}: {errors:?}");
        for (index, frame) in frames.iter().enumerate() {
            assert_eq!(frame.index, index, "{name}");
            assert!((frame.time_s - index as f64 / 30.0).abs() < 0.6e-3, "{name}: {} s", frame.time_s);
        }
        let sequence = formats::open(&path, None).unwrap();
        assert!(sequence.frames.iter().map(|frame| frame.time_s).eq(frames.iter().map(|frame| frame.time_s)));
    }
}

#[test]
fn variable_frame_rates_keep_their_times() {
    let Some(folder) = studio() else { return };
    let options = ["-vf", "setpts=N*(N+1)/2", "-vsync", "passthrough", "-c:v", "mjpeg"];
    let (frames, errors) = read_all(&video(&folder, "variable.mkv", &options));
    assert_eq!((frames.len(), errors.len()), (FRAMES, 0));
    for (n, frame) in frames.iter().enumerate() {
        let exact = (n * (n + 1)) as f64 / 60.0;
        assert!((frame.time_s - exact).abs() < 0.6e-3, "frame {n}: {} s instead of {exact} s", frame.time_s);
    }
}

#[test]
fn a_part_is_the_same_as_that_part_of_the_whole() {
    let Some(folder) = studio() else { return };
    let path = video(&folder, "a.mp4", &["-c:v", "libx264", "-bf", "2", "-g", "10"]);
    let (whole, _) = read_all(&path);
    let crop = Rect { x: 3, y: 5, size: Size::new(31, 17) };
    for range in [0..1, 7..12, 29..30, 12..12] {
        let (part, errors) = drain(&mut VideoReader::open(&path, Some(crop), Some(range.clone())).unwrap());
        assert!(errors.is_empty(), "{errors:?}");
        assert_eq!(part.iter().map(|frame| frame.index).collect::<Vec<_>>(), range.clone().collect::<Vec<_>>());
        for frame in part {
            assert_eq!(frame.time_s, whole[frame.index].time_s);
            assert_eq!(*frame.image, whole[frame.index].image.cropped(crop).unwrap());
        }
    }
    let beyond = VideoReader::open(&path, None, Some(20..31)).unwrap_err().to_string();
    assert!(beyond.contains("it has 30 frames"), "{beyond}");
    let outside = Rect { x: 40, ..crop };
    assert!(VideoReader::open(&path, Some(outside), None).unwrap_err().to_string().contains("its pictures are 64x48"));
}

#[test]
fn a_video_held_upright_is_delivered_upright() {
    let Some(folder) = studio() else { return };
    let path = video(&folder, "a.mp4", &["-c:v", "mpeg4"]);
    let mut bytes = std::fs::read(&path).unwrap();
    // The matrix of the track header (ISO 14496-12, 8.3.2) becomes a quarter turn.
    let at = bytes.windows(4).position(|name| name == b"tkhd").unwrap() + 44;
    let turn: [i32; 9] = [0, 0x1_0000, 0, -0x1_0000, 0, 0, 0, 0, 0x4000_0000];
    bytes[at..at + 36].copy_from_slice(&turn.map(i32::to_be_bytes).concat());
    std::fs::write(&path, bytes).unwrap();
    assert_eq!(probe(&path).unwrap().size, Size::new(48, 64));
    let (frames, errors) = read_all(&path);
    assert_eq!((frames.len(), errors.len()), (FRAMES, 0));
    assert_eq!(frames[0].image.size(), Size::new(48, 64));
}

#[test]
fn a_video_cut_short_is_an_error() {
    let Some(folder) = studio() else { return };
    for (name, options) in [
        ("end.mp4", ["-c:v", "mpeg4", "-movflags", "0"]),
        ("front.mp4", ["-c:v", "mpeg4", "-movflags", "+faststart"]),
        ("a.avi", ["-c:v", "mpeg4", "-bf", "0"]),
        ("a.mkv", ["-c:v", "mpeg4", "-bf", "0"]),
    ] {
        let path = video(&folder, name, &options);
        let whole = std::fs::read(&path).unwrap();
        for share in [0, 30, 90] {
            std::fs::write(&path, &whole[..whole.len() * share / 100]).unwrap();
            let error = formats::open(&path, None).expect_err(name).to_string();
            assert!(error.contains(name) && !error.contains('\n') && error.matches("; ").count() == 1, "{error}");
        }
    }
}

#[test]
fn a_damaged_frame_is_reported_and_the_others_keep_their_numbers() {
    let Some(folder) = studio() else { return };
    let path = video(&folder, "a.mkv", &["-c:v", "mjpeg", "-q:v", "3"]);
    let mut bytes = std::fs::read(&path).unwrap();
    let starts: Vec<usize> = (0..bytes.len() - 3).filter(|at| bytes[*at..].starts_with(&[0xFF, 0xD8, 0xFF])).collect();
    assert_eq!(starts.len(), FRAMES);
    bytes[starts[12]..starts[12] + 700].fill(0);
    std::fs::write(&path, bytes).unwrap();
    let mut reader = VideoReader::open(&path, None, None).unwrap();
    let (frames, errors) = drain(&mut reader);
    assert_eq!(errors.len(), 1);
    assert!(errors[0].contains("frame 12 does not decode"), "{}", errors[0]);
    let expected: Vec<usize> = (0..FRAMES).filter(|index| *index != 12).collect();
    assert_eq!(frames.iter().map(|frame| frame.index).collect::<Vec<_>>(), expected);
    assert!(reader.warnings()[0].contains("complained"));
}

#[test]
fn without_ffmpeg_the_error_names_the_package() {
    let programs = Programs { ffmpeg: "no-such-ffmpeg".into(), ffprobe: "no-such-ffprobe".into() };
    let path = Path::new("a.mp4");
    let described = programs.probe(path).unwrap_err().to_string();
    let decoded = Decoder::start(&programs, path, &Selection::default()).unwrap_err().to_string();
    for (error, program) in [(described, "`ffprobe`"), (decoded, "`ffmpeg`")] {
        assert!(error.contains(program) && error.contains("install the package `ffmpeg`"), "{error}");
    }
}

#[test]
fn what_is_no_video_is_not_taken_for_one() {
    let Some(folder) = studio() else { return };
    let text = folder.path().join("notes.txt");
    std::fs::write(&text, "line of text\n".repeat(50)).unwrap();
    assert!(matches!(formats::open(&text, None), Err(FramesError::Unrecognised { .. })));
    let disguised = folder.path().join("notes.mp4");
    std::fs::write(&disguised, "line of text\n".repeat(50)).unwrap();
    assert!(formats::open(&disguised, None).unwrap_err().to_string().contains("notes.mp4"));
    let sound = folder.path().join("sound.mp4");
    let tone = ["-v", "error", "-f", "lavfi", "-i", "sine=duration=0.2"];
    assert!(Command::new("ffmpeg").args(tone).arg(&sound).status().unwrap().success());
    assert!(formats::open(&sound, None).unwrap_err().to_string().contains("no video stream"));
}

#[test]
fn names_that_look_like_addresses_or_options_are_files() {
    let Some(folder) = studio() else { return };
    let plain = video(&folder, "a.mp4", &["-c:v", "mpeg4"]);
    for name in ["http:colon.mp4", "-dash.mp4", "with space 'n quote.mp4"] {
        let path = folder.path().join(name);
        std::fs::copy(&plain, &path).unwrap();
        assert_eq!(read_all(&path).0.len(), FRAMES, "{name}");
    }
}

#[test]
fn the_process_ends_with_its_reader() {
    let Some(folder) = studio() else { return };
    let path = video(&folder, "a.mp4", &["-vf", "scale=1280:960", "-c:v", "mpeg4"]);
    let mut decoder = Decoder::start(&Programs::default(), &path, &Selection::default()).unwrap();
    assert!(decoder.next_picture().unwrap().is_some());
    let process = decoder.process();
    assert!(!process.has_ended());
    drop(decoder);
    assert!(process.has_ended());
}

/// Serves the same bytes to everyone who asks, as a camera on the network does.
fn serve(bytes: Vec<u8>) -> PathBuf {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}/live.ts", listener.local_addr().unwrap());
    std::thread::spawn(move || {
        for mut stream in listener.incoming().map_while(Result::ok) {
            let bytes = bytes.clone();
            std::thread::spawn(move || {
                std::io::BufReader::new(&stream).read_line(&mut String::new()).ok();
                stream.write_all(b"HTTP/1.0 200 OK\r\nContent-Type: video/mp2t\r\n\r\n").ok();
                stream.write_all(&bytes).ok();
            });
        }
    });
    address.into()
}

#[test]
fn of_a_live_source_the_newest_frames_are_kept_and_the_others_counted() {
    let Some(folder) = studio() else { return };
    let path = video(&folder, "a.ts", &["-c:v", "mpeg2video"]);
    let address = serve(std::fs::read(path).unwrap());
    let mut live = LiveReader::open(&address, None).unwrap();
    // A method slower than the source: by now all frames have come, and only the last few still wait.
    std::thread::sleep(std::time::Duration::from_secs(2));
    let (frames, errors) = drain(&mut live);
    assert!(errors.is_empty(), "{errors:?}");
    assert_eq!(frames.len() + live.dropped(), FRAMES);
    assert!(live.dropped() > 0 && live.warnings()[0].contains("were dropped"));
    assert_eq!(frames.last().unwrap().index, FRAMES - 1);
    assert!((frames.last().unwrap().time_s - 29.0 / 30.0).abs() < 1e-3);
}

#[test]
fn a_live_address_opens_as_a_sequence() {
    let Some(folder) = studio() else { return };
    let address = serve(std::fs::read(video(&folder, "a.ts", &["-c:v", "mpeg2video"])).unwrap());
    let sequence: Sequence = formats::open(&address, None).unwrap();
    assert!(sequence.is_live() && sequence.frames.is_empty());
    let mut source = sequence.open_frames(0..0).unwrap();
    assert_eq!(source.next_frame().unwrap().unwrap().image.size(), sequence.size);
}

#[test]
fn a_silent_address_is_an_error() {
    if studio().is_none() {
        return;
    }
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let address = PathBuf::from(format!("http://127.0.0.1:{port}/nothing"));
    let error = LiveReader::open(&address, None).unwrap().next_frame().unwrap_err().to_string();
    assert!(error.contains("gives no picture (Connection refused)"), "{error}");
    assert!(formats::open(&address, None).is_err());
}

#[test]
fn real_clips_have_the_frames_they_are_said_to_have() {
    let clips = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/clips");
    if !clips.exists() || studio().is_none() {
        eprintln!("skipped: no real data at {}", clips.display());
        return;
    }
    for (name, count) in [("eg_pulling_gt.mp4", 63), ("jk_endoscope.avi", 183), ("rvim_endo.mp4", 250)] {
        let (frames, errors) = read_all(&clips.join(name));
        assert_eq!((frames.len(), errors.len()), (count, 0), "{name}: {errors:?}");
    }
}
