//! The training objective, from pictures and network outputs to one number.
//!
//! `total = sum_s L_vs^s + lambda_s sum_s L_smooth^s / decay^s + lambda_e sum_s L_reg^s` (the paper's last equation), plus
//! `lambda_g sum_s L_geo^s` where depths of neighbouring views are compared. `s` counts scales from the finest. Nothing
//! here reads a value back from the device.

use crate::brightness::align_brightness;
use crate::camera::{CameraBatch, CameraPyramid};
use crate::config::{AcrossSources, Brightness, ObjectiveConfig, Scales};
use crate::geometry::depth_disagreement;
use crate::mask_loss::reliability_cross_entropy;
use crate::photometric::{auto_mask, average, minimum_over_sources, photometric_error};
use crate::pyramid::{WHOLLY, enlarge, shrink, shrink_usable};
use crate::smoothness::smoothness;
use crate::warp::{Synthesized, sample_bilinear, synthesize};
use burn::tensor::Tensor;

/// A picture and which of its pixels mean anything.
#[derive(Clone, Debug)]
pub struct View {
    /// `[batch, 3, height, width]`, RGB in [-1, 1].
    pub image: Tensor<4>,
    /// `[batch, 1, height, width]`, 1 for good pixels, 0 for those known to be bad before training: outside the field
    /// of view, saturated. `None` if all are good.
    pub usable: Option<Tensor<4>>,
}

/// A batch of snippets: a target and its sources in time order.
#[derive(Clone, Debug)]
pub struct ViewBatch {
    /// The frame whose depth is predicted.
    pub target: View,
    /// Its neighbours.
    pub sources: Vec<View>,
    /// Cameras of each scale; all frames of a snippet share theirs.
    pub cameras: CameraPyramid,
}

/// What the networks say about a batch.
#[derive(Clone, Debug)]
pub struct Prediction {
    /// Disparity (inverse depth) of the target, finest first, each `[batch, 1, height, width]`.
    pub disparities: Vec<Tensor<4>>,
    /// Motion to each source, `[batch, 3, 4]`; see [`source_from_target`](crate::motion::source_from_target).
    pub source_from_target: Vec<Tensor<3>>,
    /// Reliability in (0, 1) at each scale, `[batch, sources, height, width]`; empty without a mask network.
    pub masks: Vec<Tensor<4>>,
    /// Disparities of each source, scales as in `disparities`; empty unless views are to agree on depth.
    pub source_disparities: Vec<Vec<Tensor<4>>>,
}

/// The terms of the objective, each `[1]`, before their weights lambda.
#[derive(Clone, Debug)]
pub struct LossTerms {
    /// Sum over scales of the view synthesis error.
    pub photometric: Tensor<1>,
    /// Sum over scales of smoothness divided by the decay of the scale.
    pub smoothness: Tensor<1>,
    /// Sum over scales of the price of unreliable pixels.
    pub mask: Tensor<1>,
    /// Sum over scales of the depth disagreement between views.
    pub geometry: Tensor<1>,
    /// The weighted sum to minimise.
    pub total: Tensor<1>,
}

/// The objective of a batch.
///
/// Scales are those of `prediction.disparities`; `batch.cameras` needs one level for each, or the first alone when all
/// scales are judged at full size.
pub fn objective(batch: &ViewBatch, prediction: &Prediction, config: &ObjectiveConfig) -> LossTerms {
    let zero = Tensor::<1>::zeros([1], (&batch.target.image.device(), batch.target.image.dtype()));
    let (mut photometric, mut geometry) = (zero.clone(), zero.clone());
    let (mut smooth, mut mask) = (zero.clone(), zero);
    for (scale, disparity) in prediction.disparities.iter().enumerate() {
        let (l_vs, l_geo) = view_synthesis(&Scale::new(batch, prediction, scale, config), config);
        photometric = photometric + l_vs;
        geometry = geometry + l_geo;
        let [_, _, height, width] = disparity.dims();
        let image = shrink(batch.target.image.clone(), [height, width]);
        let decay = config.smoothness_decay.powi(i32::try_from(scale).unwrap_or(i32::MAX));
        smooth = smooth + smoothness(disparity.clone(), &image, config.smoothness) / decay;
        if let Some(reliability) = prediction.masks.get(scale) {
            mask = mask + reliability_cross_entropy(reliability.clone());
        }
    }
    let total = photometric.clone()
        + smooth.clone() * config.smoothness_weight
        + mask.clone() * config.mask_weight
        + geometry.clone() * config.geometry_weight;
    LossTerms { photometric, smoothness: smooth, mask, geometry, total }
}

/// One scale's inputs, all of one size.
struct Scale<'a> {
    target: View,
    sources: Vec<View>,
    cameras: &'a CameraBatch,
    depth: Tensor<4>,
    source_from_target: &'a [Tensor<3>],
    /// Per source, `[batch, 1, height, width]`.
    reliability: Vec<Option<Tensor<4>>>,
    source_depths: Vec<Option<Tensor<4>>>,
}

