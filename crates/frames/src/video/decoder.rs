//! The `ffmpeg` process: one picture with its time after the other.
//!
//! Invariant: `showinfo` logs a frame before `ffmpeg` writes its pixels, so for every picture on the pipe a header is
//! already on its way. The process never outlives its [`Decoder`].

use super::index::{REMEDY, VideoIndex, VideoInfo};
use super::{Programs, command, input_arguments, not_started};
use crate::FramesError;
use endoscape_core::{Image, Rect, Size};
use std::io::{BufRead, BufReader, Read};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};

/// Headers that may wait for their pixels; ffmpeg works a few frames ahead of its output.
const HEADERS_AHEAD: usize = 1024;
/// Largest picture accepted, in pixels.
const LARGEST_AREA: usize = 1 << 27;

/// What to decode.
#[derive(Clone, Debug, Default)]
pub(super) struct Selection {
    /// Block of each picture to keep.
    pub crop: Option<Rect>,
    /// Time stamps to keep, in the stream's own units.
    pub stamps: Option<Range<i64>>,
}

/// What is known of a frame before its pixels arrive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Header {
    /// Time stamp in the stream's own units; `None` where the stream has none.
    pub stamp: Option<i64>,
    /// Seconds per unit of the time stamp, as a fraction.
    pub time_base: [i64; 2],
    /// Size of the picture.
    pub size: Size,
}

impl Header {
    /// The time stamp in seconds.
    pub fn time_s(&self) -> Option<f64> {
        let [numerator, denominator] = self.time_base;
        self.stamp.map(|stamp| stamp as f64 * numerator as f64 / denominator as f64)
    }
}

/// Complaints of the decoder so far.
#[derive(Clone, Debug, Default)]
pub(super) struct Complaints {
    /// How many.
    pub count: usize,
    /// The first one, usually the cause of the others.
    pub first: Option<String>,
}

/// A handle that can end the process from another thread.
#[derive(Clone, Debug)]
pub(super) struct Process(Arc<Mutex<Child>>);

impl Process {
    /// Ends the process and takes its exit status, so that no zombie stays.
    pub fn end(&self) {
        let mut child = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        // Both fail only if the process has already been waited for.
        child.kill().ok();
        child.wait().ok();
    }

    /// Whether the process is gone and its exit status taken.
    #[cfg(test)]
    pub fn has_ended(&self) -> bool {
        self.0.lock().unwrap().try_wait().unwrap().is_some()
    }
}

/// A running `ffmpeg` and what it delivers.
#[derive(Debug)]
pub(super) struct Decoder {
    path: PathBuf,
    process: Process,
    pixels: BufReader<ChildStdout>,
    headers: Receiver<Header>,
    complaints: Arc<Mutex<Complaints>>,
}

impl Decoder {
    /// Starts decoding to RGB.
    ///
    /// # Errors
    /// [`FramesError::Program`] without ffmpeg.
    pub fn start(programs: &Programs, path: &Path, selection: &Selection) -> Result<Self, FramesError> {
        Self::start_with(programs, path, selection, &["-f", "rawvideo", "-pix_fmt", "rgb24", "pipe:1"])
    }

    fn start_with(
        programs: &Programs,
        path: &Path,
        selection: &Selection,
        output: &[&str],
    ) -> Result<Self, FramesError> {
        let mut ffmpeg = command(&programs.ffmpeg);
        ffmpeg.args(["-hide_banner", "-nostdin", "-nostats", "-v", "repeat+level+info"]);
        // Time stamps stay those of the container (`copyts`), and no frame is repeated or dropped to keep a rate.
        ffmpeg.arg("-copyts").args(input_arguments(path)).args(["-map", "0:V:0", "-vf", &filters(selection)]);
        ffmpeg.args(["-vsync", "passthrough"]).args(output);
        let mut child = ffmpeg.spawn().map_err(|error| not_started(path, "ffmpeg", &error))?;
        let pipes = child.stdout.take().zip(child.stderr.take());
        let process = Process(Arc::new(Mutex::new(child)));
        let Some((pixels, log)) = pipes else {
            process.end();
            return Err(FramesError::file(path, "the pipes to ffmpeg are missing", "try again"));
        };
        let (sender, headers) = sync_channel(HEADERS_AHEAD);
        let complaints = Arc::new(Mutex::new(Complaints::default()));
        let shared = Arc::clone(&complaints);
        std::thread::spawn(move || read_log(BufReader::new(log), &sender, &shared));
        Ok(Self { path: path.to_path_buf(), process, pixels: BufReader::new(pixels), headers, complaints })
    }

    /// A handle to end the process while another thread waits for its pixels.
    pub fn process(&self) -> Process {
        self.process.clone()
    }

