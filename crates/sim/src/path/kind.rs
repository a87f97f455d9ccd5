//! The kinds of flight and their habits.

use crate::SimError;
use crate::anatomy::Axis;
use crate::random::Key;
use std::str::FromStr;

/// Kinds of flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PathKind {
    /// A swallowed capsule: carried by peristalsis, tumbling and drifting.
    Capsule,
    /// A magnetically steered capsule: slow steps of translation and rotation.
    Steered1,
    /// Steered: a scan with many small loops.
    Steered2,
    /// Steered: a wide scan with more entangled loops.
    Steered3,
    /// Steered: quick motions in all directions at once.
    Steered4,
    /// A flexible endoscope going in, its tip searching the way.
    Insertion,
    /// A flexible endoscope coming out, its view circling along the wall.
    Withdrawal,
    /// A flexible endoscope that bends back and looks at where it came from.
    Retroflexion,
    /// A hand-held inspection with the speeds measured in C3VD.
    Survey,
}

impl PathKind {
    /// All kinds.
    pub const ALL: [Self; 9] = [
        Self::Capsule,
        Self::Steered1,
        Self::Steered2,
        Self::Steered3,
        Self::Steered4,
        Self::Insertion,
        Self::Withdrawal,
        Self::Retroflexion,
        Self::Survey,
    ];

    /// Its name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Capsule => "capsule",
            Self::Steered1 => "steered-1",
            Self::Steered2 => "steered-2",
            Self::Steered3 => "steered-3",
            Self::Steered4 => "steered-4",
            Self::Insertion => "insertion",
            Self::Withdrawal => "withdrawal",
            Self::Retroflexion => "retroflexion",
            Self::Survey => "survey",
        }
    }
}

impl FromStr for PathKind {
    type Err = SimError;

    fn from_str(text: &str) -> Result<Self, SimError> {
        Self::ALL.into_iter().find(|kind| kind.name() == text).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            SimError::parameter(format!("there is no path `{text}`"), format!("use one of: {names}"))
        })
    }
}

/// How a flight uses its stretch of the axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Course {
    /// There and back.
    Roam,
    /// From the natural opening inwards.
    Forward,
    /// The other way round, still looking inwards.
    Backward,
}

/// Numbers of a kind; lengths in metres, times in seconds, angles in radians.
#[derive(Clone, Copy, Debug)]
pub(super) struct Habits {
    pub course: Course,
    /// Longest stretch of the axis flown along.
    pub stretch_m: f64,
    /// Mean progress along the axis.
    pub speed_m_s: f64,
    /// Irregular progress on top of it.
    pub surge_m: f64,
    pub surge_period_s: f64,
    /// Share of the free room used across the lumen.
    pub stray: f64,
    pub stray_period_s: f64,
    /// Share of the straying that goes in loops, and their period.
    pub loops: f64,
    pub loop_period_s: f64,
    /// Ratio of the two frequencies of a loop; 1 is a circle.
    pub lissajous: f64,
    /// Unrest of the view.
    pub tilt_rad: f64,
    pub turn_period_s: f64,
    pub roll_rad: f64,
    pub spin_rad_s: f64,
    /// Half-angle of the cone on which the view circles.
    pub circling_rad: f64,
    pub retroflexion_rad: f64,
    /// Limits of the centre of projection.
    pub fastest_m_s: f64,
    pub hardest_m_s2: f64,
}

/// A steered capsule that barely moves; the other kinds are told by their differences.
const CALM: Habits = Habits {
    course: Course::Roam,
    stretch_m: 0.08,
    speed_m_s: 0.002,
    surge_m: 0.003,
    surge_period_s: 9.0,
    stray: 0.45,
    stray_period_s: 14.0,
    loops: 0.0,
    loop_period_s: 12.0,
    lissajous: 1.0,
    tilt_rad: 0.30,
    turn_period_s: 13.0,
    roll_rad: 0.25,
    spin_rad_s: 0.0,
    circling_rad: 0.0,
    retroflexion_rad: 0.0,
    fastest_m_s: 0.02,
    hardest_m_s2: 0.05,
};

const STEERED_2: Habits = Habits {
    loops: 0.7,
    stray: 0.7,
    loop_period_s: 10.0,
    speed_m_s: 0.004,
    fastest_m_s: 0.03,
    hardest_m_s2: 0.08,
    ..CALM
};

const STEERED_3: Habits = Habits {
    stretch_m: 0.14,
    loops: 0.6,
    stray: 0.8,
    loop_period_s: 8.0,
    lissajous: 1.5,
    speed_m_s: 0.006,
    surge_m: 0.008,
    tilt_rad: 0.5,
    turn_period_s: 9.0,
    fastest_m_s: 0.04,
    hardest_m_s2: 0.12,
    ..CALM
};

