//! The motion between two pictures from brightness alone (docs/math.md, "Direct alignment").
//!
//! Points of a reference picture with inverse depths are moved into the current picture; the motion and an affine
//! change of brightness are those that make brightness agree, by Levenberg-Marquardt with Huber's loss from the
//! coarsest level to the finest.

use super::lens::Lens;
use super::point::{InverseDepth, Point};
use super::pyramid::{Lenses, Level, Pyramid, at_level};
use super::search::Target;
use crate::least_squares::{self, NormalEquations, Problem, Stop};
use endoscape_core::{Camera, CameraError, Grid, Image, Pose, se3};
use nalgebra::{Matrix6, SVector, Vector2, Vector3, Vector6};
use rayon::iter::{IndexedParallelIterator, IntoParallelRefMutIterator, ParallelIterator};

/// Unknowns: twist of the motion (6), logarithm of the gain, offset.
const UNKNOWNS: usize = 8;
/// Residuals beyond this many standard deviations count linearly (Huber's 95 % efficiency).
const HUBER: f64 = 1.345;
/// Residuals beyond this many standard deviations are no agreement.
const OUTLIER: f64 = 3.0;
/// Standard deviation of a pixel's place, pixels: what interpolation and a rolling or blurred picture leave.
const PLACE_SIGMA: f64 = 0.2;
const STOP: Stop = Stop { evaluations: 30, relative_decrease: 1e-4 };
/// Standard deviation of the logarithm of the gain and of the offset (grey levels) between two pictures: what keeps
/// them from explaining motion away.
const GAIN_SIGMA: f64 = 0.2;
const OFFSET_SIGMA: f64 = 20.0;

/// Affine change of brightness: `current = exp(log_gain) * reference + offset`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Brightness {
    /// Logarithm of the gain.
    pub log_gain: f64,
    /// Offset in grey levels.
    pub offset: f64,
}

impl Brightness {
    /// Brightness expected in the current picture.
    pub fn apply(&self, reference: f64) -> f64 {
        self.log_gain.exp() * reference + self.offset
    }
}

/// Where the current camera is against the reference.
#[derive(Clone, Copy, Debug)]
pub struct Alignment {
    /// Takes points of the reference camera to the current one, in the unit of the reference's depths.
    pub current_from_reference: Pose,
    /// Change of brightness.
    pub brightness: Brightness,
    /// Covariance of the twist `[v; w]` of a motion applied after [`Alignment::current_from_reference`], as far as
    /// brightness noise explains it.
    pub covariance: Matrix6<f64>,
    /// Root mean square of the residuals that agree, grey levels.
    pub residual: f64,
    /// Share of the visible points that agree.
    pub agreeing: f64,
    /// Share of all points that are visible in the current picture.
    pub visible: f64,
    /// Correlation of the visible points' brightness in both pictures, -1 to 1. Unlike the agreement, which forgives
    /// what uncertain depths may explain, it is near 0 for a picture of something else.
    pub correlation: f64,
}

impl Alignment {
    /// A guess to start from.
    pub fn guess(current_from_reference: Pose, brightness: Brightness) -> Self {
        let covariance = Matrix6::zeros();
        let residual = f64::INFINITY;
        Self { current_from_reference, brightness, covariance, residual, agreeing: 0.0, visible: 0.0, correlation: 0.0 }
    }
}

#[derive(Clone, Copy)]
struct State {
    motion: Pose,
    brightness: Brightness,
}

/// Alignment at one level.
struct LevelProblem<'a> {
    points: &'a [Point],
    /// Brightness of each point in the reference's level.
    reference: &'a [f64],
    lens: &'a Lens,
    current: &'a Level,
    noise: f64,
    /// One point of so many is looked at.
    step: usize,
}

/// One point seen in the current picture.
struct Seen {
    /// Brightness in the current picture and in the reference.
    brightness: [f64; 2],
    residual: f64,
    /// Standard deviation from noise and from the point's depth, grey levels.
    sigma: f64,
    derivative: SVector<f64, UNKNOWNS>,
}

