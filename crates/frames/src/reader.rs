//! The stream of decoded frames.
//!
//! ```text
//! Sequence::open_frames -> pictures: a few threads decode ahead, order kept    \
//!                       -> video:    one ffmpeg process                         > FrameSource -> Frame
//!                       -> live:     one ffmpeg process and a short queue      /
//! ```
//! Memory is bounded by the number of frames decoded ahead, never by the length of the sequence.

use crate::sequence::{FrameEntry, ImageLocation, Sequence, VideoFile};
use crate::video::{self, LiveReader, VideoReader};
use crate::{FramesError, picture};
use endoscape_core::{Camera, DepthMap, Frame, Image, Mask, Size};
use std::collections::{BTreeMap, VecDeque};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};

/// Most threads that decode pictures; more only help where the disk is no limit.
const MOST_THREADS: usize = 4;
/// Pictures each thread may have ready.
const AHEAD: usize = 2;

/// Gives frames in time order until there are no more.
pub trait FrameSource: Send {
    /// The next frame, or `None` at the end. After an error about one frame (a picture that does not decode) the next
    /// call goes on with the frame after it.
    ///
    /// # Errors
    /// [`FramesError`] that names the frame's file.
    fn next_frame(&mut self) -> Result<Option<Frame>, FramesError>;

    /// What the user should know about the frames given so far, one sentence each: dropped frames, damaged pictures.
    fn warnings(&self) -> Vec<String> {
        Vec::new()
    }
}

impl Sequence {
    /// Opens the frames at positions `range` of [`Sequence::frames`], in order.
    ///
    /// Each frame has its position as index, and the sequence's camera, its own time and mask. Of a live sequence,
    /// which has no list of frames, everything the source gives is delivered and `range` has no meaning.
    ///
    /// # Errors
    /// [`FramesError`] for a range outside the sequence or a video that cannot be opened. Pictures that cannot be read
    /// or have another size than the sequence are errors of their own frame.
    pub fn open_frames(&self, range: Range<usize>) -> Result<Box<dyn FrameSource>, FramesError> {
        let dress = Dress { size: self.size, camera: self.camera.map(Arc::new) };
        if let (Some(video), true) = (&self.video, self.is_live()) {
            let source = Box::new(LiveReader::open(&video.path, video.crop)?);
            return Ok(Box::new(Dressed { source, entries: None, dress, path: video.path.clone() }));
        }
        let entries = self.entries(&range)?;
        let Some((video, positions)) = self.video.as_ref().zip(video_positions(entries)) else {
            return Ok(Box::new(PictureReader::start(entries, range.start, &dress)));
        };
        let span = positions.first().map_or(0..0, |first| *first..positions.last().unwrap_or(first) + 1);
        let numbered = positions.into_iter().zip((range.start..).zip(entries.iter().cloned()));
        let source = Box::new(VideoReader::open(&video.path, video.crop, Some(span))?);
        Ok(Box::new(Dressed { source, entries: Some(numbered.collect()), dress, path: video.path.clone() }))
    }

    /// Whether the frames come from a live address and are not known in advance.
    pub fn is_live(&self) -> bool {
        self.video.as_ref().is_some_and(|video| video::is_live_address(&video.path))
    }

    /// The picture at one position.
    ///
    /// # Errors
    /// As [`Sequence::read_images`].
    pub fn read_image(&self, position: usize) -> Result<Image, FramesError> {
        let missing = || FramesError::file(&self.root, format!("frame {position} is missing"), "choose another frame");
        self.read_images(&[position])?.pop().ok_or_else(missing)
    }

    /// The pictures at several positions, in the order asked for; a video is decoded once for all of them.
    ///
    /// # Errors
    /// [`FramesError`] for a position outside the sequence, or a picture that cannot be read or has another size.
    pub fn read_images(&self, positions: &[usize]) -> Result<Vec<Image>, FramesError> {
        for position in positions {
            self.entries(&(*position..position.saturating_add(1)))?;
        }
        let entries: Vec<&FrameEntry> = positions.iter().map(|position| &self.frames[*position]).collect();
        let in_video = entries.iter().map(|entry| match entry.image {
            ImageLocation::Video(position) => Some(position),
            ImageLocation::File(_) => None,
        });
        match self.video.as_ref().zip(in_video.collect::<Option<Vec<usize>>>()) {
            Some((video, wanted)) => read_from_video(video, &wanted, self.size),
            None => entries.into_iter().map(|entry| read_picture(entry, self.size)).collect(),
        }
    }

    /// The depth at one position, `None` where the frame has none.
    ///
    /// # Errors
    /// [`FramesError`] for a position outside the sequence, or as [`crate::depth::DepthFile::read`].
    pub fn read_depth(&self, position: usize) -> Result<Option<DepthMap>, FramesError> {
        let entries = self.entries(&(position..position.saturating_add(1)))?;
        let file = entries.first().and_then(|entry| entry.depth.as_ref());
        file.map(|file| file.read(self.camera.as_ref(), self.size)).transpose()
    }

    /// The mask of usable pixels at one position, `None` where the frame has none.
    ///
    /// # Errors
    /// [`FramesError`] for a position outside the sequence, or a mask that cannot be read or has another size.
    pub fn read_mask(&self, position: usize) -> Result<Option<Mask>, FramesError> {
        let entries = self.entries(&(position..position.saturating_add(1)))?;
        entries.first().map_or(Ok(None), |entry| read_mask(entry, self.size))
    }

    fn entries(&self, range: &Range<usize>) -> Result<&[FrameEntry], FramesError> {
        self.frames.get(range.clone()).ok_or_else(|| FramesError::Request {
            what: format!("{} has no frames {}..{}", self.root.display(), range.start, range.end),
            remedy: format!("it has {} frames, counted from 0", self.frames.len()),
        })
    }
}

