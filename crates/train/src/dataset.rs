//! Snippets of all clips, in an order that depends on the seed alone.

use crate::augment::{AugmentConfig, Augmented, augment};
use crate::clip::{Clip, ClipFrame};
use crate::error::TrainError;
use crate::gap::{GapConfig, Target, choose};
use endoscape_core::{Camera, Event, EventSink, Size};
use rand::rngs::ChaCha8Rng;
use rand::seq::{IndexedRandom, SliceRandom};
use rand::{Rng, SeedableRng};
use std::ops::Range;
use std::sync::Arc;

/// A target frame with its neighbours to both sides.
#[derive(Clone, Debug)]
pub struct Snippet {
    clip: usize,
    target: Target,
}

/// The frames of a snippet, target first, then its neighbours in time order, and the camera that took them.
pub struct Drawn<'a> {
    /// The frames.
    pub frames: Vec<&'a ClipFrame>,
    /// Their camera.
    pub camera: &'a Camera,
    /// Whether it stands still, whatever moves before it.
    pub stands: bool,
}

/// All snippets of a set of clips of one size.
#[derive(Clone, Debug)]
pub struct SnippetDataset {
    clips: Vec<Arc<Clip>>,
    snippets: Vec<Snippet>,
    length: usize,
    median_gaps: Vec<usize>,
}

impl SnippetDataset {
    /// Chooses the snippets of `length` frames (odd) in clips of one size.
    ///
    /// # Errors
    /// [`TrainError::Data`] if no clip has a single usable snippet. A clip without any is left out with a warning.
    pub fn new(
        clips: Vec<Arc<Clip>>,
        length: usize,
        gap: &GapConfig,
        events: &mut dyn EventSink,
    ) -> Result<Self, TrainError> {
        let (mut snippets, mut median_gaps) = (Vec::new(), Vec::new());
        let mut reasons = Vec::new();
        for (index, clip) in clips.iter().enumerate() {
            let chosen = choose(clip, length, gap);
            median_gaps.push(chosen.median_gap().unwrap_or(1));
            if chosen.targets.is_empty() {
                let counts = format!("{} frames hardly move, {} show too little", chosen.still, chosen.unmatched);
                reasons.push(format!("{} gives no snippet of {length} frames ({counts})", clip.name));
            }
            snippets.extend(chosen.targets.into_iter().map(|target| Snippet { clip: index, target }));
        }
        if snippets.is_empty() {
            let reason = if reasons.is_empty() { "no sequence was given".to_owned() } else { reasons.join(", ") };
            let remedy = "give a longer or livelier sequence, or set the gap yourself with --gap FRAMES";
            return Err(TrainError::data("training data", reason, remedy));
        }
        reasons.into_iter().for_each(|reason| events.event(Event::Warned(format!("{reason}; it is not used"))));
        Ok(Self { clips, snippets, length, median_gaps })
    }

    /// Number of snippets.
    pub const fn len(&self) -> usize {
        self.snippets.len()
    }

    /// Never: a data set without snippets is not made.
    pub const fn is_empty(&self) -> bool {
        self.snippets.is_empty()
    }

    /// Frames per snippet.
    pub const fn snippet_length(&self) -> usize {
        self.length
    }

    /// Size of all frames.
    pub fn size(&self) -> Size {
        self.clips[0].camera.size()
    }

    /// The clips, each with the middle of the gaps chosen in it.
    pub fn clips(&self) -> impl Iterator<Item = (&Clip, usize)> {
        self.clips.iter().map(Arc::as_ref).zip(self.median_gaps.iter().copied())
    }

    /// Frames of all clips that labels say something about.
    pub fn labelled_frames(&self) -> usize {
        self.clips.iter().flat_map(|clip| &clip.frames).filter(|frame| frame.label.is_some()).count()
    }

    /// The snippets of stretches that labels say something about throughout; `None` if there are none.
    pub fn labelled(&self) -> Option<Self> {
        let is_labelled = |clip: usize, frames: Range<usize>| {
            self.clips[clip].frames.get(frames).is_some_and(|frames| frames.iter().all(|frame| frame.label.is_some()))
        };
        self.kept(is_labelled)
    }

    /// Share of the snippets in which the camera stands still.
    pub fn standing_share(&self) -> f64 {
        self.snippets.iter().filter(|snippet| snippet.target.stands).count() as f64 / self.snippets.len() as f64
    }

