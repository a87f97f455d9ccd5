//! Evidence of what is wrong with a motion: what a network that corrects motions looks at.
//!
//! The source is rebuilt as the target would see it if a motion were right. Where it is not, brightness differs, and to
//! first order the difference is minus the sum over the six parts of the motion that is left, each times the slope of the
//! picture along the way that this part moves the pixel: `r ~ -sum_k s_k m_k` (Lucas and Kanade, IJCAI 1981). So a network
//! is shown, for each pixel, the difference `r`, the products `r s_k`, whose sums alone would make a step of gradient
//! descent, and the squares `s_k^2`, by which to weigh them. What it has to learn is whom to believe.
//!
//! Everything is relative to the target's typical depth, so that a unit of length never matters, and to local brightness,
//! so that a lamp that moves along does not. No gradient runs through any of it.

use crate::camera::CameraBatch;
use crate::motion::{Rotation, source_from_target};
use crate::warp::{Correspondence, correspond, sample_bilinear};
use burn::tensor::{Tensor, TensorData};

/// Channels of [`Alignment::evidence`].
pub const EVIDENCE_CHANNELS: usize = 17;

/// Radius of the surroundings that brightness is compared with, as a share of the picture's width: 4 pixels at 160.
const SURROUNDINGS: f64 = 0.025;
/// Brightness, of 1, that is added to that of the surroundings: noise in the dark is no contrast.
const DARK: f64 = 0.05;
/// Contrast and sensitivity lie within these limits, whatever a highlight does.
const LIMIT: f64 = 4.0;
/// Factors that bring contrast and sensitivity of endoscopic pictures to about 1, where networks learn best.
const CONTRAST_GAIN: f64 = 5.0;
const SENSITIVITY_GAIN: f64 = 28.0;
/// Motion by which sensitivity is measured, in typical depths and radians: about a pixel at 160.
const PROBE: f32 = 0.01;
/// Depths outside this range are unknown, as they are for the warp.
const KNOWN_DEPTH: [f64; 2] = [1e-6, 1e6];

/// A batch of targets, ready for sources to be aligned with them.
///
/// Motions are `source_from_target`: they take points of the target's camera to the source's (x right, y down, z ahead).
#[derive(Clone, Debug)]
pub struct Alignment {
    /// `[batch, 1, height, width]`.
    contrast: Tensor<4>,
    /// `[batch, 6, height, width]`: what each part of a motion changes the contrast by.
    sensitivity: Tensor<4>,
    /// `[batch, 9, height, width]`: relief, direction, squared sensitivities.
    scene: Tensor<4>,
    /// `[batch, 1, height, width]`.
    depth: Tensor<4>,
    /// Typical depth of each target, `[batch, 1]`.
    unit: Tensor<2>,
    cameras: CameraBatch,
}

impl Alignment {
    /// Prepares targets.
    ///
    /// # Shapes
    /// - `target`: `[batch, 3, height, width]`, RGB in [-1, 1]
    /// - `depth`: `[batch, 1, height, width]`, along the optical axis, 0 where unknown
    /// - `cameras`: of that batch and size, the same for target and source
    pub fn new(target: Tensor<4>, depth: Tensor<4>, cameras: &CameraBatch) -> Self {
        let contrast = contrast(target);
        let [low, high] = KNOWN_DEPTH;
        let known = depth.clone().greater_scalar(low).bool_and(depth.clone().lower_scalar(high));
        let log_depth = depth.clone().mask_fill(known.clone().bool_not(), 1.0).log();
        let known = known.float().cast(depth.dtype());
        let count = known.clone().sum_dims(&[1, 2, 3]).clamp_min(1.0);
        let mean = log_depth.clone().sum_dims(&[1, 2, 3]) / count;
        let relief = (log_depth - mean.clone()) * known;
        let batch = contrast.dims()[0];
        let mut alignment = Self {
            sensitivity: contrast.clone(),
            scene: contrast.clone(),
            unit: mean.reshape([batch, 1]).exp(),
            contrast,
            depth,
            cameras: cameras.clone(),
        };
        alignment.sensitivity = alignment.measured_sensitivity();
        let squares = alignment.sensitivity.clone().square() / (LIMIT * LIMIT);
        alignment.scene = Tensor::cat(vec![relief, directions(cameras, batch), squares], 1);
        alignment
    }

