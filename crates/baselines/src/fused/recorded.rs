//! A method that also listens to recorded readings: each is shown to it before the first frame that is not older.

use endoscape_core::{MagneticReading, Observation, Odometry, TimedPose, TrackError, Tracked};
use std::collections::VecDeque;
use std::time::Duration;

/// A method over frames with readings between them, as they would come in live.
///
/// Readings after the last frame are never shown.
pub struct Recorded<O> {
    pub(super) method: O,
    readings: VecDeque<MagneticReading>,
}

impl<O: Odometry> Recorded<O> {
    /// Gives a method readings in the order of time, on the clock of its frames.
    pub fn new(method: O, readings: Vec<MagneticReading>) -> Self {
        Self { method, readings: readings.into() }
    }
}

impl<O: Odometry> Odometry for Recorded<O> {
    fn name(&self) -> &'static str {
        self.method.name()
    }

    fn track(&mut self, observation: &Observation) -> Result<Tracked, TrackError> {
        while let Some(reading) = self.readings.pop_front_if(|reading| reading.time_s <= observation.time_s()) {
            self.method.track(&Observation::Magnetic(reading))?;
        }
        self.method.track(observation)
    }

    fn revisions(&self) -> &[TimedPose] {
        self.method.revisions()
    }

    fn stage_times(&self) -> &[(&'static str, Duration)] {
        self.method.stage_times()
    }
}
