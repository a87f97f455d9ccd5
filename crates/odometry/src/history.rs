//! Which frames a motion is measured between.
//!
//! The motion network was trained on windows whose frames are evenly spaced in time, the target in the middle, and far
//! enough apart for the picture to have moved (`train`, gap). Neighbouring frames of a slow endoscope are closer, and
//! chaining their tiny motions adds up the error of each. So every frame is measured against a keyframe:
//!
//! ```text
//! keyframes        A ........ L ....
//! new frame                         F      measured against A, the anchor
//! window     B ... A ........ ..... F      B as long before A as F is after; target A; sources B, F
//! ```
//! - The latest keyframe L is made when the picture has moved by the trained displacement since the anchor A.
//! - A frame less than that away from L is measured against A: between one and two trained displacements, the very
//!   range that training uses. One that is farther becomes the latest keyframe, and L the anchor.
//! - For windows of more than three frames the others lie evenly between B, A and F.
//!
//! No frame waits for a later one: the newest is the last source. Where every frame is far (gap 1) this is the plain
//! sliding window. When L becomes the anchor, B of its first window is the keyframe that L was measured against, about
//! as far before it as F is after: the motion to B is a second, backward estimate of the very link that placed L.
//!
//! Memory: two keyframes and the last [`REMEMBERED`] frames before each.

use crate::refine::Contrast;
use crate::scale::Scale;
use endoscape_baselines::direct::align::Reference;
use endoscape_core::{Grid, Image, Pose};
use endoscape_frames::parallax::{Thumbnail, displacement};
use endoscape_synthesis::Alignment;
use std::collections::VecDeque;
use std::sync::Arc;

/// Frames kept to fill windows from: twice the largest gap that training tries.
pub const REMEMBERED: usize = 64;
/// Displacements are measured up to a tenth of the width; a keyframe is made before half of that is used up, because a
/// frame may be twice as far from its anchor.
const LARGEST_DISPLACEMENT: f64 = 0.05;

/// A frame that may fill a place in a window.
#[derive(Clone, Debug)]
pub struct View {
    /// Its place in the stream, frames that were not usable counted too.
    pub position: usize,
    /// The picture at the networks' size.
    pub image: Arc<Image>,
    /// For refining the motion to it from a later anchor: kept with keyframes only, being larger than the picture.
    pub contrast: Option<Arc<Contrast>>,
    /// Its pose in the unit of the sequence.
    pub world_from_camera: Pose,
}

/// A frame that others are measured against.
#[derive(Clone, Debug)]
pub struct Keyframe {
    /// Picture and pose.
    pub view: View,
    /// Brightness of the picture.
    pub luma: Arc<Grid<f32>>,
    /// For measuring displacement.
    pub thumbnail: Thumbnail,
    /// Depth in the network's unit for this frame.
    pub depth: Arc<Grid<f32>>,
    /// From that unit to the unit of the sequence.
    pub scale: Scale,
    /// For refining the motions from it; `None` where they are not.
    pub reference: Option<Reference>,
    /// For the alignment network; `None` without one.
    pub alignment: Option<Alignment>,
    /// Frames before it, oldest first.
    before: Vec<View>,
    /// The keyframe it was measured against.
    previous: Option<View>,
}

/// How far the picture has moved since the latest keyframe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distance {
    /// Too little for a motion to be measured from there; the displacement as a share of the width, where it is known.
    Near(Option<f64>),
    /// Enough.
    Far,
}

/// When a frame is far from a keyframe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spacing {
    /// Sources on each side of a target.
    pub side: usize,
    /// Frames between neighbours of a window; 0 to go by displacement.
    pub fixed_gap: usize,
    /// Displacement between neighbours of a window, share of the width.
    pub least_displacement: f64,
}

/// The frames of a window.
#[derive(Clone, Debug)]
pub struct Window {
    /// The anchor's picture.
    pub target: Arc<Image>,
    /// In time order; the last is the newest frame.
    pub sources: Vec<Arc<Image>>,
    /// The first source, where that is the keyframe that the anchor was measured against.
    pub previous: Option<View>,
}

/// What is remembered of the stream.
#[derive(Clone, Debug)]
pub struct History {
    spacing: Spacing,
    anchor: Keyframe,
    latest: Keyframe,
    recent: VecDeque<View>,
    /// Frames between the last two keyframes: the guess where displacement cannot be measured.
    usual_gap: usize,
}

