//! Augmentation: the same snippet as it could also have been.
//!
//! | module | what | seen by |
//! |---|---|---|
//! | [`view`] | enlargement with a crop, mirroring; the camera changes along | networks and loss |
//! | [`turn`] | sources of a camera turned about its centre | networks and loss |
//! | here | time running backwards | networks and loss |
//! | [`appearance`] | colour, exposure, vignette, motion blur | networks |
//! | [`artefacts`] | highlights, occluders | networks |
//! | [`artefacts`] | soft deformation of the sources | motion network |
//!
//! The loss compares the pictures as they were (Godard et al. 2019): whatever is done to the inputs, the networks must
//! give the depth and motion of the real scene. Every random choice comes from the generator handed in.

pub mod appearance;
pub mod artefacts;
pub mod planes;
pub mod turn;
pub mod view;

use crate::clip::ClipFrame;
use crate::error::TrainError;
use crate::lesson::Lesson;
use appearance::{ColourShift, expose, motion_blur, shift_colour, vignette};
use artefacts::{Blob, Deformation, add_speculars, deform, occlude};
use endoscape_core::{Camera, Size};
use planes::Planes;
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};
use std::f32::consts::TAU;
use turn::Turn;
use view::ViewChange;

/// What is varied and how strongly; shares are probabilities per snippet, 0 switches off. `default()` is
/// [`AugmentConfig::endo`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AugmentConfig {
    /// Largest enlargement before cropping back, drawn per axis. Default 1.15 (SfMLearner); 1 switches off.
    pub enlarge: f64,
    /// Share of mirrored snippets. Default 0.5.
    pub mirror: f64,
    /// Share of snippets upside down. Default 0.
    pub flip: f64,
    /// Share of snippets whose time runs backwards. Default 0.
    pub reverse: f64,
    /// Share of snippets whose sources are turned as far as `enlarge` has cropped something away. Default 0.
    pub turn: f64,
    /// Share of snippets with changed colours. Default 0.5 (Godard et al. 2019).
    pub colour: f64,
    /// Largest change of brightness, contrast and saturation. Default 0.2 (Godard et al. 2019).
    pub colour_change: f32,
    /// Largest change of each channel against the others. Default 0.1.
    pub white_balance: f32,
    /// Largest change of exposure between the frames of a snippet, in stops. Default 0.2.
    pub exposure_stops: f32,
    /// Share of snippets with darkened corners, by up to half. Default 0.2.
    pub vignette: f64,
    /// Share of frames smeared by up to 3 % of the width. Default 0.1.
    pub blur: f64,
    /// Share of frames with added highlights. Default 0.2.
    pub speculars: f64,
    /// Share of frames partly hidden. Default 0.1.
    pub occluder: f64,
    /// Share of source frames softly deformed, by up to 1 % of the width. Default 0.2.
    pub deformation: f64,
}

impl Default for AugmentConfig {
    fn default() -> Self {
        Self::endo()
    }
}

impl AugmentConfig {
    /// Everything, at the strength the fields name as default.
    pub const fn endo() -> Self {
        Self {
            enlarge: 1.15,
            mirror: 0.5,
            flip: 0.0,
            reverse: 0.0,
            turn: 0.0,
            colour: 0.5,
            colour_change: 0.2,
            white_balance: 0.1,
            exposure_stops: 0.2,
            vignette: 0.2,
            blur: 0.1,
            speculars: 0.2,
            occluder: 0.1,
            deformation: 0.2,
        }
    }

    /// What SfMLearner does: enlarge and crop.
    pub const fn paper() -> Self {
        Self { enlarge: 1.15, ..Self::none() }
    }

    /// Nothing at all, for validation.
    pub const fn none() -> Self {
        Self {
            enlarge: 1.0,
            mirror: 0.0,
            flip: 0.0,
            reverse: 0.0,
            turn: 0.0,
            colour: 0.0,
            colour_change: 0.0,
            white_balance: 0.0,
            exposure_stops: 0.0,
            vignette: 0.0,
            blur: 0.0,
            speculars: 0.0,
            occluder: 0.0,
            deformation: 0.0,
        }
    }

    /// # Errors
    /// [`TrainError::Config`] for the first field outside its range.
    pub fn validate(&self) -> Result<(), TrainError> {
        let shares = [
            ("mirror", self.mirror),
            ("flip", self.flip),
            ("reverse", self.reverse),
            ("turn", self.turn),
            ("colour", self.colour),
            ("vignette", self.vignette),
            ("blur", self.blur),
            ("speculars", self.speculars),
            ("occluder", self.occluder),
            ("deformation", self.deformation),
            ("colour_change", f64::from(self.colour_change)),
            ("white_balance", f64::from(self.white_balance)),
        ];
        if let Some((name, value)) = shares.into_iter().find(|(_, value)| !(0.0..=1.0).contains(value)) {
            return Err(TrainError::config(format!("augment.{name}"), format!("is {value} but must be from 0 to 1")));
        }
        let ranges =
            [("enlarge", self.enlarge, 1.0..=4.0), ("exposure_stops", f64::from(self.exposure_stops), 0.0..=4.0)];
        match ranges.into_iter().find(|(_, value, range)| !range.contains(value)) {
            Some((name, value, range)) => {
                let reason = format!("is {value} but must be from {} to {}", range.start(), range.end());
                Err(TrainError::config(format!("augment.{name}"), reason))
            }
            None => Ok(()),
        }
    }
}