/// Positions in the video, if all frames lie in one.
fn video_positions(entries: &[FrameEntry]) -> Option<Vec<usize>> {
    let position = |entry: &FrameEntry| match entry.image {
        ImageLocation::Video(position) => Some(position),
        ImageLocation::File(_) => None,
    };
    entries.iter().map(position).collect()
}

fn read_from_video(video: &VideoFile, wanted: &[usize], size: Size) -> Result<Vec<Image>, FramesError> {
    let Some((first, last)) = wanted.iter().min().zip(wanted.iter().max()) else { return Ok(Vec::new()) };
    let mut reader = VideoReader::open(&video.path, video.crop, Some(*first..last + 1))?;
    let mut found = BTreeMap::new();
    let mut failure = None;
    loop {
        match reader.next_frame() {
            Ok(Some(frame)) if wanted.contains(&frame.index) => {
                check_size(&video.path, frame.image.size(), size)?;
                found.insert(frame.index, frame.image);
            }
            Ok(Some(_)) => {}
            Ok(None) => break,
            // Only of interest if it is about a frame that was asked for.
            Err(error) => failure = Some(error),
        }
    }
    let images: Option<Vec<Image>> = wanted.iter().map(|at| found.get(at).map(|image| (**image).clone())).collect();
    let lost = || FramesError::file(&video.path, "a frame does not decode", "choose another frame");
    images.ok_or_else(|| failure.unwrap_or_else(lost))
}

/// Refuses a picture of another size than its sequence.
fn check_size(path: &Path, got: Size, sequence: Size) -> Result<(), FramesError> {
    if got == sequence {
        return Ok(());
    }
    Err(FramesError::OtherSize { path: path.to_path_buf(), found: got, expected: sequence })
}

fn read_picture(entry: &FrameEntry, size: Size) -> Result<Image, FramesError> {
    let ImageLocation::File(path) = &entry.image else {
        let what = format!("frame {} lies in a video that the sequence does not name", entry.number);
        return Err(FramesError::Request { what, remedy: "open the video itself".into() });
    };
    let image = picture::read(path)?;
    check_size(path, image.size(), size)?;
    Ok(image)
}

fn read_mask(entry: &FrameEntry, size: Size) -> Result<Option<Mask>, FramesError> {
    let Some(path) = &entry.mask else { return Ok(None) };
    let mask = picture::read_mask(path)?;
    check_size(path, mask.size(), size)?;
    Ok(Some(mask))
}

/// What every frame of a sequence gets beside its pixels.
#[derive(Clone)]
struct Dress {
    size: Size,
    camera: Option<Arc<Camera>>,
}

impl Dress {
    fn frame(&self, index: usize, entry: &FrameEntry, image: Arc<Image>) -> Result<Frame, FramesError> {
        let usable = read_mask(entry, self.size)?.map(Arc::new);
        Ok(Frame { index, time_s: entry.time_s, image, camera: self.camera.clone(), usable })
    }
}

/// Pictures decoded by a few threads, each taking every n-th, so that asking the threads in turn keeps the order.
struct PictureReader {
    workers: Vec<Receiver<Result<Frame, FramesError>>>,
    turn: usize,
}

impl PictureReader {
    fn start(entries: &[FrameEntry], first: usize, dress: &Dress) -> Self {
        let threads = std::thread::available_parallelism().map_or(1, usize::from).min(MOST_THREADS);
        let worker = |offset: usize| {
            let (sender, receiver) = sync_channel(AHEAD);
            let share: Vec<_> = (first..).zip(entries.iter().cloned()).skip(offset).step_by(threads).collect();
            let dress = dress.clone();
            std::thread::spawn(move || {
                for (index, entry) in share {
                    let read = read_picture(&entry, dress.size);
                    let frame = read.and_then(|image| dress.frame(index, &entry, Arc::new(image)));
                    // Nobody listens any more: the reader was dropped.
                    if sender.send(frame).is_err() {
                        return;
                    }
                }
            });
            receiver
        };
        Self { workers: (0..threads).map(worker).collect(), turn: 0 }
    }
}

impl FrameSource for PictureReader {
    fn next_frame(&mut self) -> Result<Option<Frame>, FramesError> {
        let worker = &self.workers[self.turn % self.workers.len()];
        self.turn += 1;
        // The first thread out of frames marks the end: those after it have none either.
        worker.recv().map_or(Ok(None), |frame| frame.map(Some))
    }
}

/// Frames of a video with what the sequence knows about them.
struct Dressed<Source> {
    source: Box<Source>,
    /// Of the frames wanted: position in the video, then position and entry in the sequence. `None` takes all.
    entries: Option<VecDeque<(usize, (usize, FrameEntry))>>,
    dress: Dress,
    path: std::path::PathBuf,
}

impl<Source: FrameSource> FrameSource for Dressed<Source> {
    fn next_frame(&mut self) -> Result<Option<Frame>, FramesError> {
        while let Some(frame) = self.source.next_frame()? {
            let Some(entries) = &mut self.entries else {
                check_size(&self.path, frame.image.size(), self.dress.size)?;
                return Ok(Some(Frame { camera: self.dress.camera.clone(), ..frame }));
            };
            while entries.front().is_some_and(|(position, _)| *position < frame.index) {
                entries.pop_front();
            }
            if let Some((_, (index, entry))) = entries.pop_front_if(|(position, _)| *position == frame.index) {
                check_size(&self.path, frame.image.size(), self.dress.size)?;
                return self.dress.frame(index, &entry, frame.image).map(Some);
            }
        }
        Ok(None)
    }

    fn warnings(&self) -> Vec<String> {
        self.source.warnings()
    }
}

#[cfg(test)]
mod tests;
