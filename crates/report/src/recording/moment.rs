//! When something was: the number of a frame and its time, as far as they are known.

use crate::study::SequenceStudy;
use endoscape_eval::associate::DEFAULT_TOLERANCE_S;
use endoscape_eval::poses::{Poses, Stamps};
use endoscape_eval::trace::Trace;
use endoscape_frames::Sequence;

/// A place on both time lines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Moment {
    /// Number of the frame.
    pub frame: Option<usize>,
    /// Its time, seconds.
    pub time_s: Option<f64>,
}

/// Numbers and times of the frames of a sequence, both rising.
#[derive(Debug)]
pub(super) struct Clock(Vec<(usize, f64)>);

impl Clock {
    /// From the frames themselves, or else from what a method wrote down about them.
    pub(super) fn of(study: &SequenceStudy, sequence: Option<&Sequence>) -> Self {
        let from_runs = || {
            let runs = study.methods.iter().filter_map(|method| method.run.as_ref());
            let longest = runs.map(|run| &run.frames).max_by_key(|frames| frames.len());
            longest.into_iter().flatten().map(|frame| (frame.index, frame.time_s)).collect()
        };
        let from_sequence =
            |sequence: &Sequence| sequence.frames.iter().map(|frame| (frame.number, frame.time_s)).collect::<Vec<_>>();
        Self(sequence.map(from_sequence).filter(|frames| !frames.is_empty()).unwrap_or_else(from_runs))
    }

    /// The moment of a time: its frame is the nearest, as poses are associated.
    pub(super) fn at_time(&self, time_s: f64) -> Moment {
        let after = self.0.partition_point(|(_, frame_time_s)| *frame_time_s < time_s);
        let near = [after.checked_sub(1), Some(after)].into_iter().flatten().filter_map(|index| self.0.get(index));
        let distance = |frame: &&(usize, f64)| (frame.1 - time_s).abs();
        let nearest = near.min_by(|a, b| distance(a).total_cmp(&distance(b)));
        let frame = nearest.filter(|frame| distance(frame) <= DEFAULT_TOLERANCE_S).map(|(number, _)| *number);
        Moment { frame, time_s: Some(time_s) }
    }

    /// The moment of a frame by its position in the sequence, for poses that know nothing but their order.
    pub(super) fn at_position(&self, position: usize) -> Moment {
        let frame = self.0.get(position);
        Moment { frame: Some(frame.map_or(position, |(number, _)| *number)), time_s: frame.map(|(_, time_s)| *time_s) }
    }

    /// The moment of a frame by its number.
    pub(super) fn at_number(&self, number: usize) -> Moment {
        let known = self.0.binary_search_by_key(&number, |(number, _)| *number).ok();
        Moment { frame: Some(number), time_s: known.map(|index| self.0[index].1) }
    }

    /// The moment of each pose.
    pub(super) fn of_poses(&self, poses: &Poses) -> Vec<Moment> {
        match poses.stamps() {
            Stamps::Seconds(times_s) => times_s.iter().map(|time_s| self.at_time(*time_s)).collect(),
            Stamps::Frames(frames) => frames.iter().map(|frame| self.at_position(*frame as usize)).collect(),
            Stamps::Order => (0..poses.len()).map(|index| self.at_position(index)).collect(),
        }
    }

    /// The moment of each true pose of a trace.
    pub(super) fn of_trace(&self, trace: &Trace) -> Vec<Moment> {
        let moment = |stamp: &f64| {
            if trace.in_seconds { self.at_time(*stamp) } else { self.at_position(*stamp as usize) }
        };
        trace.stamps.iter().map(moment).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_belongs_to_the_nearest_frame_within_the_tolerance() {
        let clock = Clock(vec![(10, 0.0), (11, 0.04), (20, 0.08)]);
        let frame = |time_s| clock.at_time(time_s).frame;
        assert_eq!([frame(-0.001), frame(0.045), frame(0.0799)], [Some(10), Some(11), Some(20)]);
        assert_eq!((frame(0.06), frame(9.0)), (None, None));
        assert_eq!(clock.at_time(0.06).time_s, Some(0.06));
    }

    #[test]
    fn positions_become_numbers_where_frames_are_known() {
        let clock = Clock(vec![(10, 0.0), (12, 0.04)]);
        assert_eq!(clock.at_position(1), Moment { frame: Some(12), time_s: Some(0.04) });
        assert_eq!(clock.at_position(7), Moment { frame: Some(7), time_s: None });
        assert_eq!(clock.at_number(10).time_s, Some(0.0));
    }
}