impl Keyframe {
    /// A keyframe without a past.
    pub const fn new(
        view: View,
        luma: Arc<Grid<f32>>,
        thumbnail: Thumbnail,
        depth: Arc<Grid<f32>>,
        scale: Scale,
    ) -> Self {
        Self {
            view,
            luma,
            thumbnail,
            depth,
            scale,
            reference: None,
            alignment: None,
            before: Vec::new(),
            previous: None,
        }
    }
}

impl History {
    /// Begins with the first usable frame.
    pub fn new(first: Keyframe, spacing: Spacing) -> Self {
        let recent = VecDeque::from([View { contrast: None, ..first.view.clone() }]);
        Self { spacing, anchor: first.clone(), latest: first, recent, usual_gap: 1 }
    }

    /// The keyframe that the newest frame is measured against.
    pub const fn anchor(&self) -> &Keyframe {
        &self.anchor
    }

    /// The same, to learn more about it.
    pub const fn anchor_mut(&mut self) -> &mut Keyframe {
        &mut self.anchor
    }

    /// Whether there is only one keyframe so far, so that the anchor may be closer than training has seen.
    pub const fn is_beginning(&self) -> bool {
        self.anchor.view.position == self.latest.view.position
    }

    /// Judges the distance of a new frame from the latest keyframe.
    pub fn distance(&self, thumbnail: &Thumbnail, position: usize) -> Distance {
        let gap = position.saturating_sub(self.latest.view.position);
        let Spacing { side, fixed_gap, least_displacement } = self.spacing;
        if fixed_gap > 0 {
            return if gap >= side * fixed_gap { Distance::Far } else { Distance::Near(None) };
        }
        let enough = (side as f64 * least_displacement).min(LARGEST_DISPLACEMENT);
        match displacement(&self.latest.thumbnail, thumbnail) {
            Some(moved) if moved >= enough => Distance::Far,
            None if gap >= self.usual_gap => Distance::Far,
            moved => Distance::Near(moved),
        }
    }

    /// Makes the latest keyframe the anchor, because a frame far from it has come.
    pub fn advance(&mut self) {
        self.anchor = self.latest.clone();
    }

    /// The window of a frame that has just come; `looks_back` if it is the first one of its anchor.
    pub fn window(&self, position: usize, image: &Arc<Image>, looks_back: bool) -> Window {
        let Keyframe { view: anchor, before, previous, .. } = &self.anchor;
        let previous = previous.as_ref().filter(|_| looks_back);
        let (span, side) = (position.saturating_sub(anchor.position), self.spacing.side.max(1));
        let place = |step: usize| (span * step).div_ceil(side);
        let earlier = |step: usize| nearest(before.iter(), anchor.position.saturating_sub(place(step)));
        let later = |step: usize| nearest(self.recent.iter(), anchor.position + place(step));
        // At the beginning the anchor itself stands in for frames that do not exist.
        let picture = |view: Option<&View>| view.unwrap_or(anchor).image.clone();
        let first = picture(previous.or_else(|| earlier(side)));
        let earlier_sources = std::iter::once(first).chain((1..side).rev().map(|step| picture(earlier(step))));
        let later_sources = (1..side).map(|step| picture(later(step)));
        Window {
            target: anchor.image.clone(),
            sources: earlier_sources.chain(later_sources).chain([image.clone()]).collect(),
            previous: previous.cloned(),
        }
    }

    /// Remembers a frame whose pose is known now; `keyframe` if it is to become the latest one.
    pub fn remember(&mut self, view: View, keyframe: Option<Keyframe>) {
        if let Some(keyframe) = keyframe {
            self.usual_gap = keyframe.view.position.saturating_sub(self.latest.view.position).max(1);
            let (before, previous) = (self.recent.iter().cloned().collect(), Some(self.anchor.view.clone()));
            self.latest = Keyframe { before, previous, ..keyframe };
        }
        if self.recent.len() == REMEMBERED {
            self.recent.pop_front();
        }
        self.recent.push_back(View { contrast: None, ..view });
    }
}

/// The view nearest to a position, the earlier of two.
fn nearest<'a>(views: impl Iterator<Item = &'a View>, position: usize) -> Option<&'a View> {
    views.min_by_key(|view| view.position.abs_diff(position))
}

#[cfg(test)]
mod tests;
