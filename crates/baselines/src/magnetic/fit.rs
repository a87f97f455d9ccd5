//! Position and heading of a magnet, and a uniform disturbing field, from one reading (docs/math.md, "Magnetic
//! localisation").

use super::measurement::Measurement;
use crate::least_squares::{self, Minimum, NormalEquations, Problem, Stop};
use endoscape_core::magnetic::Dipole;
use nalgebra::{Matrix3, Matrix3x2, Matrix5, Point3, SVector, UnitVector3, Vector3};

/// Unknowns: position (3), heading on the sphere (2), uniform field (3).
pub const UNKNOWNS: usize = 8;
/// A step may lower the cost by less than this share of it and still be taken for noise in the last digits.
const STOP: Stop = Stop { evaluations: 60, relative_decrease: 1e-14 };
/// Residuals beyond this many standard deviations lose weight while outliers are not yet known (Cauchy's weight, 95 %
/// efficiency for Gaussian noise: P. Huber, "Robust statistics", 1981).
const CAUCHY_SCALE: f64 = 2.385;

/// What is known of the uniform field before a reading.
#[derive(Clone, Copy, Debug)]
pub struct FieldPrior {
    /// Expected field, tesla.
    pub mean_tesla: Vector3<f64>,
    /// Its covariance, tesla squared.
    pub covariance_tesla2: Matrix3<f64>,
}

/// A magnet of known strength somewhere, in a uniform field.
#[derive(Clone, Copy, Debug)]
pub struct MagnetState {
    /// Position in the array's frame, metres.
    pub position_m: Point3<f64>,
    /// Direction of the moment in the array's frame.
    pub heading: UnitVector3<f64>,
    /// Uniform disturbing field, tesla.
    pub field_tesla: Vector3<f64>,
}

impl MagnetState {
    /// Two unit vectors across the heading; the heading's covariance refers to them.
    pub fn tangents(&self) -> Matrix3x2<f64> {
        tangents(&self.heading)
    }
}

/// Two unit vectors that are perpendicular to a direction and to each other.
pub fn tangents(direction: &UnitVector3<f64>) -> Matrix3x2<f64> {
    // The axis least along the direction is safely not parallel to it.
    let least = direction.iamin();
    let first = direction.cross(&Vector3::ith(least, 1.0)).normalize();
    Matrix3x2::from_columns(&[first, direction.cross(&first)])
}

/// Result of one fit.
#[derive(Clone, Debug)]
pub struct Fit {
    /// The best state.
    pub state: MagnetState,
    /// Covariance of position (m) and heading (rad, along [`MagnetState::tangents`]).
    pub covariance: Matrix5<f64>,
    /// What the next reading may expect of the uniform field.
    pub field: FieldPrior,
    /// Sum of squared residuals of the sensors kept, in standard deviations.
    pub chi_squared: f64,
    /// Components kept.
    pub measurements: usize,
    /// Sensors refused as outliers.
    pub outliers: usize,
}

impl Fit {
    /// Squared residual per degree of freedom; near 1 where model and noise are right.
    pub fn reduced_chi_squared(&self) -> f64 {
        self.chi_squared / (self.measurements as f64 - 5.0).max(1.0)
    }
}

struct DipoleProblem<'a> {
    measurements: &'a [Measurement],
    moment_a_m2: f64,
    noise_tesla: f64,
    prior: FieldPrior,
    prior_information: Matrix3<f64>,
    robust: bool,
}

impl DipoleProblem<'_> {
    /// The same problem over sensors that are believed, so without the robust loss.
    const fn least_squares_over<'a>(&self, measurements: &'a [Measurement]) -> DipoleProblem<'a> {
        let Self { moment_a_m2, noise_tesla, prior, prior_information, .. } = *self;
        DipoleProblem { measurements, moment_a_m2, noise_tesla, prior, prior_information, robust: false }
    }

    /// Whitened residual of one component with its derivative by the eight unknowns.
    fn residuals<'m>(
        &self,
        state: &MagnetState,
        measurement: &'m Measurement,
    ) -> impl Iterator<Item = (f64, SVector<f64, UNKNOWNS>)> + use<'m> {
        let dipole =
            Dipole { position_m: state.position_m, moment_a_m2: state.heading.into_inner() * self.moment_a_m2 };
        let field = dipole.field_tesla(&measurement.at_m) + state.field_tesla;
        let by_position = -dipole.field_gradient(&measurement.at_m);
        let per_moment = Dipole::field_per_moment(&(measurement.at_m - state.position_m));
        let by_heading = per_moment * tangents(&state.heading) * self.moment_a_m2;
        let noise = self.noise_tesla;
        measurement.components.iter().map(move |(axis, value)| {
            let (p, u) = (by_position.tr_mul(axis), by_heading.tr_mul(axis));
            let derivative = [p.x, p.y, p.z, u.x, u.y, axis.x, axis.y, axis.z];
            ((axis.dot(&field) - value) / noise, SVector::from(derivative) / noise)
        })
    }

    fn chi_squared(&self, state: &MagnetState, measurement: &Measurement) -> f64 {
        self.residuals(state, measurement).map(|(residual, _)| residual * residual).sum()
    }
}

