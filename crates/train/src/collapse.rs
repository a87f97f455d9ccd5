//! Notices when a training has found a way to a low loss that teaches nothing.
//!
//! The objective has degenerate minima: a flat depth, a mask that hides everything, a motion that never moves or that
//! leaves the view. None of them comes back by itself, so each is named once, in one sentence, with what usually helps.

use burn::tensor::Tensor;
use endoscape_synthesis::Prediction;

/// Figures of a batch that give a collapse away, each `[1]` and still on the device.
#[derive(Clone, Debug)]
pub struct VitalSigns {
    /// Standard deviation of the disparity over a picture, as a share of its mean; mean over the batch.
    pub depth_spread: Tensor<1>,
    /// Mean reliability; 1 without a mask.
    pub mask: Tensor<1>,
    /// Mean length of the translation, in the unit of depth.
    pub translation: Tensor<1>,
    /// Mean length of the rotation, radians.
    pub rotation: Tensor<1>,
}

impl VitalSigns {
    /// Takes them from what the networks said.
    ///
    /// # Shapes
    /// - `motion`: `[batch, sources, 6]`
    pub fn new(prediction: &Prediction, motion: Tensor<3>) -> Self {
        let motion = motion.detach();
        // What is not predicted has not collapsed.
        let whole: Tensor<1> = motion.ones_like().mean();
        let depth_spread = prediction.disparities.first().map(|disparity| {
            let disparity: Tensor<2> = disparity.clone().detach().flatten(1, 3);
            let mean = disparity.clone().mean_dim(1);
            let deviation = (disparity - mean.clone()).square().mean_dim(1).sqrt();
            (deviation / mean).mean()
        });
        let length = |first: usize| motion.clone().narrow(2, first, 3).square().sum_dim(2).sqrt().mean();
        let mask = prediction.masks.first().map(|mask| mask.clone().detach().mean());
        Self {
            mask: mask.unwrap_or_else(|| whole.clone()),
            depth_spread: depth_spread.unwrap_or(whole),
            translation: length(0),
            rotation: length(3),
        }
    }
}

/// What can collapse.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Collapse {
    Depth,
    Mask,
    Motion,
    View,
}

impl Collapse {
    const ALL: [Self; 4] = [Self::Depth, Self::Mask, Self::Motion, Self::View];

    fn shows(self, signs: &Signs) -> bool {
        match self {
            Self::Depth => signs.depth_spread < 0.01,
            Self::Mask => signs.mask < 0.1,
            // At the smallest depth, 0.1, this moves a picture by a hundredth of a pixel.
            Self::Motion => signs.translation < 1e-5 && signs.rotation < 1e-5,
            Self::View => signs.coverage < 0.02,
        }
    }

    const fn sentence(self) -> &'static str {
        match self {
            Self::Depth => {
                "the predicted depth has become flat; more parallax (a larger gap.least), a smaller \
                 objective.smoothness_weight or a lower learning_rate usually helps"
            }
            Self::Mask => {
                "the reliability mask now hides nearly everything; a larger objective.mask_weight usually helps"
            }
            Self::Motion => {
                "the predicted motion has become zero; frames farther apart (a larger gap.least or --gap) or a lower \
                 learning_rate usually help"
            }
            Self::View => {
                "hardly a pixel of the target is seen by its sources any more; frames nearer to each other (a smaller \
                 gap.most or --gap) or a lower learning_rate usually help"
            }
        }
    }
}

/// [`VitalSigns`] read back, with the coverage of the objective.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signs {
    /// Share of pixels that count in the objective.
    pub coverage: f32,
    /// See [`VitalSigns::depth_spread`].
    pub depth_spread: f32,
    /// See [`VitalSigns::mask`].
    pub mask: f32,
    /// See [`VitalSigns::translation`].
    pub translation: f32,
    /// See [`VitalSigns::rotation`].
    pub rotation: f32,
}

/// Remembers what looks collapsed and speaks up once it has lasted.
#[derive(Clone, Debug, Default)]
pub struct CollapseWatch {
    /// For each of [`Collapse::ALL`]: how many looks in a row.
    lasting: [u32; 4],
}

/// Looks in a row before a collapse is believed: the first steps pass through flat depth.
const PATIENCE: u32 = 20;

impl CollapseWatch {
    /// Takes the figures of another look; returns the sentences to tell, each at most once per collapse.
    pub fn look(&mut self, signs: &Signs) -> Vec<&'static str> {
        let mut sentences = Vec::new();
        for (lasting, collapse) in self.lasting.iter_mut().zip(Collapse::ALL) {
            *lasting = if collapse.shows(signs) { lasting.saturating_add(1) } else { 0 };
            if *lasting == PATIENCE {
                sentences.push(collapse.sentence());
            }
        }
        sentences
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::Device;

    const HEALTHY: Signs = Signs { coverage: 0.8, depth_spread: 0.4, mask: 0.9, translation: 0.02, rotation: 0.01 };

    fn told(signs: Signs, looks: u32) -> Vec<&'static str> {
        let mut watch = CollapseWatch::default();
        (0..looks).flat_map(|_| watch.look(&signs)).collect()
    }

    #[test]
    fn each_collapse_is_told_once_and_only_if_it_lasts() {
        let flat = Signs { depth_spread: 0.001, ..HEALTHY };
        let hidden = Signs { mask: 0.02, ..HEALTHY };
        let still = Signs { translation: 1e-7, rotation: 1e-7, ..HEALTHY };
        let away = Signs { coverage: 0.001, ..HEALTHY };
        for (signs, word) in [(flat, "flat"), (hidden, "mask"), (still, "motion"), (away, "seen")] {
            let sentences = told(signs, 100);
            assert!(sentences.len() == 1 && sentences[0].contains(word), "{sentences:?}");
            assert!(told(signs, PATIENCE - 1).is_empty());
        }
        assert!(told(HEALTHY, 100).is_empty());
        let turning = Signs { translation: 0.0, ..HEALTHY };
        assert!(told(turning, 100).is_empty(), "a camera that only turns has not collapsed");
    }

    #[test]
    fn signs_are_what_they_say() {
        let device = Device::flex();
        let disparity = Tensor::<1>::from_floats([1.0, 3.0], &device).reshape([1, 1, 1, 2]);
        let prediction = Prediction {
            disparities: vec![disparity],
            source_from_target: Vec::new(),
            masks: Vec::new(),
            source_disparities: Vec::new(),
        };
        let motion = Tensor::<1>::from_floats([3.0, 0.0, 4.0, 0.0, 0.6, 0.8], &device).reshape([1, 1, 6]);
        let signs = VitalSigns::new(&prediction, motion);
        let read = |figure: Tensor<1>| figure.into_scalar::<f32>();
        assert_eq!((read(signs.depth_spread), read(signs.mask)), (0.5, 1.0));
        assert_eq!((read(signs.translation), read(signs.rotation)), (5.0, 1.0));
    }
}