/// One frame of an augmented snippet.
#[derive(Clone, Debug)]
pub struct AugmentedFrame {
    /// What the loss compares.
    pub original: Planes,
    /// 1 for pixels the loss may use, else 0, row after row.
    pub usable: Vec<f32>,
    /// What the depth network sees.
    pub depth_input: Planes,
    /// What the motion network sees.
    pub motion_input: Planes,
}

/// An augmented snippet.
#[derive(Clone, Debug)]
pub struct Augmented {
    /// Target first.
    pub frames: Vec<AugmentedFrame>,
    /// The camera that fits all of them.
    pub camera: Camera,
    /// What labels say about it, where there are any.
    pub lesson: Option<Lesson>,
}

/// Augments a snippet, target first.
///
/// # Errors
/// [`TrainError::Camera`] if the camera is not of the frames' size.
pub fn augment(
    frames: &[&ClipFrame],
    camera: &Camera,
    config: &AugmentConfig,
    rng: &mut impl Rng,
) -> Result<Augmented, TrainError> {
    let change = draw_view(camera.size(), config, rng);
    let camera = change.camera(camera)?;
    let frames = in_time(frames, rng.random_bool(config.reverse));
    let turns = draw_turns(&change, &camera, frames.len(), config, rng);
    let look = Look::draw(config, rng);
    let mut augmented = Vec::with_capacity(frames.len());
    for (index, (frame, turn)) in frames.iter().zip(&turns).enumerate() {
        let original = change.picture(&frame.image, turn.as_ref());
        let mut depth_input = original.clone();
        look.apply(&mut depth_input);
        vary_frame(&mut depth_input, config, rng);
        let mut motion_input = depth_input.clone();
        // The target stays as it is: its depth is judged pixel by pixel.
        if index > 0 && rng.random_bool(config.deformation) {
            deform(&mut motion_input, &draw_deformation(rng));
        }
        let usable = change.mask(&frame.usable, turn.as_ref());
        augmented.push(AugmentedFrame { original, usable, depth_input, motion_input });
    }
    let lesson = Lesson::of(&frames, &change, &turns, rng);
    Ok(Augmented { frames: augmented, camera, lesson })
}

/// Target first, then its sources in the order of time or against it.
fn in_time<'a>(frames: &[&'a ClipFrame], is_reversed: bool) -> Vec<&'a ClipFrame> {
    let mut frames = frames.to_vec();
    if let (true, Some(sources)) = (is_reversed, frames.get_mut(1..)) {
        sources.reverse();
    }
    frames
}

/// A turn of every source or of none, and none of the target.
fn draw_turns(
    change: &ViewChange,
    camera: &Camera,
    frames: usize,
    config: &AugmentConfig,
    rng: &mut impl Rng,
) -> Vec<Option<Turn>> {
    let is_turned = rng.random_bool(config.turn);
    (0..frames).map(|index| (is_turned && index > 0).then(|| Turn::draw(change, camera, rng)).flatten()).collect()
}

fn draw_view(size: Size, config: &AugmentConfig, rng: &mut impl Rng) -> ViewChange {
    let scale = [rng.random_range(1.0..=config.enlarge), rng.random_range(1.0..=config.enlarge)];
    let place = [rng.random(), rng.random()];
    ViewChange::new(size, scale, place, [rng.random_bool(config.mirror), rng.random_bool(config.flip)])
}

/// What all frames of a snippet share.
struct Look {
    colour: Option<ColourShift>,
    vignette: Option<f32>,
}

impl Look {
    fn draw(config: &AugmentConfig, rng: &mut impl Rng) -> Self {
        let colour = rng.random_bool(config.colour).then(|| ColourShift {
            brightness: around_one(config.colour_change, rng),
            contrast: around_one(config.colour_change, rng),
            saturation: around_one(config.colour_change, rng),
            balance: std::array::from_fn(|_| around_one(config.white_balance, rng)),
        });
        Self { colour, vignette: rng.random_bool(config.vignette).then(|| rng.random_range(0.1..0.5)) }
    }

    fn apply(&self, planes: &mut Planes) {
        if let Some(colour) = &self.colour {
            shift_colour(planes, colour);
        }
        if let Some(strength) = self.vignette {
            vignette(planes, strength);
        }
    }
}

