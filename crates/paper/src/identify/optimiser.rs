//! The optimisers, all from the crate `basin`; no other module uses it.

use std::cell::Cell;
use std::convert::Infallible;

use basin::{
    BoxBounds, Constrained, ConstraintSet, CostFunction, DenseMatrix, Executor, Gradient, Jacobian,
    LinearBlock, PointState, Residual, SelectedFirstOrderState, Slsqp, State,
    TrustRegionReflective,
};
use nalgebra::{DMatrix, DVector};

use super::fit::{Derivatives, Fit, mean_square};
use super::parameter::Inequality;

/// Largest number of rounds of sequential quadratic programming.
const ROUNDS_MAX: u32 = 30;
/// Iterations of one round. With more, BFGS would have to learn the curvature that new coordinates contain.
const ITERATIONS_PER_ROUND: u64 = 3;
/// Smallest relative progress of a round; with less, the search ends. One sample of thousands has far more weight.
const PROGRESS_MIN: f64 = 1e-6;
/// Smallest singular value that scales a direction, relative to the largest. It bounds steps in poorly determined
/// directions.
const SCALE_MIN: f64 = 1e-8;
/// Accuracy of a round, relative to its first cost.
const ACCURACY: f64 = 1e-9;
/// Smallest divisor of costs, a mean square in m²: that of a nanometre.
const MEAN_SQUARE_MIN: f64 = 1e-18;
/// Smallest relative progress of an iteration of the second optimiser: a tenth of a standard error changes the cost by a hundredth
/// of one sample's, of which there are thousands.
const CHECK_PROGRESS_MIN: f64 = 1e-8;
/// Largest number of iterations of the second optimiser.
const CHECK_ITERATIONS_MAX: u64 = 60;

/// Result of an optimiser.
#[derive(Clone, Debug)]
pub struct Optimum {
    /// Values of the parameters.
    pub values: Vec<f64>,
    /// Mean square of the residual in m².
    pub mean_square: f64,
    /// Number of steps.
    pub iterations: u64,
    /// Whether further steps would not have lowered the mean square.
    pub has_converged: bool,
}

/// Callback for every gradient: number of the iteration, RMS of the residual in metres.
pub type OnIteration<'a> = &'a dyn Fn(u64, f64);

/// Runs sequential quadratic programming (Kraft's SLSQP) with bounds and order, in rounds. Each round has its own
/// coordinates, in which the Gauss-Newton approximation of the Hessian is the identity, because BFGS alone is slow in
/// the long valleys of this problem. Bounds and order are linear in any coordinates. A round without a result ends the
/// search where it is. It returns `None` for an invalid start.
pub fn sequential_quadratic_programming(
    fit: &Fit<'_>,
    start: &[f64],
    progress: OnIteration<'_>,
) -> Option<Optimum> {
    let mut best = Optimum {
        values: start.to_vec(),
        mean_square: mean_square(&fit.residual_metres(start)?),
        iterations: 0,
        has_converged: false,
    };
    for _ in 0..ROUNDS_MAX {
        let Some(round) = round(fit, &best, progress) else {
            break;
        };
        let gain = best.mean_square - round.mean_square;
        let iterations = best.iterations + round.iterations;
        let has_converged = gain <= PROGRESS_MIN * best.mean_square;
        let better = if gain > 0.0 { round } else { best };
        best = Optimum {
            iterations,
            has_converged,
            ..better
        };
        if has_converged {
            break;
        }
    }
    Some(best)
}

fn round(fit: &Fit<'_>, from: &Optimum, progress: OnIteration<'_>) -> Option<Optimum> {
    let coordinates = Coordinates::new(fit, from)?;
    let constraints = ConstraintSet::new().with_linear_inequalities(coordinates.constraints(fit));
    let problem = Round {
        fit,
        coordinates: &coordinates,
        progress,
        iterations: Cell::new(from.iterations),
    };
    let result = Executor::new(
        Constrained::new(problem, constraints),
        Slsqp::new().with_absolute_accuracy_tolerance(ACCURACY),
        SelectedFirstOrderState::new(vec![0.0; from.values.len()]),
    )
    .max_iter(ITERATIONS_PER_ROUND)
    .run()
    .ok()?;
    let values = coordinates.values(fit, result.state.param());
    Some(Optimum {
        mean_square: mean_square(&fit.residual_metres(&values)?),
        values,
        iterations: result.state.iter(),
        has_converged: false,
    })
}

