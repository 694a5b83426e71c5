//! Quality of an estimate: standard errors, correlations, and combinations that the data do not determine.

use nalgebra::{DMatrix, DVector};
use plant_emulator::sensor::PositionSensor;
use scenario::rig::nodes::Sensor;
use serde::Serialize;

use super::data::IdentificationData;
use super::fit::{Derivatives, Fit, rms};
use super::optimiser::{decomposed, to_matrix};
use super::residual_test::{ResidualTest, Sizes, sizes_of};
use super::sensor_model::SensorModel;

/// Longest time between residuals that are treated as dependent.
const CORRELATION_SECONDS: f64 = 1.0;
/// Number of emulated measurements that give the sensor's part in the errors.
pub const REPLICAS: u32 = 999;
/// Largest ratio to the largest singular value of one that counts as zero.
const RANK_TOLERANCE: f64 = 1e-12;

/// Estimate of one parameter.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// The estimate: the least squares, less the shift by the sensor if [`FitStatistics::is_corrected`].
    pub value: f64,
    /// Value at the end of the search.
    pub least_squares: f64,
    /// Root of the diagonal of `σ² (JᵀJ)⁻¹`: right if the residuals were independent.
    pub standard_error_if_independent: f64,
    /// Standard error that allows for residuals that depend on their neighbours (Newey and West) and for the sensor's
    /// steps.
    pub standard_error: f64,
    /// Shift of the least squares by the sensor's steps and ends, according to the fitted model.
    pub sensor_shift: f64,
}

/// Statistics of a fit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FitStatistics {
    /// Estimates, one per parameter.
    pub estimates: Vec<Estimate>,
    /// Correlation of each pair of estimates, from `(JᵀJ)⁻¹`.
    pub correlations: Vec<Vec<f64>>,
    /// Singular values of the Jacobian in metres RMS: the change of the position for a change of 100 %, from the best
    /// determined combination of parameters to the worst.
    pub singular_values_metres: Vec<f64>,
    /// The combinations of parameters that belong to the singular values: relative changes, whose squares sum to 1.
    pub directions: Vec<Vec<f64>>,
    /// Whether the values are corrected by the sensor's shift. Without noise the shift is not random, and if the model
    /// explains the data it is known.
    pub is_corrected: bool,
    /// RMS of the residual.
    pub residual_metres_rms: f64,
    /// RMS of the residual that the sensor alone would leave.
    pub sensor_metres_rms: f64,
    /// Tests of whether the sensor alone explains the residual.
    pub residual_tests: Vec<ResidualTest>,
}

impl FitStatistics {
    /// Returns the statistics of an estimate; `None` if the model has no derivative.
    pub fn new(fit: &Fit<'_>, values: &[f64]) -> Option<Self> {
        let columns = fit.jacobian(values)?;
        let residual = fit.residual_metres(values)?;
        let true_metres = fit.simulated_metres(values)?;
        let parameters = fit.parameters.iter().zip(values);
        let sizes = parameters.map(|(p, value)| value.abs().max(0.01 * p.range()));
        let linear = Linear::new(&columns, sizes.collect())?;
        let residual_metres_rms = rms(&residual);
        let independent = linear.covariance(degrees_of_freedom_scaled(&residual, values.len()));
        let robust = linear.robust_covariance(fit, &residual);
        let replicas = Replicas::new(fit, &true_metres, &linear);
        let corrected: Vec<f64> = values
            .iter()
            .zip(&replicas.shift)
            .map(|(value, shift)| value - shift)
            .collect();
        let residual_tests =
            ResidualTest::all(sizes_of(fit.measurements, &residual), replicas.sizes_max);
        let is_corrected = !is_noisy(fit) && is_passed(&residual_tests) && fit.admits(&corrected);
        let estimates = values.iter().enumerate().map(|(place, value)| {
            let spread = replicas.spread[place];
            let variance = robust[(place, place)].max(independent[(place, place)]);
            Estimate {
                value: if is_corrected {
                    corrected[place]
                } else {
                    *value
                },
                least_squares: *value,
                standard_error_if_independent: libm::sqrt(independent[(place, place)]),
                standard_error: libm::sqrt(variance.max(spread * spread)),
                sensor_shift: replicas.shift[place],
            }
        });
        Some(Self {
            estimates: estimates.collect(),
            correlations: correlations(&independent),
            singular_values_metres: linear.singular_values_metres(),
            directions: (0..values.len())
                .map(|place| linear.direction(place))
                .collect(),
            is_corrected,
            residual_metres_rms,
            sensor_metres_rms: replicas.sensor_metres_rms,
            residual_tests,
        })
    }

