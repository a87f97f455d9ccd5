//! A depth map corrected by points whose depth the motion has measured.
//!
//! The depth network errs smoothly: a whole fold is too near, the lumen not deep enough. Points of the keyframe, whose
//! depth many pictures have measured ([`crate::refine`]), say by how much at some places, and between them the error is
//! interpolated. With `l_i` the logarithm of measured over predicted depth at the place `u_i`,
//!
//! ```text
//! c = argmin  sum_i rho((c(u_i) - l_i) / s_i) + |c|^2 / S^2 + |D c|^2 / T^2        corrected depth = depth exp(c(u))
//! ```
//!
//! where `c` is bilinear between 8 x 7 knots, `D` takes the differences of neighbouring knots and `rho` is Huber's loss:
//! interpolation with a prior, so that little is changed where nothing was measured.
//!
//! Turning the camera and moving it sideways look alike, the more so through a lens that is not the one assumed, and a
//! flat scene makes one pass for the other. A correction that flattens the scene is therefore not believed, nor are those
//! of the next frames. Networks err the other way: before scenes they do not know they predict too little relief.

use endoscape_core::{Grid, Size};
use nalgebra::{DMatrix, DVector, Point2};

/// Knots across and down.
const COLUMNS: usize = 8;
const ROWS: usize = 7;
/// Standard deviation of the correction at a knot: what the network errs by on pictures of other makers (docs/results.md).
const SPREAD: f64 = 0.3;
/// Standard deviation of the difference between neighbouring knots.
const STEP: f64 = 0.2;
/// What a smooth correction leaves unexplained at a point.
const LEFT: f64 = 0.05;
/// Residuals beyond this many standard deviations count linearly.
const HUBER: f64 = 1.345;
/// Solutions in turn, each weighted by the residuals of the one before.
const ROUNDS: usize = 3;
/// Fewer points say nothing.
const FEWEST: usize = 20;
/// Least relief of a corrected map, as a share of that of the predicted one.
const FLATTEST: f64 = 0.9;
/// Frames without correction after one that flattened the scene: what misled the motion seldom ends with a frame.
const DOUBTFUL: usize = 60;

/// A place whose depth has been measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Where, in the map's pixels.
    pub at: Point2<f64>,
    /// Logarithm of the measured over the predicted depth.
    pub log_ratio: f64,
    /// Standard deviation of that logarithm.
    pub sigma: f64,
}

/// Corrects the maps of a stream, frame after frame.
#[derive(Clone, Debug, Default)]
pub struct Corrector {
    /// Frames during which nothing is believed.
    doubtful: usize,
}

impl Corrector {
    /// A depth map in any unit as sightings have it; `None` where they are too few, or where they or those of a frame
    /// shortly before would flatten the scene.
    pub fn corrected(&mut self, depth: &Grid<f32>, sightings: &[Sighting]) -> Option<Grid<f32>> {
        if self.doubtful > 0 {
            self.doubtful -= 1;
            return None;
        }
        let corrected = Correction::fit(sightings, depth.size())?.apply(depth);
        let is_flatter = relief(&corrected) < FLATTEST * relief(depth);
        self.doubtful = if is_flatter { DOUBTFUL } else { 0 };
        (!is_flatter).then_some(corrected)
    }
}

/// Standard deviation of the logarithm of depth.
fn relief(depth: &Grid<f32>) -> f64 {
    let logs = depth.values().iter().map(|depth| f64::from(depth.ln()));
    let (sum, squares) = logs.fold((0.0, 0.0), |(sum, squares), log| (sum + log, squares + log * log));
    let count = depth.size().area().max(1) as f64;
    (squares / count - (sum / count).powi(2)).max(0.0).sqrt()
}

/// The logarithm of the factor on a map's depths.
#[derive(Clone, Debug)]
pub struct Correction {
    knots: DVector<f64>,
    size: Size,
}

impl Correction {
    /// The correction of a map of `size` that sightings ask for; `None` for too few.
    pub fn fit(sightings: &[Sighting], size: Size) -> Option<Self> {
        if sightings.len() < FEWEST {
            return None;
        }
        let prior = prior();
        let mut correction = Self { knots: DVector::zeros(COLUMNS * ROWS), size };
        for _ in 0..ROUNDS {
            let (mut information, mut target) = (prior.clone(), DVector::zeros(COLUMNS * ROWS));
            for sighting in sightings {
                let variance = sighting.sigma.powi(2) + LEFT * LEFT;
                let residual = (correction.at(&sighting.at) - sighting.log_ratio).abs() / variance.sqrt();
                let weight = if residual <= HUBER { 1.0 } else { HUBER / residual } / variance;
                let shares = shares(&sighting.at, size);
                for (knot, share) in shares {
                    target[knot] += weight * share * sighting.log_ratio;
                    for (other, other_share) in shares {
                        information[(knot, other)] += weight * share * other_share;
                    }
                }
            }
            correction.knots = information.cholesky()?.solve(&target);
        }
        Some(correction)
    }

    /// The logarithm of the factor at a place.
    pub fn at(&self, place: &Point2<f64>) -> f64 {
        shares(place, self.size).iter().map(|(knot, share)| share * self.knots[*knot]).sum()
    }

    /// The corrected map.
    pub fn apply(&self, depth: &Grid<f32>) -> Grid<f32> {
        Grid::from_fn(depth.size(), |x, y| {
            let known = depth.get(x, y).copied().unwrap_or(f32::NAN);
            known * self.at(&Point2::new(x as f64, y as f64)).exp() as f32
        })
    }
}

