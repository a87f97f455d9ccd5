//! A part of a video file, every frame accounted for.

use super::decoder::{Decoder, Header, Selection};
use super::index::{REMEDY, VideoIndex};
use super::{Programs, index};
use crate::{FrameSource, FramesError};
use endoscape_core::{Frame, Image, Rect};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The frames of a video file in order.
///
/// Frames are told apart by their time stamps, not by counting: when the decoder skips a damaged one, the frames
/// after it keep their numbers, and the gap is reported as one error before the reader goes on.
#[derive(Debug)]
pub struct VideoReader {
    path: PathBuf,
    index: Arc<VideoIndex>,
    decoder: Decoder,
    /// Positions not delivered yet.
    range: Range<usize>,
    /// A frame that arrived after a gap, kept while the gap is reported.
    pending: Option<(usize, Image)>,
    delivered: usize,
}

impl VideoReader {
    /// Opens the frames `range` (all of them if `None`) of a file, each cropped to `crop`.
    ///
    /// # Errors
    /// [`FramesError`] for a missing or damaged file, a range or crop outside the video, or a missing ffmpeg.
    pub fn open(path: &Path, crop: Option<Rect>, range: Option<Range<usize>>) -> Result<Self, FramesError> {
        Self::with_index(path, Arc::new(index(path)?), crop, range)
    }

    /// As [`VideoReader::open`] for a file whose index is known already.
    ///
    /// # Errors
    /// As [`VideoReader::open`].
    pub fn with_index(
        path: &Path,
        index: Arc<VideoIndex>,
        crop: Option<Rect>,
        range: Option<Range<usize>>,
    ) -> Result<Self, FramesError> {
        let range = range.unwrap_or(0..index.len());
        if range.start > range.end || range.end > index.len() {
            let what = format!("{} has no frames {} to {}", path.display(), range.start, range.end);
            return Err(FramesError::Request { what, remedy: format!("it has {} frames", index.len()) });
        }
        if let Some(rect) = crop.filter(|rect| !rect.fits(index.info.size)) {
            let size = rect.size;
            let what = format!("{}: the block of {size} at ({}, {}) does not fit", path.display(), rect.x, rect.y);
            return Err(FramesError::Request { what, remedy: format!("its pictures are {}", index.info.size) });
        }
        let stamp = |position: usize| index.stamps.get(position).copied();
        let stamps = stamp(range.start).map(|start| start..stamp(range.end).unwrap_or(i64::MAX));
        let stamps = stamps.filter(|_| range != (0..index.len()));
        let decoder = Decoder::start(&Programs::default(), path, &Selection { crop, stamps })?;
        Ok(Self { path: path.to_path_buf(), index, decoder, range, pending: None, delivered: 0 })
    }

    /// Position of a frame in the index: that of the nearest time stamp.
    fn position(&self, header: &Header) -> Option<usize> {
        let [numerator, denominator] = self.index.info.time_base;
        let stamp = (header.time_s()? * denominator as f64 / numerator as f64).round() as i64;
        let stamps = &self.index.stamps;
        let after = stamps.partition_point(|other| *other < stamp);
        let distance = |position: &usize| stamps.get(*position).map_or(u64::MAX, |other| other.abs_diff(stamp));
        [after.saturating_sub(1), after].into_iter().min_by_key(distance)
    }

    /// The next frame the decoder gives that lies in the range, with its position.
    fn decode(&mut self) -> Result<Option<(usize, Image)>, FramesError> {
        while let Some((header, image)) = self.decoder.next_picture()? {
            // A frame without a time can only be the next one.
            let position = self.position(&header).unwrap_or(self.range.start);
            if self.range.contains(&position) {
                return Ok(Some((position, image)));
            }
        }
        Ok(None)
    }

    /// Gives the frames before `end` up, with a sentence on why.
    fn skip_to(&mut self, end: usize) -> FramesError {
        let gap = self.range.start..end;
        self.range.start = end;
        let because = self.decoder.complaints().first.map_or_else(String::new, |first| format!(" ({first})"));
        let reason = match gap.len() {
            1 => format!("frame {} does not decode{because}", gap.start),
            _ => format!("frames {} to {} do not decode{because}", gap.start, gap.end - 1),
        };
        FramesError::file(&self.path, reason, REMEDY)
    }

    fn frame(&mut self, position: usize, image: Image) -> Frame {
        self.range.start = position + 1;
        self.delivered += 1;
        let time_s = self.index.time_s(position);
        Frame { index: position, time_s, image: Arc::new(image), camera: None, usable: None }
    }
}

impl FrameSource for VideoReader {
    fn next_frame(&mut self) -> Result<Option<Frame>, FramesError> {
        if self.range.is_empty() {
            return Ok(None);
        }
        let next = match self.pending.take() {
            Some(pending) => Some(pending),
            None => self.decode()?,
        };
        match next {
            None => Err(self.skip_to(self.range.end)),
            Some((position, image)) if position > self.range.start => {
                self.pending = Some((position, image));
                Err(self.skip_to(position))
            }
            Some((position, image)) => Ok(Some(self.frame(position, image))),
        }
    }

    fn warnings(&self) -> Vec<String> {
        let complaints = self.decoder.complaints();
        let Some(first) = complaints.first else { return Vec::new() };
        let (path, count, delivered) = (self.path.display(), complaints.count, self.delivered);
        vec![format!(
            "{path}: the decoder complained {count} times over {delivered} frames (first: {first}); some pictures may be damaged"
        )]
    }
}