impl LevelProblem<'_> {
    /// Points that are looked at, by their place in the list.
    fn places(&self) -> impl Iterator<Item = usize> {
        (0..self.points.len()).step_by(self.step)
    }

    /// Points that have a say.
    fn weighty(&self) -> usize {
        self.places().filter(|place| self.points[*place].weight > 0.0).count()
    }

    /// With `q = R ray + rho t` (the moved point times its inverse depth `rho`) everything stays finite for far points.
    fn see(&self, state: &State, index: usize) -> Option<Seen> {
        let (point, reference) = (&self.points[index], self.reference[index]);
        if point.weight <= 0.0 {
            return None;
        }
        let rho = point.inverse_depth.mean;
        let t = state.motion.translation.vector;
        let q = state.motion.rotation * point.ray + t * rho;
        let (pixel, pixel_by_q) = self.lens.linearise(&q)?;
        let sample = self.current.sample(&pixel)?;
        let by_q = pixel_by_q.tr_mul(&sample.gradient);
        let by_rotation = q.cross(&by_q);
        let gained = state.brightness.log_gain.exp() * reference;
        let derivative = SVector::from([
            rho * by_q.x,
            rho * by_q.y,
            rho * by_q.z,
            by_rotation.x,
            by_rotation.y,
            by_rotation.z,
            -gained,
            -1.0,
        ]);
        let by_depth = by_q.dot(&t);
        let place = PLACE_SIGMA * PLACE_SIGMA * sample.gradient.norm_squared();
        let sigma = (self.noise * self.noise + place + by_depth * by_depth * point.inverse_depth.variance).sqrt();
        let residual = sample.value - gained - state.brightness.offset;
        Some(Seen { brightness: [sample.value, reference], residual, sigma, derivative })
    }
}

impl Problem<UNKNOWNS> for LevelProblem<'_> {
    type State = State;

    /// Means over the visible points, so that losing points is no gain.
    fn linearise(&self, state: &State) -> Option<NormalEquations<UNKNOWNS>> {
        let (mut equations, mut visible) = (NormalEquations::empty(), 0_usize);
        for place in self.places() {
            let Some(Seen { residual, sigma, derivative, .. }) = self.see(state, place) else { continue };
            let size = residual.abs() / sigma;
            let huber = if size <= HUBER { 1.0 } else { HUBER / size };
            let weight = self.points[place].weight / (sigma * sigma);
            equations.add(residual, &derivative, huber * weight);
            // Huber's loss differs from the weighted square where it is linear.
            equations.cost += 0.5 * weight * residual * residual * huber * (1.0 - huber);
            visible += 1;
        }
        if visible * 5 < self.weighty() || visible < UNKNOWNS {
            return None;
        }
        let mean = 1.0 / visible as f64;
        equations.cost *= mean;
        equations.gradient *= mean;
        equations.information *= mean;
        let priors = [(6, state.brightness.log_gain, GAIN_SIGMA), (7, state.brightness.offset, OFFSET_SIGMA)];
        for (row, value, sigma) in priors {
            equations.add(value, &SVector::ith(row, 1.0), mean / (sigma * sigma));
        }
        equations.cost.is_finite().then_some(equations)
    }

    fn moved(&self, state: &State, step: &SVector<f64, UNKNOWNS>) -> State {
        let twist: Vector6<f64> = step.fixed_rows::<6>(0).into_owned();
        let mut motion = se3::exp(&twist) * state.motion;
        motion.rotation.renormalize();
        let brightness =
            Brightness { log_gain: state.brightness.log_gain + step[6], offset: state.brightness.offset + step[7] };
        State { motion, brightness }
    }
}

