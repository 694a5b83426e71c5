//! The verdict as a table for the terminal.

use std::path::Path;

use scenario::expect::Limit;
use scenario::metrics;

use crate::table::{Cell, Table, Text};
use crate::viewer::INSTALL;
use judge::timing::Timing;
use judge::verdict::{Metric, Outcome, Tries, Verdict};
use recording::run_folder::file;

/// Returns the text of a verdict: name, table, outcome and reason.
pub fn verdict(verdict: &Verdict) -> Text {
    with_outcome(verdict, verdict.remark())
}

/// Returns a verdict in one line.
pub fn line(verdict: &Verdict) -> String {
    let outcome = outcome_text(verdict, verdict.remark());
    format!("{}: {outcome}", verdict.scenario)
}

fn outcome_text(verdict: &Verdict, remark: Option<String>) -> String {
    let tries = verdict.tries.as_ref().map(tries);
    let tries = tries.map_or_else(String::new, |tries| format!(" ({tries})"));
    let remark = remark.map_or_else(String::new, |remark| format!(": {remark}"));
    format!("{}{tries}{remark}", verdict.outcome.word())
}

/// Returns the outcome with the values that have limits, or those that missed their limits, in one
/// line.
pub fn values(verdict: &Verdict) -> String {
    let limited = verdict.metrics.iter().filter(|row| row.limit.is_some());
    let missed = limited.clone().filter(|row| row.passed == Some(false));
    let values = match verdict.outcome {
        Outcome::Fail => Vec::from_iter(missed.map(self::missed)),
        _ => Vec::from_iter(limited.map(|row| format!("{} {}", row.name, measured(row)))),
    };
    let reason = verdict.remark().into_iter();
    let outcome = verdict.outcome.word().to_owned();
    let all = [outcome].into_iter().chain(reason).chain(values);
    Vec::from_iter(all).join(" · ")
}

/// Describes the earlier plays: `try 2 of 3; try 1: stalls; settling_time_seconds 0.3100, limit ≤
/// 0.2`.
pub(crate) fn tries(tries: &Tries) -> String {
    let earlier = (1..).zip(&tries.earlier).map(|(number, play)| {
        let beyond = play.beyond.iter().map(|row| {
            let limit = limit(&row.name, row.limit);
            format!("; {} {}, limit {limit}", row.name, measured(row))
        });
        format!("; try {number}: stalls{}", Vec::from_iter(beyond).concat())
    });
    let earlier = Vec::from_iter(earlier).concat();
    format!("try {} of {}{earlier}", tries.number, tries.max)
}

fn with_outcome(verdict: &Verdict, remark: Option<String>) -> Text {
    let mut text = Text::default();
    text.line(format!("\n{}", verdict.scenario));
    if !verdict.metrics.is_empty() {
        text.table(&table(verdict));
    }
    for loss in &verdict.losses {
        text.line(loss);
    }
    if let Some(timing) = &verdict.timing {
        add_timing(&mut text, timing);
    }
    text.line(outcome_text(verdict, remark));
    text
}

/// Returns the text of a run: name, table, outcome, and the folder.
pub fn run(verdict: &Verdict, folder: &Path) -> Text {
    // The reason of a run that broke off was printed as an error already.
    let remark = verdict
        .remark()
        .filter(|_| verdict.outcome != Outcome::Incomplete);
    let mut text = with_outcome(verdict, remark);
    text.line(format!("run folder  {}", folder.display()));
    let [page, recording] = [file::REPORT, file::RERUN].map(|name| folder.join(name));
    if page.exists() {
        text.line(format!("look at it  {}", page.display()));
    }
    if recording.exists() {
        text.line(format!(
            "in Rerun    rerun {}   (viewer: {INSTALL})",
            recording.display()
        ));
    }
    text
}

/// Returns one line for each of several runs.
pub fn summary(verdicts: &[Verdict]) -> Text {
    let mut table = Table::new(["scenario", "limits", "result"]);
    for verdict in verdicts {
        let metrics = || verdict.metrics.iter();
        let limited = metrics().filter(|metric| metric.limit.is_some()).count();
        let passed = metrics()
            .filter(|metric| metric.limit.is_some() && metric.passed == Some(true))
            .count();
        table.add([
            Cell::new(&verdict.scenario),
            Cell::new(format!("{passed} of {limited} met")),
            outcome(verdict.outcome),
        ]);
    }
    let mut text = Text::default();
    text.line("");
    text.table(&table);
    text
}

/// Returns the cell of an outcome.
pub fn outcome(outcome: Outcome) -> Cell {
    let cell = Cell::new(outcome.word());
    match outcome {
        Outcome::Pass => cell.good(),
        Outcome::Fail | Outcome::Incomplete => cell.bad(),
        Outcome::Inconclusive => cell.unsure(),
    }
}