impl Problem<UNKNOWNS> for DipoleProblem<'_> {
    type State = MagnetState;

    fn linearise(&self, state: &MagnetState) -> Option<NormalEquations<UNKNOWNS>> {
        let mut equations = NormalEquations::empty();
        for (residual, derivative) in self.measurements.iter().flat_map(|m| self.residuals(state, m)) {
            let weight = if self.robust { 1.0 / (1.0 + (residual / CAUCHY_SCALE).powi(2)) } else { 1.0 };
            equations.add(residual, &derivative, weight);
            if self.robust {
                // The weight belongs to the derivative of Cauchy's loss; the cost is the loss itself.
                let squared = residual * residual;
                let loss = CAUCHY_SCALE.powi(2) * (squared / CAUCHY_SCALE.powi(2)).ln_1p();
                equations.cost += 0.5 * (loss - weight * squared);
            }
        }
        let off = state.field_tesla - self.prior.mean_tesla;
        let pull = self.prior_information * off;
        equations.cost += 0.5 * off.dot(&pull);
        for row in 0..3 {
            equations.gradient[5 + row] += pull[row];
            for column in 0..3 {
                equations.information[(5 + row, 5 + column)] += self.prior_information[(row, column)];
            }
        }
        equations.cost.is_finite().then_some(equations)
    }

    fn moved(&self, state: &MagnetState, step: &SVector<f64, UNKNOWNS>) -> MagnetState {
        let turn = state.tangents() * step.fixed_rows::<2>(3);
        MagnetState {
            position_m: state.position_m + step.fixed_rows::<3>(0),
            heading: UnitVector3::new_normalize(state.heading.into_inner() + turn),
            field_tesla: state.field_tesla + step.fixed_rows::<3>(5),
        }
    }
}

/// What does not change from reading to reading.
#[derive(Clone, Copy, Debug)]
pub struct FitConfig {
    /// Strength of the magnet, A m^2.
    pub moment_a_m2: f64,
    /// Standard deviation of a component, tesla.
    pub noise_tesla: f64,
    /// A sensor whose squared residual, in standard deviations and per component, is beyond this is an outlier.
    pub outlier_chi_squared: f64,
}

/// Fits a magnet to measurements, starting from `start`: first with a robust loss, then by least squares over the
/// sensors that agree, so that the covariance is that of Gaussian noise. `None` where less agrees than five unknowns
/// need, or the magnet runs away.
pub fn fit(measurements: &[Measurement], start: MagnetState, prior: FieldPrior, config: &FitConfig) -> Option<Fit> {
    let prior_information = least_squares::covariance(&prior.covariance_tesla2)?;
    let FitConfig { moment_a_m2, noise_tesla, .. } = *config;
    let robust = DipoleProblem { measurements, moment_a_m2, noise_tesla, prior, prior_information, robust: true };
    let mut state = least_squares::minimise(&robust, start, STOP)?.state;
    let mut kept: Vec<Measurement> = Vec::new();
    // Refusing a sensor moves the magnet, which may free or convict others; three rounds settle it.
    for _ in 0..3 {
        let agrees =
            |m: &&Measurement| robust.chi_squared(&state, m) <= config.outlier_chi_squared * m.components.len() as f64;
        let agreeing: Vec<Measurement> = measurements.iter().filter(agrees).cloned().collect();
        let settled = agreeing.len() == kept.len();
        kept = agreeing;
        if settled {
            break;
        }
        state = least_squares::minimise(&robust.least_squares_over(&kept), state, STOP)?.state;
    }
    let last = robust.least_squares_over(&kept);
    let minimum = least_squares::minimise(&last, state, STOP)?;
    summarise(&last, &minimum, measurements.len() - kept.len())
}

fn summarise(problem: &DipoleProblem<'_>, minimum: &Minimum<MagnetState, UNKNOWNS>, outliers: usize) -> Option<Fit> {
    let measurements: usize = problem.measurements.iter().map(|m| m.components.len()).sum();
    if measurements < 5 {
        return None;
    }
    let covariance = least_squares::covariance(&minimum.equations.information)?;
    let state = minimum.state;
    Some(Fit {
        state,
        covariance: covariance.fixed_view::<5, 5>(0, 0).into_owned(),
        field: FieldPrior {
            mean_tesla: state.field_tesla,
            covariance_tesla2: covariance.fixed_view::<3, 3>(5, 5).into_owned(),
        },
        chi_squared: problem.measurements.iter().map(|m| problem.chi_squared(&state, m)).sum(),
        measurements,
        outliers,
    })
}
