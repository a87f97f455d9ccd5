//! Which frames of a clip make a snippet: how many frames lie between neighbours.
//!
//! Neighbouring frames of a slow endoscope move by less than a pixel, which teaches nothing: the networks learn from
//! parallax. Too far apart and the views do not overlap. So for every frame the gap is chosen by how far the picture
//! moves, and stretches in which it hardly moves are left out.

use crate::clip::Clip;
use crate::error::TrainError;
use endoscape_frames::parallax::{Thumbnail, displacement, displacement_at};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Gaps that are tried, in frames; the last is a second of ordinary video.
const LADDER: [usize; 11] = [1, 2, 3, 4, 6, 8, 10, 12, 16, 24, 32];

/// The camera stands where a quarter of the picture moves by less than this share of [`GapConfig::least`]: half a pixel
/// of the thumbnails for the usual 0.02, as far as anybody can tell.
const STANDING: f64 = 0.25;

/// How the gap between the frames of a snippet is chosen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GapConfig {
    /// Frames from one frame of a snippet to the next; 0 chooses by displacement. Default 0.
    pub fixed: usize,
    /// Smallest median displacement from one frame of a snippet to the next, as a share of the picture's width.
    /// Default 0.02: 3 pixels at 160, 8 at 416, about what neighbouring frames of KITTI move.
    pub least: f64,
    /// Largest such displacement; every gap between both is used. Default 0.04.
    pub most: f64,
    /// Whether frames around which the picture hardly moves or the camera stands are used too, at every gap: they teach
    /// nothing about depth, but that standing still is a motion. Default off; on in `adapt`.
    pub still: bool,
}

impl Default for GapConfig {
    fn default() -> Self {
        Self { fixed: 0, least: 0.02, most: 0.04, still: false }
    }
}

impl GapConfig {
    /// # Errors
    /// [`TrainError::Config`] for displacements that are out of order or beyond what can be measured.
    pub fn validate(&self) -> Result<(), TrainError> {
        let ordered = self.least >= 0.0 && self.least < self.most && self.most <= 0.1;
        if ordered {
            return Ok(());
        }
        let reason = format!("is {} to {}, but 0 <= least < most <= 0.1 is needed", self.least, self.most);
        Err(TrainError::config("gap.least, gap.most", reason))
    }
}

/// A target frame of a clip and the gaps at which it has all its neighbours.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Target {
    /// Index into [`Clip::frames`].
    pub frame: usize,
    /// Possible gaps in frames, smallest first, never empty.
    pub gaps: Vec<usize>,
    /// Whether the camera stands at the smallest of them, whatever moves before it.
    pub stands: bool,
}

/// What was chosen in a clip, and why the rest was not.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Targets {
    /// The targets in time order.
    pub targets: Vec<Target>,
    /// Frames around which the picture hardly moves.
    pub still: usize,
    /// Frames in which too little is recognised again.
    pub unmatched: usize,
}

impl Targets {
    /// Gap in the middle of all that are possible, if any is.
    pub fn median_gap(&self) -> Option<usize> {
        let mut gaps: Vec<usize> = self.targets.iter().flat_map(|target| target.gaps.iter().copied()).collect();
        let middle = gaps.len() / 2;
        (!gaps.is_empty()).then(|| *gaps.select_nth_unstable(middle).1)
    }
}

/// Chooses targets and gaps for snippets of `length` frames, the target in the middle.
pub fn choose(clip: &Clip, length: usize, config: &GapConfig) -> Targets {
    let (count, side) = (clip.frames.len(), length / 2);
    let fits = |frame: usize, gap: usize| frame >= side * gap && frame + side * gap < count;
    let thumbnails: Vec<Thumbnail> =
        clip.frames.par_iter().map(|frame| Thumbnail::new(&frame.image, &frame.usable)).collect();
    if config.fixed > 0 {
        let frames = (0..count).filter(|frame| fits(*frame, config.fixed));
        return Targets {
            targets: frames.map(|frame| target(&thumbnails, frame, vec![config.fixed], config)).collect(),
            ..Targets::default()
        };
    }
    let reach: Vec<Gaps> = (0..count).into_par_iter().map(|frame| gaps_after(&thumbnails, frame, config)).collect();
    let mut chosen = Targets::default();
    for (frame, gaps) in reach.into_iter().enumerate() {
        let gaps = match gaps {
            Gaps::Unmatched => {
                chosen.unmatched += 1;
                continue;
            }
            Gaps::Still => {
                chosen.still += 1;
                if config.still { LADDER.into() } else { continue }
            }
            Gaps::Found(gaps) => gaps,
        };
        let mut target = target(&thumbnails, frame, gaps, config);
        target.gaps.retain(|gap| fits(frame, *gap));
        if !target.gaps.is_empty() {
            chosen.targets.push(target);
        }
    }
    chosen
}