    /// Geometric mean of the known depths of each target, `[batch, 1]`; 1 where none is known.
    pub fn typical_depth(&self) -> Tensor<2> {
        self.unit.clone()
    }

    /// What speaks against a motion.
    ///
    /// # Shapes
    /// - `source_contrast`: [`contrast`] of the sources, `[batch, 1, height, width]`
    /// - `source_from_target`: `[batch, 3, 4]`, translation in the unit of depth
    /// - returns: `[batch, EVIDENCE_CHANNELS, height, width]`
    pub fn evidence(&self, source_contrast: Tensor<4>, source_from_target: Tensor<3>) -> Tensor<4> {
        let difference = self.difference(source_contrast, source_from_target);
        let products = self.sensitivity.clone() * difference.clone();
        Tensor::cat(vec![self.contrast.clone(), difference * 2.0, products, self.scene.clone()], 1)
    }

    /// Contrast of the source as rebuilt by a motion, less that of the target; 0 where the source does not show it.
    ///
    /// # Shapes
    /// - as [`Self::evidence`]
    /// - returns: `[batch, 1, height, width]`
    pub fn difference(&self, source_contrast: Tensor<4>, source_from_target: Tensor<3>) -> Tensor<4> {
        let (rebuilt, in_view) = self.rebuilt(source_contrast, source_from_target);
        (rebuilt - self.contrast.clone()) * in_view
    }

    /// Mean difference in contrast from the source as rebuilt by a motion, `[batch]`; a pixel that the source does not
    /// show costs its whole contrast, so that looking away is no way to agree.
    ///
    /// # Shapes
    /// - as [`Self::evidence`]
    pub fn disagreement(&self, source_contrast: Tensor<4>, source_from_target: Tensor<3>) -> Tensor<1> {
        let (rebuilt, in_view) = self.rebuilt(source_contrast, source_from_target);
        let batch = rebuilt.dims()[0];
        (rebuilt * in_view - self.contrast.clone()).abs().mean_dims(&[1, 2, 3]).reshape([batch])
    }

    /// The source's contrast at the target's pixels, and where it is shown, each `[batch, 1, height, width]`.
    fn rebuilt(&self, source_contrast: Tensor<4>, source_from_target: Tensor<3>) -> (Tensor<4>, Tensor<4>) {
        let Correspondence { pixels, in_view, .. } = correspond(self.depth.clone(), source_from_target, &self.cameras);
        (sample_bilinear(source_contrast, pixels), in_view)
    }

    /// The motion `left` after `source_from_target`.
    ///
    /// # Shapes
    /// - `left`: `[batch, 6]`, translation in typical depths of the target, then axis times angle
    /// - `source_from_target`, returns: `[batch, 3, 4]`, translation in the unit of depth
    pub fn corrected(&self, left: Tensor<2>, source_from_target: Tensor<3>) -> Tensor<3> {
        let left = self.transform(left);
        let rotation = left.clone().narrow(2, 0, 3);
        let moved = rotation.matmul(source_from_target);
        let translation = moved.clone().narrow(2, 3, 1) + left.narrow(2, 3, 1);
        Tensor::cat(vec![moved.narrow(2, 0, 3), translation], 2)
    }

    /// Sum of the differences of two motions: of translation in typical depths, and of the three angles (half that of the
    /// entries of the rotation matrices, to first order), `[batch]`.
    ///
    /// # Shapes
    /// - `a`, `b`: `[batch, 3, 4]`, translation in the unit of depth
    pub fn distance(&self, a: Tensor<3>, b: Tensor<3>) -> Tensor<1> {
        let difference = (a - b).abs();
        let batch = difference.dims()[0];
        let translation = difference.clone().narrow(2, 3, 1).sum_dims(&[1, 2]) / self.unit.clone().unsqueeze_dim(2);
        let rotation = difference.narrow(2, 0, 3).sum_dims(&[1, 2]) * 0.5;
        (translation + rotation).reshape([batch])
    }

    /// A motion in typical depths as a transform in the unit of depth.
    fn transform(&self, motion: Tensor<2>) -> Tensor<3> {
        let translation = motion.clone().narrow(1, 0, 3) * self.unit.clone();
        source_from_target(Tensor::cat(vec![translation, motion.narrow(1, 3, 3)], 1), Rotation::AxisAngle)
    }