impl<'a> Scale<'a> {
    fn new(batch: &'a ViewBatch, prediction: &'a Prediction, scale: usize, config: &ObjectiveConfig) -> Self {
        let levels = batch.cameras.levels();
        let cameras = match config.scales {
            Scales::Full => &levels[0],
            Scales::Native => &levels[scale],
        };
        let size = [cameras.size().height, cameras.size().width];
        let disparity = |pyramid: &Vec<Tensor<4>>| enlarge(pyramid[scale].clone(), size);
        let mask = |source: usize| prediction.masks.get(scale).map(|mask| mask.clone().narrow(1, source, 1));
        let count = batch.sources.len();
        Self {
            target: batch.target.shrunk(size),
            sources: batch.sources.iter().map(|source| source.shrunk(size)).collect(),
            cameras,
            depth: disparity(&prediction.disparities).recip(),
            source_from_target: &prediction.source_from_target,
            reliability: (0..count).map(|source| mask(source).map(|mask| enlarge(mask, size))).collect(),
            source_depths: (0..count)
                .map(|source| prediction.source_disparities.get(source).map(|pyramid| disparity(pyramid).recip()))
                .collect(),
        }
    }
}

impl View {
    fn shrunk(&self, size: [usize; 2]) -> Self {
        Self {
            image: shrink(self.image.clone(), size),
            usable: self.usable.clone().map(|usable| shrink_usable(usable, size)),
        }
    }
}

/// Photometric and geometric terms of one scale.
fn view_synthesis(scale: &Scale<'_>, config: &ObjectiveConfig) -> (Tensor<1>, Tensor<1>) {
    let compared: Vec<Compared> = (0..scale.sources.len()).map(|source| compare(scale, source, config)).collect();
    let zero = || Tensor::<1>::zeros([1], (&scale.depth.device(), scale.depth.dtype()));
    let geometry = compared.iter().filter_map(|source| source.disagreement.clone()).fold(zero(), Tensor::add);
    let (errors, valid): (Vec<_>, Vec<_>) = compared.into_iter().map(|source| (source.error, source.valid)).unzip();
    let photometric = match config.across_sources {
        AcrossSources::Minimum if !errors.is_empty() => {
            let (error, valid) = minimum_over_sources(errors, valid);
            average(error, valid, config.average)
        }
        _ => {
            let means = errors.into_iter().zip(valid).map(|(error, valid)| average(error, valid, config.average));
            means.fold(zero(), Tensor::add)
        }
    };
    (photometric, geometry)
}

/// How well one source explains the target.
struct Compared {
    /// `[batch, 1, height, width]`, reliability and agreement applied.
    error: Tensor<4>,
    /// `[batch, 1, height, width]`, 0 or 1.
    valid: Tensor<4>,
    /// Mean depth disagreement, `[1]`.
    disagreement: Option<Tensor<1>>,
}

/// Paints the target with one source and compares.
fn compare(scale: &Scale<'_>, source: usize, config: &ObjectiveConfig) -> Compared {
    let (target, view) = (scale.target.image.clone(), &scale.sources[source]);
    let motion = scale.source_from_target[source].clone();
    let synthesized = synthesize(view.image.clone(), scale.depth.clone(), motion, scale.cameras, config.out_of_view);
    let mut valid = usable_pixels(&synthesized, &scale.target, view);
    let image = match config.brightness {
        Brightness::Constant => synthesized.image,
        Brightness::Affine => align_brightness(synthesized.image, target.clone(), valid.clone()),
    };
    let mut error = photometric_error(target.clone(), image, config.ssim_weight);
    if config.auto_mask {
        let unwarped = photometric_error(target, view.image.clone(), config.ssim_weight);
        valid = valid * auto_mask(error.clone(), unwarped);
    }
    if let Some(reliability) = &scale.reliability[source] {
        error = error * reliability.clone();
    }
    let mut disagreement = None;
    if let Some(depth) = scale.source_depths[source].clone().filter(|_| config.geometry_weight > 0.0) {
        let sampled = sample_bilinear(depth, synthesized.correspondence.pixels);
        let map = depth_disagreement(synthesized.correspondence.depth, sampled);
        // Detached: disagreeing depths must not be a way to a lower photometric error.
        error = error * (-map.clone().detach() + 1.0);
        disagreement = Some(average(map, valid.clone(), config.average));
    }
    Compared { error, valid, disagreement }
}

/// Pixels that count under the out-of-view policy and are known to be good in both views.
fn usable_pixels(synthesized: &Synthesized, target: &View, source: &View) -> Tensor<4> {
    let mut valid = synthesized.valid.clone();
    if let Some(usable) = target.usable.clone() {
        valid = valid * usable;
    }
    if let Some(usable) = source.usable.clone() {
        let pixels = synthesized.correspondence.pixels.clone().detach();
        let dtype = valid.dtype();
        valid = valid * sample_bilinear(usable, pixels).greater_scalar(WHOLLY).float().cast(dtype);
    }
    valid
}
