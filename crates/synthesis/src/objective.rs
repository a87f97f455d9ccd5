//! The training objective, from pictures and network outputs to one number.
//!
//! `total = sum_s L_vs^s + lambda_s sum_s L_smooth^s / decay^s + lambda_e sum_s L_reg^s` (the paper's last equation), plus
//! `lambda_g sum_s L_geo^s` where depths of neighbouring views are compared. `s` counts scales from the finest. Nothing
//! here reads a value back from the device.

use crate::brightness::align_brightness;
use crate::camera::{CameraBatch, CameraPyramid};
use crate::config::{AcrossSources, Brightness, ObjectiveConfig, Scales};
use crate::geometry::depth_disagreement;
use crate::light::light_disagreement;
use crate::mask_loss::reliability_cross_entropy;
use crate::photometric::{auto_mask, average, minimum_over_sources, photometric_error};
use crate::pyramid::{WHOLLY, enlarge, shrink, shrink_usable};
use crate::smoothness::smoothness;
use crate::warp::{Synthesized, depth_from_disparity, finite_disparity, sample_bilinear, synthesize};
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
    /// Disagreement between depth and brightness at the finest scale.
    pub light: Tensor<1>,
    /// The weighted sum to minimise.
    pub total: Tensor<1>,
    /// Share of the target's pixels that count in the photometric term, mean over scales, 0 to 1. Near 0 there is
    /// nothing to learn from, however low the other numbers are.
    pub coverage: Tensor<1>,
}

impl LossTerms {
    /// Nothing at all, beside `like`.
    pub fn none<const D: usize>(like: &Tensor<D>) -> Self {
        let zero = Tensor::<1>::zeros([1], (&like.device(), like.dtype()));
        let [photometric, smoothness, mask, geometry, light, total, coverage] = std::array::from_fn(|_| zero.clone());
        Self { photometric, smoothness, mask, geometry, light, total, coverage }
    }
}

/// The objective of a batch.
///
/// Scales are those of `prediction.disparities`; `batch.cameras` needs one level for each, or the first alone when all
/// scales are judged at full size.
///
/// # Panics
/// If the parts of `batch` and `prediction` do not belong together: other numbers of sources or scales, other sizes.
pub fn objective(batch: &ViewBatch, prediction: &Prediction, config: &ObjectiveConfig) -> LossTerms {
    let zero = Tensor::<1>::zeros([1], (&batch.target.image.device(), batch.target.image.dtype()));
    let (mut photometric, mut geometry, mut coverage) = (zero.clone(), zero.clone(), zero.clone());
    let (mut smooth, mut mask) = (zero.clone(), zero.clone());
    let full = (config.scales == Scales::Full).then(|| Pictures::new(batch, 0, config));
    for (scale, disparity) in prediction.disparities.iter().enumerate() {
        let pictures = full.clone().unwrap_or_else(|| Pictures::new(batch, scale, config));
        let synthesis = view_synthesis(&Scale::new(pictures, prediction, scale), config);
        photometric = photometric + synthesis.photometric;
        geometry = geometry + synthesis.geometry;
        coverage = coverage + synthesis.coverage;
        smooth = smooth + scale_smoothness(&batch.target, disparity.clone(), scale, config);
        if let Some(reliability) = prediction.masks.get(scale) {
            mask = mask + reliability_cross_entropy(reliability.clone());
        }
    }
    let light = match prediction.disparities.first().filter(|_| config.light_weight > 0.0) {
        Some(disparity) => target_light(batch, disparity.clone()),
        None => zero,
    };
    let total = photometric.clone()
        + smooth.clone() * config.smoothness_weight
        + mask.clone() * config.mask_weight
        + geometry.clone() * config.geometry_weight
        + light.clone() * config.light_weight;
    let coverage = coverage / prediction.disparities.len().max(1) as f64;
    LossTerms { photometric, smoothness: smooth, mask, geometry, light, total, coverage }
}

/// How far the target's depth is from what its brightness says.
fn target_light(batch: &ViewBatch, disparity: Tensor<4>) -> Tensor<1> {
    let cameras = &batch.cameras.levels()[0];
    let target = batch.target.shrunk([cameras.size().height, cameras.size().width]);
    light_disagreement(depth_from_disparity(disparity), target.image, target.usable, cameras)
}

/// Smoothness of one scale, at its own size, divided by its decay.
fn scale_smoothness(target: &View, disparity: Tensor<4>, scale: usize, config: &ObjectiveConfig) -> Tensor<1> {
    let decay = (0..scale).fold(1.0, |decay, _| decay * config.smoothness_decay);
    smoothness(finite_disparity(disparity), &target.image, config.smoothness) / decay
}

/// The pictures of a batch at the size of a scale.
#[derive(Clone)]
struct Pictures<'a> {
    cameras: &'a CameraBatch,
    target: View,
    sources: Vec<View>,
    /// Per source, how well it matches the target as it stands, `[batch, 1, height, width]`; for the auto-mask alone.
    unwarped_errors: Vec<Option<Tensor<4>>>,
}

