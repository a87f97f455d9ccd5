//! Errors of depth maps (D. Eigen, C. Puhrsch, R. Fergus, "Depth map prediction from a single image using a multi-scale
//! deep network", 2014, for the figures; T. Zhou et al. 2017 for scaling each image by its median).
//!
//! Predictions are brought to the size of the truth, never the reverse. A pixel counts where the truth lies inside the
//! valid range and the crop and the prediction is known; the scaled prediction is clamped to the range.

mod resize;
mod sequence;

pub use resize::resize_to;
pub use sequence::{DepthBaselines, DepthEvaluation, ImageErrors, evaluate};

use crate::EvalError;
use crate::stats::{mean, median, std};
use endoscape_core::{DepthMap, Size};
use serde::Serialize;
use std::str::FromStr;

/// How a prediction without metres is brought to metres.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scaling {
    /// Each image by the ratio of the medians.
    Median,
    /// The whole sequence by the median of those ratios.
    Sequence,
    /// Not at all.
    None,
}

impl FromStr for Scaling {
    type Err = EvalError;

    fn from_str(text: &str) -> Result<Self, EvalError> {
        match text {
            "median" => Ok(Self::Median),
            "sequence" => Ok(Self::Sequence),
            "none" => Ok(Self::None),
            _ => Err(EvalError::Setting {
                what: format!("`{text}` is no scaling"),
                remedy: "choose one of median, sequence, none",
            }),
        }
    }
}

/// A part of the picture, as shares of its height and width: rows `top .. bottom`, columns `left .. right`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crop {
    /// First row.
    pub top: f64,
    /// Row after the last.
    pub bottom: f64,
    /// First column.
    pub left: f64,
    /// Column after the last.
    pub right: f64,
}

impl Crop {
    /// The whole picture.
    pub const WHOLE: Self = Self { top: 0.0, bottom: 1.0, left: 0.0, right: 1.0 };

    /// The crop for KITTI of R. Garg et al., "Unsupervised CNN for single view depth estimation" (2016).
    pub const GARG: Self = Self { top: 0.408_108_11, bottom: 0.991_891_89, left: 0.035_947_71, right: 0.964_052_29 };

    /// The crop for KITTI of D. Eigen et al. (2014).
    pub const EIGEN: Self = Self { top: 0.332_432_4, bottom: 0.913_513_51, left: 0.035_947_71, right: 0.964_052_29 };

    /// Rows and columns of a picture, share times extent rounded down.
    fn ranges(&self, size: Size) -> (std::ops::Range<usize>, std::ops::Range<usize>) {
        let at = |share: f64, extent: usize| ((share * extent as f64) as usize).min(extent);
        (at(self.top, size.height)..at(self.bottom, size.height), at(self.left, size.width)..at(self.right, size.width))
    }
}

impl FromStr for Crop {
    type Err = EvalError;

    fn from_str(text: &str) -> Result<Self, EvalError> {
        match text {
            "none" => Ok(Self::WHOLE),
            "garg" => Ok(Self::GARG),
            "eigen" => Ok(Self::EIGEN),
            _ => Err(EvalError::Setting {
                what: format!("`{text}` is no crop"),
                remedy: "choose one of none, garg, eigen",
            }),
        }
    }
}

/// Which pixels count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Valid {
    /// Nearest true depth that counts, metres.
    pub min_m: f64,
    /// Farthest true depth that counts, metres.
    pub max_m: f64,
    /// Part of the picture that counts.
    pub crop: Crop,
}

impl Valid {
    /// Checks the range.
    ///
    /// # Errors
    /// [`EvalError::Setting`] unless `0 < min_m < max_m`.
    pub fn new(min_m: f64, max_m: f64, crop: Crop) -> Result<Self, EvalError> {
        if min_m > 0.0 && min_m < max_m && max_m.is_finite() {
            return Ok(Self { min_m, max_m, crop });
        }
        let what = format!("{min_m} to {max_m} m is no range of depth");
        Err(EvalError::Setting { what, remedy: "give 0 < --min < --max in metres" })
    }
}

/// The figures depth papers print.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct DepthErrors {
    /// Mean of `|g - p| / g`.
    pub abs_rel: f64,
    /// Mean of `(g - p)^2 / g`, metres.
    pub sq_rel: f64,
    /// Root mean square of `g - p`, metres.
    pub rmse_m: f64,
    /// Root mean square of `ln g - ln p`.
    pub rmse_log: f64,
    /// Share of pixels with `max(g/p, p/g) < 1.25`.
    pub d1: f64,
    /// The same for `1.25^2`.
    pub d2: f64,
    /// The same for `1.25^3`.
    pub d3: f64,
    /// Standard deviation of `ln p - ln g`, times 100 as the KITTI depth benchmark prints it.
    pub silog: f64,
}

