//! What roll and scale, found late, say of the frames before: the filter runs back through them (docs/math.md,
//! "Fusion").
//!
//! On the way back the sign of time is turned and motions are inverted; everything else is as on the way forth. A frame
//! is told anew where the way back is surer of its rotation than the way forth was, so the way ends where it has nothing
//! to add.

use super::FusedConfig;
use super::filter::{Filter, MagnetFix};
use endoscape_core::{Pose, TimedPose};
use std::collections::VecDeque;

/// A motion vision saw, in its own unit.
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    /// The camera now, seen from where it was when vision was last sure.
    pub before_from_now: Pose,
    /// Time between the two, seconds.
    pub elapsed_s: f64,
}

impl Motion {
    fn inverse(&self) -> Self {
        Self { before_from_now: self.before_from_now.inverse(), ..*self }
    }
}

/// What vision said at one frame.
#[derive(Clone, Copy, Debug)]
pub enum Sight {
    /// Nothing new: it was not sure, or saw the picture before again.
    Nothing,
    /// A pose that nothing ties to earlier ones.
    Anew,
    /// A motion since the frame before that was no [`Sight::Nothing`].
    Moved(Motion),
}

/// What both sides said at one frame.
#[derive(Clone, Debug)]
pub struct Moment {
    /// Seconds.
    pub time_s: f64,
    /// The last fix since the frame before that agreed with what was known then, if there was one.
    pub fix: Option<MagnetFix>,
    /// What vision said.
    pub sight: Sight,
    /// Standard deviation of the rotation as the frame was told, radians.
    pub rotation_sigma_rad: f64,
}

/// Poses of the frames before the newest of `moments`, the latest first, from the filter at that newest one.
pub fn retraced(moments: &VecDeque<Moment>, filter: &Filter, config: &FusedConfig) -> Vec<TimedPose> {
    let mut moments = moments.iter().rev();
    let Some(newest) = moments.next() else { return Vec::new() };
    let mut back = Backwards { filter: filter.starting_at(-newest.time_s), pending: None, config };
    back.leave(newest);
    moments.map_while(|moment| back.visit(moment)).collect()
}

struct Backwards<'a> {
    /// Its clone is the camera at the last frame left that vision was sure of.
    filter: Filter,
    /// The motion from that frame to the one before it.
    pending: Option<Motion>,
    config: &'a FusedConfig,
}

impl Backwards<'_> {
    /// Goes back to a moment; `None` where it is known better already.
    fn visit(&mut self, moment: &Moment) -> Option<TimedPose> {
        self.filter.predict(-moment.time_s, &self.config.walk());
        if !matches!(moment.sight, Sight::Nothing)
            && let Some(motion) = self.pending.take()
        {
            self.filter.follow(&self.config.step(&motion, self.filter.log_scale));
        }
        if let Some(fix) = &moment.fix {
            self.filter.take_magnet(fix);
        }
        let world_from_camera = self.filter.world_from_camera;
        let surer = self.filter.rotation_sigma_rad() < moment.rotation_sigma_rad;
        self.leave(moment);
        surer.then_some(TimedPose { time_s: moment.time_s, world_from_camera })
    }

    /// Prepares for the moment before.
    fn leave(&mut self, moment: &Moment) {
        if !matches!(moment.sight, Sight::Nothing) {
            self.filter.clone_pose();
        }
        match moment.sight {
            Sight::Nothing => {}
            Sight::Anew => self.pending = None,
            Sight::Moved(motion) => self.pending = Some(motion.inverse()),
        }
    }
}
