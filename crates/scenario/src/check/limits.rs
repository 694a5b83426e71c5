//! Checks that each expectation can be judged.

use super::Check;
use crate::document::Document;
use crate::error::Problem;
use crate::expect::{Emergency, Expect, Limit};
use crate::metrics::{Form, Metric, Needs};
use crate::nearest::meant_or_known;
use crate::trial::Trial;

/// Checks that each limit can be met, and that the scenario has what its metric needs. Without all disturbances it does not know
/// which ones act on the loop.
pub(crate) fn limits(check: &mut Check<'_>, trial: &Trial, has_all_disturbances: bool) {
    let document = check.document;
    check.add(end_problem(document, trial));
    let two_sided = |(metric, _): &(&Metric, Limit)| metric.form == Form::TwoSided;
    for (metric, limit) in trial.expect.limits().filter(two_sided) {
        let (name, path) = (metric.name, format!("expect.{}", metric.name));
        check.add(limit_problem(document, &path, name, limit).or_else(|| {
            let is_known = has_all_disturbances || metric.needs != Needs::Disturbance;
            let missing = missing_for(metric, trial).filter(|_| is_known)?;
            let message = cannot_be_judged(name, trial);
            Some(document.problem(&path, message, format!("needs {missing}")))
        }));
    }
}

/// Checks that each limit on the bus can be met.
pub(super) fn of_bus(check: &mut Check<'_>, expect: &Expect) {
    let on_metrics = expect.limits();
    let metrics = on_metrics.map(|(metric, limit)| (metric.name.to_owned(), limit));
    let on_timing = expect.timing.limits();
    let timing = on_timing.map(|(path, limit)| (format!("timing.{path}"), limit));
    for (name, limit) in metrics.chain(timing) {
        let path = format!("expect.{name}");
        check.add(limit_problem(check.document, &path, &name, limit));
    }
}

fn cannot_be_judged(metric: &str, trial: &Trial) -> String {
    match trial.wiring.loop_among_several() {
        "" => format!("`{metric}` cannot be judged"),
        name => format!("`{metric}` of the loop `{name}` cannot be judged"),
    }
}

/// Refuses a limit that no value meets, or that every value meets.
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

/// Refuses an end of the judgement after the end of the run.
fn end_problem(document: &Document<'_>, trial: &Trial) -> Option<Problem> {
    let end_seconds = trial.judged_end_seconds();
    (end_seconds > trial.run.duration_seconds).then(|| {
        let label = format!("the run ends at {} s", trial.run.duration_seconds);
        let path = "expect.judged_until_seconds";
        document.problem(path, "the judgement ends after the run", label)
    })
}

/// Returns the part that the scenario lacks for a metric, up to the end of the judgement.
fn missing_for(metric: &Metric, trial: &Trial) -> Option<String> {
    let missing = metric.missing_in(trial)?;
    let end_seconds = trial.expect.judged_until_seconds;
    let before = end_seconds.map(|end| format!(" before judged_until_seconds = {end}"));
    Some(format!("{missing}{}", before.unwrap_or_default()))
}

/// Refuses an emergency that has another form, or that comes from no node of the rig.
pub(super) fn emergency(check: &Check<'_>, path: &str, text: &str) -> Option<Problem> {
    let Check { document, rig, .. } = check;
    match text.parse::<Emergency>() {
        Err(reason) => {
            let message = format!("\"{text}\" names no emergency");
            Some(document.problem(path, message, reason))
        }
        Ok(Emergency { node, .. }) if !rig.node.contains_key(&node) => {
            let message = format!("the rig has no node `{node}`");
            Some(document.problem(path, message, meant_or_known(&node, rig.node.keys())))
        }
        Ok(_) => None,
    }
}

/// Checks the demanded reactions: there is a fault, and emergencies have numbers of the standard.
pub(crate) fn reactions(check: &mut Check<'_>, trial: &Trial) {
    let (document, expect) = (check.document, &trial.expect);
    let of_faults = [Needs::Fault, Needs::FaultAndSetPoint];
    let demanded = expect.limits();
    for (metric, _) in demanded.filter(|(metric, _)| of_faults.contains(&metric.needs)) {
        let name = metric.name;
        let needs = |what: &str| {
            let message = cannot_be_judged(name, trial);
            document.problem(&format!("expect.{name}"), message, format!("needs {what}"))
        };
        check.add(metric.missing_in(trial).map(needs));
        let has_fault = match metric.needs {
            Needs::FaultAndSetPoint => trial.position_faults().next().is_some(),
            _ => trial.has_loop_faults(),
        };
        if !has_fault {
            check.add([needs("a [[fault.…]] of this loop")]);
        }
    }
    for (index, text) in expect.listed("emcy").iter().enumerate() {
        let path = format!("expect.emcy.{index}");
        check.add(emergency(check, &path, text));
    }
}
