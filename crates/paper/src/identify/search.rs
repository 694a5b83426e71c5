//! The search: from start values to the optimum, its cross-check and its statistics.

use super::fit::Fit;
use super::optimiser::{self, OnIteration, Optimum};
use super::start;
use super::statistics::{FitStatistics, sensor_metres_rms};
use runner::exit::{Exit, Failure};

/// Ratio of the residual to the sensor's from which a second attempt from another start is made.
const POOR_MISFIT: f64 = 3.0;
/// Largest distance between two optima that count as the same, in standard errors.
const AGREEMENT_STANDARD_ERRORS: f64 = 0.1;
/// The same in parts of a parameter's range, for very small standard errors.
const AGREEMENT_RANGES: f64 = 1e-4;
/// Ratio of two mean squares above which the optimisers ended in different valleys.
const LOST: f64 = 1.01;
/// Decrease of the sum of squares from which the search continues from the second optimum, as a part of one sample's.
const LOWER_SAMPLES: f64 = 0.1;

fn not_admissible(reason: &str) -> Failure {
    Exit::Usage.because(format!("the start values are not admissible: {reason}"))
}

fn never_lifts() -> Failure {
    Exit::Inconclusive.because(
        "no plant within the bounds lifts the load under the recorded current, though it was lifted; are the known parameters right?",
    )
}

/// Reason why the search began at other values than the start values, or at both.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detour {
    /// The load never lifts with the start values, so there is no gradient.
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

/// Result of a search that found the optimum by itself.
#[derive(Clone, Debug)]
pub struct Check {
    /// The search, in the report's words.
    pub checker: &'static str,
    /// Its result.
    pub optimum: Optimum,
}

/// Result of a search.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Start values that were asked for.
    pub start: Vec<f64>,
    /// Result of sequential quadratic programming.
    pub descent: Descent,
    /// Optimum that another search found without this one.
    pub check: Option<Check>,
    /// Whether another search came lower, and sequential quadratic programming continued from there.
    pub is_continued: bool,
    /// Quality of the optimum.
    pub statistics: FitStatistics,
}

impl Solution {
    /// Returns the largest distance of the two optima in standard errors.
    pub fn disagreement(&self) -> Option<f64> {
        let check = self.check.as_ref()?;
        Some(distance(&self.statistics, &check.optimum.values))
    }

    /// Returns whether two searches found the same values, each by itself.
    pub fn is_confirmed(&self, fit: &Fit<'_>) -> bool {
        let check = self.check.as_ref();
        check.is_some_and(|check| agrees(fit, &self.statistics, &check.optimum.values))
    }
}

/// Returns the largest distance of values from the optimum in standard errors.
fn distance(statistics: &FitStatistics, values: &[f64]) -> f64 {
    let pairs = values.iter().zip(&statistics.estimates);
    let distances = pairs
        .map(|(value, estimate)| (value - estimate.least_squares).abs() / estimate.standard_error);
    distances.fold(0.0, f64::max)
}

/// Returns whether values are the optimum, within a small part of its standard errors.
fn agrees(fit: &Fit<'_>, statistics: &FitStatistics, values: &[f64]) -> bool {
    let parameters = fit.parameters.iter().zip(&statistics.estimates);
    parameters
        .zip(values)
        .all(|((parameter, estimate), value)| {
            let tolerance = (AGREEMENT_STANDARD_ERRORS * estimate.standard_error)
                .max(AGREEMENT_RANGES * parameter.range());
            (value - estimate.least_squares).abs() <= tolerance
        })
}

