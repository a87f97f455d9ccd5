//! Any method over any stream: one answer per frame, in order, whatever the frames are like.
//!
//! A frame that does not decode cannot be shown to the method. It gets the pose of the frame before it, confidence 0
//! and a warning, as does a frame for which the method has no pose. Nothing is kept per frame but the numbers of those
//! lost.

use crate::OdometryError;
use crate::latency::LatencyAccount;
use endoscape_core::{Event, EventSink, Frame, MagneticReading, Observation, Odometry, Pose, TimedPose, Tracked};
use endoscape_frames::{FrameSource, FramesError, Sequence};
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Name of the stage that waits for a frame, and of the one that writes what came out.
const DECODE: &str = "decode";
const WRITE: &str = "write";
/// Name under which the account holds the time from a decoded frame to its pose and depth.
pub const FRAME: &str = "frame";
/// Warnings about single frames that are told as events; all of them are in the table of frames.
const MOST_TOLD: usize = 10;

/// The answer for one frame.
#[derive(Debug)]
pub struct Step {
    /// Number of the frame in its data set.
    pub number: usize,
    /// Its time and pose; the pose is always there.
    pub pose: TimedPose,
    /// Whether the pose can be used: confidence at least the limit.
    pub is_tracked: bool,
    /// What the method said; without pose, depth and reliability for a frame it never saw.
    pub tracked: Tracked,
    /// From the decoded frame to its pose and depth.
    pub latency: Duration,
}

/// Takes the answers in the order of the frames.
pub trait StepSink {
    /// Takes one answer.
    ///
    /// # Errors
    /// [`OdometryError::Output`] if it cannot be written.
    fn step(&mut self, step: &Step) -> Result<(), OdometryError>;

    /// Takes poses that replace those of earlier answers, by their times ([`Odometry::revisions`]).
    fn revise(&mut self, revisions: &[TimedPose]);
}

/// What to run on.
pub struct Job<'a> {
    /// The input.
    pub sequence: &'a Sequence,
    /// Positions of the frames, counted from 0; an end beyond the sequence is its end.
    pub range: Range<usize>,
    /// Poses below this confidence count as lost.
    pub lost_below: f64,
    /// Becomes true when the user wants to end early.
    pub stop: &'a AtomicBool,
}

/// How a run went.
#[derive(Clone, Debug, Default)]
pub struct Account {
    /// Frames answered.
    pub frames: usize,
    /// Numbers of those without a usable pose.
    pub lost_frames: Vec<usize>,
    /// Where the time went.
    pub latency: LatencyAccount,
    /// Seconds in all.
    pub elapsed_s: f64,
    /// Whether the user ended it early.
    pub is_interrupted: bool,
    /// What the source says about its frames, one sentence each.
    pub warnings: Vec<String>,
}

/// Shows a method every frame of a stream and hands its answers on.
///
/// # Errors
/// [`OdometryError`]: an input that cannot be opened, none of whose frames decodes, or that is not for the method; an
/// answer that cannot be written.
pub fn run(
    job: &Job<'_>,
    odometry: &mut dyn Odometry,
    sink: &mut dyn StepSink,
    events: &mut dyn EventSink,
) -> Result<Account, OdometryError> {
    let range = range_of(job)?;
    let total = (range.end < usize::MAX).then_some(range.len() as u64);
    events.event(Event::Started { stage: format!("running {}", odometry.name()), total });
    let mut source = job.sequence.open_frames(range.clone())?;
    let answers = Answers::new(job.lost_below, sink, events);
    Walk { job, odometry, answers, next: range.start }.through(source.as_mut(), &range)
}

/// Shows a method every reading of a magnetic array and hands its answers on; `lost_below` as in [`Job`].
///
/// # Errors
/// [`OdometryError`]: readings that are not for the method, or an answer that cannot be written.
pub fn run_readings(
    readings: &[MagneticReading],
    lost_below: f64,
    odometry: &mut dyn Odometry,
    sink: &mut dyn StepSink,
    events: &mut dyn EventSink,
) -> Result<Account, OdometryError> {
    let (begun, total) = (Instant::now(), Some(readings.len() as u64));
    events.event(Event::Started { stage: format!("running {}", odometry.name()), total });
    let mut answers = Answers::new(lost_below, sink, events);
    for reading in readings {
        answers.ask(odometry, (reading.index, reading.time_s), &Observation::Magnetic(reading.clone()))?;
    }
    Ok(answers.close(begun))
}

/// The frames that exist; of a live source, whose end is not known, those asked for.
fn range_of(job: &Job<'_>) -> Result<Range<usize>, OdometryError> {
    let known = if job.sequence.is_live() { usize::MAX } else { job.sequence.frames.len() };
    let range = job.range.start..job.range.end.min(known);
    if range.is_empty() {
        let what = format!("{} has no frames from {} on", job.sequence.root.display(), range.start);
        return Err(FramesError::Request { what, remedy: format!("it has {known} frames, counted from 0") }.into());
    }
    Ok(range)
}

/// A run over frames under way.
struct Walk<'a> {
    job: &'a Job<'a>,
    odometry: &'a mut dyn Odometry,
    answers: Answers<'a>,
    /// Position of the next frame.
    next: usize,
}