    /// The snippets whose frames `keep` admits; it is asked for a clip and the range of frames in it that a snippet spans
    /// at one of its gaps. `None` if nothing is left.
    pub fn kept(&self, keep: impl Fn(usize, Range<usize>) -> bool) -> Option<Self> {
        let side = self.length / 2;
        let within = |snippet: &Snippet| {
            let Target { frame, gaps, stands } = &snippet.target;
            let spans = |gap: &usize| keep(snippet.clip, frame - side * gap..frame + side * gap + 1);
            let gaps: Vec<usize> = gaps.iter().copied().filter(spans).collect();
            let target = Target { frame: *frame, gaps, stands: *stands };
            (!target.gaps.is_empty()).then_some(Snippet { clip: snippet.clip, target })
        };
        let snippets: Vec<Snippet> = self.snippets.iter().filter_map(within).collect();
        (!snippets.is_empty()).then(|| Self { snippets, ..self.clone() })
    }

    /// These snippets and at most as many of `other`, evenly spread over it.
    #[must_use]
    pub fn mixed_with(mut self, other: &Self) -> Self {
        let first = self.clips.len();
        let moved = |index: usize| {
            let Snippet { clip, target } = &other.snippets[index];
            Snippet { clip: first + clip, target: target.clone() }
        };
        self.snippets.extend(spread(other.len(), self.len()).map(moved));
        self.clips.extend(other.clips.iter().cloned());
        self.median_gaps.extend(&other.median_gaps);
        self
    }

    /// The frames of a snippet at one of its gaps, chosen by `rng`.
    ///
    /// # Panics
    /// If there is no such snippet.
    pub fn draw(&self, index: usize, rng: &mut impl Rng) -> Drawn<'_> {
        let Snippet { clip, target } = &self.snippets[index];
        let gap = target.gaps.choose(rng).copied().unwrap_or(1);
        self.frames_at(*clip, target, gap)
    }

    /// The frames of a snippet at its smallest gap.
    ///
    /// # Panics
    /// If there is no such snippet.
    pub fn plain(&self, index: usize) -> Drawn<'_> {
        let Snippet { clip, target } = &self.snippets[index];
        self.frames_at(*clip, target, target.gaps[0])
    }

    fn frames_at(&self, clip: usize, target: &Target, gap: usize) -> Drawn<'_> {
        let clip = &self.clips[clip];
        let frames = snippet_frames(clip, target.frame, gap, self.length).unwrap_or_default();
        Drawn { frames, camera: &clip.camera, stands: target.stands }
    }
}

/// At most `wanted` numbers below `count`, evenly spread.
pub fn spread(count: usize, wanted: usize) -> impl Iterator<Item = usize> {
    let taken = wanted.min(count);
    (0..taken).map(move |index| index * count / taken)
}

/// The frames of a snippet, target first, then its neighbours in time order; `None` where the clip ends before.
pub fn snippet_frames(clip: &Clip, target: usize, gap: usize, length: usize) -> Option<Vec<&ClipFrame>> {
    let side = length / 2;
    let first = target.checked_sub(side * gap)?;
    let neighbours = (0..length).filter(|position| *position != side).map(|position| first + position * gap);
    std::iter::once(target).chain(neighbours).map(|frame| clip.frames.get(frame)).collect()
}

/// How the batches of a training are drawn.
#[derive(Clone, Debug)]
pub struct DrawPlan {
    /// Seed of the training.
    pub seed: u64,
    /// Snippets per batch.
    pub batch: usize,
    /// What is varied.
    pub augment: AugmentConfig,
}

/// One augmented snippet, ready for a batch.
pub struct Item {
    /// Its frames, their camera and what is to be learned about them.
    pub snippet: Augmented,
    /// Whether its camera stands still.
    pub stands: bool,
}

impl DrawPlan {
    /// The snippets of a step, each epoch in an order of its own.
    ///
    /// Everything follows from the seed, the step and the position in the batch, so a resumed training and one with
    /// another number of threads draw the same.
    ///
    /// # Errors
    /// As [`augment`].
    pub fn items(&self, dataset: &SnippetDataset, step: u64) -> Result<Vec<Item>, TrainError> {
        let first = step * self.batch as u64;
        (0..self.batch as u64).map(|position| self.item(dataset, first + position)).collect()
    }

    fn item(&self, dataset: &SnippetDataset, number: u64) -> Result<Item, TrainError> {
        let (epoch, place) = (number / dataset.len() as u64, (number % dataset.len() as u64) as usize);
        let index = self.order(dataset.len(), epoch)[place];
        let mut rng = stream(self.seed, ITEMS + number);
        let drawn = dataset.draw(index, &mut rng);
        let snippet = augment(&drawn.frames, drawn.camera, &self.augment, &mut rng)?;
        Ok(Item { snippet, stands: drawn.stands })
    }

    fn order(&self, count: usize, epoch: u64) -> Vec<usize> {
        let mut order: Vec<usize> = (0..count).collect();
        order.shuffle(&mut stream(self.seed, epoch));
        order
    }
}