    /// Slope of the contrast along the way that each pixel takes when the camera moves, `[batch, 6, height, width]`.
    fn measured_sensitivity(&self) -> Tensor<4> {
        let [batch, _, height, width] = self.contrast.dims();
        let (device, dtype) = (self.contrast.device(), self.contrast.dtype());
        let slope_along = |length: usize| {
            Tensor::<4>::from_data(
                TensorData::new(central_differences(length), [1, 1, length, length]),
                (&device, dtype),
            )
        };
        let across = self.contrast.clone().matmul(slope_along(width).transpose());
        let down = slope_along(height).matmul(self.contrast.clone());
        let moved = |part: Option<usize>| {
            let probe: Vec<f32> = (0..6).map(|k| if Some(k) == part { PROBE } else { 0.0 }).collect();
            let probe = Tensor::<2>::from_data(TensorData::new(probe, [1, 6]), (&device, dtype)).repeat_dim(0, batch);
            correspond(self.depth.clone(), self.transform(probe), &self.cameras)
        };
        let still = moved(None);
        let part = |part: usize| {
            let there = moved(Some(part));
            let way = (there.pixels - still.pixels.clone()) * there.defined * still.defined.clone();
            let change = across.clone() * way.clone().narrow(1, 0, 1) + down.clone() * way.narrow(1, 1, 1);
            (change * (SENSITIVITY_GAIN / f64::from(PROBE) / width as f64)).clamp(-LIMIT, LIMIT)
        };
        Tensor::cat((0..6).map(part).collect(), 1)
    }
}

/// Brightness relative to its surroundings.
///
/// # Shapes
/// - `image`: `[batch, 3, height, width]`, RGB in [-1, 1]
/// - returns: `[batch, 1, height, width]`
pub fn contrast(image: Tensor<4>) -> Tensor<4> {
    let [_, _, height, width] = image.dims();
    let radius = ((SURROUNDINGS * width as f64).round() as usize).max(1);
    let (device, dtype) = (image.device(), image.dtype());
    let mean_along = |length: usize| {
        Tensor::<4>::from_data(TensorData::new(window_means(length, radius), [1, 1, length, length]), (&device, dtype))
    };
    let brightness = image.mean_dim(1) * 0.5 + 0.5;
    let surroundings = mean_along(height).matmul(brightness.clone()).matmul(mean_along(width).transpose());
    let contrast = (brightness - surroundings.clone()) / (surroundings + DARK);
    (contrast * CONTRAST_GAIN).clamp(-LIMIT, LIMIT)
}

/// Sine of the angle of each pixel's ray with the optical axis, by its parts right and down, `[batch, 2, height, width]`.
fn directions(cameras: &CameraBatch, batch: usize) -> Tensor<4> {
    let rays = cameras.rays();
    let directions = rays.clone().narrow(1, 0, 2) / rays.square().sum_dim(1).sqrt();
    let [known, _, height, width] = directions.dims();
    if known == batch { directions } else { directions.expand([batch, 2, height, width]) }
}

/// The matrix that averages a line over windows of `2 radius + 1` numbers, those of them that there are.
fn window_means(length: usize, radius: usize) -> Vec<f32> {
    let line = move |centre: usize| {
        let window = centre.saturating_sub(radius)..(centre + radius + 1).min(length);
        let share = 1.0 / window.len().max(1) as f32;
        (0..length).map(move |pixel| if window.contains(&pixel) { share } else { 0.0 })
    };
    (0..length).flat_map(line).collect()
}

/// The matrix that takes half the difference of both neighbours; at the ends, where one is missing, 0.
fn central_differences(length: usize) -> Vec<f32> {
    let entry = move |centre: usize, pixel: usize| match (pixel + 1 == centre, pixel == centre + 1) {
        _ if centre == 0 || centre + 1 == length => 0.0,
        (true, _) => -0.5,
        (_, true) => 0.5,
        _ => 0.0,
    };
    (0..length).flat_map(|centre| (0..length).map(move |pixel| entry(centre, pixel))).collect()
}

#[cfg(test)]
mod tests;