    /// Returns the values of the estimates.
    pub fn values(&self) -> Vec<f64> {
        self.estimates
            .iter()
            .map(|estimate| estimate.value)
            .collect()
    }

    /// Returns the ratio of the residual to the sensor's. It is well above 1 if the model is not the plant's.
    pub fn misfit(&self) -> f64 {
        self.residual_metres_rms / self.sensor_metres_rms
    }

    /// Returns whether the sensor explains the residual.
    pub fn explains(&self) -> bool {
        is_passed(&self.residual_tests)
    }

    /// Returns the test that the residual exceeds most, if it exceeds one.
    pub fn worst_test(&self) -> Option<&ResidualTest> {
        let tests = self.residual_tests.iter();
        let failed = tests.filter(|test| test.excess() > 1.0);
        failed.max_by(|left, right| left.excess().total_cmp(&right.excess()))
    }
}

fn is_passed(tests: &[ResidualTest]) -> bool {
    tests.iter().all(|test| test.excess() <= 1.0)
}

/// Returns `Σ r² / (samples − parameters)`.
fn degrees_of_freedom_scaled(residual: &[f64], parameters: usize) -> f64 {
    let freedom = residual.len().saturating_sub(parameters).max(1) as f64;
    residual.iter().map(|value| value * value).sum::<f64>() / freedom
}

/// The decomposed Jacobian; parameters are in units of their own size.
struct Linear {
    jacobian: DMatrix<f64>,
    sizes: Vec<f64>,
    /// Singular values, the largest first.
    singular_values: DVector<f64>,
    /// Right singular vectors, one per column.
    directions: DMatrix<f64>,
    /// `(JᵀJ)⁻¹` in scaled parameters.
    inverse: DMatrix<f64>,
}

impl Linear {
    fn new(columns: &Derivatives, sizes: Vec<f64>) -> Option<Self> {
        let jacobian = to_matrix(columns, &sizes);
        let (singular_values, directions) = decomposed(jacobian.clone())?;
        let largest = singular_values.max();
        let weights = singular_values.map(|value| value.max(RANK_TOLERANCE * largest).powi(-2));
        let inverse = &directions * DMatrix::from_diagonal(&weights) * directions.transpose();
        Some(Self {
            jacobian,
            sizes,
            singular_values,
            directions,
            inverse,
        })
    }

    /// Converts a matrix of scaled parameters to the parameters' own units.
    fn unscaled(&self, scaled: &DMatrix<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(scaled.nrows(), scaled.ncols(), |row, column| {
            scaled[(row, column)] * self.sizes[row] * self.sizes[column]
        })
    }

    fn covariance(&self, variance: f64) -> DMatrix<f64> {
        self.unscaled(&(&self.inverse * variance))
    }

    /// Returns `(JᵀJ)⁻¹ S (JᵀJ)⁻¹` with Newey and West's estimate of `S = cov(Jᵀr)`, whose weights fall linearly to
    /// zero.
    fn robust_covariance(&self, fit: &Fit<'_>, residual: &[f64]) -> DMatrix<f64> {
        let count = self.sizes.len();
        let mut spread = DMatrix::zeros(count, count);
        let mut first = 0;
        for measurement in fit.measurements {
            let rows = measurement.positions_metres.len();
            let scores = DMatrix::from_fn(rows, count, |row, column| {
                self.jacobian[(first + row, column)] * residual[first + row]
            });
            spread += long_run_spread(&scores, lags(measurement));
            first += rows;
        }
        self.unscaled(&(&self.inverse * spread * &self.inverse))
    }

