//! What floats between the wall and the lens: pooled fluid, bubbles, debris.

use crate::Effects;
use crate::render::{Moment, Sample, Scene};
use crate::sensor::Veil;

/// Everything in the lumen that is not wall.
#[derive(Clone, Debug)]
pub struct Medium {
    effects: Effects,
    seed: u64,
}

impl Medium {
    /// What the effects ask for.
    pub const fn new(effects: Effects, seed: u64) -> Self {
        Self { effects, seed }
    }

    /// What veils the wall in a frame; `None` if nothing can.
    pub fn veil(&self, _scene: &Scene<'_>, _now: &Moment<'_>, _samples: &[Sample], _time_s: f64) -> Option<Veil> {
        let _ = (self.effects, self.seed);
        None
    }
}