impl Walk<'_> {
    fn through(mut self, source: &mut dyn FrameSource, range: &Range<usize>) -> Result<Account, OdometryError> {
        let begun = Instant::now();
        let (mut failure, mut failures) = (None, 0);
        // A source that fails more often than it has frames would fail for ever.
        while failures <= range.len() && !self.job.stop.load(Ordering::Relaxed) {
            let asked = Instant::now();
            match source.next_frame() {
                Ok(Some(frame)) if frame.index >= range.end => break,
                Ok(Some(frame)) if frame.index < range.start => {}
                Ok(Some(frame)) => {
                    self.answers.account.latency.add(DECODE, asked.elapsed());
                    self.catch_up(frame.index, &mut failure)?;
                    self.take(frame)?;
                    failures = 0;
                }
                Ok(None) => break,
                Err(error) if self.job.sequence.is_live() => {
                    failure = Some(error);
                    break;
                }
                Err(error) => {
                    failures += 1;
                    failure.get_or_insert(error);
                }
            }
        }
        self.answers.account.is_interrupted = self.job.stop.load(Ordering::Relaxed);
        self.close(source, range, failure, begun)
    }

    /// Answers for the frames at the end that never came.
    fn close(
        mut self,
        source: &dyn FrameSource,
        range: &Range<usize>,
        mut failure: Option<FramesError>,
        begun: Instant,
    ) -> Result<Account, OdometryError> {
        if self.answers.account.frames == 0 {
            let first = failure.map_or_else(|| "nothing came".to_owned(), |error| error.to_string());
            return Err(OdometryError::NoFrame { input: self.job.sequence.root.display().to_string(), first });
        }
        if self.job.sequence.is_live() {
            self.answers.account.warnings.extend(failure.map(|error| error.to_string()));
        } else if !self.answers.account.is_interrupted {
            self.catch_up(range.end, &mut failure)?;
        }
        self.answers.account.warnings.extend(source.warnings());
        Ok(self.answers.close(begun))
    }

    /// Answers for the frames before `position` that did not decode. A live source drops frames that nobody could have
    /// looked at in time; it has no list that they would be missing from.
    fn catch_up(&mut self, position: usize, failure: &mut Option<FramesError>) -> Result<(), OdometryError> {
        while self.next < position && !self.job.sequence.is_live() {
            let reason =
                failure.take().map_or_else(|| "the frame does not decode".to_owned(), |error| error.to_string());
            let time_s = self.job.sequence.frames.get(self.next).map_or(0.0, |entry| entry.time_s);
            let tracked = unseen(format!("the pose is repeated: {reason}"));
            self.answers.answer((self.number(self.next), time_s), tracked, Duration::ZERO)?;
            self.next += 1;
        }
        self.next = position;
        *failure = None;
        Ok(())
    }

    fn take(&mut self, frame: Frame) -> Result<(), OdometryError> {
        let (position, time_s) = (frame.index, frame.time_s);
        let which = (self.number(position), time_s);
        self.answers.ask(self.odometry, which, &Observation::Frame(frame))?;
        self.next = position + 1;
        Ok(())
    }

    fn number(&self, position: usize) -> usize {
        self.job.sequence.frames.get(position).map_or(position, |entry| entry.number)
    }
}

/// What has been answered so far, whatever was asked about.
struct Answers<'a> {
    lost_below: f64,
    sink: &'a mut dyn StepSink,
    events: &'a mut dyn EventSink,
    account: Account,
    /// The latest pose.
    pose: Pose,
}

impl<'a> Answers<'a> {
    fn new(lost_below: f64, sink: &'a mut dyn StepSink, events: &'a mut dyn EventSink) -> Self {
        Self { lost_below, sink, events, account: Account::default(), pose: Pose::identity() }
    }

    /// Shows the method an observation, given by number and time, and writes down what it says.
    fn ask(
        &mut self,
        odometry: &mut dyn Odometry,
        which: (usize, f64),
        observation: &Observation,
    ) -> Result<(), OdometryError> {
        let begun = Instant::now();
        let tracked = odometry.track(observation)?;
        let latency = begun.elapsed();
        self.account.latency.add(FRAME, latency);
        for (stage, duration) in odometry.stage_times() {
            self.account.latency.add(stage, *duration);
        }
        self.sink.revise(odometry.revisions());
        self.answer(which, tracked, latency)
    }

    fn answer(
        &mut self,
        (number, time_s): (usize, f64),
        mut tracked: Tracked,
        latency: Duration,
    ) -> Result<(), OdometryError> {
        self.pose = tracked.world_from_camera.unwrap_or(self.pose);
        if tracked.world_from_camera.is_none() && tracked.warning.is_none() {
            tracked.warning = Some("the method has no pose, so that of the frame before is repeated".into());
        }
        let is_tracked = tracked.world_from_camera.is_some() && tracked.confidence >= self.lost_below;
        self.tell(number, &tracked);
        if !is_tracked {
            self.account.lost_frames.push(number);
        }
        let pose = TimedPose { time_s, world_from_camera: self.pose };
        let begun = Instant::now();
        self.sink.step(&Step { number, pose, is_tracked, tracked, latency })?;
        self.account.latency.add(WRITE, begun.elapsed());
        self.account.frames += 1;
        self.events.event(Event::Advanced { done: self.account.frames as u64 });
        Ok(())
    }

    fn close(mut self, begun: Instant) -> Account {
        self.account.elapsed_s = begun.elapsed().as_secs_f64();
        self.events.event(Event::Finished);
        self.account
    }

    /// Tells the first few warnings; a long bad stretch is no reason to flood a terminal.
    fn tell(&mut self, number: usize, tracked: &Tracked) {
        let Some(warning) = &tracked.warning else { return };
        match self.account.lost_frames.len() {
            few if few < MOST_TOLD => self.events.event(Event::Warned(format!("frame {number}: {warning}"))),
            MOST_TOLD => {
                let sentence = "more frames have warnings; the table of frames lists them all";
                self.events.event(Event::Warned(sentence.into()));
            }
            _ => {}
        }
    }
}

/// The answer for a frame the method never saw.
const fn unseen(warning: String) -> Tracked {
    Tracked { world_from_camera: None, confidence: 0.0, depth: None, reliability: None, warning: Some(warning) }
}
