//! Levenberg-Marquardt on manifolds, for few unknowns and many residuals.
//!
//! A [`Problem`] gives its normal equations at a state and moves a state by a step; everything else is here. Damping
//! scales the diagonal (Marquardt 1963), so unknowns of different units need no scaling by hand, and follows the gain
//! ratio as in H. B. Nielsen, "Damping parameter in Marquardt's method" (1999).

use nalgebra::{SMatrix, SVector};

/// What a least-squares problem of `N` unknowns must answer.
pub trait Problem<const N: usize> {
    /// A point of the manifold that is searched.
    type State: Clone;

    /// Cost and its quadratic model at a state; `None` where the problem has no value.
    fn linearise(&self, state: &Self::State) -> Option<NormalEquations<N>>;

    /// The state a tangent step away.
    fn moved(&self, state: &Self::State, step: &SVector<f64, N>) -> Self::State;
}

/// `cost(step) ~ cost + gradient . step + step^T information step / 2`.
#[derive(Clone, Debug)]
pub struct NormalEquations<const N: usize> {
    /// Half the sum (or mean) of squared, weighted residuals.
    pub cost: f64,
    /// `J^T W r`.
    pub gradient: SVector<f64, N>,
    /// `J^T W J`.
    pub information: SMatrix<f64, N, N>,
}

impl<const N: usize> NormalEquations<N> {
    /// No residuals yet.
    pub fn empty() -> Self {
        Self { cost: 0.0, gradient: SVector::zeros(), information: SMatrix::zeros() }
    }

    /// Adds one residual with its derivative and weight.
    pub fn add(&mut self, residual: f64, derivative: &SVector<f64, N>, weight: f64) {
        self.cost += 0.5 * weight * residual * residual;
        self.gradient.axpy(weight * residual, derivative, 1.0);
        self.information.ger(weight, derivative, derivative, 1.0);
    }
}

/// When to stop.
#[derive(Clone, Copy, Debug)]
pub struct Stop {
    /// Most evaluations of the problem.
    pub evaluations: usize,
    /// Smallest decrease of the cost, as a share of it, that is worth another step.
    pub relative_decrease: f64,
}

/// Where the search ended.
#[derive(Clone, Debug)]
pub struct Minimum<S, const N: usize> {
    /// The best state seen.
    pub state: S,
    /// The problem there.
    pub equations: NormalEquations<N>,
}

/// Starting damping as a share of the diagonal.
const FIRST_DAMPING: f64 = 1e-4;
/// Damping at which no step helps any more.
const LARGEST_DAMPING: f64 = 1e8;

/// Searches the minimum near `start`; `None` if the problem has no value there.
pub fn minimise<const N: usize, P: Problem<N>>(
    problem: &P,
    start: P::State,
    stop: Stop,
) -> Option<Minimum<P::State, N>> {
    let mut best = Minimum { equations: problem.linearise(&start)?, state: start };
    let (mut damping, mut growth) = (FIRST_DAMPING, 2.0);
    for _ in 1..stop.evaluations {
        let Some(step) = damped_step(&best.equations, damping) else { break };
        let predicted = predicted_decrease(&best.equations, &step);
        if predicted <= stop.relative_decrease * best.equations.cost {
            break;
        }
        let state = problem.moved(&best.state, &step);
        let tried = problem.linearise(&state).filter(|tried| tried.cost < best.equations.cost);
        if let Some(equations) = tried {
            let gain = (best.equations.cost - equations.cost) / predicted;
            damping *= (1.0 - (2.0 * gain - 1.0).powi(3)).max(1.0 / 3.0);
            growth = 2.0;
            best = Minimum { state, equations };
        } else {
            damping *= growth;
            growth *= 2.0;
        }
        if damping > LARGEST_DAMPING {
            break;
        }
    }
    Some(best)
}

/// Solves `(H + damping diag H) step = -gradient`; `None` where H is singular or not finite.
fn damped_step<const N: usize>(equations: &NormalEquations<N>, damping: f64) -> Option<SVector<f64, N>> {
    // Scaled to a unit diagonal first: the unknowns may differ by ten orders of magnitude.
    let scale = equations.information.diagonal().map(|d| if d > 0.0 { 1.0 / d.sqrt() } else { 0.0 });
    let mut scaled = equations.information.component_mul(&(scale * scale.transpose()));
    for i in 0..N {
        scaled[(i, i)] = 1.0 + damping;
    }
    let step = scaled.cholesky()?.solve(&equations.gradient.component_mul(&scale)).component_mul(&scale);
    step.iter().all(|x| x.is_finite()).then_some(-step)
}

fn predicted_decrease<const N: usize>(equations: &NormalEquations<N>, step: &SVector<f64, N>) -> f64 {
    -(equations.gradient.dot(step) + 0.5 * step.dot(&(equations.information * step)))
}

/// The inverse of an information matrix; `None` where some direction is unknown.
pub fn covariance<const N: usize>(information: &SMatrix<f64, N, N>) -> Option<SMatrix<f64, N, N>> {
    let scale = information.diagonal().map(|d| 1.0 / d.sqrt());
    let scale = scale * scale.transpose();
    let inverse = information.component_mul(&scale).cholesky()?.inverse().component_mul(&scale);
    inverse.iter().all(|x| x.is_finite()).then_some(inverse)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Vector2};

    /// Rosenbrock's valley (1960) with its second unknown in units a million times smaller.
    struct Valley;

    impl Problem<2> for Valley {
        type State = Vector2<f64>;

        fn linearise(&self, state: &Self::State) -> Option<NormalEquations<2>> {
            let (x, y) = (state.x, state.y * 1e-6);
            let mut equations = NormalEquations::empty();
            equations.add(10.0 * (y - x * x), &Vector2::new(-20.0 * x, 1e-5), 1.0);
            equations.add(1.0 - x, &Vector2::new(-1.0, 0.0), 1.0);
            Some(equations)
        }

        fn moved(&self, state: &Self::State, step: &Vector2<f64>) -> Self::State {
            state + step
        }
    }

    #[test]
    fn the_valley_is_followed_to_its_end() {
        let stop = Stop { evaluations: 100, relative_decrease: 0.0 };
        let minimum = minimise(&Valley, Vector2::new(-1.2, 1e6), stop).unwrap();
        assert!((minimum.state - Vector2::new(1.0, 1e6)).component_div(&Vector2::new(1.0, 1e6)).amax() < 1e-9);
    }

    #[test]
    fn an_unknown_direction_has_no_covariance() {
        assert!(covariance(&Matrix2::new(1.0, 0.0, 0.0, 0.0)).is_none());
        let inverse = covariance(&Matrix2::new(4e12, 0.0, 0.0, 0.25)).unwrap();
        assert!((inverse[(0, 0)] * 4e12 - 1.0).abs() < 1e-12 && (inverse[(1, 1)] - 4.0).abs() < 1e-12);
    }
}
