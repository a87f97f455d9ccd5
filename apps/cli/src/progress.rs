//! Progress on a terminal, silence in a pipe.

use endoscape_core::{Event, EventSink};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{IsTerminal as _, Write as _};

/// Draws a bar per stage on standard error when that is a terminal; prints warnings either way.
pub struct Progress {
    bar: ProgressBar,
    stage: String,
    /// Figures of the stage by name, the latest of each.
    figures: Vec<(String, f64)>,
}

impl Progress {
    /// A sink for one command.
    pub fn new() -> Self {
        Self { bar: ProgressBar::hidden(), stage: String::new(), figures: Vec::new() }
    }

    fn start(&mut self, stage: String, total: Option<u64>) {
        let (bar, template) = match total {
            Some(total) => (ProgressBar::new(total), "{msg} {wide_bar} {pos}/{len} {per_sec} {eta}"),
            None => (ProgressBar::new_spinner(), "{msg} {spinner} {pos} {per_sec} {elapsed}"),
        };
        let hidden = !std::io::stderr().is_terminal();
        bar.set_draw_target(if hidden { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() });
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        bar.set_message(stage.clone());
        (self.bar, self.stage, self.figures) = (bar, stage, Vec::new());
    }

    /// Shows the latest figures beside the name of the stage.
    fn measure(&mut self, name: String, value: f64) {
        match self.figures.iter_mut().find(|(known, _)| *known == name) {
            Some((_, latest)) => *latest = value,
            None => self.figures.push((name, value)),
        }
        let figures: Vec<String> = self.figures.iter().map(|(name, value)| format!("{name} {value:.4}")).collect();
        self.bar.set_message(format!("{}  {}", self.stage, figures.join("  ")));
    }
}

impl EventSink for Progress {
    fn event(&mut self, event: Event) {
        match event {
            Event::Started { stage, total } => self.start(stage, total),
            Event::Advanced { done } => self.bar.set_position(done),
            Event::Warned(warning) => self.bar.suspend(|| {
                writeln!(std::io::stderr(), "warning: {warning}").ok();
            }),
            Event::Measured { name, value, .. } => self.measure(name, value),
            Event::Finished => self.bar.finish_and_clear(),
        }
    }
}
