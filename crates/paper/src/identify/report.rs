//! The report: Markdown, which is readable on a terminal too.

use comfy_table::{Table, presets};

use super::fit::Fit;
use super::search::{Detour, Solution};
use super::statistics::{Estimate, REPLICAS};

/// Largest standard error of a temperature that counts as determined.
const DETERMINED_KELVINS: f64 = 1.0;
/// Largest relative standard error of any other parameter that counts as determined.
const DETERMINED_PART: f64 = 0.05;
/// Smallest correlation of a pair of estimates that is reported.
const CORRELATION_NAMED: f64 = 0.95;
/// Factor by which independent residuals must understate the standard errors to be worth a warning.
const DEPENDENCE_NAMED: f64 = 1.5;
/// Parameters to add if the model does not explain the data.
const MECHANICAL: [&str; 2] = ["c", "EA"];
/// Parameters of which one at least must be given: the scale of the heat balance.
const SCALES: [&str; 2] = ["R", "cp"];
/// Names of the combinations that are reported, from the worst determined on.
const COMBINATIONS: [&str; 2] = ["worst", "second worst"];
/// Relative change of the largest component for which a combination is reported.
const EXAMPLE_PART: f64 = 0.1;
/// Smallest relative shift by the sensor that is reported.
const SHIFT_NAMED: f64 = 1e-3;
/// Distance from a bound, in ranges, below which a value is at the bound.
const AT_BOUND: f64 = 1e-6;

/// Returns the whole report.
pub fn markdown(fit: &Fit<'_>, found: &Solution, notes: &[String]) -> String {
    let mut text = String::from("# Identification\n\n");
    for measurement in fit.measurements {
        text += &format!(
            "- `{}`: {}, {:.1} s, {} positions\n",
            measurement.path.display(),
            measurement.control_loop.trial.run.name,
            measurement.times_seconds.last().unwrap_or(&0.0),
            measurement.positions_metres.len()
        );
    }
    for note in notes {
        text += &format!("- {note}\n");
    }
    text += &format!(
        "\n{}\n\n{}",
        result_table(fit, found),
        paragraphs(&search(fit, found))
    );
    let sections = [
        (
            "Does the model explain the data?",
            vec![explanation(fit, found)],
        ),
        ("What the data do not determine", undetermined(fit, found)),
        ("Standard errors", errors(fit, found)),
    ];
    for (title, lines) in sections {
        text += &format!("\n## {title}\n\n{}", paragraphs(&lines));
    }
    text += &format!("\n## Correlations\n\n{}\n", correlation_table(fit, found));
    text
}

/// Returns the summary for the terminal.
pub fn summary(fit: &Fit<'_>, found: &Solution) -> String {
    let mut lines = search(fit, found);
    lines.push(explanation(fit, found));
    lines.extend(undetermined(fit, found));
    lines.extend(shift_warning(fit, found));
    format!("\n{}\n\n{}", result_table(fit, found), paragraphs(&lines))
}

fn paragraphs(lines: &[String]) -> String {
    lines.iter().map(|line| format!("- {line}\n")).collect()
}

fn empty_table() -> Table {
    let mut table = Table::new();
    table.load_style(presets::ASCII_MARKDOWN);
    table
}

fn result_table(fit: &Fit<'_>, found: &Solution) -> Table {
    let mut table = empty_table();
    table.set_header([
        "parameter",
        "unit",
        "start",
        "found",
        "± standard error",
        "least squares",
        "second optimiser",
    ]);
    for (place, parameter) in fit.parameters.iter().enumerate() {
        let estimate = &found.statistics.estimates[place];
        let check = found.check.as_ref();
        let value = check.map(|check| check.optimum.values[place]);
        table.add_row([
            format!("{} ({})", parameter.symbol, parameter.key()),
            parameter.unit.to_owned(),
            significant(found.start[place], 4),
            significant(estimate.value, 5),
            format!(
                "{} ({:.2} %)",
                significant(estimate.standard_error, 2),
                percent(estimate.standard_error, estimate)
            ),
            significant(estimate.least_squares, 5),
            value.map_or_else(|| "failed".to_owned(), |value| significant(value, 5)),
        ]);
    }
    table
}