impl<'a> Pictures<'a> {
    fn new(batch: &'a ViewBatch, level: usize, config: &ObjectiveConfig) -> Self {
        let cameras = &batch.cameras.levels()[level];
        let size = [cameras.size().height, cameras.size().width];
        let target = batch.target.shrunk(size);
        let sources: Vec<View> = batch.sources.iter().map(|source| source.shrunk(size)).collect();
        let unwarped = |source: &View| {
            let error = || photometric_error(target.image.clone(), source.image.clone(), config.ssim_weight);
            config.auto_mask.then(error)
        };
        let unwarped_errors = sources.iter().map(unwarped).collect();
        Self { cameras, target, sources, unwarped_errors }
    }

    fn size(&self) -> [usize; 2] {
        [self.cameras.size().height, self.cameras.size().width]
    }
}

/// One scale's inputs, all of one size.
struct Scale<'a> {
    pictures: Pictures<'a>,
    depth: Tensor<4>,
    source_from_target: &'a [Tensor<3>],
    /// Per source, `[batch, 1, height, width]`.
    reliability: Vec<Option<Tensor<4>>>,
    source_depths: Vec<Option<Tensor<4>>>,
}

impl<'a> Scale<'a> {
    fn new(pictures: Pictures<'a>, prediction: &'a Prediction, scale: usize) -> Self {
        let size = pictures.size();
        let depth = |pyramid: &Vec<Tensor<4>>| depth_from_disparity(enlarge(pyramid[scale].clone(), size));
        let reliability = |source: usize| {
            let mask = prediction.masks.get(scale)?.clone().narrow(1, source, 1);
            Some(enlarge(mask, size))
        };
        let sources = 0..pictures.sources.len();
        Self {
            depth: depth(&prediction.disparities),
            source_from_target: &prediction.source_from_target,
            reliability: sources.clone().map(reliability).collect(),
            source_depths: sources.map(|source| prediction.source_disparities.get(source).map(depth)).collect(),
            pictures,
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

/// What synthesis from all sources says about one scale, each `[1]`.
struct ViewSynthesis {
    photometric: Tensor<1>,
    geometry: Tensor<1>,
    coverage: Tensor<1>,
}

/// `L_vs` and `L_geo` of one scale.
fn view_synthesis(scale: &Scale<'_>, config: &ObjectiveConfig) -> ViewSynthesis {
    let zero = Tensor::<1>::zeros([1], (&scale.depth.device(), scale.depth.dtype()));
    if scale.pictures.sources.is_empty() {
        return ViewSynthesis { photometric: zero.clone(), geometry: zero.clone(), coverage: zero };
    }
    let compared: Vec<Compared> =
        (0..scale.pictures.sources.len()).map(|source| compare(scale, source, config)).collect();
    let geometry = compared.iter().filter_map(|source| source.disagreement.clone()).fold(zero.clone(), Tensor::add);
    let (errors, valid): (Vec<_>, Vec<_>) = compared.into_iter().map(|source| (source.error, source.valid)).unzip();
    let coverage = Tensor::cat(valid.clone(), 1).max_dim(1).mean();
    let photometric = match config.across_sources {
        AcrossSources::Minimum => {
            let (best, counts) = minimum_over_sources(errors, valid);
            average(best, counts, config.average)
        }
        AcrossSources::Sum => {
            let means = errors.into_iter().zip(valid).map(|(error, valid)| average(error, valid, config.average));
            means.fold(zero, Tensor::add)
        }
    };
    ViewSynthesis { photometric, geometry, coverage }
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
    let Pictures { cameras, target, sources, unwarped_errors } = &scale.pictures;
    let (image, motion) = (sources[source].image.clone(), scale.source_from_target[source].clone());
    let synthesized = synthesize(image, scale.depth.clone(), motion, cameras, config.out_of_view);
    let mut valid = usable_pixels(&synthesized, target, &sources[source]);
    let image = match config.brightness {
        Brightness::Constant => synthesized.image,
        Brightness::Affine => align_brightness(synthesized.image, target.image.clone(), valid.clone()),
    };
    let mut error = photometric_error(target.image.clone(), image, config.ssim_weight);
    if let Some(unwarped) = &unwarped_errors[source] {
        valid = valid * auto_mask(error.clone(), unwarped.clone());
    }
    if let Some(reliability) = &scale.reliability[source] {
        error = error * reliability.clone();
    }
    let mut disagreement = None;
    if let Some(depth) = scale.source_depths[source].clone().filter(|_| config.geometry_weight > 0.0) {
        let sampled = sample_bilinear(depth, synthesized.correspondence.pixels);
        let map =
            depth_disagreement(synthesized.correspondence.depth, sampled) * synthesized.correspondence.in_view.clone();
        // Detached: disagreeing depths must not be a way to a lower photometric error.
        error = error * (-map.clone().detach() + 1.0);
        disagreement = Some(average(map, valid.clone() * synthesized.correspondence.in_view, config.average));
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
