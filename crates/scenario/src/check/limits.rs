//! Checks that what is expected can be judged.

use crate::document::Document;
use crate::error::Problem;
use crate::expect::{Emergency, Limit};
use crate::scenario::Scenario;

/// Limits that can be met, on metrics that the scenario has.
pub(super) fn limits(document: &Document<'_>, scenario: &Scenario) -> Vec<Problem> {
    let mut problems = Vec::from_iter(end_problem(document, scenario));
    let timing = scenario.expect.timing.limits();
    let limits = scenario
        .expect
        .limits()
        .map(|(name, limit)| (name.to_owned(), limit));
    for (name, limit) in limits.chain(timing.map(|(path, limit)| (format!("timing.{path}"), limit)))
    {
        let path = format!("expect.{name}");
        problems.extend(limit_problem(document, &path, &name, limit).or_else(|| {
            let missing = missing_for(&name, scenario)?;
            let message = format!("`{name}` cannot be judged");
            Some(document.problem(&path, message, format!("needs {missing}")))
        }));
    }
    problems
}

/// A limit that no value or every value meets.
pub(super) fn limit_problem(
    document: &Document<'_>,
    path: &str,
    name: &str,
    limit: Limit,
) -> Option<Problem> {
    let (message, label) = match (limit.min, limit.max) {
        (None, None) => (
            format!("the limit `{name}` is empty"),
            "give min, max or both".to_owned(),
        ),
        (Some(min), Some(max)) if min > max => (
            format!("no value meets the limit `{name}`"),
            format!("min {min} is above max {max}"),
        ),
        _ => return None,
    };
    Some(document.problem(path, message, label))
}

/// A judgement that ends after the run.
fn end_problem(document: &Document<'_>, scenario: &Scenario) -> Option<Problem> {
    let end_seconds = scenario.judged_end_seconds();
    (end_seconds > scenario.duration_seconds).then(|| {
        let label = format!("the run ends at {} s", scenario.duration_seconds);
        let path = "expect.judged_until_seconds";
        document.problem(path, "the judgement ends after the run", label)
    })
}

/// What the scenario lacks for a metric, up to the end of what is judged.
fn missing_for(metric: &str, scenario: &Scenario) -> Option<String> {
    let missing = missing_piece(metric, scenario)?;
    let end_seconds = scenario.expect.judged_until_seconds;
    let before = end_seconds.map(|end| format!(" before judged_until_seconds = {end}"));
    Some(format!("{missing}{}", before.unwrap_or_default()))
}

fn missing_piece(metric: &str, scenario: &Scenario) -> Option<&'static str> {
    let end_seconds = scenario.judged_end_seconds();
    match metric {
        "settling_time_seconds" | "overshoot_percent" if scenario.judged_steps().is_empty() => {
            Some("a [[reference.step]]")
        }
        "steady_state_error_millimetres"
        | "tracking_error_millimetres_rms"
        | "current_ripple_amperes_rms"
        | "hunting_millimetres"
            if scenario.reference.is_empty() =>
        {
            Some("a [[reference.…]]")
        }
        "sine_gain" | "sine_phase_degrees" | "sine_offset_millimetres"
            if scenario.judged_sines().is_empty() =>
        {
            Some("a [[reference.sine]] of at least four periods")
        }
        "bandwidth_hertz" if scenario.judged_chirps().is_empty() => {
            Some("a [[reference.chirp]] of at least four turns")
        }
        "maximum_deviation_millimetres" | "recovery_time_seconds"
            if !(scenario.disturbance_windows().iter())
                .any(|disturbance| disturbance.window.from_seconds < end_seconds) =>
        {
            Some("a [[disturbance.…]]")
        }
        "maximum_deviation_millimetres" | "recovery_time_seconds"
            if scenario.reference.is_empty() =>
        {
            Some("a [[reference.…]]")
        }
        _ => None,
    }
}

/// Reactions that can be demanded: there is a fault, and emergencies are named as the standard numbers them.
pub(super) fn reactions(document: &Document<'_>, scenario: &Scenario) -> Vec<Problem> {
    let expect = &scenario.expect;
    let mut problems = Vec::new();
    let demanded = [
        (
            "current_zero_within_milliseconds",
            expect.current_zero_within_milliseconds.is_some(),
        ),
        (
            "recovers_within_seconds",
            expect.recovers_within_seconds.is_some(),
        ),
        ("safe_state", expect.safe_state.is_some()),
        ("emcy", !expect.emcy.is_empty()),
    ];
    for (name, _) in demanded.into_iter().filter(|(_, is_given)| *is_given) {
        if scenario.fault.is_empty() {
            let message = format!("`{name}` cannot be judged");
            let path = format!("expect.{name}");
            let problem = document.problem(&path, message, "needs a [[fault.…]] of this drive");
            problems.push(match document.has("fault") {
                true => problem.with_help("what another drive's fault does to this one is judged by an [[expect.….sequence]]"),
                false => problem,
            });
        }
    }
    for (index, text) in expect.emcy.iter().enumerate() {
        if let Err(reason) = text.parse::<Emergency>() {
            let message = format!("\"{text}\" names no emergency");
            let path = format!("expect.emcy.{index}");
            problems.push(document.problem(&path, message, reason));
        }
    }
    if expect.recovers_within_seconds.is_some() && scenario.reference.is_empty() {
        let message = "`recovers_within_seconds` cannot be judged";
        let path = "expect.recovers_within_seconds";
        problems.push(document.problem(path, message, "needs a [[reference.…]]"));
    }
    problems
}