fn percent(part: f64, estimate: &Estimate) -> f64 {
    100.0 * part / estimate.value.abs()
}

fn search(fit: &Fit<'_>, found: &Solution) -> Vec<String> {
    let mut lines = Vec::new();
    if let Some((detour, origin)) = &found.descent.detour {
        let names: Vec<String> = fit
            .parameters
            .iter()
            .zip(origin)
            .map(|(parameter, value)| format!("{} {}", parameter.symbol, significant(*value, 3)))
            .collect();
        let why = match detour {
            Detour::NeverLifts => {
                "With the start values the load never lifts, so that the residual has no gradient there."
            }
            Detour::PoorFit => "From the start values the search ended in a poor fit.",
        };
        lines.push(format!(
            "{why} The search began at the best of points spread over the bounds instead: {}.",
            names.join(", ")
        ));
    }
    let iterations = found.descent.optimum.iterations;
    lines.push(if found.descent.optimum.has_converged {
        format!("Sequential quadratic programming converged after {iterations} iterations.")
    } else {
        format!(
            "WARNING: sequential quadratic programming did not converge in {iterations} iterations."
        )
    });
    if found.is_continued {
        lines.push(
            "Trust-region reflective least squares came lower, and sequential quadratic programming went on from there: the \
             residual has a long flat valley."
                .to_owned(),
        );
    }
    let other = found.check.as_ref().map(|check| check.checker);
    lines.push(match other.zip(found.disagreement()) {
        Some((other, distance)) if found.is_confirmed(fit) => format!(
            "Cross-check: {other} ends at the same point (largest distance {} standard errors).",
            significant(distance, 2)
        ),
        Some((other, distance)) => format!(
            "WARNING: {other} ends {} standard errors away; the optimum is not confirmed.",
            significant(distance, 2)
        ),
        None => "WARNING: the second optimiser failed; the optimum is not confirmed.".to_owned(),
    });
    for (parameter, estimate) in fit.parameters.iter().zip(&found.statistics.estimates) {
        let value = estimate.least_squares;
        let distance = (value - parameter.lower).min(parameter.upper - value);
        if distance < AT_BOUND * parameter.range() {
            lines.push(format!(
                "WARNING: {} ended at a bound ({} to {}); its standard error means nothing.",
                parameter.symbol, parameter.lower, parameter.upper
            ));
        }
    }
    lines
}

fn explanation(fit: &Fit<'_>, found: &Solution) -> String {
    let statistics = &found.statistics;
    let (residual, sensor) = (
        statistics.residual_metres_rms * 1e6,
        statistics.sensor_metres_rms * 1e6,
    );
    let numbers = format!(
        "The residual is {residual:.1} µm RMS, the sensor alone would leave {sensor:.1} µm"
    );
    let Some(worst) = statistics.worst_test() else {
        return format!("{numbers}: the model explains the data.");
    };
    let (size, limit) = (
        significant(worst.residual_metres_rms * 1e6, 3),
        significant(worst.sensor_metres_rms_max * 1e6, 3),
    );
    let of = if worst.averaged_seconds > 0.0 {
        format!("averages over {} s", worst.averaged_seconds)
    } else {
        "single positions".to_owned()
    };
    format!(
        "WARNING: {numbers}. The {of} of the residual have {size} µm RMS; in {REPLICAS} emulated measurements of the fitted motion \
         the sensor alone leaves {limit} µm at most. THE MODEL DOES NOT EXPLAIN THE DATA: the plant obeys another law or has \
         other known parameters. The values found are those that hide this best, not the plant's, and their standard errors say \
         nothing about the distance to them.{}",
        advice(fit)
    )
}

/// Returns the parameters to add: those that neither the current balance nor a temperature can replace.
fn advice(fit: &Fit<'_>) -> String {
    let symbols = fit.symbols();
    let all = MECHANICAL.into_iter();
    let more = Vec::from_iter(all.filter(|symbol| !symbols.contains(symbol)));
    if more.is_empty() {
        return String::new();
    }
    format!(
        " Damping (c) and stiffness (EA) can be sought too: `--parameters {}`.",
        [symbols, more].concat().join(",")
    )
}

