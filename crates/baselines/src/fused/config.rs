//! How far the fusion trusts either side.

use super::FEWEST_SIGHTINGS;
use super::filter::{VisualStep, Walk};
use super::retrace::Motion;
use crate::{BaselineError, MagneticConfig};
use serde::{Deserialize, Serialize};

/// Settings of [`Fused`](super::Fused).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FusedConfig {
    /// Random walk of the position, metres per root second. Default 0.05: 9 mm from frame to frame at 30 Hz.
    pub walk_m: f64,
    /// Random walk of the orientation, radians per root second. Default 0.3: 3 degrees from frame to frame at 30 Hz.
    pub walk_rad: f64,
    /// Random walk of the logarithm of vision's scale, per root second. Default 0.1: a third in 10 s.
    pub walk_log_scale: f64,
    /// Standard deviation of the speed at which the wall moves by itself, metres per second along each axis: vision sees
    /// the way along the wall, not through the room. Default 3e-3: breath that moves an organ by 10 mm, 15 times a minute,
    /// has 5.6e-3 along the body, and simulated stomachs show 2e-3 to 6e-3 (docs/paper-experiment.md). 0 for a phantom.
    pub wall_m_per_s: f64,
    /// Standard deviation of a visual motion's translation: this share of it, beside the wall's. Default 0.2.
    pub visual_share: f64,
    /// ... and this at least, metres. Default 2e-4, the error per frame of ORB-SLAM2 and DSO on C3VD.
    pub visual_floor_m: f64,
    /// Standard deviation of a visual motion's rotation: this share of it. Default 0.1: a wall moves more than it turns.
    pub visual_turn_share: f64,
    /// ... and this at least, radians. Default 5e-3, as above.
    pub visual_floor_rad: f64,
    /// Visual motions below this confidence are not used. Default 0.1.
    pub visual_confidence: f64,
    /// Sightings roll and scale are found from, at most. Default 120, 4 s at 30 Hz.
    pub window: usize,
    /// The roll counts as known up to this standard deviation, radians. Default 0.1.
    pub known: f64,
    /// Settings of the magnetic side.
    pub magnetic: MagneticConfig,
}

impl Default for FusedConfig {
    fn default() -> Self {
        Self {
            walk_m: 0.05,
            walk_rad: 0.3,
            walk_log_scale: 0.1,
            wall_m_per_s: 0.003,
            visual_share: 0.2,
            visual_turn_share: 0.1,
            visual_floor_m: 2e-4,
            visual_floor_rad: 5e-3,
            visual_confidence: 0.1,
            window: 120,
            known: 0.1,
            magnetic: MagneticConfig::default(),
        }
    }
}

impl FusedConfig {
    pub(super) fn check(&self) -> Result<(), BaselineError> {
        let positive = [
            ("walk_m", self.walk_m),
            ("walk_rad", self.walk_rad),
            ("walk_log_scale", self.walk_log_scale),
            ("visual_share", self.visual_share),
            ("visual_turn_share", self.visual_turn_share),
            ("visual_floor_m", self.visual_floor_m),
            ("visual_floor_rad", self.visual_floor_rad),
            ("known", self.known),
        ];
        let bad = positive.into_iter().find(|(_, value)| !(value.is_finite() && *value > 0.0));
        if let Some((name, value)) = bad {
            return Err(BaselineError::Config { name, value, expected: "a finite number above 0" });
        }
        if !(self.wall_m_per_s.is_finite() && self.wall_m_per_s >= 0.0) {
            let (name, value) = ("wall_m_per_s", self.wall_m_per_s);
            return Err(BaselineError::Config { name, value, expected: "a finite number of at least 0" });
        }
        if self.window < FEWEST_SIGHTINGS {
            return Err(BaselineError::Config { name: "window", value: self.window as f64, expected: "at least 8" });
        }
        Ok(())
    }

    pub(super) const fn walk(&self) -> Walk {
        Walk { translation_m: self.walk_m, rotation_rad: self.walk_rad, log_scale: self.walk_log_scale }
    }

    /// A motion vision saw, with how far it is to be trusted; `log_scale` is that of metres per unit of vision.
    pub(super) fn step(&self, motion: &Motion, log_scale: f64) -> VisualStep {
        let way_m = motion.before_from_now.translation.vector.norm() * log_scale.exp();
        let turn_rad = motion.before_from_now.rotation.angle();
        let by_wall_m = self.wall_m_per_s * motion.elapsed_s;
        VisualStep {
            motion: motion.before_from_now,
            translation_sigma_m: self.visual_floor_m.hypot(self.visual_share * way_m).hypot(by_wall_m),
            rotation_sigma_rad: self.visual_floor_rad.hypot(self.visual_turn_share * turn_rad),
        }
    }
}