/// A reference picture with points of known or guessed depth, ready to be aligned to.
#[derive(Clone, Debug)]
pub struct Reference {
    /// The points.
    pub points: Vec<Point>,
    /// Brightness of each point at each level.
    brightness: Vec<Vec<f64>>,
    /// Points that are enough for a coarse level, which only leads to the next.
    coarse_points: usize,
}

impl Reference {
    /// Reads the brightness of points at every level of their picture.
    pub fn new(points: Vec<Point>, pyramid: &Pyramid, lenses: &Lenses) -> Self {
        let mut reference = Self { points, brightness: Vec::new(), coarse_points: usize::MAX };
        reference.brightness = (0..lenses.count())
            .map(|level| {
                let at = |point: &Point| pyramid.level(level).sample(&at_level(&point.pixel, level));
                reference.points.iter().map(|point| at(point).map_or(f64::NAN, |sample| sample.value)).collect()
            })
            .collect();
        reference.retain_points(|_| true);
        reference
    }

    /// About `count` points of a picture whose depth is given, at its full size.
    ///
    /// `doubt` is the standard deviation of depth as a share of it; `weights`, 0 to 1 per pixel, scales the say of each.
    /// Pixels of weight 0 or without depth (not above 0) have none.
    pub fn of_depth(
        (pyramid, lenses): (&Pyramid, &Lenses),
        (depth, doubt): (&Grid<f32>, f64),
        weights: Option<&Grid<f32>>,
        count: usize,
    ) -> Self {
        let point = |(x, y): (usize, usize)| {
            let depth = depth.get(x, y).copied().filter(|depth| *depth > 0.0 && depth.is_finite())?;
            let weight = weights.map_or(1.0, |weights| f64::from(*weights.get(x, y).unwrap_or(&0.0)));
            let mean = 1.0 / f64::from(depth);
            let known = InverseDepth { mean, variance: (doubt * mean).powi(2) };
            let point = Point::new(pyramid.level(0), lenses.level(0), Vector2::new(x as f64, y as f64), known)?;
            (weight > 0.0).then_some(Point { weight, ..point })
        };
        let points = super::point::select(pyramid, count).into_iter().filter_map(point).collect();
        Self { coarse_points: COARSE_POINTS, ..Self::new(points, pyramid, lenses) }
    }

    /// Keeps the points that `keep` accepts and that every level can show.
    pub fn retain_points(&mut self, keep: impl Fn(&Point) -> bool) {
        let shown = |index: usize| self.brightness.iter().all(|level| level[index].is_finite());
        let kept: Vec<bool> = (0..self.points.len()).map(|i| shown(i) && keep(&self.points[i])).collect();
        let mut flags = kept.iter();
        self.points.retain(|_| flags.next().is_some_and(|kept| *kept));
        for level in &mut self.brightness {
            let mut flags = kept.iter();
            level.retain(|_| flags.next().is_some_and(|kept| *kept));
        }
    }

    /// Lets a picture whose motion is known say how deep the points are; those that it shows too little moved, or not
    /// clearly, stay as they are. `alignment` has the motion and the change of brightness, `noise` is the standard
    /// deviation of brightness between the pictures, grey levels.
    pub fn observe(&mut self, current: &Pyramid, lenses: &Lenses, alignment: &Alignment, noise: f64) {
        let (level, lens) = (current.level(0), lenses.level(0));
        let (motion, brightness) = (alignment.current_from_reference, alignment.brightness);
        let target = Target { level, lens, motion, brightness, noise };
        self.points.par_iter_mut().with_min_len(POINTS_PER_TASK).for_each(|point| point.observe(target.search(point)));
    }

