//! Batches made ahead by a few threads, handed out in order.
//!
//! Thread `k` of `n` makes the batches of steps `k`, `k + n`, `k + 2n`, and the steps are collected in turn, so the order
//! never depends on which thread is faster. Each thread keeps at most `AHEAD` batches ready: memory is bounded.

use crate::batch::SnippetBatch;
use crate::dataset::{DrawPlan, SnippetDataset};
use crate::error::TrainError;
use burn::tensor::Device;
use endoscape_synthesis::ObjectiveConfig;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};

/// Batches a thread may have ready.
const AHEAD: usize = 2;

/// Hands out the batches of consecutive steps; dropping it ends its threads.
pub struct Loader {
    workers: Vec<Receiver<Result<SnippetBatch, TrainError>>>,
    turn: usize,
}

/// What the threads work from.
#[derive(Clone)]
pub struct LoaderPlan {
    /// The snippets.
    pub dataset: Arc<SnippetDataset>,
    /// How they are drawn.
    pub draw: DrawPlan,
    /// Decides which cameras a batch needs.
    pub objective: ObjectiveConfig,
    /// Where the batches go.
    pub device: Device,
}

impl Loader {
    /// Starts `threads` threads with the batch of step `first`.
    pub fn start(plan: &LoaderPlan, first: u64, threads: usize) -> Self {
        let threads = threads.max(1);
        let worker = |offset: usize| {
            let (sender, receiver) = sync_channel(AHEAD);
            let plan = plan.clone();
            std::thread::spawn(move || {
                for step in (first + offset as u64..).step_by(threads) {
                    let items = plan.draw.items(&plan.dataset, step);
                    let batch = items.and_then(|items| SnippetBatch::new(&items, &plan.objective, &plan.device));
                    let failed = batch.is_err();
                    // Nobody listens any more: the loader was dropped.
                    if sender.send(batch).is_err() || failed {
                        return;
                    }
                }
            });
            receiver
        };
        Self { workers: (0..threads).map(worker).collect(), turn: 0 }
    }

    /// The batch of the next step.
    ///
    /// # Errors
    /// [`TrainError`] of the snippet that could not be made, [`TrainError::Loader`] if a thread died.
    pub fn next_batch(&mut self) -> Result<SnippetBatch, TrainError> {
        let worker = &self.workers[self.turn % self.workers.len()];
        self.turn += 1;
        worker.recv().unwrap_or(Err(TrainError::Loader))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::augment::AugmentConfig;
    use crate::gap::GapConfig;
    use crate::testing::sliding_clip;
    use endoscape_core::event::NullSink;

    #[test]
    fn the_number_of_threads_changes_nothing() {
        let clips = vec![Arc::new(sliding_clip(24, 2.0))];
        let dataset = SnippetDataset::new(clips, 3, &GapConfig::default(), &mut NullSink).unwrap();
        let plan = LoaderPlan {
            dataset: Arc::new(dataset),
            draw: DrawPlan { seed: 4, batch: 2, augment: AugmentConfig::endo() },
            objective: ObjectiveConfig::paper(),
            device: Device::flex(),
        };
        let batches = |first: u64, threads: usize, count: usize| {
            let mut loader = Loader::start(&plan, first, threads);
            let batch = |_| loader.next_batch().unwrap().motion_inputs[1].to_data();
            (0..count).map(batch).collect::<Vec<_>>()
        };
        let all = batches(0, 1, 6);
        assert_eq!(batches(0, 3, 6), all);
        assert_eq!(batches(4, 2, 2), all[4..]);
    }
}