/// Linear coordinates: `values = origin + transform · place`.
struct Coordinates {
    origin: Vec<f64>,
    transform: DMatrix<f64>,
    /// Mean square of the residual at the origin; costs are divided by it.
    scale: f64,
}

impl Coordinates {
    fn new(fit: &Fit<'_>, from: &Optimum) -> Option<Self> {
        let columns = fit.jacobian(&from.values)?;
        let parameters = fit.parameters.iter();
        let ranges = Vec::from_iter(parameters.map(|parameter| parameter.range()));
        let scale = from.mean_square.max(MEAN_SQUARE_MIN);
        let root = libm::sqrt(scale * columns.first().map_or(0, Vec::len) as f64);
        let scales = Vec::from_iter(ranges.iter().map(|range| range / root));
        let (singular_values, directions) = decomposed(to_matrix(&columns, &scales))?;
        let largest = singular_values.max();
        let transform = DMatrix::from_fn(ranges.len(), ranges.len(), |row, column| {
            let singular = singular_values[column].max(SCALE_MIN * largest);
            ranges[row] * directions[(row, column)] / singular
        });
        Some(Self {
            origin: from.values.clone(),
            transform,
            scale,
        })
    }

    /// Returns the parameters at a place. Rounding never leads out of the bounds.
    fn values(&self, fit: &Fit<'_>, place: &[f64]) -> Vec<f64> {
        let moved = &self.transform * DVector::from_column_slice(place);
        let values = self.origin.iter().zip(moved.iter()).zip(&fit.parameters);
        values
            .map(|((origin, by), parameter)| (origin + by).clamp(parameter.lower, parameter.upper))
            .collect()
    }

    /// Returns bounds and order, `rows · place ≤ limits`.
    fn constraints(&self, fit: &Fit<'_>) -> LinearBlock<DenseMatrix, Vec<f64>> {
        let count = self.origin.len();
        let mut inequalities = fit.ordering();
        for (place, parameter) in fit.parameters.iter().enumerate() {
            for (sign, limit) in [(1.0, parameter.upper), (-1.0, -parameter.lower)] {
                let mut coefficients = vec![0.0; count];
                coefficients[place] = sign;
                inequalities.push(Inequality {
                    coefficients,
                    limit,
                });
            }
        }
        let (mut rows, mut limits) = (Vec::new(), Vec::new());
        for inequality in &inequalities {
            let coefficients = DVector::from_column_slice(&inequality.coefficients);
            rows.extend((coefficients.transpose() * &self.transform).iter());
            let origin = coefficients.dot(&DVector::from_column_slice(&self.origin));
            limits.push(inequality.limit - origin);
        }
        LinearBlock::new(
            DenseMatrix::from_row_slice(limits.len(), count, &rows),
            limits,
        )
    }
}

/// Cost of a round: half the mean square over its coordinates.
struct Round<'a> {
    fit: &'a Fit<'a>,
    coordinates: &'a Coordinates,
    progress: OnIteration<'a>,
    iterations: Cell<u64>,
}

impl CostFunction for Round<'_> {
    type Param = Vec<f64>;
    type Output = f64;
    type Error = Infallible;

    fn cost(&self, place: &Vec<f64>) -> Result<f64, Infallible> {
        let values = self.coordinates.values(self.fit, place);
        let residual = self.fit.residual_metres(&values);
        let cost = |residual: Vec<f64>| 0.5 * mean_square(&residual) / self.coordinates.scale;
        Ok(residual.map_or(f64::INFINITY, cost))
    }
}

impl Gradient for Round<'_> {
    type Gradient = Vec<f64>;

    fn gradient(&self, place: &Vec<f64>) -> Result<Vec<f64>, Infallible> {
        let values = self.coordinates.values(self.fit, place);
        let residual = self.fit.residual_metres(&values);
        let derivatives = residual.and_then(|residual| {
            let columns = self.fit.jacobian_at(&values, &residual)?;
            Some((residual, columns))
        });
        let Some((residual, columns)) = derivatives else {
            return Ok(vec![f64::NAN; place.len()]);
        };
        let mean = mean_square(&residual);
        (self.progress)(self.iterations.get(), libm::sqrt(mean));
        self.iterations.set(self.iterations.get() + 1);
        let residual = DVector::from_vec(residual);
        let count = residual.len() as f64;
        let unscaled = vec![1.0; columns.len()];
        let slopes =
            to_matrix(&columns, &unscaled).tr_mul(&residual) / (count * self.coordinates.scale);
        Ok(self
            .coordinates
            .transform
            .tr_mul(&slopes)
            .iter()
            .copied()
            .collect())
    }
}