const STEERED_4: Habits = Habits {
    stretch_m: 0.14,
    loops: 0.4,
    stray: 0.85,
    stray_period_s: 5.0,
    loop_period_s: 4.0,
    lissajous: 2.0,
    speed_m_s: 0.010,
    surge_m: 0.008,
    surge_period_s: 4.0,
    tilt_rad: 0.7,
    turn_period_s: 4.5,
    roll_rad: 0.7,
    fastest_m_s: 0.06,
    hardest_m_s2: 0.4,
    ..CALM
};

const CAPSULE: Habits = Habits {
    stretch_m: 0.5,
    speed_m_s: 0.003,
    surge_m: 0.010,
    surge_period_s: 20.0,
    stray: 0.85,
    stray_period_s: 11.0,
    tilt_rad: 1.0,
    turn_period_s: 16.0,
    roll_rad: 1.5,
    spin_rad_s: 0.03,
    fastest_m_s: 0.03,
    hardest_m_s2: 0.08,
    ..CALM
};

const INSERTION: Habits = Habits {
    course: Course::Forward,
    stretch_m: 2.0,
    speed_m_s: 0.012,
    surge_m: 0.012,
    surge_period_s: 7.0,
    stray: 0.7,
    stray_period_s: 6.0,
    tilt_rad: 0.45,
    turn_period_s: 6.0,
    roll_rad: 0.8,
    fastest_m_s: 0.06,
    hardest_m_s2: 0.3,
    ..CALM
};

const WITHDRAWAL: Habits = Habits {
    course: Course::Backward,
    stretch_m: 2.0,
    speed_m_s: 0.007,
    surge_m: 0.006,
    stray: 0.6,
    stray_period_s: 8.0,
    tilt_rad: 0.2,
    circling_rad: 0.45,
    loop_period_s: 7.0,
    fastest_m_s: 0.04,
    hardest_m_s2: 0.2,
    ..CALM
};

const RETROFLEXION: Habits = Habits {
    course: Course::Forward,
    stretch_m: 0.06,
    speed_m_s: 0.006,
    stray: 0.5,
    tilt_rad: 0.25,
    roll_rad: 1.2,
    spin_rad_s: 0.05,
    retroflexion_rad: 2.9,
    fastest_m_s: 0.03,
    hardest_m_s2: 0.1,
    ..CALM
};

const SURVEY: Habits = Habits {
    stretch_m: 0.12,
    speed_m_s: 0.005,
    surge_m: 0.006,
    surge_period_s: 8.0,
    stray: 0.6,
    stray_period_s: 9.0,
    tilt_rad: 0.35,
    turn_period_s: 10.0,
    roll_rad: 0.3,
    fastest_m_s: 0.03,
    hardest_m_s2: 0.1,
    ..CALM
};

impl PathKind {
    /// Kinds 1 to 4 follow the descriptions of the four trajectories in M. Turan et al., "A non-rigid map fusion-based
    /// direct SLAM method for endoscopic capsule robots" (2017): slow increments; a scan with many local loop closures;
    /// a wider scan with more complex ones; fast combined motions of high frequency. Speeds of an endoscope's tip are
    /// those of C3VD (median 6 mm/s and 3 to 7 degrees/s at 30 frames per second).
    pub(super) const fn habits(self) -> Habits {
        match self {
            Self::Steered1 => CALM,
            Self::Steered2 => STEERED_2,
            Self::Steered3 => STEERED_3,
            Self::Steered4 => STEERED_4,
            Self::Capsule => CAPSULE,
            Self::Insertion => INSERTION,
            Self::Withdrawal => WITHDRAWAL,
            Self::Retroflexion => RETROFLEXION,
            Self::Survey => SURVEY,
        }
    }
}

impl Habits {
    /// The part of the passable axis this flight uses: all of it, or a piece around a wide place.
    pub(super) fn stretch(&self, from_m: f64, to_m: f64, axis: &Axis, key: Key) -> (f64, f64) {
        // Blind ends are dull to look at: a flight turns before it reaches them.
        let spare_m = 0.1 * (to_m - from_m);
        let (from_m, to_m) = (from_m + spare_m, to_m - spare_m);
        if to_m - from_m <= self.stretch_m {
            return (from_m, to_m);
        }
        if self.stretch_m > 1.0 {
            return (from_m, from_m + self.stretch_m);
        }
        // Of a few places the roomiest, so that seeds differ and no flight is cramped.
        let candidate = |i: u64| key.of("stretch").at(i).range(from_m, to_m - self.stretch_m);
        let room = |start_m: &f64| axis.room_m(start_m + 0.5 * self.stretch_m);
        let start_m = (0..4).map(candidate).max_by(|a, b| room(a).total_cmp(&room(b))).unwrap_or(from_m);
        (start_m, start_m + self.stretch_m)
    }
}