    /// Returns the step to the least squares for a change of the measured positions, `−(JᵀJ)⁻¹ Jᵀ e`, where `J` is the
    /// residual's, and the rest of the change after that step.
    fn refit(&self, error: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let error = DVector::from_column_slice(error);
        let shift = -(&self.inverse * self.jacobian.tr_mul(&error));
        let left_over = &self.jacobian * &shift + error;
        let shift = shift.iter().zip(&self.sizes);
        let shift = shift.map(|(shift, size)| shift * size).collect();
        (shift, left_over.as_slice().to_vec())
    }

    fn singular_values_metres(&self) -> Vec<f64> {
        let root = libm::sqrt(self.jacobian.nrows() as f64);
        let values = self.singular_values.iter();
        values.map(|value| value / root).collect()
    }

    /// Returns a right singular vector with a positive largest component.
    fn direction(&self, place: usize) -> Vec<f64> {
        let direction: Vec<f64> = self.directions.column(place).iter().copied().collect();
        let largest = direction
            .iter()
            .copied()
            .reduce(|a, b| if b.abs() > a.abs() { b } else { a });
        let sign = largest.unwrap_or(1.0).signum();
        direction.iter().map(|component| component * sign).collect()
    }
}

/// Returns the number of samples within [`CORRELATION_SECONDS`].
fn lags(measurement: &IdentificationData) -> usize {
    let Some(first) = measurement.times_seconds.first() else {
        return 0;
    };
    measurement
        .times_seconds
        .iter()
        .take_while(|time| *time - first < CORRELATION_SECONDS)
        .count()
}

fn long_run_spread(scores: &DMatrix<f64>, lags: usize) -> DMatrix<f64> {
    let rows = scores.nrows();
    let mut spread = scores.tr_mul(scores);
    for lag in 1..=lags.min(rows.saturating_sub(1)) {
        let weight = 1.0 - lag as f64 / (lags as f64 + 1.0);
        let product = scores
            .rows(0, rows - lag)
            .tr_mul(&scores.rows(lag, rows - lag));
        spread += (&product + product.transpose()) * weight;
    }
    spread
}

fn correlations(covariance: &DMatrix<f64>) -> Vec<Vec<f64>> {
    let count = covariance.nrows();
    let deviation = |place: usize| libm::sqrt(covariance[(place, place)]);
    let row = |row: usize| {
        let entry =
            |column: usize| covariance[(row, column)] / (deviation(row) * deviation(column));
        (0..count).map(entry).collect()
    };
    (0..count).map(row).collect()
}

/// Effect of the sensor on the estimate: the fitted motion, measured by the emulated sensor many times.
///
/// Without noise the sensor's steps are not a random error: the same motion gives the same readings, and the estimate
/// is shifted. The fitted motion gives the shift. Motions that are up to half a step higher or lower give its
/// uncertainty.
struct Replicas {
    shift: Vec<f64>,
    spread: Vec<f64>,
    sensor_metres_rms: f64,
    /// Largest sizes of the residuals after a fit to each emulated measurement.
    sizes_max: Sizes,
}

impl Replicas {
    fn new(fit: &Fit<'_>, true_metres: &[f64], linear: &Linear) -> Self {
        let mut sizes_max = Sizes::default();
        let mut shifts = Vec::new();
        for replica in 1..=REPLICAS {
            let error = sensor_errors(fit, true_metres, replica);
            let (shift, left_over) = linear.refit(&error);
            let sizes = sizes_of(fit.measurements, &left_over);
            for (max, size) in sizes_max.iter_mut().zip(sizes) {
                *max = max.max(size);
            }
            shifts.push(shift);
        }
        let exact = sensor_errors(fit, true_metres, 0);
        let mean = |place: usize| {
            shifts.iter().map(|shift| shift[place]).sum::<f64>() / f64::from(REPLICAS)
        };
        let spread = |place: usize| {
            let squares = shifts
                .iter()
                .map(|shift| (shift[place] - mean(place)).powi(2));
            libm::sqrt(squares.sum::<f64>() / f64::from(REPLICAS - 1))
        };
        let places = 0..linear.sizes.len();
        Self {
            shift: if is_noisy(fit) {
                places.clone().map(mean).collect()
            } else {
                linear.refit(&exact).0
            },
            spread: places.map(spread).collect(),
            sensor_metres_rms: rms(&exact),
            sizes_max,
        }
    }
}

