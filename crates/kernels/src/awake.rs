//! Keeping the threads of the pool awake.

use rayon::Yield;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// How long a thread without work waits before it may fall asleep after all.
const PATIENCE: Duration = Duration::from_micros(200);
/// How many works of callers from outside the pool are underway.
static UNDERWAY: AtomicUsize = AtomicUsize::new(0);

/// Counts a work as underway until it ends, by a panic too.
struct Underway;

impl Underway {
    fn begin() -> Self {
        UNDERWAY.fetch_add(1, Ordering::AcqRel);
        Self
    }
}

impl Drop for Underway {
    fn drop(&mut self) {
        UNDERWAY.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Does work of many small parallel parts on a thread of the pool, whose other threads stay awake between the parts.
///
/// Threads without work fall asleep within microseconds, and waking one takes longer than a small layer. A thread that
/// finds nothing to do for a while sleeps all the same, so that nobody waits for it. After the work of a caller from
/// outside the pool its threads stay awake for that while too, leaving their core to whoever wants it: the next work
/// often follows at once. Calls may be nested: the inner one wakes threads that have fallen asleep since. Burn keeps one
/// graph of gradients per thread, so a pass forward in here and its pass backward belong into the same call.
pub fn awake<R: Send>(work: impl FnOnce() -> R + Send) -> R {
    if rayon::current_thread_index().is_some() {
        return among_the_awake(work);
    }
    rayon::scope(|_| {
        let underway = Underway::begin();
        let result = among_the_awake(work);
        drop(underway);
        let until = Instant::now() + PATIENCE;
        (0..rayon::current_num_threads()).for_each(|_| rayon::spawn(move || linger(until)));
        result
    })
}

fn among_the_awake<R: Send>(work: impl FnOnce() -> R + Send) -> R {
    let done = &AtomicBool::new(false);
    rayon::scope(|scope| {
        let own = rayon::current_thread_index();
        for _ in 1..rayon::current_num_threads() {
            // The thread that does the work may get one of these back while it waits for others.
            scope.spawn(move |_| {
                if rayon::current_thread_index() != own {
                    wait_until(done);
                }
            });
        }
        let result = work();
        done.store(true, Ordering::Release);
        result
    })
}

/// Waits for the next work, which somebody who waits for parts of it must not be kept from.
fn linger(until: Instant) {
    while UNDERWAY.load(Ordering::Acquire) == 0 && Instant::now() < until {
        if matches!(rayon::yield_now(), Some(Yield::Executed)) {
            return;
        }
        std::thread::yield_now();
    }
}

fn wait_until(done: &AtomicBool) {
    let mut idle_since = Instant::now();
    while !done.load(Ordering::Acquire) && idle_since.elapsed() < PATIENCE {
        match rayon::yield_now() {
            Some(Yield::Executed) => idle_since = Instant::now(),
            _ => std::hint::spin_loop(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;

    #[test]
    fn work_is_done_once_nested_or_not() {
        let sum = || (0..1000_u64).into_par_iter().sum::<u64>();
        for threads in 1..4 {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let nested = || rayon::join(|| awake(sum), || awake(|| awake(sum)));
            assert_eq!(pool.install(nested), (499_500, 499_500));
        }
        assert_eq!(awake(|| rayon::join(|| awake(sum), sum)), (499_500, 499_500));
    }

    #[test]
    fn works_may_follow_each_other_at_once_and_come_from_several_callers() {
        let sums = || (0..200_u64).map(|first| awake(|| (first..1000).into_par_iter().sum::<u64>())).sum::<u64>();
        let expected = (0..200_u64).map(|first| (first..1000).sum::<u64>()).sum::<u64>();
        std::thread::scope(|scope| {
            let callers = [scope.spawn(sums), scope.spawn(sums)];
            assert!(callers.into_iter().all(|caller| caller.join().unwrap() == expected));
        });
    }

    #[test]
    fn nobody_lingers_for_ever() {
        // Each comes back, or this test never ends: after its time, and at once where that is over.
        linger(Instant::now() + PATIENCE);
        linger(Instant::now());
    }

    #[test]
    fn a_work_that_panics_is_no_longer_underway() {
        let panicked = std::panic::catch_unwind(|| awake(|| assert_eq!(rayon::current_num_threads(), 0)));
        assert!(panicked.is_err());
        // Other tests may have works underway, but each of them ends.
        while UNDERWAY.load(Ordering::Acquire) > 0 {
            std::thread::yield_now();
        }
    }
}