/// Searches from the start values, checks the optimum with a second optimiser, from two starts if need be, and rates it.
///
/// # Errors
/// The start is not admissible, or no plant within the bounds can explain any motion.
pub fn search(
    fit: &Fit<'_>,
    start: &[f64],
    progress: OnIteration<'_>,
) -> Result<Solution, Failure> {
    let mut descent = descend(fit, start, progress)?;
    let origin = descent.detour.as_ref().map_or(start, |(_, origin)| origin);
    let mut checks = Vec::from_iter(second_opinion(
        fit,
        origin,
        "trust-region reflective least squares from the same start",
    ));
    let lowest = descent.optimum.mean_square;
    if checks
        .iter()
        .all(|check| check.optimum.mean_square > LOST * lowest)
    {
        checks = Vec::from_iter(opinion_from_scan(fit));
    }
    let worth = LOWER_SAMPLES / fit.sample_count().max(1) as f64;
    let lower = checks.pop_if(|check| check.optimum.mean_square < lowest * (1.0 - worth));
    let is_continued = lower.is_some();
    if let Some(lower) = lower {
        let lower = lower.optimum;
        let mut continued =
            optimiser::sequential_quadratic_programming(fit, &lower.values, progress)
                .unwrap_or(lower);
        continued.iterations += descent.optimum.iterations;
        let before = std::mem::replace(&mut descent.optimum, continued);
        // The search that it continued from cannot confirm the end.
        checks.push(Check {
            checker: "sequential quadratic programming from the start, which had ended before by itself,",
            optimum: before,
        });
    }
    let optimum = &descent.optimum;
    let statistics = FitStatistics::new(fit, &optimum.values)
        .ok_or_else(|| without_statistics(fit, &optimum.values))?;
    let is_confirmed = |check: &Check| agrees(fit, &statistics, &check.optimum.values);
    if statistics.explains() && !checks.iter().any(is_confirmed) {
        checks.extend(opinion_from_scan(fit));
    }
    let distance = |check: &Check| distance(&statistics, &check.optimum.values);
    let check = checks
        .into_iter()
        .min_by(|left, right| distance(left).total_cmp(&distance(right)));
    Ok(Solution {
        is_continued,
        start: start.to_vec(),
        descent,
        check,
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
) -> Result<Descent, Failure> {
    check_start(fit, start)?;
    if !start::lifts(fit, start) {
        let origin = start::scan(fit)
            .filter(|origin| start::lifts(fit, origin))
            .ok_or_else(never_lifts)?;
        let optimum = descend_from(fit, &origin, progress).ok_or_else(never_lifts)?;
        let detour = Some((Detour::NeverLifts, origin));
        return Ok(Descent { detour, optimum });
    }
    let optimum = descend_from(fit, start, progress)
        .ok_or_else(|| not_admissible("the plant cannot be simulated with them"))?;
    if (is_poor(fit, &optimum) || !optimum.has_converged)
        && let Some(origin) = start::scan(fit)
        && let Some(second) = descend_from(fit, &origin, progress)
        && second.mean_square < 0.99 * optimum.mean_square
    {
        return Ok(Descent {
            detour: Some((Detour::PoorFit, origin)),
            optimum: second,
        });
    }
    Ok(Descent {
        detour: None,
        optimum,
    })
}

/// Returns the reason why an optimum has no statistics.
fn without_statistics(fit: &Fit<'_>, values: &[f64]) -> Failure {
    let symbols = fit.symbols();
    let Some(columns) = fit.jacobian(values) else {
        let symbols = symbols.join(", ");
        return Exit::Inconclusive.because(format!(
            "the search ended at values beside which the plant cannot be simulated ({symbols}); begin elsewhere with `--start`"
        ));
    };
    let without: Vec<_> = symbols
        .into_iter()
        .zip(&columns)
        .filter(|(_, column)| column.iter().all(|part| *part == 0.0))
        .map(|(symbol, _)| symbol)
        .collect();
    let without = without.join(", ");
    Exit::Inconclusive.because(format!(
        "the simulated position does not depend on {without} in these recordings"
    ))
}

fn is_poor(fit: &Fit<'_>, optimum: &Optimum) -> bool {
    let sensor = fit
        .simulated_metres(&optimum.values)
        .map(|positions| sensor_metres_rms(fit, &positions));
    sensor.is_none_or(|sensor| libm::sqrt(optimum.mean_square) > POOR_MISFIT * sensor)
}

/// Searches with coarse integration steps first, since they are cheap, then with the fit's own steps.
fn descend_from(fit: &Fit<'_>, origin: &[f64], progress: OnIteration<'_>) -> Option<Optimum> {
    let near = optimiser::sequential_quadratic_programming(&fit.coarse(), origin, progress)?;
    if fit.is_coarse {
        return Some(near);
    }
    let optimum = optimiser::sequential_quadratic_programming(fit, &near.values, progress)?;
    Some(Optimum {
        iterations: near.iterations + optimum.iterations,
        ..optimum
    })
}

/// Runs the second optimiser, with coarse steps first as well.
fn second_opinion(fit: &Fit<'_>, origin: &[f64], checker: &'static str) -> Option<Check> {
    let near = optimiser::trust_region_reflective(&fit.coarse(), origin)?;
    let optimum = if fit.is_coarse {
        near
    } else {
        optimiser::trust_region_reflective(fit, &near.values)?
    };
    Some(Check { checker, optimum })
}

fn opinion_from_scan(fit: &Fit<'_>) -> Option<Check> {
    second_opinion(
        fit,
        &start::scan(fit)?,
        "trust-region reflective least squares from a scanned point",
    )
}

fn check_start(fit: &Fit<'_>, start: &[f64]) -> Result<(), Failure> {
    for (parameter, value) in fit.parameters.iter().zip(start) {
        let (lower, upper) = (parameter.lower, parameter.upper);
        if !(lower..=upper).contains(value) {
            let symbol = parameter.symbol;
            let reason = format!("{symbol} is {value}, outside its bounds {lower} to {upper}");
            return Err(not_admissible(&reason));
        }
    }
    if fit.is_ordered(start) {
        Ok(())
    } else {
        let reason = "As must be below Af and Mf below Ms, by 1 °C at least";
        Err(not_admissible(reason))
    }
}