fn is_noisy(fit: &Fit<'_>) -> bool {
    fit.measurements
        .iter()
        .any(|measurement| measurement.sensor().noise_rms() > 0.0)
}

/// Returns the RMS of the residual that the sensor alone would leave for this motion.
pub fn sensor_metres_rms(fit: &Fit<'_>, true_metres: &[f64]) -> f64 {
    rms(&sensor_errors(fit, true_metres, 0))
}

/// Returns the measured less the expected positions for one emulated measurement; replica 0 is exactly the fitted
/// motion.
fn sensor_errors(fit: &Fit<'_>, true_metres: &[f64], replica: u32) -> Vec<f64> {
    let parts = fit.parts(true_metres);
    let errors = parts.flat_map(|(measurement, part)| {
        let (sensor, step) = (measurement.sensor(), measurement.sensor_step_metres());
        trace_errors(sensor, part, step, replica)
    });
    errors.collect()
}

fn trace_errors(sensor: &Sensor, true_metres: &[f64], step: f64, replica: u32) -> Vec<f64> {
    // Scenarios have small seeds, so none has the noise of a replica.
    let mut emulated = PositionSensor::new(sensor, 1e-3, u64::MAX - u64::from(replica));
    let model = SensorModel::new(sensor);
    // Offsets of −1/2 to 1/2 step, evenly spread. On the stop the position of the load is certain.
    let offset = if replica == 0 {
        0.0
    } else {
        step * ((f64::from(replica) - 0.5) / f64::from(REPLICAS) - 0.5)
    };
    let error = |position: &f64| {
        let position = if *position > step {
            position + offset
        } else {
            *position
        };
        let counts = emulated.sample(position);
        emulated.position(counts) - model.expected_metres(position)
    };
    true_metres.iter().map(error).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn independent_scores_have_no_long_run() {
        // Alternating signs: neighbours cancel, so the long-run spread is far smaller than the sum of squares.
        let scores = DMatrix::from_fn(1000, 1, |row, _| if row % 2 == 0 { 1.0 } else { -1.0 });
        assert!(long_run_spread(&scores, 50)[(0, 0)] < 30.0);
        // Equal neighbours add up: about `lags` times the sum of squares.
        let scores = DMatrix::from_element(1000, 1, 1.0);
        assert!(long_run_spread(&scores, 50)[(0, 0)] > 40_000.0);
    }

    #[test]
    fn a_linear_problem_has_the_textbook_covariance() {
        // y = a + b t at t = −1, 0, 1: var a = σ²/3, var b = σ²/2, uncorrelated.
        let columns = vec![vec![1.0, 1.0, 1.0], vec![-1.0, 0.0, 1.0]];
        let linear = Linear::new(&columns, vec![2.0, 0.5]).unwrap();
        let covariance = linear.covariance(6.0);
        assert!((covariance[(0, 0)] - 2.0).abs() < 1e-12);
        assert!((covariance[(1, 1)] - 3.0).abs() < 1e-12);
        assert!(correlations(&covariance)[0][1].abs() < 1e-12);
        // The residual's Jacobian is minus the model's: here both have this sign, so the step is opposite.
        let (shift, _) = linear.refit(&[1.0, 2.0, 3.0]);
        assert!(
            (shift[0] + 2.0).abs() < 1e-12 && (shift[1] + 1.0).abs() < 1e-12,
            "{shift:?}"
        );
    }
}
