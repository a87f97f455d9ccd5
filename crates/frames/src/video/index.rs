//! What a video is and when its frames are, without decoding it.

use super::{Programs, command, decoder, input_arguments, not_started};
use crate::FramesError;
use endoscape_core::Size;
use serde::Deserialize;
use std::io::{BufRead as _, BufReader, Read as _};
use std::path::Path;
use std::process::{ChildStdout, Command};

/// What to do about a damaged file.
pub(super) const REMEDY: &str = "fetch it again, or save what is left with `ffmpeg -i IN -c copy OUT`";
/// Largest width and height accepted.
const LARGEST_EXTENT: usize = 16_384;

/// A video as its container describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct VideoInfo {
    /// Size of the pictures in pixels, upright: a rotation noted in the container is applied.
    pub size: Size,
    /// Average frames per second, where the container states it.
    pub fps: Option<f64>,
    /// Number of frames as the container states it; [`VideoIndex`] counts them.
    pub frames: Option<usize>,
    /// Length in seconds, where the container states it.
    pub duration_s: Option<f64>,
    /// Names of the container format, as ffmpeg lists them.
    pub(super) container: String,
    /// Seconds per unit of time stamp.
    pub(super) time_base: [i64; 2],
}

/// A video with the time of each of its frames.
///
/// The times are the container's time stamps, in order of display; the number of them is the number of frames the
/// file holds.
#[derive(Clone, Debug, PartialEq)]
pub struct VideoIndex {
    /// What the container says.
    pub info: VideoInfo,
    /// Time stamps in units of the time base, increasing.
    pub(super) stamps: Vec<i64>,
}

impl VideoInfo {
    /// Whether this is a recording rather than a still picture or a text, which ffmpeg can show as pictures too.
    pub fn is_moving(&self) -> bool {
        let still = |name: &str| name == "image2" || name == "tty" || name.ends_with("_pipe");
        !self.container.split(',').any(still)
    }
}

impl VideoIndex {
    /// Number of frames.
    pub const fn len(&self) -> usize {
        self.stamps.len()
    }

    /// Whether there is no frame; never so for an index that was read from a file.
    pub const fn is_empty(&self) -> bool {
        self.stamps.is_empty()
    }

    /// Seconds of each frame since the first one.
    pub fn times_s(&self) -> impl Iterator<Item = f64> + '_ {
        (0..self.len()).map(|position| self.time_s(position))
    }

    /// Seconds of one frame since the first one; of a frame that does not exist, 0.
    pub(super) fn time_s(&self, position: usize) -> f64 {
        let [numerator, denominator] = self.info.time_base;
        let stamp = |position: usize| self.stamps.get(position).copied();
        let since_first = stamp(position).zip(stamp(0)).map_or(0.0, |(stamp, first)| stamp as f64 - first as f64);
        since_first * numerator as f64 / denominator as f64
    }
}

/// The parts of ffprobe's JSON that matter here; it writes most numbers as text.
#[derive(Deserialize)]
struct Answer {
    #[serde(default)]
    streams: Vec<Stream>,
    #[serde(default)]
    format: Container,
}

#[derive(Deserialize)]
struct Stream {
    #[serde(default)]
    width: usize,
    #[serde(default)]
    height: usize,
    avg_frame_rate: Option<String>,
    time_base: Option<String>,
    nb_frames: Option<String>,
    duration: Option<String>,
    #[serde(default)]
    side_data_list: Vec<SideData>,
}

#[derive(Deserialize)]
struct SideData {
    rotation: Option<f64>,
}

#[derive(Default, Deserialize)]
struct Container {
    #[serde(default)]
    format_name: String,
    duration: Option<String>,
}

impl Programs {
    /// As [`super::probe`], with these programs.
    ///
    /// # Errors
    /// As [`super::probe`].
    pub fn probe(&self, path: &Path) -> Result<VideoInfo, FramesError> {
        let mut ffprobe = self.ffprobe(path, &["-show_streams", "-show_format", "-of", "json"]);
        let output = ffprobe.output().map_err(|error| not_started(path, "ffprobe", &error))?;
        let log = String::from_utf8_lossy(&output.stderr);
        if !output.status.success() {
            return Err(FramesError::file(
                path,
                format!("is no readable video ({})", first_line(&log)),
                "fetch or record it again",
            ));
        }
        let answer: Answer = serde_json::from_slice(&output.stdout)
            .map_err(|error| FramesError::file(path, format!("ffprobe gave no answer ({error})"), REMEDY))?;
        let no_video = || FramesError::file(path, "has no video stream", "give a file with pictures in it");
        let stream = answer.streams.into_iter().next().ok_or_else(no_video)?;
        describe(path, &stream, answer.format)
    }

