//! `junit.xml`: one test case for each limit, for CI systems.

use quick_junit::{NonSuccessKind, Property, Report, TestCase, TestCaseStatus, TestSuite};

use crate::terminal::answer;
use judge::verdict::{Metric, Outcome, SpoiledPlay, Verdict};
use platform::terminal::printable;

/// Returns the report of one or several runs.
///
/// # Errors
/// The XML cannot be written.
pub fn to_xml(verdicts: &[Verdict]) -> Result<String, quick_junit::SerializeError> {
    let mut report = Report::new("canrig");
    report.add_test_suites(verdicts.iter().map(suite));
    report.to_string()
}

fn suite(verdict: &Verdict) -> TestSuite {
    // XML has no form for most control characters, and the library drops the text of an escape sequence with them.
    let class = printable(&verdict.scenario);
    let mut suite = TestSuite::new(&*class);
    suite.add_property(("version", &*printable(&verdict.version)));
    suite.add_property(("seed", verdict.seed.to_string().as_str()));
    suite.add_properties(properties(&verdict.requirements));
    let earlier = verdict.tries.iter().flat_map(|tries| &tries.earlier);
    for (number, play) in (1..).zip(earlier) {
        suite.add_properties(earlier_play(number, play));
    }
    let metrics = verdict.metrics.iter();
    let limited = metrics.filter(|metric| metric.limit.is_some());
    suite.add_test_cases(limited.map(|metric| case(&class, metric, verdict.outcome)));
    suite.add_test_case(run_case(&class, verdict));
    suite
}

/// Returns the properties of a play that stalls spoiled: its outcome with the reason, its folder,
/// and its values beyond their limits.
fn earlier_play(number: u32, play: &SpoiledPlay) -> Vec<Property> {
    let property = |name: &str, value: &str| {
        let name = format!("try {number}{name}");
        Property::new(&*printable(&name), &*printable(value))
    };
    let outcome = format!("{}: {}", Outcome::Inconclusive.word(), play.reason);
    let beyond = play.beyond.iter();
    let values = beyond.map(|row| property(&format!(": {}", row.name), &measured(row)));
    let [outcome, folder] = [("", outcome.as_str()), (": run folder", &play.folder)]
        .map(|(name, value)| property(name, value));
    [outcome, folder].into_iter().chain(values).collect()
}

/// Returns the run itself as a case, so that a run without limits or without an end appears.
fn run_case(class: &str, verdict: &Verdict) -> TestCase {
    let reason = verdict.reason.clone().unwrap_or_default();
    let status = match verdict.outcome {
        // The rows name the limits that were not met.
        Outcome::Fail if !reason.is_empty() => problem(NonSuccessKind::Failure, &reason),
        Outcome::Pass if verdict.judged_nothing() => {
            let mut skipped = TestCaseStatus::skipped();
            skipped.set_message(verdict.remark().unwrap_or_default());
            skipped
        }
        Outcome::Pass | Outcome::Fail => TestCaseStatus::success(),
        Outcome::Inconclusive | Outcome::Incomplete => problem(NonSuccessKind::Error, &reason),
    };
    let mut case = named("run", class, status);
    if !verdict.losses.is_empty() {
        case.set_system_out(&*printable(&verdict.losses.join("\n")));
    }
    case
}

fn case(class: &str, metric: &Metric, outcome: Outcome) -> TestCase {
    let status = match (outcome, metric.passed) {
        (Outcome::Inconclusive, _) => problem(NonSuccessKind::Error, "inconclusive"),
        (_, Some(true)) => TestCaseStatus::success(),
        (_, None) => problem(NonSuccessKind::Error, "not judged"),
        _ => problem(NonSuccessKind::Failure, &message(metric)),
    };
    let mut case = named(&metric.name, class, status);
    case.add_properties(properties(&metric.requirements));
    case
}

/// Returns one property for each requirement, as test management tools read them.
fn properties(requirements: &[String]) -> Vec<Property> {
    let property = |name: &String| Property::new("requirement", &*printable(name));
    requirements.iter().map(property).collect()
}

fn named(name: &str, class: &str, status: TestCaseStatus) -> TestCase {
    let mut case = TestCase::new(&*printable(name), status);
    case.set_classname(class);
    case
}

fn problem(kind: NonSuccessKind, message: &str) -> TestCaseStatus {
    let mut status = TestCaseStatus::non_success(kind);
    status.set_message(&*printable(message));
    status
}

fn message(metric: &Metric) -> String {
    format!("{}: {}", metric.name, measured(metric))
}

/// Returns the measured value, its time and its limit.
fn measured(metric: &Metric) -> String {
    let shown = |value: f64| match answer(&metric.name, value) {
        Some(answer) => answer.to_owned(),
        None => value.to_string(),
    };
    let measured = match (metric.value, &metric.remark) {
        (Some(value), _) => format!("measured {}", shown(value)),
        (None, Some(remark)) => remark.clone(),
        (None, None) => "not measured".to_owned(),
    };
    let when = metric
        .at_seconds
        .map(|time| format!(" at {time} s"))
        .unwrap_or_default();
    format!("{measured}{when}, limit {}", limit(metric))
}

