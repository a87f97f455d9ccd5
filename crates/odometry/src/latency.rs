//! Percentiles of durations in constant memory, however long a run is.

use hdrhistogram::Histogram;
use serde::Serialize;
use std::collections::BTreeMap;
use std::time::Duration;

/// Decimal digits kept of a duration: percentiles are right to one per cent.
const DIGITS: u8 = 2;
/// Longest duration told apart, microseconds: a day.
const LONGEST_US: u64 = 86_400_000_000;

/// Percentiles in milliseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Percentiles {
    /// Half of the durations are shorter.
    pub p50: f64,
    /// 95 of a hundred are shorter.
    pub p95: f64,
    /// 99 of a hundred are shorter.
    pub p99: f64,
    /// The longest.
    pub max: f64,
}

/// Durations of one kind.
#[derive(Clone, Debug)]
struct Durations(Histogram<u64>);

impl Durations {
    /// Never `None`: the histogram takes one to five digits and any maximum above one.
    fn new() -> Option<Self> {
        Histogram::new_with_max(LONGEST_US, DIGITS).ok().map(Self)
    }

    fn add(&mut self, duration: Duration) {
        // A longer duration counts as the longest.
        self.0.saturating_record(u64::try_from(duration.as_micros()).unwrap_or(u64::MAX));
    }

    fn percentiles(&self) -> Percentiles {
        let milliseconds = |microseconds: u64| microseconds as f64 * 1e-3;
        let at = |quantile: f64| milliseconds(self.0.value_at_quantile(quantile));
        let max = if self.0.is_empty() { 0.0 } else { milliseconds(self.0.max()) };
        Percentiles { p50: at(0.5).min(max), p95: at(0.95).min(max), p99: at(0.99).min(max), max }
    }
}

/// Where the time of a run went.
#[derive(Clone, Debug, Default)]
pub struct LatencyAccount {
    stages: BTreeMap<&'static str, Durations>,
}

impl LatencyAccount {
    /// Adds the time of one stage of one frame.
    pub fn add(&mut self, stage: &'static str, duration: Duration) {
        if let Some(known) = self.stages.get_mut(stage) {
            known.add(duration);
        } else if let Some(mut fresh) = Durations::new() {
            fresh.add(duration);
            self.stages.insert(stage, fresh);
        }
    }

    /// Percentiles of one stage; zeros for a stage that never ran.
    pub fn stage_ms(&self, stage: &str) -> Percentiles {
        self.stages.get(stage).map_or_else(Percentiles::default, Durations::percentiles)
    }

    /// Percentiles of each stage by name.
    pub fn stages_ms(&self) -> BTreeMap<&'static str, Percentiles> {
        self.stages.iter().map(|(name, durations)| (*name, durations.percentiles())).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_those_of_the_sorted_durations() {
        let mut account = LatencyAccount::default();
        for milliseconds in (1..=1000).rev() {
            account.add("motion", Duration::from_millis(milliseconds));
            account.add("depth", Duration::from_millis(2 * milliseconds));
        }
        let near = |found: f64, expected: f64| (found / expected - 1.0).abs() < 0.011;
        let motion = account.stage_ms("motion");
        assert!(near(motion.p50, 500.0) && near(motion.p95, 950.0) && near(motion.p99, 990.0), "{motion:?}");
        assert!(near(motion.max, 1000.0));
        assert!(near(account.stages_ms()["depth"].p50, 1000.0));
    }

    #[test]
    fn no_frame_takes_no_time_and_no_duration_is_too_long() {
        assert_eq!(LatencyAccount::default().stage_ms("depth"), Percentiles::default());
        let near_a_day = |milliseconds: f64| (milliseconds / 86.4e6 - 1.0).abs() < 0.011;
        let mut account = LatencyAccount::default();
        account.add("depth", Duration::MAX);
        account.add("depth", Duration::ZERO);
        assert!(near_a_day(account.stage_ms("depth").max));
    }
}
