//! Depth of a keyframe's point from a second picture of known motion.
//!
//! The point's pattern is slid along its epipolar curve, sampled in inverse depth so that any camera will do, and the
//! best place is refined by Gauss-Newton. Its variance follows from brightness noise, from the gradient along the curve
//! and from how far the pixel moves per inverse depth (J. Engel, J. Sturm, D. Cremers, "Semi-dense visual odometry for
//! a monocular camera", ICCV 2013, section 2.2).

use super::align::{Brightness, moved_ray};
use super::lens::Lens;
use super::point::{InverseDepth, PATTERN, Point};
use super::pyramid::Level;
use endoscape_core::Pose;

/// Half-width of the searched range, standard deviations.
const RANGE_SIGMAS: f64 = 2.0;
/// Smallest inverse depth searched, as a share of the expected one: forty times as far.
const FARTHEST: f64 = 0.025;
/// Steps per pixel of the curve.
const STEPS_PER_PIXEL: f64 = 1.0;
/// Most steps; a longer curve is searched around its middle.
const MOST_STEPS: f64 = 120.0;
/// Largest mean squared residual of a match, in noise variances.
const WORST_MATCH: f64 = 6.0;
/// A second place this much worse, at most, makes a match ambiguous.
const AMBIGUOUS: f64 = 1.3;
/// Standard deviation of the pixel's place that motion errors leave, pixels.
const PLACE_SIGMA: f64 = 0.3;

/// What a picture says about a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Search {
    /// It was seen at this inverse depth.
    Found(InverseDepth),
    /// It should have been seen and was not, or not clearly.
    Missed,
    /// The picture cannot tell: out of view, or no parallax.
    Blind,
}

/// A picture to search in, with its camera and its motion and brightness against the keyframe.
#[derive(Clone, Copy, Debug)]
pub struct Target<'a> {
    /// The full picture.
    pub level: &'a Level,
    /// Its camera.
    pub lens: &'a Lens,
    /// Takes points of the keyframe's camera to the picture's.
    pub motion: Pose,
    /// Change of brightness from keyframe to picture.
    pub brightness: Brightness,
    /// Standard deviation of brightness, grey levels.
    pub noise: f64,
}