impl DepthErrors {
    const FIGURES: usize = 8;

    const fn figures(&self) -> [f64; Self::FIGURES] {
        [self.abs_rel, self.sq_rel, self.rmse_m, self.rmse_log, self.d1, self.d2, self.d3, self.silog]
    }

    const fn from_figures(figures: [f64; Self::FIGURES]) -> Self {
        let [abs_rel, sq_rel, rmse_m, rmse_log, d1, d2, d3, silog] = figures;
        Self { abs_rel, sq_rel, rmse_m, rmse_log, d1, d2, d3, silog }
    }

    /// Mean of each figure over images, each image counting the same; `None` for no images.
    pub fn mean(images: &[Self]) -> Option<Self> {
        let mut figures = [0.0; Self::FIGURES];
        for (index, figure) in figures.iter_mut().enumerate() {
            *figure = mean(&images.iter().map(|image| image.figures()[index]).collect::<Vec<_>>())?;
        }
        Some(Self::from_figures(figures))
    }
}

/// True and predicted depth, metres, of the pixels that count.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Samples {
    truth_m: Vec<f64>,
    prediction: Vec<f64>,
    asked: usize,
}

impl Samples {
    /// Collects the pixels that count; the prediction is resized to the truth.
    ///
    /// # Errors
    /// [`EvalError::Shape`] if their aspect ratios differ.
    pub fn of(prediction: &DepthMap, truth: &DepthMap, valid: &Valid) -> Result<Self, EvalError> {
        let prediction = resize_to(prediction, truth.size())?;
        let (rows, columns) = valid.crop.ranges(truth.size());
        let mut samples = Self::default();
        for y in rows {
            let both = truth.grid().row(y)[columns.clone()].iter().zip(&prediction.grid().row(y)[columns.clone()]);
            for (truth_m, prediction) in both.map(|(truth_m, prediction)| (f64::from(*truth_m), f64::from(*prediction)))
            {
                if truth_m > valid.min_m && truth_m < valid.max_m {
                    samples.asked += 1;
                    if prediction > 0.0 {
                        samples.truth_m.push(truth_m);
                        samples.prediction.push(prediction);
                    }
                }
            }
        }
        Ok(samples)
    }

    /// Number of pixels that count.
    pub const fn len(&self) -> usize {
        self.truth_m.len()
    }

    /// Whether no pixel counts.
    pub const fn is_empty(&self) -> bool {
        self.truth_m.is_empty()
    }

    /// Share of the pixels with a valid truth that are predicted, 0 to 1.
    pub fn coverage(&self) -> f64 {
        self.len() as f64 / self.asked.max(1) as f64
    }

    /// Ratio of the medians: what this image's prediction has to be multiplied by; `None` without pixels.
    pub fn median_ratio(&self) -> Option<f64> {
        Some(median(&self.truth_m)? / median(&self.prediction)?)
    }

    /// The same pixels with one depth everywhere, the answer that looks at nothing.
    pub fn constant(&self, depth: f64) -> Self {
        Self { prediction: vec![depth; self.len()], ..self.clone() }
    }

    /// The figures after multiplying the prediction by `scale`; `None` without pixels.
    pub fn errors(&self, scale: f64, valid: &Valid) -> Option<DepthErrors> {
        let mut sums = [0.0; DepthErrors::FIGURES];
        let mut log_sum = 0.0;
        for (g, p) in self.truth_m.iter().zip(&self.prediction) {
            let p = (p * scale).clamp(valid.min_m, valid.max_m);
            let (difference, log, ratio) = (g - p, (p / g).ln(), (g / p).max(p / g));
            let below = |power: i32| f64::from(u8::from(ratio < 1.25_f64.powi(power)));
            let square = difference * difference;
            let terms = [difference.abs() / g, square / g, square, log * log, below(1), below(2), below(3), 0.0];
            sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
            log_sum += log;
        }
        let count = self.len() as f64;
        let mut figures = sums.map(|sum| sum / count);
        let log_mean = log_sum / count;
        figures[7] = 100.0 * (figures[3] - log_mean * log_mean).max(0.0).sqrt();
        (figures[2], figures[3]) = (figures[2].sqrt(), figures[3].sqrt());
        (!self.is_empty()).then(|| DepthErrors::from_figures(figures))
    }
}

/// The scale to apply to a whole sequence, from the ratios of its images; `None` for none.
pub fn sequence_scale(ratios: &[f64]) -> Option<f64> {
    median(ratios)
}

/// How much the scale changes from image to image: standard deviation of the ratios over their median.
pub fn scale_std(ratios: &[f64]) -> Option<f64> {
    let middle = median(ratios)?;
    std(&ratios.iter().map(|ratio| ratio / middle).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests;
