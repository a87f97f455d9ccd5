//! Where to start without a previous position: a grid of positions, at each of which the moment is a linear fit.

use super::fit::{FieldPrior, MagnetState};
use super::measurement::Measurement;
use crate::least_squares::{self, NormalEquations};
use endoscape_core::magnetic::{Dipole, HallArray};
use nalgebra::{Point3, SVector, UnitVector3, Vector3};

/// Positions across the array in each direction.
const ACROSS: usize = 5;
/// Heights above the array, metres: closely spaced near it, where the field changes fastest.
const HEIGHTS_M: [f64; 6] = [0.02, 0.04, 0.065, 0.1, 0.15, 0.22];
/// Rounds of reweighting that turn the linear fit into one of absolute residuals, which a few broken sensors cannot
/// capture.
const ROUNDS: usize = 4;

/// The `count` most promising states, best first.
///
/// A state's worth is the misfit of its linear moment, plus how far the moment's strength is from the magnet's.
pub fn starts(
    measurements: &[Measurement],
    array: &HallArray,
    prior: &FieldPrior,
    moment_a_m2: f64,
    count: usize,
) -> Vec<MagnetState> {
    let mut found: Vec<(f64, MagnetState)> = positions(array)
        .filter_map(|position_m| linear_state(measurements, position_m, prior, moment_a_m2, array.noise_tesla))
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.into_iter().take(count).map(|(_, state)| state).collect()
}

/// A grid over the array and a margin of half its extent.
fn positions(array: &HallArray) -> impl Iterator<Item = Point3<f64>> + use<> {
    let extent = |axis: usize| {
        let values = || array.positions_m.iter().map(move |position| position[axis]);
        let (low, high) = (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
        let margin = 0.5 * (high - low) + 0.02;
        (low - margin, high + margin)
    };
    let (x, y, base_m) =
        (extent(0), extent(1), array.positions_m.iter().fold(f64::NEG_INFINITY, |top, p| top.max(p[2])));
    let at = |(low, high): (f64, f64), index: usize| low + (high - low) * index as f64 / (ACROSS as f64 - 1.0);
    let columns = (0..ACROSS).flat_map(move |i| (0..ACROSS).map(move |j| (at(x, i), at(y, j))));
    columns.flat_map(move |(x, y)| HEIGHTS_M.iter().map(move |height_m| Point3::new(x, y, base_m + height_m)))
}

/// Fits moment and uniform field at a position by reweighted linear least squares.
fn linear_state(
    measurements: &[Measurement],
    position_m: Point3<f64>,
    prior: &FieldPrior,
    moment_a_m2: f64,
    noise_tesla: f64,
) -> Option<(f64, MagnetState)> {
    let mut unknowns = SVector::<f64, 6>::zeros();
    let mut misfit = f64::INFINITY;
    let rows: Vec<_> = linear_rows(measurements, &position_m, prior, noise_tesla).collect();
    for round in 0..ROUNDS {
        let (mut equations, mut absolute) = (NormalEquations::<6>::empty(), 0.0);
        for (derivative, value) in &rows {
            let residual = derivative.dot(&unknowns) - value;
            absolute += residual.abs();
            let weight = if round == 0 { 1.0 } else { 1.0 / residual.abs().max(1.0) };
            equations.add(residual, derivative, weight);
        }
        unknowns -= least_squares::covariance(&equations.information)? * equations.gradient;
        misfit = absolute;
    }
    let moment = unknowns.fixed_rows::<3>(0).into_owned();
    let heading = UnitVector3::try_new(moment, f64::MIN_POSITIVE)?;
    let field_tesla = prior.mean_tesla + unknowns.fixed_rows::<3>(3);
    // A moment off by a factor costs as much as the field it would add.
    let strength = (moment.norm() / moment_a_m2).ln().abs();
    Some((misfit * (1.0 + strength), MagnetState { position_m, heading, field_tesla }))
}

/// Rows of the linear problem in (moment, deviation of the uniform field), whitened; the prior's last.
fn linear_rows<'a>(
    measurements: &'a [Measurement],
    position_m: &'a Point3<f64>,
    prior: &'a FieldPrior,
    noise_tesla: f64,
) -> impl Iterator<Item = (SVector<f64, 6>, f64)> + 'a {
    let row = |m: Vector3<f64>, f: Vector3<f64>| SVector::from([m.x, m.y, m.z, f.x, f.y, f.z]);
    let measured = measurements.iter().flat_map(move |measurement| {
        let per_moment = Dipole::field_per_moment(&(measurement.at_m - position_m));
        measurement.components.iter().map(move |(axis, value)| {
            let value = value - axis.dot(&prior.mean_tesla);
            (row(per_moment * axis / noise_tesla, axis / noise_tesla), value / noise_tesla)
        })
    });
    let priors = (0..3)
        .map(move |i| (row(Vector3::zeros(), Vector3::ith(i, 1.0 / prior.covariance_tesla2[(i, i)].sqrt())), 0.0));
    measured.chain(priors)
}
