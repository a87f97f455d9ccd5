//! Tries every convention on a few pairs of frames and says which one the data obey.

use super::consistency::{Residual, View, residual};
use super::convention::{Convention, NO_MOTION, conventions};
use crate::{FrameEntry, FramesError, Sequence};
use endoscape_core::{Camera, se3};
use serde::Serialize;

/// Frames between the two of a pair, at most: far enough apart to show a wrong convention, near enough to overlap.
const FARTHEST_FRAMES: usize = 30;

/// Pairs looked at along the sequence.
const PAIRS: usize = 4;

/// A wrong convention must be this much better before it is believed, so that ties and noise do not raise an alarm.
const CLEARLY_BETTER: f64 = 0.8;

/// Factors tried on translations where the scale of the depth is not known: 12 per decade over six decades.
const SCALE_STEPS: i32 = 36;

/// Agreement of the depth of two frames under the loader's convention.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DepthConsistency {
    /// Number of the frame whose depth is projected.
    pub frame_a: usize,
    /// Number of the frame it is compared with.
    pub frame_b: usize,
    /// Median absolute difference, metres.
    pub median_m: f64,
    /// 90th percentile, metres.
    pub p90_m: f64,
    /// Share of the samples that landed off by at most 5 % of their depth.
    pub inlier_share: f64,
    /// Share of the samples that landed on known depth.
    pub overlap: f64,
}

/// How well one convention explains the data, over all pairs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ConventionScore {
    /// What it assumes.
    pub name: String,
    /// Middle of the pairs' median absolute differences, metres; `None` where the views would not overlap.
    pub median_m: Option<f64>,
}

/// What the depth check found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Verdict {
    /// The first pair under the loader's convention.
    pub consistency: Option<DepthConsistency>,
    /// Every convention, the loader's first.
    pub scores: Vec<ConventionScore>,
    /// Sentences for the user.
    pub warnings: Vec<String>,
}

/// Checks poses, depth and calibration of a sequence against each other.
///
/// # Errors
/// [`FramesError`] if a depth map cannot be read.
pub fn check(sequence: &Sequence) -> Result<Verdict, FramesError> {
    let Some(camera) = &sequence.camera else { return Ok(Verdict::default()) };
    let pairs = views(sequence, camera)?;
    let Some((first_a, first_b)) = pairs.first() else { return Ok(Verdict::default()) };
    let scale_free = sequence.frames.iter().filter_map(|frame| frame.depth.as_ref()).any(|depth| depth.encoding.is_scale_free());
    let tried = tried_conventions(camera, &pairs, scale_free);
    let scores: Vec<ConventionScore> = tried
        .iter()
        .map(|convention| ConventionScore { name: convention.name.clone(), median_m: pooled(&pairs, convention) })
        .collect();
    let of_first = tried.first().and_then(|loaded| residual(first_a, first_b, loaded));
    let consistency = of_first.map(|residual| report(first_a, first_b, residual));
    let warnings = warnings(&scores, consistency.as_ref());
    Ok(Verdict { consistency, scores, warnings })
}

fn report(a: &View, b: &View, residual: Residual) -> DepthConsistency {
    let Residual { median_m, p90_m, inlier_share, overlap } = residual;
    DepthConsistency { frame_a: a.number, frame_b: b.number, median_m, p90_m, inlier_share, overlap }
}

/// Each convention; where the depth has no scale, each with the scale of translations that suits it best.
fn tried_conventions(camera: &Camera, pairs: &[(View, View)], scale_free: bool) -> Vec<Convention> {
    let all = conventions(camera);
    if !scale_free {
        return all;
    }
    let base = all.into_iter().filter(|convention| !convention.name.starts_with("translations"));
    base.map(|convention| best_scale(convention, pairs)).collect()
}

fn best_scale(convention: Convention, pairs: &[(View, View)]) -> Convention {
    if convention.name == NO_MOTION {
        return convention;
    }
    let scaled = (-SCALE_STEPS..=SCALE_STEPS).map(|step| 10.0_f64.powf(f64::from(step) / 12.0));
    let candidates = scaled.map(|factor| convention.with_translations_times(factor));
    let scored = candidates.filter_map(|candidate| Some((pooled(pairs, &candidate)?, candidate)));
    scored.min_by(|(a, _), (b, _)| a.total_cmp(b)).map_or(convention, |(_, best)| best)
}

/// Middle of the pairs' medians; `None` unless at least half of the pairs overlap.
fn pooled(pairs: &[(View, View)], convention: &Convention) -> Option<f64> {
    let mut medians: Vec<f64> =
        pairs.iter().filter_map(|(a, b)| residual(a, b, convention)).map(|residual| residual.median_m).collect();
    medians.sort_by(f64::total_cmp);
    (2 * medians.len() >= pairs.len()).then(|| medians.get(medians.len() / 2).copied()).flatten()
}