/// Returns both sides of the limit, or the wanted answer.
fn limit(metric: &Metric) -> String {
    let limit = metric.limit.unwrap_or_default();
    if let Some(wanted) = limit.min.and_then(|wanted| answer(&metric.name, wanted)) {
        return wanted.to_owned();
    }
    let sides = [("min", limit.min), ("max", limit.max)]
        .into_iter()
        .filter_map(|(side, value)| value.map(|value| format!("{side} {value}")));
    sides.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use scenario::expect::Limit;

    use super::*;

    /// Returns whether a document of XML 1.0 may hold the character, also in the attributes that canrig writes.
    fn is_xml(character: char) -> bool {
        matches!(character, '\t' | '\n' | ' '..='\u{d7ff}' | '\u{e000}'..='\u{fffd}' | '\u{10000}'..)
    }

    proptest! {
        #[test]
        fn whatever_the_names_are_the_report_is_xml_that_holds_them(
            [scenario, name, remark, requirement, loss, reason] in any::<[String; 6]>(),
            outcome in 0..4_usize,
        ) {
            use Outcome::{Fail, Incomplete, Inconclusive, Pass};
            let limit = Some(Limit { min: None, max: Some(1.0) });
            let verdict = Verdict {
                outcome: [Pass, Fail, Inconclusive, Incomplete][outcome],
                losses: vec![loss],
                requirements: vec![requirement],
                metrics: vec![Metric::new(name.clone(), Err(remark), limit)],
                ..Verdict::incomplete(&scenario, 1, &reason)
            };
            let xml = to_xml(&[verdict]).unwrap();
            prop_assert!(xml.chars().all(is_xml), "{xml:?}");
            let read = Report::deserialize_from_str(&xml).unwrap();
            let suite = &read.test_suites[0];
            // A reader turns white space in attributes into spaces.
            let spaces = |text: &str| text.replace(['\n', '\t'], " ");
            prop_assert_eq!(spaces(suite.name.as_str()), spaces(&printable(&scenario)));
            prop_assert_eq!(spaces(suite.test_cases[0].name.as_str()), spaces(&printable(&name)));
        }
    }

    #[test]
    fn a_failed_limit_is_a_failure_with_its_numbers() {
        let limit = Some(Limit {
            min: None,
            max: Some(0.23),
        });
        let mut verdict = Verdict::incomplete("step", 1, "");
        verdict.outcome = Outcome::Fail;
        verdict.metrics = vec![Metric::new("settling_time_seconds", Ok(0.5), limit)];
        verdict.requirements = vec!["REQ-1".to_owned()];
        verdict.metrics[0].requirements = vec!["REQ-2".to_owned()];
        let xml = to_xml(&[verdict]).unwrap();
        assert!(
            xml.contains("settling_time_seconds: measured 0.5, limit max 0.23"),
            "{xml}"
        );
        assert!(xml.contains("failures=\"1\""), "{xml}");
        let (suite, case) = xml.split_once("<testcase").unwrap();
        let property = |name: &str| format!("<property name=\"requirement\" value=\"{name}\"/>");
        assert!(suite.contains(&property("REQ-1")), "{xml}");
        assert!(case.contains(&property("REQ-2")), "{xml}");
    }

    #[test]
    fn a_node_that_ended_the_run_is_a_failure_of_the_run() {
        let mut verdict = Verdict::incomplete("step", 1, "controller: silent since 3.012 s");
        verdict.outcome = Outcome::Fail;
        let xml = to_xml(&[verdict]).unwrap();
        let failure = "<failure message=\"controller: silent since 3.012 s\"";
        assert!(xml.contains(failure), "{xml}");
    }

    #[test]
    fn an_answer_is_yes_or_no() {
        let limit = Some(Limit {
            min: Some(1.0),
            max: Some(1.0),
        });
        let metric = Metric::new("safe_state", Ok(0.0), limit);
        assert_eq!(message(&metric), "safe_state: measured no, limit yes");
    }

    /// A limit that was not judged is not met, whatever the outcome of the run.
    #[test]
    fn what_was_not_judged_is_an_error() {
        let limit = Some(Limit {
            min: None,
            max: Some(1.0),
        });
        let met = Metric::new("met", Ok(0.5), limit);
        let unknown = Metric::not_judged("unknown", "nobody publishes it".to_owned(), limit);
        let xml = |outcome, reason| {
            let mut verdict = Verdict::incomplete("step", 1, reason);
            verdict.outcome = outcome;
            verdict.metrics = vec![met.clone(), unknown.clone()];
            to_xml(&[verdict]).unwrap()
        };
        let counts = |failures, errors| {
            format!("tests=\"3\" skipped=\"0\" errors=\"{errors}\" failures=\"{failures}\"")
        };
        let (failed, open) = (
            xml(Outcome::Fail, "too hot"),
            xml(Outcome::Inconclusive, "busy"),
        );
        assert!(failed.contains(&counts(1, 1)), "{failed}");
        assert!(failed.contains("<error message=\"not judged\""), "{failed}");
        assert!(open.contains(&counts(0, 3)), "{open}");
    }
}
