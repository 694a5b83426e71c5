//! The search: from start values to the optimum, its cross-check and its statistics.

use super::fit::Fit;
use super::optimiser::{self, OnIteration, Optimum};
use super::start;
use super::statistics::{FitStatistics, sensor_metres_rms};

/// Ratio of the residual to the sensor's from which a second attempt from another start is made.
const POOR_MISFIT: f64 = 3.0;
/// Largest distance of two optima that agree, in standard errors; below it in ranges, for very small errors.
const AGREEMENT_STANDARD_ERRORS: f64 = 0.1;
const AGREEMENT_RANGES: f64 = 1e-4;
/// Ratio of two mean squares above which the optimisers ended in different valleys.
const LOST: f64 = 1.01;
/// Decrease of the sum of squares from which the search continues from the second optimum, as a part of one sample's.
const LOWER_SAMPLES: f64 = 0.1;

/// Reason why a search has no result.
#[derive(Debug, thiserror::Error)]
pub enum SearchError {
    /// The start values are not admissible.
    #[error("the start values are not admissible: {0}")]
    Start(String),
    /// No plant within the bounds lifts the load.
    #[error(
        "no plant within the bounds lifts the load under the recorded current, though it was lifted; are the known parameters right?"
    )]
    NeverLifts,
    /// The model has no derivative.
    #[error("the simulated position does not depend on the parameters ({0}) in these recordings")]
    NoDerivative(String),
}

/// Reason why the search began at other values than the start values, or at both.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detour {
    /// With the start values the load never lifts, so there is no gradient.
    NeverLifts,
    /// The fit from the start values was poor; another start gave a better one.
    PoorFit,
}

/// Result of the first optimiser, with its origin.
#[derive(Clone, Debug)]
pub struct Descent {
    /// Reason for another origin than the start values, and that origin.
    pub detour: Option<(Detour, Vec<f64>)>,
    /// Result of the optimiser.
    pub optimum: Optimum,
}

/// Result of a search.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Start values that were asked for.
    pub start: Vec<f64>,
    /// Result of sequential quadratic programming.
    pub descent: Descent,
    /// Result of the second optimiser.
    pub check: Option<Optimum>,
    /// Whether the second optimiser failed from the first one's origin and began at a scanned point.
    pub is_check_from_scan: bool,
    /// Whether the second optimiser came lower, and the first one continued from there.
    pub is_continued: bool,
    /// Quality of the optimum.
    pub statistics: FitStatistics,
}

impl Solution {
    /// Returns the largest distance of the two optima in standard errors.
    #[must_use]
    pub fn disagreement(&self) -> Option<f64> {
        let check = self.check.as_ref()?;
        let pairs = check.values.iter().zip(&self.statistics.estimates);
        let distances = pairs.map(|(value, estimate)| {
            (value - estimate.least_squares).abs() / estimate.standard_error
        });
        Some(distances.fold(0.0, f64::max))
    }

    /// Returns whether two optimisers found the same values independently and the first has converged.
    #[must_use]
    pub fn is_confirmed(&self, fit: &Fit<'_>) -> bool {
        let Some(check) = &self.check else {
            return false;
        };
        let parameters = fit.parameters.iter().zip(&self.statistics.estimates);
        let is_near = parameters
            .zip(&check.values)
            .all(|((parameter, estimate), value)| {
                let tolerance = (AGREEMENT_STANDARD_ERRORS * estimate.standard_error)
                    .max(AGREEMENT_RANGES * parameter.range());
                (value - estimate.least_squares).abs() <= tolerance
            });
        self.descent.optimum.has_converged && is_near && !self.is_continued
    }
}

/// Searches from the start values, checks the optimum with a second optimiser, and rates it.
///
/// # Errors
/// The start is not admissible, or no plant within the bounds can explain any motion.
pub fn search(
    fit: &Fit<'_>,
    start: &[f64],
    progress: OnIteration<'_>,
) -> Result<Solution, SearchError> {
    let mut descent = descend(fit, start, progress)?;
    let origin = descent.detour.as_ref().map_or(start, |(_, origin)| origin);
    let lowest = descent.optimum.mean_square;
    let mut check = second_opinion(fit, origin);
    let is_check_from_scan = check
        .as_ref()
        .is_none_or(|check| check.mean_square > LOST * lowest);
    if is_check_from_scan {
        check = start::scan(fit).and_then(|origin| second_opinion(fit, &origin));
    }
    #[expect(
        clippy::cast_precision_loss,
        reason = "sample counts stay far below 2^52"
    )]
    let worth = lowest * (1.0 - LOWER_SAMPLES / fit.sample_count().max(1) as f64);
    let lower = check.as_ref().filter(|check| check.mean_square < worth);
    let is_continued = lower.is_some();
    if let Some(lower) = lower
        && let Some(continued) =
            optimiser::sequential_quadratic_programming(fit, &lower.values, progress)
    {
        let iterations = descent.optimum.iterations + continued.iterations;
        descent.optimum = Optimum {
            iterations,
            ..continued
        };
    }
    let statistics =
        FitStatistics::new(fit, &descent.optimum.values).ok_or_else(|| no_derivative(fit))?;
    Ok(Solution {
        is_continued,
        start: start.to_vec(),
        descent,
        check,
        is_check_from_scan,
        statistics,
    })
}

