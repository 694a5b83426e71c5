//! The search: from start values to the optimum, its cross-check and its statistics.

use super::fit::Fit;
use super::optimiser::{self, OnIteration, Optimum};
use super::start;
use super::statistics::{FitStatistics, sensor_metres_rms};

/// A residual so many times what the sensor leaves is worth a second attempt from elsewhere.
const POOR_MISFIT: f64 = 3.0;
/// Two optima agree within this part of a standard error, or of a range where the errors are tiny.
const AGREEMENT_STANDARD_ERRORS: f64 = 0.1;
const AGREEMENT_RANGES: f64 = 1e-4;
/// A mean square so many times the other optimiser's is another valley.
const LOST: f64 = 1.01;
/// A sum of squares that is lower by this part of one sample's is worth going on from.
const LOWER_SAMPLES: f64 = 0.1;

/// Why nothing was found.
#[derive(Debug, thiserror::Error)]
pub enum SearchError {
    /// The start is not admissible.
    #[error("the start values are not admissible: {0}")]
    Start(String),
    /// Nothing lifts the load.
    #[error(
        "no plant within the bounds lifts the load under the recorded current, though it was lifted; are the known parameters right?"
    )]
    NeverLifts,
    /// No derivative.
    #[error("the simulated position does not depend on the parameters ({0}) in these recordings")]
    NoDerivative(String),
}

/// Why the search did not begin at the start values, or not only there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detour {
    /// With the start values the load never lifts, so there is no gradient.
    NeverLifts,
    /// From the start values the fit stayed poor; another start gave a better one.
    PoorFit,
}

/// Where the first optimiser ended, and how it came there.
#[derive(Clone, Debug)]
pub struct Descent {
    /// Where the search really began, and why not at the start values.
    pub detour: Option<(Detour, Vec<f64>)>,
    /// Where it ended.
    pub optimum: Optimum,
}

/// What was found.
#[derive(Clone, Debug)]
pub struct Solution {
    /// The start values that were asked for.
    pub start: Vec<f64>,
    /// Sequential quadratic programming.
    pub descent: Descent,
    /// Where the second optimiser ended.
    pub check: Option<Optimum>,
    /// True when the second optimiser was lost from the first one's origin and began at a scanned point.
    pub is_check_from_scan: bool,
    /// True when the second optimiser came lower, and the first one went on from there.
    pub is_continued: bool,
    /// What the optimum is worth.
    pub statistics: FitStatistics,
}

impl Solution {
    /// Largest distance of the two optima in standard errors.
    #[must_use]
    pub fn disagreement(&self) -> Option<f64> {
        let check = self.check.as_ref()?;
        let pairs = check.values.iter().zip(&self.statistics.estimates);
        let distances = pairs.map(|(value, estimate)| {
            (value - estimate.least_squares).abs() / estimate.standard_error
        });
        Some(distances.fold(0.0, f64::max))
    }

    /// True when two optimisers found the same independently and the first has converged.
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

/// Searches from the start values, checks the optimum with a second optimiser and says what it is worth.
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

/// Sequential quadratic programming from the start values. Where the load never lifts with them, or the fit stays poor,
/// it begins at the best of points spread over the bounds.
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

/// From the best of the scanned points; `None` unless that ends lower.
fn second_attempt(
    fit: &Fit<'_>,
    first: &Optimum,
    progress: OnIteration<'_>,
) -> Option<(Vec<f64>, Optimum)> {
    let origin = start::scan(fit)?;
    let second = descend_from(fit, &origin, progress)?;
    (second.mean_square < 0.99 * first.mean_square).then_some((origin, second))
}

/// Coarse steps of integration first, since they are cheap; the end is found with the fit's own.
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

/// The second optimiser, coarse steps first as well.
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