/// Returns the table of one run's metrics with their limits.
fn table(verdict: &Verdict) -> Table {
    let mut table = Table::new(["metric", "measured", "limit", "result"]);
    for metric in &verdict.metrics {
        table.add([
            Cell::new(&metric.name),
            Cell::number(measured(metric)),
            Cell::new(limit(&metric.name, metric.limit)),
            result(metric, verdict.outcome),
        ]);
    }
    table
}

/// Adds a table of latencies and latenesses in microseconds, with the losses, and the reasons to distrust it.
fn add_timing(text: &mut Text, timing: &Timing) {
    let mut table = Table::new(["microseconds", "median", "p99", "p99.9", "max"]);
    for (name, quantiles) in timing.rows() {
        let values = quantiles
            .values()
            .map(|value| Cell::number(format!("{value:.0}")));
        table.add([Cell::new(name)].into_iter().chain(values));
    }
    text.table(&table);
    text.line(timing.losses());
    for reason in &timing.distrust {
        text.line(format!("the timing is not trusted: {reason}"));
    }
}

/// Returns the value of a metric, or the reason why there is none, and its time.
pub fn measured(metric: &Metric) -> String {
    let measured = match (metric.value, &metric.remark) {
        (Some(measured), _) => value(&metric.name, measured),
        (None, Some(remark)) => remark.clone(),
        (None, None) => "–".to_owned(),
    };
    match metric.at_seconds {
        Some(time) => format!("{measured} at {time:.3} s"),
        None => measured,
    }
}

/// Returns a metric with its value and the limit that it missed: `overshoot_percent 2.500 (limit ≤ 2.4)`.
pub(crate) fn missed(metric: &Metric) -> String {
    let limit = limit(&metric.name, metric.limit);
    format!("{} {}", metric.name, with_limit(&measured(metric), &limit))
}

/// Returns a value with its limit: `2.500 (limit ≤ 2.4)`.
pub fn with_limit(value: &str, limit: &str) -> String {
    format!("{value} (limit {limit})")
}

/// Returns the value of a metric in a run of a sweep, in which it may have none although it is limited.
pub fn reached(name: &str, reached: Option<f64>) -> String {
    reached.map_or_else(|| "never".to_owned(), |reached| value(name, reached))
}

/// Returns the value of a metric as a text: a number, or yes or no.
pub fn value(name: &str, value: f64) -> String {
    answer(name, value).map_or_else(|| significant(value), str::to_owned)
}

/// Returns yes or no, if the metric of this name is an answer.
pub(crate) fn answer(name: &str, value: f64) -> Option<&'static str> {
    let text = |is_yes| if is_yes { "yes" } else { "no" };
    metrics::answer(name, value).map(text)
}

/// Writes a number with four digits; with a power of ten if it would be long otherwise, or have no digits but zeros.
pub fn significant(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let decimals: usize = match value.abs() {
        v if (LONG_FROM..f64::INFINITY).contains(&v) || v < 1e-3 => return power_of_ten(value),
        v if v >= 1000.0 => 0,
        v if v >= 100.0 => 1,
        v if v >= 10.0 => 2,
        v if v >= 1.0 => 3,
        v if v >= 0.1 => 4,
        v if v >= 0.01 => 5,
        _ => 6,
    };
    let mut text = format!("{value:.decimals$}");
    // A small number need not end in zeros.
    let shortest = text.len() - decimals.saturating_sub(4);
    text.truncate(text.trim_end_matches('0').len().max(shortest));
    with_minus(text)
}

