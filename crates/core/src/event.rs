//! How libraries tell what happens: values handed to a sink, never text on a terminal.

/// Something worth telling while work is under way.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A stage begins; `total` steps where that is known.
    Started {
        /// Name of the stage, as a user would say it.
        stage: String,
        /// Steps it will take, where known.
        total: Option<u64>,
    },
    /// `done` steps of the current stage are finished.
    Advanced {
        /// Steps finished so far.
        done: u64,
    },
    /// A figure that changes along the work, such as a loss or a rate.
    Measured {
        /// Name with its unit, such as `photometric` or `latency_ms`.
        name: String,
        /// Step the figure belongs to.
        step: u64,
        /// The figure.
        value: f64,
    },
    /// Something the user should know but that does not stop the work.
    Warned(String),
    /// The current stage is over.
    Finished,
}

/// Takes events as they happen. A sink must be quick: it runs inside the work.
pub trait EventSink {
    /// Takes one event.
    fn event(&mut self, event: Event);
}

/// Forgets every event.
#[derive(Clone, Copy, Debug, Default)]
pub struct NullSink;

impl EventSink for NullSink {
    fn event(&mut self, _event: Event) {}
}

/// Keeps every event in order; for tests and for callers that look afterwards.
impl EventSink for Vec<Event> {
    fn event(&mut self, event: Event) {
        self.push(event);
    }
}

/// Tells several sinks, first to last.
impl EventSink for Vec<Box<dyn EventSink>> {
    fn event(&mut self, event: Event) {
        for sink in self.iter_mut() {
            sink.event(event.clone());
        }
    }
}