/// Runs trust-region reflective least squares from the same start, on the same residual, as a cross-check. It knows
/// bounds only. If the order is violated, there is no residual, and it takes a shorter step.
pub fn trust_region_reflective(fit: &Fit<'_>, start: &[f64]) -> Option<Optimum> {
    let scale = libm::sqrt(mean_square(&fit.residual_metres(start)?).max(MEAN_SQUARE_MIN));
    let problem = LeastSquares { fit, scale };
    let count = start.len();
    let bounds = ConstraintSet::new().with_bounds(BoxBounds::new(
        Some(vec![0.0; count]),
        Some(vec![1.0; count]),
    ));
    let result = Executor::new(
        Constrained::new(problem, bounds),
        TrustRegionReflective::new().with_relative_cost_change_tolerance(CHECK_PROGRESS_MIN),
        PointState::new(fractions(fit, start)),
    )
    .max_iter(CHECK_ITERATIONS_MAX)
    .run()
    .ok()?;
    let values = at_fractions(fit, result.state.param());
    Some(Optimum {
        mean_square: mean_square(&fit.residual_metres(&values)?),
        values,
        iterations: result.state.iter(),
        has_converged: result.state.iter() < CHECK_ITERATIONS_MAX,
    })
}

/// Cost of the second optimiser: the residual over the parameters as fractions of their ranges.
struct LeastSquares<'a> {
    fit: &'a Fit<'a>,
    scale: f64,
}

impl Residual for LeastSquares<'_> {
    type Param = Vec<f64>;
    type Output = Vec<f64>;
    type Error = Infallible;

    fn residual(&self, place: &Vec<f64>) -> Result<Vec<f64>, Infallible> {
        let values = at_fractions(self.fit, place);
        let is_ordered = self.fit.is_ordered(&values);
        let residual = is_ordered
            .then(|| self.fit.residual_metres(&values))
            .flatten()
            .unwrap_or_else(|| vec![f64::NAN; self.fit.sample_count()]);
        Ok(residual.iter().map(|metres| metres / self.scale).collect())
    }
}

impl Jacobian for LeastSquares<'_> {
    type Jacobian = DenseMatrix;

    fn jacobian(&self, place: &Vec<f64>) -> Result<DenseMatrix, Infallible> {
        let values = at_fractions(self.fit, place);
        let columns = self
            .fit
            .jacobian(&values)
            .unwrap_or_else(|| vec![vec![f64::NAN; self.fit.sample_count()]; place.len()]);
        let parameters = self.fit.parameters.iter();
        let ranges = Vec::from_iter(parameters.map(|one| one.range() / self.scale));
        let jacobian = to_matrix(&columns, &ranges);
        Ok(DenseMatrix::from_row_slice(
            jacobian.nrows(),
            jacobian.ncols(),
            jacobian.transpose().as_slice(),
        ))
    }
}

fn fractions(fit: &Fit<'_>, values: &[f64]) -> Vec<f64> {
    let pairs = fit.parameters.iter().zip(values);
    pairs
        .map(|(parameter, value)| (value - parameter.lower) / parameter.range())
        .collect()
}

fn at_fractions(fit: &Fit<'_>, place: &[f64]) -> Vec<f64> {
    let pairs = fit.parameters.iter().zip(place);
    pairs
        .map(|(parameter, place)| {
            (parameter.lower + place * parameter.range()).clamp(parameter.lower, parameter.upper)
        })
        .collect()
}

/// Returns columns as a matrix, each multiplied by its scale.
pub fn to_matrix(columns: &Derivatives, scales: &[f64]) -> DMatrix<f64> {
    let rows = columns.first().map_or(0, Vec::len);
    DMatrix::from_fn(rows, columns.len(), |row, column| {
        columns[column][row] * scales[column]
    })
}

/// Returns the singular values of a matrix, and its right singular vectors as columns; `None` if no parameter has an effect.
pub fn decomposed(jacobian: DMatrix<f64>) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let decomposition = jacobian.svd(false, true);
    let directions = decomposition.v_t?.transpose();
    let singular_values = decomposition.singular_values;
    (singular_values.max() > 0.0).then_some((singular_values, directions))
}