/// Returns whether a standard error is small enough to call the parameter determined.
fn is_determined(unit: &str, estimate: &Estimate) -> bool {
    if unit == "°C" {
        estimate.standard_error <= DETERMINED_KELVINS
    } else {
        estimate.standard_error <= DETERMINED_PART * estimate.value.abs()
    }
}

fn undetermined(fit: &Fit<'_>, found: &Solution) -> Vec<String> {
    let mut lines = Vec::new();
    for (parameter, estimate) in fit.parameters.iter().zip(&found.statistics.estimates) {
        if !is_determined(parameter.unit, estimate) {
            lines.push(format!(
                "NOT DETERMINED: {} = {} ± {} {} ({:.0} %).",
                parameter.symbol,
                significant(estimate.value, 3),
                significant(estimate.standard_error, 2),
                parameter.unit,
                percent(estimate.standard_error, estimate)
            ));
        }
    }
    if lines.is_empty() {
        lines.push(format!(
            "All {} parameters are determined (standard errors within {:.0} %, temperatures within {DETERMINED_KELVINS} °C).",
            fit.parameters.len(),
            100.0 * DETERMINED_PART
        ));
    } else {
        lines.push("Add an excitation that separates them: current steps show the thermal time constant, a fan the convection.".to_owned());
    }
    lines.extend(weakest(fit, found));
    lines.extend(correlated(fit, found));
    lines
}

/// Returns the worst determined combinations, with their effect on the position.
fn weakest(fit: &Fit<'_>, found: &Solution) -> Vec<String> {
    let statistics = &found.statistics;
    let directions = statistics.directions.iter();
    let combinations = directions.zip(&statistics.singular_values_metres).rev();
    let mut lines: Vec<String> = combinations
        .zip(COMBINATIONS)
        .map(|((direction, metres), name)| combination(fit, name, direction, *metres))
        .collect();
    let values = &statistics.singular_values_metres;
    let [first, last] = [values.first(), values.last()].map(|end| end.copied().unwrap_or_default());
    lines.push(format!(
        "The residual has {} µm RMS. The singular values of the Jacobian span a factor of {}.",
        significant(statistics.residual_metres_rms * 1e6, 3),
        significant(first / last.max(f64::MIN_POSITIVE), 2)
    ));
    lines
}

fn combination(fit: &Fit<'_>, name: &str, direction: &[f64], singular_value_metres: f64) -> String {
    let largest = direction.iter().fold(0.0, |a: f64, b| a.max(b.abs()));
    let length = EXAMPLE_PART / largest.max(f64::MIN_POSITIVE);
    let parts = fit.parameters.iter().zip(direction);
    let changes: Vec<String> = parts
        .map(|(parameter, part)| format!("{} {:+.1} %", parameter.symbol, 100.0 * part * length))
        .collect();
    format!(
        "The {name} determined combination: {} together change the position by {} µm RMS.",
        changes.join(", "),
        significant(singular_value_metres * length * 1e6, 3)
    )
}

fn correlated(fit: &Fit<'_>, found: &Solution) -> Option<String> {
    let count = fit.parameters.len();
    let pairs = (0..count).flat_map(|row| (0..row).map(move |column| (row, column)));
    let named: Vec<String> = pairs
        .filter_map(|(row, column)| {
            let correlation = found.statistics.correlations[row][column];
            let symbols = (fit.parameters[column].symbol, fit.parameters[row].symbol);
            (correlation.abs() > CORRELATION_NAMED)
                .then(|| format!("{} and {} {correlation:+.3}", symbols.0, symbols.1))
        })
        .collect();
    (!named.is_empty()).then(|| {
        format!(
            "Strongly correlated, so that only a combination of them is well known: {}.",
            named.join(", ")
        )
    })
}

fn errors(fit: &Fit<'_>, found: &Solution) -> Vec<String> {
    let mut lines = vec![
        "The standard errors allow for residuals that depend on their neighbours within 1 s (Newey and West) and for the steps of \
         the sensor; they hold where the model explains the data."
            .to_owned(),
    ];
    if let Some(given) = given_scale(fit) {
        lines.push(given);
    }
    let ratios = found
        .statistics
        .estimates
        .iter()
        .map(|estimate| estimate.standard_error / estimate.standard_error_if_independent);
    let ratio = ratios.fold(0.0, f64::max);
    if ratio > DEPENDENCE_NAMED {
        lines.push(format!(
            "The usual formula, σ² (JᵀJ)⁻¹, takes them as independent and would be up to {ratio:.1} times too small."
        ));
    }
    lines.extend(shift_warning(fit, found));
    lines
}