fn warnings(scores: &[ConventionScore], consistency: Option<&DepthConsistency>) -> Vec<String> {
    let Some((loaded, others)) = scores.split_first() else { return Vec::new() };
    let loaded_m = loaded.median_m.unwrap_or(f64::INFINITY);
    let best = others.iter().filter_map(|score| Some((score.median_m?, score))).min_by(|a, b| a.0.total_cmp(&b.0));
    let mm = |metres: f64| if metres.is_finite() { format!("{:.3} mm", 1e3 * metres) } else { "no overlap".into() };
    let mut warnings = Vec::new();
    let still_m = others.iter().find(|score| score.name == NO_MOTION).and_then(|score| score.median_m);
    let moves_better = scores.iter().any(|score| score.median_m.zip(still_m).is_some_and(|(a, s)| a < CLEARLY_BETTER * s));
    if let (Some(still_m), false) = (still_m, moves_better) {
        warnings.push(format!(
            "the poses do not seem to belong to these frames: no reading of them explains the depth better than a camera that stands still ({}); check that pose file and frames are of the same recording",
            mm(still_m)
        ));
    } else if let Some((best_m, score)) = best.filter(|(best_m, _)| *best_m < CLEARLY_BETTER * loaded_m) {
        warnings.push(format!(
            "the depth agrees better under another convention, `{}` ({} against {} as loaded); correct the data set or its calibration before you trust its poses",
            score.name, mm(best_m), mm(loaded_m)
        ));
    } else if consistency.is_some_and(|found| found.inlier_share < 0.5) {
        warnings.push(format!(
            "poses, depth and calibration disagree under every convention tried (best {}); check the calibration and the unit of the depth",
            mm(loaded_m)
        ));
    }
    warnings
}

/// Pairs of frames with depth and pose, spread along the sequence.
fn views(sequence: &Sequence, camera: &Camera) -> Result<Vec<(View, View)>, FramesError> {
    let usable: Vec<&FrameEntry> =
        sequence.frames.iter().filter(|frame| frame.depth.is_some() && frame.world_from_camera.is_some()).collect();
    let mut pairs = Vec::new();
    for start in (0..PAIRS).map(|part| part * usable.len() / PAIRS) {
        let Some(first) = usable.get(start) else { continue };
        let Some(a) = view(first, camera)? else { continue };
        let Some(second) = partner(&a, &usable[start..]) else { continue };
        if let Some(b) = view(second, camera)? {
            pairs.push((a, b));
        }
    }
    pairs.dedup_by_key(|(a, _)| a.number);
    Ok(pairs)
}

/// The last frame within reach that still looks at the same place: moved by at most half the depth, turned by at most
/// half a radian; the next frame if none is.
fn partner<'a>(a: &View, following: &[&'a FrameEntry]) -> Option<&'a FrameEntry> {
    let depth_m = f64::from(a.depth.median_m()?);
    let near = |frame: &&FrameEntry| {
        frame.world_from_camera.is_some_and(|world_from_camera| {
            let motion = a.world_from_camera.inverse() * world_from_camera;
            motion.translation.vector.norm() <= 0.5 * depth_m && se3::rotation_angle_rad(&motion) <= 0.5
        })
    };
    let reach = following.iter().skip(1).take_while(|frame| frame.number <= a.number + FARTHEST_FRAMES);
    reach.filter(|frame| near(frame)).last().or_else(|| following.get(1)).copied()
}

fn view(frame: &FrameEntry, camera: &Camera) -> Result<Option<View>, FramesError> {
    let (Some(depth), Some(world_from_camera)) = (&frame.depth, frame.world_from_camera) else { return Ok(None) };
    let depth = depth.read(Some(camera), camera.size())?;
    Ok(Some(View { number: frame.number, depth, world_from_camera }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn score(name: &str, median_m: f64) -> ConventionScore {
        ConventionScore { name: name.into(), median_m: Some(median_m) }
    }

    #[test]
    fn a_good_loader_is_not_accused() {
        let scores = [score("as loaded", 2e-5), score("inverse", 1.9e-5), score(NO_MOTION, 1e-3)];
        assert!(warnings(&scores, None).is_empty());
    }

    #[test]
    fn a_better_convention_is_named() {
        let scores = [score("as loaded", 5e-3), score("inverse", 2e-5), score(NO_MOTION, 1e-3)];
        assert!(warnings(&scores, None)[0].contains("`inverse` (0.020 mm against 5.000 mm as loaded)"));
    }

    #[test]
    fn poses_of_other_frames_are_named() {
        let scores = [score("as loaded", 5e-3), score("inverse", 9e-4), score(NO_MOTION, 1e-3)];
        assert!(warnings(&scores, None)[0].contains("do not seem to belong"));
    }
}
