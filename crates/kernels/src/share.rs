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