/// Runs sequential quadratic programming from the start values. If the load never lifts with them, or the fit stays
/// poor, it begins at the best of points spread over the bounds.
///
/// # Errors
/// As [`search`].
pub fn descend(
    fit: &Fit<'_>,
    start: &[f64],
    progress: OnIteration<'_>,
) -> Result<Descent, SearchError> {
    check_start(fit, start)?;
    if !start::lifts(fit, start) {
        let origin = start::scan(fit)
            .filter(|origin| start::lifts(fit, origin))
            .ok_or(SearchError::NeverLifts)?;
        let optimum = descend_from(fit, &origin, progress).ok_or_else(|| no_derivative(fit))?;
        let detour = Some((Detour::NeverLifts, origin));
        return Ok(Descent { detour, optimum });
    }
    let optimum = descend_from(fit, start, progress).ok_or_else(|| no_derivative(fit))?;
    if is_poor(fit, &optimum)
        && let Some((origin, optimum)) = second_attempt(fit, &optimum, progress)
    {
        let detour = Some((Detour::PoorFit, origin));
        return Ok(Descent { detour, optimum });
    }
    Ok(Descent {
        detour: None,
        optimum,
    })
}

fn no_derivative(fit: &Fit<'_>) -> SearchError {
    let symbols = fit.symbols();
    SearchError::NoDerivative(symbols.join(", "))
}

fn is_poor(fit: &Fit<'_>, optimum: &Optimum) -> bool {
    let sensor = fit
        .simulated_metres(&optimum.values)
        .map(|positions| sensor_metres_rms(fit, &positions));
    sensor.is_none_or(|sensor| libm::sqrt(optimum.mean_square) > POOR_MISFIT * sensor)
}

/// Searches from the best of the scanned points; returns `None` unless the result is lower.
fn second_attempt(
    fit: &Fit<'_>,
    first: &Optimum,
    progress: OnIteration<'_>,
) -> Option<(Vec<f64>, Optimum)> {
    let origin = start::scan(fit)?;
    let second = descend_from(fit, &origin, progress)?;
    (second.mean_square < 0.99 * first.mean_square).then_some((origin, second))
}

/// Searches with coarse integration steps first, since they are cheap, then with the fit's own steps.
fn descend_from(fit: &Fit<'_>, origin: &[f64], progress: OnIteration<'_>) -> Option<Optimum> {
    let near = optimiser::sequential_quadratic_programming(&fit.coarse(), origin, progress)?;
    if fit.is_coarse() {
        return Some(near);
    }
    let optimum = optimiser::sequential_quadratic_programming(fit, &near.values, progress)?;
    Some(Optimum {
        iterations: near.iterations + optimum.iterations,
        ..optimum
    })
}

/// Runs the second optimiser, with coarse steps first as well.
fn second_opinion(fit: &Fit<'_>, origin: &[f64]) -> Option<Optimum> {
    let near = optimiser::trust_region_reflective(&fit.coarse(), origin)?;
    if fit.is_coarse() {
        return Some(near);
    }
    optimiser::trust_region_reflective(fit, &near.values)
}

fn check_start(fit: &Fit<'_>, start: &[f64]) -> Result<(), SearchError> {
    for (parameter, value) in fit.parameters.iter().zip(start) {
        let (lower, upper) = (parameter.lower, parameter.upper);
        if !(lower..=upper).contains(value) {
            let symbol = parameter.symbol;
            let message = format!("{symbol} is {value}, outside its bounds {lower} to {upper}");
            return Err(SearchError::Start(message));
        }
    }
    if fit.is_ordered(start) {
        Ok(())
    } else {
        let message = "As must be below Af and Mf below Ms, by 1 °C at least".to_owned();
        Err(SearchError::Start(message))
    }
}