/// A target with its gaps; where the camera stands and such frames are wanted, with all the smaller ones too.
fn target(thumbnails: &[Thumbnail], frame: usize, gaps: Vec<usize>, config: &GapConfig) -> Target {
    let stands = stands(thumbnails, frame, gaps[0], config);
    let largest = gaps[gaps.len() - 1];
    let all = || LADDER.into_iter().filter(|gap| *gap <= largest).collect();
    let gaps = if stands && config.still && config.fixed == 0 { all() } else { gaps };
    Target { frame, gaps, stands }
}

/// Whether the camera has stood still from a frame to the one `gap` later, or earlier at the end of the clip.
fn stands(thumbnails: &[Thumbnail], frame: usize, gap: usize, config: &GapConfig) -> bool {
    let other = if frame + gap < thumbnails.len() { Some(frame + gap) } else { frame.checked_sub(gap) };
    let quarter = other.and_then(|other| displacement_at(&thumbnails[frame], &thumbnails[other], 0.25));
    quarter.is_some_and(|moved| moved < STANDING * config.least)
}

enum Gaps {
    Still,
    Unmatched,
    Found(Vec<usize>),
}

/// Gaps after which the picture has moved as far as wanted; the smallest gap that moves it enough if none hits.
fn gaps_after(thumbnails: &[Thumbnail], frame: usize, config: &GapConfig) -> Gaps {
    let mut found = Vec::new();
    let mut measured = false;
    for gap in LADDER {
        // The end of the clip is judged by looking back.
        let other = if frame + gap < thumbnails.len() { Some(frame + gap) } else { frame.checked_sub(gap) };
        let Some(moved) = other.and_then(|other| displacement(&thumbnails[frame], &thumbnails[other])) else { break };
        measured = true;
        if moved > config.most && !found.is_empty() {
            break;
        }
        if moved >= config.least {
            found.push(gap);
        }
        if moved > config.most {
            break;
        }
    }
    match (measured, found.is_empty()) {
        (false, _) => Gaps::Unmatched,
        (true, true) => Gaps::Still,
        (true, false) => Gaps::Found(found),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{clip_of, sliding_clip};
    use endoscape_core::{Image, Size};

    #[test]
    fn the_gap_grows_as_the_camera_slows_down() {
        // Two per cent of 96 pixels are 1.9.
        for (pixels_per_frame, first_gap) in [(2.5, 1), (1.0, 2), (0.5, 4)] {
            let targets = choose(&sliding_clip(40, pixels_per_frame), 3, &GapConfig::default());
            let middle = targets.targets.iter().find(|target| target.frame == 20).unwrap();
            assert_eq!(middle.gaps[0], first_gap, "{pixels_per_frame} pixels per frame: {middle:?}");
        }
    }

    #[test]
    fn all_frames_of_a_snippet_exist() {
        for length in [3, 5, 7] {
            let targets = choose(&sliding_clip(30, 1.0), length, &GapConfig::default());
            for Target { frame, gaps, .. } in &targets.targets {
                assert!(gaps.iter().all(|gap| *frame >= length / 2 * gap && frame + length / 2 * gap < 30));
            }
            assert!(targets.median_gap().is_some());
        }
    }

    #[test]
    fn still_and_unrecognisable_stretches_are_left_out() {
        let still = choose(&sliding_clip(12, 0.0), 3, &GapConfig::default());
        assert_eq!((still.targets.len(), still.still), (0, 12));
        let config = GapConfig { still: true, ..GapConfig::default() };
        let wanted = choose(&sliding_clip(12, 0.0), 3, &config);
        assert!(wanted.targets.len() == 10 && wanted.targets.iter().all(|target| target.stands), "{wanted:?}");
        let moving = choose(&sliding_clip(12, 2.5), 3, &config);
        assert!(moving.targets.len() > 5 && moving.targets.iter().all(|target| !target.stands), "{moving:?}");
        let black = clip_of((0..12).map(|_| Image::from_fn(Size::new(96, 64), |_, _| [0; 3])).collect());
        assert_eq!(choose(&black, 3, &GapConfig::default()).unmatched, 12);
    }

    #[test]
    fn a_fixed_gap_is_taken_at_its_word() {
        let config = GapConfig { fixed: 2, ..GapConfig::default() };
        let targets = choose(&sliding_clip(9, 0.0), 5, &config);
        assert_eq!(targets.targets, [Target { frame: 4, gaps: vec![2], stands: true }]);
    }
}