/// Streams below this number shuffle epochs, those above draw items.
const ITEMS: u64 = 1 << 32;

fn stream(seed: u64, stream: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(stream);
    rng
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::sliding_clip;
    use endoscape_core::event::NullSink;
    use std::collections::BTreeSet;

    fn dataset() -> SnippetDataset {
        let clips = [sliding_clip(30, 1.0), sliding_clip(20, 2.5)].map(Arc::new);
        SnippetDataset::new(clips.into(), 3, &GapConfig::default(), &mut NullSink).unwrap()
    }

    fn plan(seed: u64) -> DrawPlan {
        DrawPlan { seed, batch: 4, augment: AugmentConfig::endo() }
    }

    #[test]
    fn an_epoch_visits_every_snippet_once_and_epochs_differ() {
        let dataset = dataset();
        let (first, second) = (plan(1).order(dataset.len(), 0), plan(1).order(dataset.len(), 1));
        assert_eq!(first.iter().collect::<BTreeSet<_>>().len(), dataset.len());
        assert_ne!(first, second);
        assert_ne!(first, plan(2).order(dataset.len(), 0));
    }

    #[test]
    fn a_step_is_the_same_whenever_it_is_drawn() {
        let dataset = dataset();
        let (again, once) = (plan(1).items(&dataset, 9).unwrap(), plan(1).items(&dataset, 9).unwrap());
        for (a, b) in again.iter().zip(&once) {
            let (a, b) = (&a.snippet, &b.snippet);
            assert_eq!((a.frames[1].motion_input.values(), a.camera), (b.frames[1].motion_input.values(), b.camera));
        }
        let other = plan(1).items(&dataset, 10).unwrap();
        assert_ne!(once[0].snippet.frames[0].original, other[0].snippet.frames[0].original);
    }

    #[test]
    fn neighbours_come_in_time_order_after_the_target() {
        let clip = sliding_clip(20, 1.0);
        let positions = |frames: Vec<&ClipFrame>| frames.iter().map(|frame| frame.position).collect::<Vec<_>>();
        assert_eq!(positions(snippet_frames(&clip, 8, 3, 5).unwrap()), [8, 2, 5, 11, 14]);
        assert!(snippet_frames(&clip, 2, 3, 3).is_none());
        assert!(snippet_frames(&clip, 18, 2, 3).is_none());
    }

    #[test]
    fn snippets_are_spread_over_all() {
        assert_eq!(spread(10, 4).collect::<Vec<_>>(), [0, 2, 5, 7]);
        assert_eq!(spread(3, 64).collect::<Vec<_>>(), [0, 1, 2]);
    }

    #[test]
    fn kept_snippets_lie_wholly_inside() {
        let all = dataset();
        let early = all.kept(|_, frames| frames.end <= 12).unwrap();
        let late = all.kept(|_, frames| frames.start >= 12).unwrap();
        assert!(early.len() + late.len() < all.len());
        for (part, allowed) in [(&early, 0..12), (&late, 12..30)] {
            let mut rng = stream(0, 0);
            let mut drawn = (0..part.len()).flat_map(|index| part.draw(index, &mut rng).frames);
            assert!(drawn.all(|frame| allowed.contains(&frame.position)));
        }
        assert!(all.kept(|clip, _| clip > 1).is_none());
    }

    #[test]
    fn a_mixture_is_never_mostly_old() {
        let of = |frames| {
            SnippetDataset::new(vec![Arc::new(sliding_clip(frames, 2.5))], 3, &GapConfig::default(), &mut NullSink)
                .unwrap()
        };
        let (new, old) = (of(10), of(40));
        let mixed = new.clone().mixed_with(&old);
        assert_eq!((mixed.len(), mixed.clips().count()), (2 * new.len(), 2));
        assert_eq!(old.clone().mixed_with(&new).len(), old.len() + new.len());
        let last = mixed.plain(mixed.len() - 1).frames[0].position;
        assert!(last > 10, "the old snippets come from one end: {last}");
    }

    #[test]
    fn clips_without_snippets_are_named() {
        let mut events = Vec::new();
        let still = Arc::new(sliding_clip(10, 0.0));
        let error = SnippetDataset::new(vec![still.clone()], 3, &GapConfig::default(), &mut events).unwrap_err();
        assert!(error.to_string().contains("10 frames hardly move"), "{error}");
        let lively = Arc::new(sliding_clip(10, 2.5));
        let both = SnippetDataset::new(vec![still, lively], 3, &GapConfig::default(), &mut events).unwrap();
        assert!(!both.is_empty());
        assert!(matches!(&events[0], Event::Warned(text) if text.contains("it is not used")));
    }
}