/// What differs from frame to frame.
fn vary_frame(planes: &mut Planes, config: &AugmentConfig, rng: &mut impl Rng) {
    if config.exposure_stops > 0.0 {
        expose(planes, rng.random_range(-config.exposure_stops..=config.exposure_stops).exp2());
    }
    if rng.random_bool(config.blur) {
        let reach = 0.03 * planes.size().width as f32;
        motion_blur(planes, [rng.random_range(-reach..=reach), rng.random_range(-reach..=reach)]);
    }
    if rng.random_bool(config.speculars) {
        let count = rng.random_range(1..=6);
        let blobs: Vec<Blob> = (0..count).map(|_| draw_blob(planes.size(), 0.005..0.03, rng)).collect();
        add_speculars(planes, &blobs);
    }
    if rng.random_bool(config.occluder) {
        let colour = [rng.random(), rng.random(), rng.random()];
        occlude(planes, &draw_blob(planes.size(), 0.05..0.2, rng), colour);
    }
}

fn draw_blob(size: Size, radius: std::ops::Range<f32>, rng: &mut impl Rng) -> Blob {
    let height = size.height as f32 / size.width as f32;
    Blob {
        centre: [rng.random(), rng.random_range(0.0..=height)],
        radii: [rng.random_range(radius.clone()), rng.random_range(radius)],
        turn_rad: rng.random_range(0.0..TAU),
    }
}

fn draw_deformation(rng: &mut impl Rng) -> Deformation {
    Deformation {
        amplitude: rng.random_range(0.0..0.01),
        waves: rng.random_range(0.5..2.0),
        phases_rad: [rng.random_range(0.0..TAU), rng.random_range(0.0..TAU)],
    }
}

fn around_one(change: f32, rng: &mut impl Rng) -> f32 {
    rng.random_range(1.0 - change..=1.0 + change)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::sliding_clip;
    use rand::SeedableRng;
    use rand::rngs::ChaCha8Rng;

    fn augmented(config: &AugmentConfig, seed: u64) -> (Vec<AugmentedFrame>, Camera) {
        let clip = sliding_clip(3, 2.0);
        let frames: Vec<&ClipFrame> = clip.frames.iter().collect();
        let snippet = augment(&frames, &clip.camera, config, &mut ChaCha8Rng::seed_from_u64(seed)).unwrap();
        (snippet.frames, snippet.camera)
    }

    #[test]
    fn a_seed_fixes_everything() {
        let (a, b, c) = (
            augmented(&AugmentConfig::endo(), 1),
            augmented(&AugmentConfig::endo(), 1),
            augmented(&AugmentConfig::endo(), 2),
        );
        assert_eq!((a.0[2].motion_input.values(), a.1), (b.0[2].motion_input.values(), b.1));
        assert_ne!(a.0[0].depth_input, c.0[0].depth_input);
    }

    #[test]
    fn nothing_switched_on_leaves_the_pictures_alone() {
        let clip = sliding_clip(3, 2.0);
        let (frames, camera) = augmented(&AugmentConfig::none(), 5);
        assert_eq!(camera, clip.camera);
        for (frame, before) in frames.iter().zip(&clip.frames) {
            let picture = Planes::new(&before.image);
            assert_eq!([&frame.original, &frame.depth_input, &frame.motion_input], [&picture; 3]);
            assert!(frame.usable.iter().all(|usable| *usable == 1.0));
        }
    }

    #[test]
    fn the_loss_never_sees_an_artefact() {
        let everything = AugmentConfig {
            colour: 1.0,
            vignette: 1.0,
            blur: 1.0,
            speculars: 1.0,
            occluder: 1.0,
            deformation: 1.0,
            turn: 1.0,
            reverse: 1.0,
            flip: 0.5,
            ..AugmentConfig::endo()
        };
        let AugmentConfig { enlarge, mirror, flip, reverse, turn, .. } = everything;
        let only_view = AugmentConfig { enlarge, mirror, flip, reverse, turn, ..AugmentConfig::none() };
        let (with, without) = (augmented(&everything, 3), augmented(&only_view, 3));
        assert_eq!(with.1, without.1);
        for (with, without) in with.0.iter().zip(&without.0) {
            assert_eq!(with.original, without.original);
            assert_ne!(with.depth_input, without.depth_input);
        }
        // The target is never deformed.
        assert_eq!(with.0[0].depth_input, with.0[0].motion_input);
        assert_ne!(with.0[1].depth_input, with.0[1].motion_input);
    }

    #[test]
    fn settings_outside_their_range_are_named() {
        let config = AugmentConfig { mirror: 1.5, ..AugmentConfig::none() };
        let message = config.validate().unwrap_err().to_string();
        assert_eq!(message, "the setting `augment.mirror` is 1.5 but must be from 0 to 1");
        assert!(AugmentConfig { enlarge: 0.5, ..AugmentConfig::none() }.validate().is_err());
        assert!(AugmentConfig { exposure_stops: f32::NAN, ..AugmentConfig::none() }.validate().is_err());
    }
}