    /// As [`super::index`], with these programs.
    ///
    /// # Errors
    /// As [`super::index`].
    pub fn index(&self, path: &Path) -> Result<VideoIndex, FramesError> {
        let info = self.probe(path)?;
        let mut ffprobe = self.ffprobe(path, &["-show_entries", "packet=pts,flags", "-of", "csv=p=0"]);
        let mut child = ffprobe.spawn().map_err(|error| not_started(path, "ffprobe", &error))?;
        // Emptied beside the packets, so that neither pipe fills up while the other one is read.
        let log = child.stderr.take().map(|mut pipe| {
            std::thread::spawn(move || {
                let mut text = Vec::new();
                pipe.read_to_end(&mut text).ok();
                String::from_utf8_lossy(&text).into_owned()
            })
        });
        let stamps = child.stdout.take().map(read_stamps).unwrap_or_default();
        child.wait().map_err(|error| FramesError::io(path, "read", error))?;
        let log = log.and_then(|thread| thread.join().ok()).unwrap_or_default();
        let index = match stamps {
            Some(mut stamps) => {
                stamps.sort_unstable();
                stamps.dedup();
                VideoIndex { info, stamps }
            }
            // Packets without time stamps (some AVI files): only the decoder knows the times.
            None => decoder::index_by_decoding(self, path, info)?,
        };
        check_complete(path, &index, &log)?;
        Ok(index)
    }

    /// `ffprobe` on the first stream of moving pictures; `V` leaves cover art out.
    fn ffprobe(&self, path: &Path, question: &[&str]) -> Command {
        let mut ffprobe = command(&self.ffprobe);
        ffprobe.args(["-v", "error", "-select_streams", "V:0"]).args(question).args(input_arguments(path));
        ffprobe
    }
}

fn describe(path: &Path, stream: &Stream, format: Container) -> Result<VideoInfo, FramesError> {
    let sideways =
        stream.side_data_list.iter().filter_map(|data| data.rotation).any(|angle| angle.abs() % 180.0 == 90.0);
    let size = if sideways { Size::new(stream.height, stream.width) } else { Size::new(stream.width, stream.height) };
    if size.area() == 0 || size.width.max(size.height) > LARGEST_EXTENT {
        return Err(FramesError::file(path, format!("says its pictures are {size}"), REMEDY));
    }
    let ratio = |text: &Option<String>, separator| {
        let (numerator, denominator) = text.as_deref()?.split_once(separator)?;
        let ratio = [numerator.parse::<i64>().ok()?, denominator.parse().ok()?];
        ratio.iter().all(|term| *term > 0).then_some(ratio)
    };
    let seconds = |text: &Option<String>| text.as_deref()?.parse().ok().filter(|value: &f64| *value > 0.0);
    Ok(VideoInfo {
        size,
        fps: ratio(&stream.avg_frame_rate, '/').map(|[numerator, denominator]| numerator as f64 / denominator as f64),
        frames: stream.nb_frames.as_deref().and_then(|text| text.parse().ok()).filter(|frames| *frames > 0),
        duration_s: seconds(&stream.duration).or_else(|| seconds(&format.duration)),
        container: format.format_name,
        time_base: ratio(&stream.time_base, '/').unwrap_or([1, 1000]),
    })
}

/// Time stamps of the packets that are shown (`D` marks those an edit list discards); `None` if any has none.
fn read_stamps(pipe: ChildStdout) -> Option<Vec<i64>> {
    let mut stamps = Some(Vec::new());
    // Read to the end in any case: a closed pipe would read like a failure of ffprobe.
    for line in BufReader::new(pipe).lines().map_while(Result::ok) {
        let mut fields = line.split(',');
        let (Some(stamp), Some(flags)) = (fields.next(), fields.next()) else { continue };
        if flags.contains('D') {
            continue;
        }
        match (stamp.parse(), &mut stamps) {
            (Ok(stamp), Some(stamps)) => stamps.push(stamp),
            _ => stamps = None,
        }
    }
    stamps
}

/// Refuses a file that ends before its own header says: half a recording must not pass for a whole one.
///
/// Counts are not compared in the MOV family, whose edit lists leave packets out on purpose.
fn check_complete(path: &Path, index: &VideoIndex, log: &str) -> Result<(), FramesError> {
    if index.is_empty() {
        return Err(FramesError::file(path, format!("holds no frame ({})", first_line(log)), REMEDY));
    }
    let cut = log.contains("partial file") || log.contains("ended prematurely");
    let fewer = !index.info.container.contains("mov") && index.info.frames.is_some_and(|frames| frames > index.len());
    if cut || fewer {
        let of = index.info.frames.map_or_else(String::new, |frames| format!(" of {frames}"));
        return Err(FramesError::file(path, format!("is cut short after {}{of} frames", index.len()), REMEDY));
    }
    Ok(())
}

/// The first thing a program said, usually the cause, without the address in front, on one line.
pub(super) fn first_line(log: &str) -> &str {
    let line = log.lines().find(|line| !line.trim().is_empty()).unwrap_or("no reason given").trim();
    let line = line.strip_prefix('[').and_then(|rest| rest.split_once("] ")).map_or(line, |(_, message)| message);
    line.rsplit_once(": ").map_or(line, |(_, message)| message)
}
