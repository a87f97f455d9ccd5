//! Tasks dealt out to threads.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::vec::IntoIter;

/// How often a thread that is done looks whether the others are, before it may fall asleep.
const LOOKS: usize = 10_000;

/// Does all tasks, each by the thread that is free next.
///
/// Equal tasks do not take equal times where a core is lent to others too, so none belongs to a thread before it is begun.
/// Neighbours often read the same numbers, so the caller works from the first one on, the others from the last one back.
pub fn share<T: Send>(tasks: Vec<T>, run: impl Fn(T) + Sync) {
    let threads = rayon::current_num_threads().min(tasks.len());
    if threads < 2 {
        return tasks.into_iter().for_each(run);
    }
    let unfinished = AtomicUsize::new(tasks.len());
    let tasks = Mutex::new(tasks.into_iter());
    let work = |next: fn(&mut IntoIter<T>) -> Option<T>| {
        let next = || next(&mut tasks.lock().unwrap_or_else(PoisonError::into_inner));
        while let Some(task) = next() {
            run(task);
            unfinished.fetch_sub(1, Ordering::Release);
        }
    };
    rayon::in_place_scope(|scope| {
        (1..threads).for_each(|_| scope.spawn(|_| work(IntoIter::next_back)));
        work(IntoIter::next);
        // A thread that waits for the scope falls asleep within microseconds, and waking it takes longer than a task.
        let _ = (0..LOOKS).find(|_| {
            std::hint::spin_loop();
            unfinished.load(Ordering::Acquire) == 0
        });
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_task_is_done_once_by_any_number_of_threads() {
        for threads in 1..4 {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            for count in [0, 1, 2, 5, 100] {
                let mut done = vec![0; count];
                pool.install(|| share(done.iter_mut().collect(), |times| *times += 1));
                assert_eq!(done, vec![1; count], "{threads} threads");
            }
        }
        let mut done = [0; 9];
        share(done.iter_mut().collect(), |times| *times += 1);
        assert_eq!(done, [1; 9], "from outside the pool");
    }

    #[test]
    fn a_panic_of_a_task_reaches_the_caller() {
        let failing = || share((0..8).collect(), |task| assert_ne!(task, 5));
        assert!(std::panic::catch_unwind(failing).is_err());
    }
}