    /// Finds the motion to a current picture near a guess.
    ///
    /// `noise` is the standard deviation of brightness between the pictures, grey levels. `None` where too few points
    /// are visible.
    pub fn align(&self, current: &Pyramid, lenses: &Lenses, guess: &Alignment, noise: f64) -> Option<Alignment> {
        let problem = |level: usize| LevelProblem {
            points: &self.points,
            reference: &self.brightness[level],
            lens: lenses.level(level),
            current: current.level(level),
            noise,
            step: if level == 0 { 1 } else { (self.points.len() / self.coarse_points).clamp(1, 1 << level) },
        };
        let mut state = State { motion: guess.current_from_reference, brightness: guess.brightness };
        let mut information = None;
        for level in (0..lenses.count()).rev() {
            let minimum = least_squares::minimise(&problem(level), state, STOP)?;
            (state, information) = (minimum.state, Some(minimum.equations.information));
        }
        summarise(&problem(0), &state, &information?)
    }
}

fn summarise(
    problem: &LevelProblem<'_>,
    state: &State,
    information: &nalgebra::SMatrix<f64, 8, 8>,
) -> Option<Alignment> {
    let seen: Vec<Seen> = problem.places().filter_map(|place| problem.see(state, place)).collect();
    let agree: Vec<f64> = seen.iter().filter(|s| s.residual.abs() < OUTLIER * s.sigma).map(|s| s.residual).collect();
    let visible = seen.len().max(1) as f64;
    let covariance = least_squares::covariance(&(information * visible))?;
    Some(Alignment {
        current_from_reference: state.motion,
        brightness: state.brightness,
        covariance: covariance.fixed_view::<6, 6>(0, 0).into_owned(),
        residual: (agree.iter().map(|r| r * r).sum::<f64>() / agree.len().max(1) as f64).sqrt(),
        agreeing: agree.len() as f64 / visible,
        visible: visible / problem.weighty().max(1) as f64,
        correlation: correlation(&seen),
    })
}

/// Pearson's correlation of brightness in the two pictures; 0 where one of them is of one brightness.
fn correlation(seen: &[Seen]) -> f64 {
    let count = seen.len().max(1) as f64;
    let mean = |which: usize| seen.iter().map(|s| s.brightness[which]).sum::<f64>() / count;
    let means = [mean(0), mean(1)];
    let moment = |a: usize, b: usize| {
        seen.iter().map(|s| (s.brightness[a] - means[a]) * (s.brightness[b] - means[b])).sum::<f64>() / count
    };
    let spread = (moment(0, 0) * moment(1, 1)).sqrt();
    if spread > f64::EPSILON { moment(0, 1) / spread } else { 0.0 }
}

/// Aligns two pictures of one camera near a guess, given the depth of the first: the building block for other methods.
/// [`Reference`] is the same in steps, for pictures that are compared more than once.
///
/// `weights` as in [`Reference::of_depth`]; about `count` pixels are used. `None` where too few of them are visible.
///
/// # Errors
/// [`CameraError`] for a camera that cannot be halved.
pub fn align(
    reference: (&Image, &Grid<f32>, Option<&Grid<f32>>),
    current: &Image,
    camera: &Camera,
    guess: &Pose,
    count: usize,
) -> Result<Option<Alignment>, CameraError> {
    let (image, depth, weights) = reference;
    let lenses = Lenses::new(camera, 6)?;
    let pyramid = Pyramid::new(image, None, &lenses);
    let reference = Reference::of_depth((&pyramid, &lenses), (depth, DEPTH_DOUBT), weights, count);
    let current = Pyramid::new(current, None, &lenses);
    let guess = Alignment::guess(*guess, Brightness::default());
    Ok(reference.align(&current, &lenses, &guess, super::BRIGHTNESS_NOISE))
}

/// Points whose depth is searched by one task: enough to be worth the handing over.
const POINTS_PER_TASK: usize = 64;

/// Points of given depth that are enough for a coarse level.
const COARSE_POINTS: usize = 200;

/// Standard deviation of a depth given to [`align`], as a share of it.
const DEPTH_DOUBT: f64 = 0.02;

/// The point at inverse depth `rho` on a ray, moved and multiplied by `rho`.
pub fn moved_ray(motion: &Pose, ray: &Vector3<f64>, rho: f64) -> Vector3<f64> {
    motion.rotation * ray + motion.translation.vector * rho
}