/// The four knots around a place with their shares.
fn shares(place: &Point2<f64>, size: Size) -> [(usize, f64); 4] {
    let cell = |at: f64, extent: usize, knots: usize| {
        let at = ((at + 0.5) / extent.max(1) as f64).clamp(0.0, 1.0) * (knots - 1) as f64;
        let first = (at as usize).min(knots - 2);
        (first, at - first as f64)
    };
    let ((column, across), (row, down)) = (cell(place.x, size.width, COLUMNS), cell(place.y, size.height, ROWS));
    let knot = row * COLUMNS + column;
    [
        (knot, (1.0 - across) * (1.0 - down)),
        (knot + 1, across * (1.0 - down)),
        (knot + COLUMNS, (1.0 - across) * down),
        (knot + COLUMNS + 1, across * down),
    ]
}

/// Information of the knots before anything is seen.
fn prior() -> DMatrix<f64> {
    let mut information = DMatrix::identity(COLUMNS * ROWS, COLUMNS * ROWS) / (SPREAD * SPREAD);
    let mut join = |a: usize, b: usize| {
        for (one, other) in [(a, b), (b, a)] {
            information[(one, one)] += 1.0 / (STEP * STEP);
            information[(one, other)] -= 1.0 / (STEP * STEP);
        }
    };
    for row in 0..ROWS {
        for column in 0..COLUMNS {
            let knot = row * COLUMNS + column;
            if column + 1 < COLUMNS {
                join(knot, knot + 1);
            }
            if row + 1 < ROWS {
                join(knot, knot + COLUMNS);
            }
        }
    }
    information
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SIZE: Size = Size::new(80, 64);

    fn hill() -> Grid<f32> {
        Grid::from_fn(SIZE, |x, y| 2.0 + (x as f32 / 12.0).sin() + y as f32 / 40.0)
    }

    /// Sightings on a lattice that find depths wrong by a smooth factor.
    fn sightings(error: impl Fn(f64, f64) -> f64) -> Vec<Sighting> {
        let places = (2..64).step_by(4).flat_map(|y| (2..80).step_by(4).map(move |x| (f64::from(x), f64::from(y))));
        places.map(|(x, y)| Sighting { at: Point2::new(x, y), log_ratio: error(x, y), sigma: 0.05 }).collect()
    }

    fn slope(x: f64, y: f64) -> f64 {
        0.4 * (x / 80.0 - 0.5) - 0.3 * (y / 64.0 - 0.5)
    }

    /// Mean distance of a correction's logarithm from an expected one.
    fn off(correction: &Correction, expected: impl Fn(f64, f64) -> f64) -> f64 {
        let sightings = sightings(expected);
        let distance = |s: &Sighting| (correction.at(&s.at) - s.log_ratio).abs();
        sightings.iter().map(distance).sum::<f64>() / sightings.len() as f64
    }

    #[test]
    fn a_smooth_error_is_undone_also_among_outliers() {
        // A fifth of outliers, all to one side, moves Huber's loss by some hundredths.
        for (spoilt, limit) in [(usize::MAX, 0.03), (5, 0.06)] {
            let mut seen = sightings(slope);
            seen.iter_mut().step_by(spoilt).skip(1).for_each(|sighting| sighting.log_ratio += 2.0);
            let found = Correction::fit(&seen, SIZE).unwrap();
            assert!(off(&found, slope) < limit, "{} with one of {spoilt} spoilt", off(&found, slope));
        }
    }

    #[test]
    fn little_changes_where_nothing_was_measured() {
        let left: Vec<Sighting> = sightings(|_, _| 0.4).into_iter().filter(|s| s.at.x < 25.0).collect();
        let found = Correction::fit(&left, SIZE).unwrap();
        let at = |x: f64| found.at(&Point2::new(x, 32.0));
        assert!(at(10.0) > 0.35 && at(45.0) < at(10.0) && at(79.0) < 0.5 * at(10.0), "{} {}", at(45.0), at(79.0));
        assert!(Correction::fit(&left[..FEWEST - 1], SIZE).is_none());
    }

    #[test]
    fn a_flatter_scene_is_not_believed() {
        let depth = hill();
        let flatten = |x: f64, y: f64| -f64::from(depth.get(x as usize, y as usize).unwrap().ln());
        let deeper = sightings(|x, y| -0.5 * flatten(x, y));
        let mut corrector = Corrector::default();
        let deepened = corrector.corrected(&depth, &deeper).unwrap();
        assert!(relief(&deepened) > 1.2 * relief(&depth));
        assert!(corrector.corrected(&depth, &sightings(flatten)).is_none());
        let later = (0..=DOUBTFUL).map(|_| corrector.corrected(&depth, &deeper).is_some());
        assert_eq!(later.filter(|believed| *believed).count(), 1);
    }

    proptest! {
        #[test]
        fn depths_stay_positive_numbers(seen in prop::collection::vec((0.0..80.0, 0.0..64.0, -5.0..5.0, 0.01..1.0), 0..60)) {
            let sighting = |&(x, y, log_ratio, sigma): &(f64, f64, f64, f64)| Sighting { at: Point2::new(x, y), log_ratio, sigma };
            let seen: Vec<Sighting> = seen.iter().map(sighting).collect();
            if let Some(depth) = Corrector::default().corrected(&hill(), &seen) {
                prop_assert!(depth.values().iter().all(|depth| depth.is_finite() && *depth > 0.0));
            }
        }
    }
}