impl Target<'_> {
    /// Sum of squared differences of the pattern at an inverse depth.
    fn difference(&self, point: &Point, rho: f64) -> Option<f64> {
        let mut squares = 0.0;
        for (ray, brightness) in point.rays.iter().zip(point.brightness) {
            let pixel = self.lens.project(&moved_ray(&self.motion, ray, rho))?;
            squares += (self.level.sample(&pixel)?.value - self.brightness.apply(brightness)).powi(2);
        }
        Some(squares)
    }

    /// The same with what Gauss-Newton needs.
    fn compare(&self, point: &Point, rho: f64) -> Option<(f64, f64, f64)> {
        let (mut squares, mut slope, mut information) = (0.0, 0.0, 0.0);
        for (ray, brightness) in point.rays.iter().zip(point.brightness) {
            let q = moved_ray(&self.motion, ray, rho);
            let (pixel, pixel_by_q) = self.lens.linearise(&q)?;
            let sample = self.level.sample(&pixel)?;
            let residual = sample.value - self.brightness.apply(brightness);
            let by_rho = pixel_by_q.tr_mul(&sample.gradient).dot(&self.motion.translation.vector);
            squares += residual * residual;
            slope += by_rho * residual;
            information += by_rho * by_rho;
        }
        Some((squares, slope, information))
    }

    /// Pixels the point moves per unit of inverse depth.
    fn speed(&self, point: &Point, rho: f64) -> Option<f64> {
        let q = moved_ray(&self.motion, &point.ray, rho);
        Some((self.lens.linearise(&q)?.1 * self.motion.translation.vector).norm())
    }

    /// Whether a point looks the same at the depth it is believed to have.
    pub fn agrees(&self, point: &Point) -> bool {
        self.difference(point, point.inverse_depth.mean).is_some_and(|squares| squares < self.worst())
    }

    /// Largest sum of squared differences of a match.
    fn worst(&self) -> f64 {
        WORST_MATCH * self.noise * self.noise * PATTERN.len() as f64
    }

    /// Looks for a point within its uncertainty.
    pub fn search(&self, point: &Point) -> Search {
        let InverseDepth { mean, variance } = point.inverse_depth;
        let Some(speed) = self.speed(point, mean) else { return Search::Blind };
        let sigma = variance.sqrt();
        // Less than a third of a pixel of doubt cannot be improved by a picture whose places are no better known.
        if speed * sigma < PLACE_SIGMA {
            return Search::Blind;
        }
        let reach = (RANGE_SIGMAS * sigma).min(0.5 * MOST_STEPS / (STEPS_PER_PIXEL * speed));
        let low = (mean - reach).max(FARTHEST * mean);
        let steps = ((mean + reach - low) * speed * STEPS_PER_PIXEL).ceil().clamp(4.0, MOST_STEPS) as usize;
        let step = (mean + reach - low) / steps as f64;
        let costs: Vec<Option<f64>> = (0..=steps).map(|i| self.difference(point, low + step * i as f64)).collect();
        let Some((best, cost)) = cheapest(&costs, |_| true) else { return Search::Blind };
        let elsewhere = cheapest(&costs, |i| i.abs_diff(best) > 3).map_or(f64::INFINITY, |(_, cost)| cost);
        if cost > self.worst() || elsewhere < AMBIGUOUS * cost {
            return Search::Missed;
        }
        self.refine(point, low + step * best as f64, step)
    }

    /// Gauss-Newton within a step of a place, and the variance there.
    fn refine(&self, point: &Point, start: f64, step: f64) -> Search {
        let (mut rho, mut last) = (start, None);
        for _ in 0..3 {
            let Some((squares, slope, information)) = self.compare(point, rho) else { return Search::Blind };
            if information <= 0.0 {
                return Search::Blind;
            }
            last = Some((squares, information));
            rho = (rho - slope / information).clamp(start - step, start + step);
        }
        let (Some((squares, information)), Some(speed)) = (last, self.speed(point, rho)) else { return Search::Blind };
        let noise = (self.noise * self.noise).max(squares / PATTERN.len() as f64);
        let variance = noise / information + (PLACE_SIGMA / speed).powi(2);
        if rho > 0.0 { Search::Found(InverseDepth { mean: rho, variance }) } else { Search::Missed }
    }
}

fn cheapest(costs: &[Option<f64>], allowed: impl Fn(usize) -> bool) -> Option<(usize, f64)> {
    let known = costs.iter().enumerate().filter_map(|(index, cost)| Some((index, (*cost)?)));
    known.filter(|(index, _)| allowed(*index)).min_by(|a, b| a.1.total_cmp(&b.1))
}

/// Squared distance in standard deviations beyond which a found depth contradicts the known one.
const CONTRADICTION: f64 = 9.0;
/// Growth of the variance per picture, for what the filter's independence assumption leaves out (LSD-SLAM's value).
const GROWTH: f64 = 1.02;

impl Point {
    /// Takes what a picture says into account: the product of two Gaussians, unless they contradict each other.
    pub fn observe(&mut self, search: Search) {
        match search {
            Search::Blind => {}
            Search::Missed => self.missed += 1,
            Search::Found(seen) => {
                let known = InverseDepth { variance: self.inverse_depth.variance * GROWTH, ..self.inverse_depth };
                let total = known.variance + seen.variance;
                if (seen.mean - known.mean).powi(2) > CONTRADICTION * total {
                    self.missed += 1;
                    return;
                }
                let mean = (known.mean * seen.variance + seen.mean * known.variance) / total;
                self.inverse_depth = InverseDepth { mean, variance: known.variance * seen.variance / total };
                self.found += 1;
                self.missed = 0;
            }
        }
    }
}