/// Returns the reminder that one scale of the heat balance is given, unless it is sought. Eq. (1) divided by `m cp` has
/// `R`, `C` and `h` over `m cp` only.
fn given_scale(fit: &Fit<'_>) -> Option<String> {
    let symbols = fit.symbols();
    let scales = SCALES.into_iter();
    let given = Vec::from_iter(scales.filter(|symbol| !symbols.contains(symbol)));
    (!given.is_empty()).then(|| {
        format!(
            "The standard errors hold for the given {}: no recording of positions shows the scale of the heat. Twice the c_p, R, C \
             and h give the same motion.",
            given.join(" and ")
        )
    })
}

/// Returns whether quantisation shifts an estimate beyond the usual standard error, by a relevant amount.
fn is_shifted(estimate: &Estimate) -> bool {
    let shift = estimate.sensor_shift.abs();
    shift > estimate.standard_error_if_independent && shift > SHIFT_NAMED * estimate.value.abs()
}

/// Returns a warning if quantisation shifts an estimate by more than the usual standard error.
fn shift_warning(fit: &Fit<'_>, found: &Solution) -> Option<String> {
    let estimates = fit.parameters.iter().zip(&found.statistics.estimates);
    let shifted: Vec<String> = estimates
        .filter(|(_, estimate)| is_shifted(estimate))
        .map(|(parameter, estimate)| {
            format!(
                "{} by {} ({:+.2} %)",
                parameter.symbol,
                significant(estimate.sensor_shift, 2),
                percent(estimate.sensor_shift, estimate)
            )
        })
        .collect();
    let remedy = if found.statistics.is_corrected {
        "The values found are corrected by this; the standard errors still hold without the correction."
    } else {
        "The standard errors allow for it; the values are not corrected."
    };
    (!shifted.is_empty()).then(|| {
        format!(
            "WARNING: quantisation biases the least squares by more than the usual standard errors: measuring the fitted motion with \
             this sensor and fitting again moves {}. {remedy}",
            shifted.join(", ")
        )
    })
}

fn correlation_table(fit: &Fit<'_>, found: &Solution) -> Table {
    let mut table = empty_table();
    table.set_header(std::iter::once("").chain(fit.symbols()));
    for (parameter, row) in fit.parameters.iter().zip(&found.statistics.correlations) {
        let cells = row.iter().map(|correlation| format!("{correlation:+.3}"));
        table.add_row(std::iter::once(parameter.symbol.to_owned()).chain(cells));
    }
    table
}

/// Formats a number with the given significant digits, without an exponent if possible.
fn significant(value: f64, digits: i32) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let magnitude = libm::floor(libm::log10(value.abs()));
    if !(-5.0..6.0).contains(&magnitude) {
        return format!("{value:.*e}", usize::try_from(digits - 1).unwrap_or(0));
    }
    #[expect(clippy::cast_possible_truncation, reason = "between −5 and 6")]
    let decimals = digits - 1 - magnitude as i32;
    format!("{value:.*}", usize::try_from(decimals).unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_their_digits() {
        let texts =
            [0.255, 93.0, 7.5e10, -0.000_123_4, 0.0, 2e-5].map(|value| significant(value, 3));
        assert_eq!(
            texts,
            ["0.255", "93.0", "7.50e10", "-0.000123", "0", "0.0000200"]
        );
    }

    #[test]
    fn a_temperature_is_judged_in_degrees_and_the_rest_in_percent() {
        let estimate = |value, standard_error| Estimate {
            value,
            standard_error,
            least_squares: value,
            standard_error_if_independent: 0.0,
            sensor_shift: 0.0,
        };
        assert!(is_determined("°C", &estimate(0.5, 0.9)));
        assert!(!is_determined("°C", &estimate(100.0, 2.0)));
        assert!(is_determined("W/(m K)", &estimate(0.255, 0.01)));
        assert!(!is_determined("W/(m K)", &estimate(0.255, 0.07)));
    }
}
