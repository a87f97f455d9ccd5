//! Which frames of a video are kept apart to judge by: the last sixth of every stretch of at most 600 frames.
//!
//! One block at the end of a short video; several spread over a long one, whose end may show something else than the
//! rest. No snippet that is learned from has a frame in such a block, and none that is judged has a frame outside. Where a
//! sixth has fewer than eight snippets, a quarter or a third is held back; a video that has none then is left out.

use crate::clip::Clip;
use crate::config::TrainConfig;
use crate::dataset::SnippetDataset;
use crate::error::TrainError;
use endoscape_core::{Event, EventSink};
use std::ops::Range;
use std::sync::Arc;

/// Longest stretch with one block held back, frames: 20 seconds of ordinary video.
const STRETCH: usize = 600;
/// One frame in so many is held back; the first that leaves enough to judge by.
const SHARES: [usize; 3] = [6, 4, 3];
/// Snippets of a video that are enough to judge by; fewer are a matter of luck.
const ENOUGH: usize = 8;

/// The snippets of some videos in two parts that share no frame.
pub struct Parts {
    /// To learn from.
    pub learned: SnippetDataset,
    /// To judge by.
    pub held: SnippetDataset,
}

impl Parts {
    /// Divides the snippets of clips of one size. A clip that is too short for both parts is left out with a warning.
    ///
    /// # Errors
    /// [`TrainError::Data`] if that leaves nothing, or as [`SnippetDataset::new`].
    pub fn of(clips: Vec<Arc<Clip>>, config: &TrainConfig, events: &mut dyn EventSink) -> Result<Self, TrainError> {
        let all = SnippetDataset::new(clips, config.snippet_length(), &config.gap, events)?;
        let lengths: Vec<(String, usize)> =
            all.clips().map(|(clip, _)| (clip.name.clone(), clip.frames.len())).collect();
        let blocks: Vec<Vec<Range<usize>>> =
            lengths.iter().enumerate().map(|(clip, (_, frames))| blocks_of(&all, clip, *frames)).collect();
        let short: Vec<&str> =
            lengths.iter().zip(&blocks).filter(|(_, blocks)| blocks.is_empty()).map(|((name, _), _)| &**name).collect();
        let used = |clip: usize| !blocks[clip].is_empty();
        let learned = all.kept(|clip, span| used(clip) && blocks[clip].iter().all(|block| apart(block, &span)));
        let held = all.kept(|clip, span| blocks[clip].iter().any(|block| within(block, &span)));
        let Some((learned, held)) = learned.zip(held) else {
            let reason = "too short to learn from one part and judge by another";
            let remedy = "give a longer or livelier video, or several at once";
            return Err(TrainError::data(&short.join(", "), reason, remedy));
        };
        for name in short {
            let told = format!("{name} is too short to hold a part of it back; it is not used");
            events.event(Event::Warned(told));
        }
        Ok(Self { learned, held })
    }

    /// Both parts with at most as many snippets of `other`.
    #[must_use]
    pub fn mixed_with(self, other: &Self) -> Self {
        Self { learned: self.learned.mixed_with(&other.learned), held: self.held.mixed_with(&other.held) }
    }
}

/// The blocks of a clip that have enough snippets inside, or the most there can be, and some outside; none if it is too
/// short.
fn blocks_of(all: &SnippetDataset, index: usize, frames: usize) -> Vec<Range<usize>> {
    let held = |blocks: &Vec<Range<usize>>| {
        let inside = |clip: usize, span: Range<usize>| clip == index && blocks.iter().any(|block| within(block, &span));
        let outside = |clip: usize, span: Range<usize>| clip == index && blocks.iter().all(|block| apart(block, &span));
        all.kept(outside).and_then(|_| all.kept(inside)).map_or(0, |held| held.len())
    };
    let (mut most, mut best) = (0, Vec::new());
    for blocks in SHARES.map(|share| blocks(frames, share)) {
        let count = held(&blocks);
        if count > most {
            (most, best) = (count, blocks);
        }
        if most >= ENOUGH {
            break;
        }
    }
    best
}

/// The last part, one frame in `share`, of every stretch.
fn blocks(frames: usize, share: usize) -> Vec<Range<usize>> {
    let stretches = frames.div_ceil(STRETCH);
    let bound = |stretch: usize| stretch * frames / stretches;
    let block = |stretch: usize| {
        let (start, end) = (bound(stretch), bound(stretch + 1));
        end - (end - start).div_ceil(share)..end
    };
    (0..stretches).map(block).collect()
}

fn within(block: &Range<usize>, span: &Range<usize>) -> bool {
    block.start <= span.start && span.end <= block.end
}

fn apart(block: &Range<usize>, span: &Range<usize>) -> bool {
    span.end <= block.start || block.end <= span.start
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::sliding_clip;
    use endoscape_core::event::NullSink;
    use std::collections::BTreeSet;

    /// Frames that some snippet of a part shows.
    fn frames(part: &SnippetDataset) -> BTreeSet<(String, usize)> {
        let mut seen = BTreeSet::new();
        for index in 0..part.len() {
            // Gaps are drawn; a few tries see them all.
            for seed in 0..8 {
                let mut rng = <rand::rngs::ChaCha8Rng as rand::SeedableRng>::seed_from_u64(seed);
                seen.extend(part.draw(index, &mut rng).frames.iter().map(|frame| (String::new(), frame.position)));
            }
        }
        seen
    }

    #[test]
    fn blocks_are_a_sixth_and_spread_over_long_videos() {
        assert_eq!(blocks(150, 6), vec![125..150]);
        assert_eq!(blocks(7, 6), vec![5..7]);
        let long = blocks(1500, 6);
        assert_eq!(long, [416..500, 916..1000, 1416..1500]);
        assert!(blocks(0, 6).is_empty());
    }

    #[test]
    fn no_frame_is_on_both_sides() {
        for (length, pixels_per_frame) in [(60, 1.0), (24, 2.5), (12, 2.5)] {
            let clips = vec![Arc::new(sliding_clip(length, pixels_per_frame))];
            let parts = Parts::of(clips, &TrainConfig::fast(), &mut NullSink).unwrap();
            let (learned, held) = (frames(&parts.learned), frames(&parts.held));
            assert!(learned.is_disjoint(&held), "{length}: {learned:?} {held:?}");
            assert!(held.iter().all(|(_, frame)| *frame >= length - length.div_ceil(3)));
        }
    }

    #[test]
    fn short_videos_are_left_out_and_named() {
        let mut events = Vec::new();
        let short = Arc::new(Clip { name: "short".into(), ..sliding_clip(5, 2.5) });
        let error = Parts::of(vec![short.clone()], &TrainConfig::fast(), &mut events).err().unwrap().to_string();
        assert!(error.contains("short") && error.contains("longer"), "{error}");
        let long = Arc::new(sliding_clip(40, 2.5));
        let parts = Parts::of(vec![short, long], &TrainConfig::fast(), &mut events).unwrap();
        assert!(parts.learned.len() > parts.held.len());
        assert!(matches!(&events[0], Event::Warned(text) if text.contains("short is too short")), "{events:?}");
    }
}