/// Writes a number with at most four digits, for a round number such as a tolerance: `0.25`.
pub fn rounded(value: f64) -> String {
    let text = significant(value);
    if text.contains('.') && !text.contains('e') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

/// Returns a number with a minus sign, which is wider than a hyphen.
pub fn with_minus(number: String) -> String {
    match number.strip_prefix('-') {
        Some(rest) => format!("−{rest}"),
        None => number,
    }
}

/// Least number that is shown with a power of ten.
const LONG_FROM: f64 = 1e7;

/// Writes a number as `6e10` or `1.235e−6`.
fn power_of_ten(value: f64) -> String {
    let text = format!("{value:.3e}");
    let (digits, power) = text.split_once('e').unwrap_or((&text, "0"));
    let digits = digits.trim_end_matches('0').trim_end_matches('.');
    with_minus(format!("{digits}e{}", with_minus(power.to_owned())))
}

/// Writes a number as a file has it, with a power of ten if it is long.
pub fn as_written(value: f64) -> String {
    if value.abs() >= LONG_FROM && value.is_finite() {
        format!("{value:e}")
    } else {
        value.to_string()
    }
}

/// Returns the limit of a metric as a text; empty without a limit.
pub fn limit(name: &str, limit: Option<Limit>) -> String {
    let Some(limit) = limit else {
        return String::new();
    };
    if let Some(wanted) = limit.min.and_then(|wanted| answer(name, wanted)) {
        return wanted.to_owned();
    }
    let [min, max] = [limit.min, limit.max].map(|end| end.map(as_written).map(with_minus));
    match (min, max) {
        (Some(min), Some(max)) => format!("{min} … {max}"),
        (Some(min), None) => format!("≥ {min}"),
        (None, Some(max)) => format!("≤ {max}"),
        (None, None) => String::new(),
    }
}

/// Returns the cell that says whether a limit was met.
pub fn result(metric: &Metric, outcome: Outcome) -> Cell {
    match (metric.passed, outcome) {
        (None, _) if metric.limit.is_some() => Cell::new("not judged").unsure(),
        (None, _) => Cell::new(""),
        (Some(_), Outcome::Inconclusive) => Cell::new("not judged").unsure(),
        (Some(true), _) => Cell::new("pass").good(),
        (Some(false), _) => Cell::new("FAIL").bad().bold(),
    }
}

/// Returns a timing whose quantiles of the round trip are 11, 22, 33 and 44 µs, with external nodes only.
#[cfg(test)]
pub(crate) fn made_up_timing() -> Timing {
    use recording::latency::Quantiles;

    Timing {
        controller: None,
        plant_emulator: None,
        sync_to_position_microseconds: Quantiles::default(),
        position_to_command_microseconds: Quantiles::default(),
        round_trip_microseconds: Quantiles {
            median: 11.0,
            p99: 22.0,
            p99_9: 33.0,
            max: 44.0,
        },
        distrust: Vec::new(),
        on_this_machine: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use scenario::expect::Limit;

    use super::*;

    #[test]
    fn a_row_shows_value_limit_and_result() {
        let limit = Some(Limit {
            min: None,
            max: Some(0.23),
        });
        let mut verdict = Verdict::incomplete("step", 1, "");
        verdict.outcome = Outcome::Fail;
        verdict.metrics = vec![Metric::new(
            "settling_time_seconds",
            Err("never settled".to_owned()),
            limit,
        )];
        let text = table(&verdict).to_string();
        assert!(text.contains("settling_time_seconds"), "{text}");
        assert!(
            text.contains("never settled") && text.contains("≤ 0.23") && text.contains("FAIL"),
            "{text}"
        );
    }

    #[test]
    fn an_answer_is_shown_as_yes_or_no() {
        let exactly = |value| Limit {
            min: Some(value),
            max: Some(value),
        };
        let cells = |name: &str, value: Result<f64, String>, wanted: f64| {
            let metric = Metric::new(name, value, Some(exactly(wanted)));
            [measured(&metric), limit(name, metric.limit)]
        };
        assert_eq!(cells("safe_state", Ok(1.0), 1.0), ["yes", "yes"]);
        assert_eq!(cells("safe_state", Ok(1.0), 0.0), ["yes", "no"]);
        assert_eq!(cells("no_event", Ok(0.0), 0.0), ["yes", "yes"]);
        let missing = Err("drive 0x8130 is missing".to_owned());
        assert_eq!(
            cells("emcy", missing, 0.0),
            ["drive 0x8130 is missing", "yes"]
        );
        assert_eq!(cells("sine_gain", Ok(1.0), 1.0), ["1.000", "1 … 1"]);
    }

    #[test]
    fn numbers_have_four_digits_however_large_or_small() {
        let shown = [
            6e10, 1.234_56e7, 123_456.0, 35.041, 0.156, 0.032_146, 0.003, 1.2e-6, -3e12, 0.0,
        ]
        .map(significant);
        let expected = [
            "6e10", "1.235e7", "123456", "35.04", "0.1560", "0.03215", "0.0030", "1.2e−6", "−3e12",
            "0",
        ];
        assert_eq!(shown, expected);
        let tolerances = [5.0, 0.25, 0.132_56, 20.0, 100_000.0, 0.0].map(rounded);
        assert_eq!(tolerances, ["5", "0.25", "0.1326", "20", "100000", "0"]);
        let below = Some(Limit {
            min: None,
            max: Some(6e10),
        });
        assert_eq!(limit("position_millimetres_max", below), "≤ 6e10");
    }

    #[test]
    fn each_quantile_is_under_its_name() {
        let mut text = Text::default();
        add_timing(&mut text, &made_up_timing());
        let text = text.to_string();
        let cells = |start: &str| {
            let line = text.lines().find(|line| line.contains(start)).unwrap();
            let cells = line.split(['│', '┆']).map(str::trim);
            cells
                .filter(|cell| !cell.is_empty())
                .collect::<Vec<_>>()
                .join(" ")
        };
        assert_eq!(cells("microseconds"), "microseconds median p99 p99.9 max");
        assert_eq!(cells("round trip"), "round trip 11 22 33 44");
    }
}
