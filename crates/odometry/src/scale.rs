//! One unit of length over the whole sequence.
//!
//! The depth network answers every frame on its own, so its unit wanders from frame to frame. Two frames that see the
//! same surface tell how much: with `z` the depth a pixel of frame a should have in frame b after the motion between
//! them, and `D_b` what the network says there,
//!
//! ```text
//! r     = median over reliable pixels of z / D_b          ratio
//! ln s_b = m (ln s_a + ln r)                              Scale::next, m = scale_memory
//! ```
//!
//! and `s_b D_b`, `s_b t` are depth and translation in the unit of the first frame. `m` just below 1 lets go of the
//! past slowly, because the errors of a chain of ratios add up without bound. The idea of comparing depths that two
//! frames give of one point is that of Bian et al., NeurIPS 2019, section 3.2, at work instead of in training.

use crate::reproject::{Moved, bilinear};
use endoscape_core::Grid;

/// Fewer pixels than this share of those compared say nothing.
const LEAST_SHARE: f64 = 0.1;
/// Fewer pixels than this say nothing, however small the picture.
const LEAST_PIXELS: usize = 50;
/// Median absolute deviation of the logarithms beyond which the depths do not show the same surface: a factor of 1.5.
const WIDEST_SPREAD: f64 = 0.405;
/// A unit does not double between two frames; such a ratio is a mismatch.
const LARGEST_STEP: f64 = std::f64::consts::LN_2;
/// The unit never leaves a factor of four to both sides of the networks' own.
const LARGEST_LOG: f64 = 2.0 * std::f64::consts::LN_2;

/// How many times larger the unit of `depth` is than that of the depths in `moved`; `None` where too little can be compared.
///
/// `counts` says which pixels of the frame that `moved` comes from may be compared, and `compared` how many there were
/// before some left the picture.
pub fn ratio(moved: &[Moved], depth: &Grid<f32>, counts: impl Fn(usize) -> bool, compared: usize) -> Option<f64> {
    let log_ratio = |pixel: &Moved| {
        let predicted = bilinear(depth, &pixel.to).filter(|depth| depth.is_finite() && *depth > 0.0)?;
        Some((pixel.depth / predicted).ln()).filter(|log| log.is_finite())
    };
    let mut logs: Vec<f64> = moved.iter().filter(|pixel| counts(pixel.from)).filter_map(log_ratio).collect();
    if logs.len() < LEAST_PIXELS || (logs.len() as f64) < LEAST_SHARE * compared as f64 {
        return None;
    }
    let middle = median(&mut logs)?;
    let mut deviations: Vec<f64> = logs.iter().map(|log| (log - middle).abs()).collect();
    let spread = median(&mut deviations)?;
    (spread <= WIDEST_SPREAD && middle.abs() <= LARGEST_STEP).then(|| middle.exp())
}

fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// The factor that takes depths and translations of one frame to the unit of the sequence.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Scale {
    log: f64,
}

impl Scale {
    /// The factor `s`.
    pub fn factor(self) -> f64 {
        self.log.exp()
    }

    /// The scale of a frame whose own unit is `ratio` times larger than this one's; without a ratio the unit is taken to be the same.
    pub fn next(self, ratio: Option<f64>, memory: f64) -> Self {
        let log = memory * (self.log + ratio.map_or(0.0, f64::ln));
        Self { log: if log.is_finite() { log.clamp(-LARGEST_LOG, LARGEST_LOG) } else { self.log } }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reproject::{LATTICE, Reprojector};
    use endoscape_core::{Camera, Pose, Size};
    use proptest::prelude::*;

    const SIZE: Size = Size::new(80, 64);

    /// Depth of the wall `z = 3 + x / 2` seen from `forward_m` along the axis.
    fn wall(reprojector: &Camera, forward_m: f64) -> Grid<f32> {
        Grid::from_fn(SIZE, |x, y| {
            let ray = reprojector.unproject(&nalgebra::Point2::new(x as f64, y as f64)).unwrap();
            let slope = 0.5 * ray.x / ray.z;
            ((3.0 - forward_m) / (1.0 - slope)) as f32
        })
    }

    fn camera() -> Camera {
        Camera::from_field_of_view(SIZE, 1.0).unwrap()
    }

    /// Two views of the wall, the second in a unit `drift` times larger.
    fn measured(drift: f32, spoil: impl Fn(usize) -> bool) -> Option<f64> {
        let lattice = Reprojector::new(&camera(), SIZE, LATTICE).unwrap();
        let moved = lattice.reproject(&wall(&camera(), 0.0), &Pose::translation(0.0, 0.0, -0.4));
        let mut second = wall(&camera(), 0.4).map(|depth| depth / drift);
        let spoilt = second.values_mut().iter_mut().enumerate().filter(|(index, _)| spoil(*index));
        spoilt.for_each(|(index, depth)| *depth *= if index % 2 == 0 { 30.0 } else { f32::NAN });
        ratio(&moved, &second, |_| true, lattice.len())
    }

    #[test]
    fn a_known_drift_is_found_also_among_outliers() {
        for drift in [0.6, 0.9, 1.0, 1.1, 1.8] {
            for spoil in [0, 7, 3] {
                let found = measured(drift, |index| spoil > 0 && (index / 5) % spoil == 0).unwrap();
                assert!((found / f64::from(drift) - 1.0).abs() < 0.02, "{found} instead of {drift}");
            }
        }
    }

    #[test]
    fn what_cannot_be_compared_is_left_alone() {
        assert_eq!(measured(1.2, |_| true), None);
        assert_eq!(measured(3.0, |_| false), None);
        assert_eq!(ratio(&[], &wall(&camera(), 0.0), |_| true, 100), None);
        let lattice = Reprojector::new(&camera(), SIZE, LATTICE).unwrap();
        let moved = lattice.reproject(&wall(&camera(), 0.0), &Pose::identity());
        assert_eq!(ratio(&moved, &wall(&camera(), 0.0), |_| false, lattice.len()), None);
        let noise = Grid::from_fn(SIZE, |x, y| ((37 * x + 91 * y) % 97) as f32 + 0.1);
        assert_eq!(ratio(&moved, &noise, |_| true, lattice.len()), None);
    }

    #[test]
    fn a_steady_drift_is_followed_and_then_forgotten() {
        // Every frame's unit is 2 % larger than the one before: a chain without memory loss follows it exactly.
        let follow = |memory: f64| (0..20).fold(Scale::default(), |scale, _| scale.next(Some(1.02), memory)).factor();
        assert!((follow(1.0) - 1.02_f64.powi(20)).abs() < 1e-9);
        assert!(follow(0.98) > 1.25 && follow(0.98) < follow(1.0));
        assert_eq!(follow(0.0), 1.0);
        let settled = (0..34).fold(Scale { log: 1.0 }, |scale, _| scale.next(None, 0.98));
        assert!((settled.log - 0.5).abs() < 0.01);
    }

    proptest! {
        #[test]
        fn the_scale_is_bounded_whatever_comes(ratios in prop::collection::vec(prop::num::f64::ANY, 1..60)) {
            let scale = ratios.into_iter().fold(Scale::default(), |scale, ratio| scale.next(Some(ratio), 0.98));
            prop_assert!((0.2499..=4.0001).contains(&scale.factor()));
        }
    }
}
