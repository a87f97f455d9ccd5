//! Network streams and devices: the newest picture, never an old one.

use super::Programs;
use super::decoder::{Decoder, Process, Selection};
use crate::{FrameSource, FramesError};
use endoscape_core::{Frame, Rect};
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Frames that may wait for a slow method before the oldest is dropped.
const WAITING: usize = 4;
/// How long a source may be silent.
const SILENCE: Duration = Duration::from_secs(10);

/// Frames of a live source, decoded by a thread of their own.
///
/// When the method is slower than the source, the oldest waiting frame is dropped and counted, so the delay never
/// grows. [`Frame::index`] counts all frames of the source, so a gap shows there too.
#[derive(Debug)]
pub struct LiveReader {
    path: PathBuf,
    shared: Arc<Shared>,
    process: Process,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Shared {
    queue: Mutex<Queue>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct Queue {
    waiting: VecDeque<Frame>,
    seen: usize,
    dropped: usize,
    /// Why the source ended, once it has.
    ended: Option<Option<FramesError>>,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn push(&self, frame: Frame) {
        let mut queue = self.lock();
        queue.seen += 1;
        if queue.waiting.len() == WAITING {
            queue.waiting.pop_front();
            queue.dropped += 1;
        }
        queue.waiting.push_back(frame);
        self.changed.notify_one();
    }

    fn end(&self, error: Option<FramesError>) {
        self.lock().ended = Some(error);
        self.changed.notify_one();
    }
}

impl LiveReader {
    /// Connects to an address (`rtsp://...`, `http://...`, `/dev/video0`), each picture cropped to `crop`.
    ///
    /// # Errors
    /// [`FramesError::Program`] without ffmpeg. That nobody answers at the address shows at the first frame.
    pub fn open(address: &Path, crop: Option<Rect>) -> Result<Self, FramesError> {
        let decoder = Decoder::start(&Programs::default(), address, &Selection { crop, stamps: None })?;
        let (process, shared) = (decoder.process(), Arc::new(Shared::default()));
        let (path, feed) = (address.to_path_buf(), Arc::clone(&shared));
        let thread = std::thread::spawn(move || feed.end(pump(decoder, &path, &feed)));
        Ok(Self { path: address.to_path_buf(), shared, process, thread: Some(thread) })
    }

    /// Frames of the source that were dropped so far because nobody asked for them in time.
    pub fn dropped(&self) -> usize {
        self.shared.lock().dropped
    }
}

/// Moves frames from the decoder into the queue until the source ends; an error if it never gave any.
fn pump(mut decoder: Decoder, path: &Path, shared: &Shared) -> Option<FramesError> {
    let (mut index, mut first_s, mut last_s) = (0, None, 0.0);
    loop {
        match decoder.next_picture() {
            Ok(Some((header, image))) => {
                // Without a time stamp the frame is at least not before the last one.
                let time_s = header.time_s().map_or(last_s, |time| time - *first_s.get_or_insert(time));
                last_s = time_s;
                shared.push(Frame { index, time_s, image: Arc::new(image), camera: None, usable: None });
                index += 1;
            }
            Ok(None) if index == 0 => {
                let reason = decoder.complaints().first.unwrap_or_else(|| "nothing came".into());
                let reason = format!("gives no picture ({reason})");
                return Some(FramesError::file(path, reason, "check the address and that the source is on"));
            }
            Ok(None) => return None,
            Err(error) => return Some(error),
        }
    }
}

impl FrameSource for LiveReader {
    fn next_frame(&mut self) -> Result<Option<Frame>, FramesError> {
        let idle = |queue: &mut Queue| queue.waiting.is_empty() && queue.ended.is_none();
        let waited = self.shared.changed.wait_timeout_while(self.shared.lock(), SILENCE, idle);
        let (mut queue, timeout) = waited.unwrap_or_else(PoisonError::into_inner);
        if let Some(frame) = queue.waiting.pop_front() {
            return Ok(Some(frame));
        }
        if timeout.timed_out() {
            let reason = format!("has given no picture for {} s", SILENCE.as_secs());
            return Err(FramesError::file(&self.path, reason, "check that the source is on"));
        }
        queue.ended.as_mut().and_then(Option::take).map_or(Ok(None), Err)
    }

    fn warnings(&self) -> Vec<String> {
        let Queue { seen, dropped, .. } = *self.shared.lock();
        let sentence =
            format!("{}: {dropped} of {seen} frames were dropped to keep up with the source", self.path.display());
        if dropped > 0 { vec![sentence] } else { Vec::new() }
    }
}

impl Drop for LiveReader {
    fn drop(&mut self) {
        // Ends the pipe the thread reads from; only then is it sure to come to its end.
        self.process.end();
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
    }
}