    /// What ffmpeg complained about so far.
    pub fn complaints(&self) -> Complaints {
        self.complaints.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The next picture, or `None` when the stream is over, whether it was whole or not.
    ///
    /// # Errors
    /// [`FramesError::File`] for pictures too large to be true.
    pub fn next_picture(&mut self) -> Result<Option<(Header, Image)>, FramesError> {
        let Ok(header) = self.headers.recv() else { return Ok(None) };
        let size = header.size;
        if size.width.checked_mul(size.height).is_none_or(|area| area == 0 || area > LARGEST_AREA) {
            return Err(FramesError::file(&self.path, format!("says its pictures are {size}"), REMEDY));
        }
        let mut rgb = vec![0; 3 * size.area()];
        if self.pixels.read_exact(&mut rgb).is_err() {
            return Ok(None);
        }
        let image = Image::new(size, rgb).map_err(|error| FramesError::file(&self.path, error.to_string(), REMEDY))?;
        Ok(Some((header, image)))
    }
}

impl Drop for Decoder {
    fn drop(&mut self) {
        self.process.end();
    }
}

/// Times of all frames by decoding them all, for containers whose packets have none.
pub(super) fn index_by_decoding(programs: &Programs, path: &Path, info: VideoInfo) -> Result<VideoIndex, FramesError> {
    let decoder = Decoder::start_with(programs, path, &Selection::default(), &["-f", "null", "-"])?;
    let mut index = VideoIndex { info, stamps: Vec::new() };
    for header in &decoder.headers {
        let Some(stamp) = header.stamp else {
            let remedy = "give it times with `ffmpeg -i IN -c copy OUT.mp4`";
            return Err(FramesError::file(path, "does not say when its frames are", remedy));
        };
        index.info.time_base = header.time_base;
        index.stamps.push(stamp);
    }
    index.stamps.sort_unstable();
    index.stamps.dedup();
    Ok(index)
}

/// The filter chain: choose, convert, crop (after the conversion, so that odd offsets are exact), log.
fn filters(selection: &Selection) -> String {
    let mut chain = Vec::new();
    if let Some(Range { start, end }) = selection.stamps {
        chain.push(format!("trim=start_pts={start}:end_pts={end}"));
    }
    chain.push("format=rgb24".into());
    if let Some(Rect { x, y, size: Size { width, height } }) = selection.crop {
        chain.push(format!("crop={width}:{height}:{x}:{y}"));
    }
    chain.push("showinfo=checksum=0".into());
    chain.join(",")
}

/// Sorts the log into headers and complaints until the process ends. Goes on reading when nobody wants headers any
/// more: a full pipe would stop ffmpeg.
fn read_log(mut log: impl BufRead, headers: &SyncSender<Header>, complaints: &Mutex<Complaints>) {
    let mut time_base = [1, 1];
    let mut line = Vec::new();
    while log.read_until(b'\n', &mut line).is_ok_and(|length| length > 0) {
        let text = String::from_utf8_lossy(&line);
        if text.starts_with("[Parsed_showinfo") {
            time_base = parse_time_base(&text).unwrap_or(time_base);
            if let Some(header) = parse_header(&text, time_base) {
                headers.send(header).ok();
            }
        } else if let Some((_, message)) = text.split_once("[error] ").or_else(|| text.split_once("[fatal] ")) {
            let mut complaints = complaints.lock().unwrap_or_else(PoisonError::into_inner);
            complaints.count += 1;
            complaints.first.get_or_insert_with(|| super::index::first_line(message).to_owned());
        }
        line.clear();
    }
}

/// `... config in time_base: 1/15360, frame_rate: 30/1`
fn parse_time_base(line: &str) -> Option<[i64; 2]> {
    let (_, rest) = line.split_once("config in time_base: ")?;
    let (numerator, denominator) = rest.split_once(',')?.0.split_once('/')?;
    let base = [numerator.parse().ok()?, denominator.parse().ok()?];
    base.iter().all(|term| *term > 0).then_some(base)
}

/// `... n:   0 pts:   512 pts_time:0.0333333 pos: 48 fmt:rgb24 sar:1/1 s:640x512 i:P ...`; without a time `pts:NOPTS`.
fn parse_header(line: &str, time_base: [i64; 2]) -> Option<Header> {
    let value = |key: &str| line.split_once(key)?.1.split_whitespace().next();
    let (width, height) = value(" s:")?.split_once('x')?;
    let size = Size::new(width.parse().ok()?, height.parse().ok()?);
    Some(Header { stamp: value(" pts:")?.parse().ok(), time_base, size })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log_lines_are_understood() {
        let log = "[info] Input #0\n\
            [Parsed_showinfo_1 @ 0x5] [info] config in time_base: 1/15360, frame_rate: 30/1\n\
            [Parsed_showinfo_1 @ 0x5] [info] config out time_base: 0/0, frame_rate: 0/0\n\
            [Parsed_showinfo_1 @ 0x5] [info] n:   0 pts:    512 pts_time:0.0333333 pos: 48 fmt:rgb24 sar:1/1 s:640x512 i:P \n\
            [Parsed_showinfo_1 @ 0x5] [info] color_range:pc color_space:gbr\n\
            [h264 @ 0x7] [error] Reference 3 >= 3\n\
            [error] in.mp4: Invalid data\n\
            [Parsed_showinfo_1 @ 0x5] [info] n:   1 pts:  NOPTS pts_time:NOPTS pos: 48 fmt:rgb24 sar:1/1 s:2x3 i:P";
        let (sender, headers) = sync_channel(8);
        let complaints = Mutex::default();
        read_log(log.as_bytes(), &sender, &complaints);
        drop(sender);
        let headers: Vec<Header> = headers.iter().collect();
        assert_eq!(headers[0], Header { stamp: Some(512), time_base: [1, 15_360], size: Size::new(640, 512) });
        assert_eq!(headers[0].time_s(), Some(512.0 / 15_360.0));
        assert_eq!((headers[1].stamp, headers[1].size), (None, Size::new(2, 3)));
        let complaints = complaints.into_inner().unwrap();
        assert_eq!((complaints.count, complaints.first.as_deref()), (2, Some("Reference 3 >= 3")));
    }
}
