//! Errors over the images of a sequence.

use super::{DepthErrors, Samples, Scaling, Valid, scale_std, sequence_scale};
use crate::stats::{Spread, mean};
use rayon::prelude::*;
use serde::Serialize;

/// Errors of one image.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ImageErrors {
    /// Position of the image in the list that was judged.
    pub index: usize,
    /// Factor its prediction was multiplied by.
    pub scale: f64,
    /// Share of the pixels with a valid truth that are predicted, 0 to 1.
    pub coverage: f64,
    /// The figures.
    #[serde(flatten)]
    pub errors: DepthErrors,
}

/// What a trivial answer gets on the same pixels.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DepthBaselines {
    /// One depth for every pixel, scaled like the prediction (without scaling: the middle true depth of the sequence).
    pub constant: DepthErrors,
}

/// The whole answer of `eval depth`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DepthEvaluation {
    /// Images judged.
    pub frames: usize,
    /// Share of the pixels with a valid truth that are predicted, 0 to 1.
    pub coverage: f64,
    /// Median over images of the ratio of median true to median predicted depth.
    pub scale: f64,
    /// Standard deviation of those ratios over their median: how much scale drifts.
    pub scale_std: f64,
    /// Mean over images.
    #[serde(flatten)]
    pub errors: DepthErrors,
    /// 95 % interval of the mean of `abs_rel` over images.
    pub abs_rel_ci95: [f64; 2],
    /// The same figures of a trivial answer.
    pub baselines: DepthBaselines,
    /// Each image.
    pub images: Vec<ImageErrors>,
}

/// What the first look at an image finds.
struct Glance {
    ratio: f64,
    true_median_m: f64,
}

/// Judges `count` images that `load` brings one by one, so that a long sequence needs no memory. Each is loaded twice.
///
/// Images without a pixel that counts are left out; `Ok(None)` if that leaves none.
///
/// # Errors
/// The first error of `load`.
pub fn evaluate<E: Send>(
    count: usize,
    load: impl Fn(usize) -> Result<Samples, E> + Sync,
    scaling: Scaling,
    valid: &Valid,
) -> Result<Option<DepthEvaluation>, E> {
    let look = |index: usize| {
        load(index).map(|samples| {
            let true_median_m = samples.constant(1.0).median_ratio()?;
            Some((index, Glance { ratio: samples.median_ratio()?, true_median_m }))
        })
    };
    let glances: Vec<Option<(usize, Glance)>> = (0..count).into_par_iter().map(look).collect::<Result<_, E>>()?;
    let glances: Vec<(usize, Glance)> = glances.into_iter().flatten().collect();
    let ratios: Vec<f64> = glances.iter().map(|(_, glance)| glance.ratio).collect();
    let true_medians_m: Vec<f64> = glances.iter().map(|(_, glance)| glance.true_median_m).collect();
    let (Some(scale), Some(middle_m)) = (sequence_scale(&ratios), sequence_scale(&true_medians_m)) else {
        return Ok(None);
    };
    let judge = |(index, glance): &(usize, Glance)| {
        let (scale, constant_m) = match scaling {
            Scaling::Median => (glance.ratio, glance.true_median_m),
            Scaling::Sequence => (scale, middle_m),
            Scaling::None => (1.0, middle_m),
        };
        load(*index).map(|samples| {
            let errors = samples.errors(scale, valid)?;
            let image = ImageErrors { index: *index, scale, coverage: samples.coverage(), errors };
            Some((image, samples.constant(constant_m).errors(1.0, valid)?))
        })
    };
    let judged: Vec<Option<(ImageErrors, DepthErrors)>> = glances.par_iter().map(judge).collect::<Result<_, E>>()?;
    let (images, constant): (Vec<ImageErrors>, Vec<DepthErrors>) = judged.into_iter().flatten().unzip();
    Ok(summed(images, &constant, scale, scale_std(&ratios).unwrap_or_default()))
}

fn summed(images: Vec<ImageErrors>, constant: &[DepthErrors], scale: f64, scale_std: f64) -> Option<DepthEvaluation> {
    let abs_rel: Vec<f64> = images.iter().map(|image| image.errors.abs_rel).collect();
    Some(DepthEvaluation {
        frames: images.len(),
        coverage: mean(&images.iter().map(|image| image.coverage).collect::<Vec<_>>())?,
        scale,
        scale_std,
        errors: DepthErrors::mean(&images.iter().map(|image| image.errors).collect::<Vec<_>>())?,
        abs_rel_ci95: Spread::of(&abs_rel, 1)?.ci95,
        baselines: DepthBaselines { constant: DepthErrors::mean(constant)? },
        images,
    })
}
