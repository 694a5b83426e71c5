//! Checks of signals and sequences: each can be judged, lies within the run, and is given once.

use std::collections::BTreeSet;

use super::limits::{emergency, limit_problem};
use super::requirements::names;
use super::{Check, name};
use crate::document::Document;
use crate::error::Problem;
use crate::expect::{Demand, Expect, Expected, Sequence, SignalCheck};
use crate::trial::Trial;

/// Time by which a window may end after the last row: the `signals.csv` of a run ends with its last cycle, not with the run.
const END_SECONDS: f64 = 0.1;

/// Checks the demands on signals, and the sequences.
pub(super) fn check(check: &mut Check<'_>, expect: &Expect, duration_seconds: f64) {
    let document = check.document;
    let mut rows = BTreeSet::new();
    for (index, signal) in expect.signal.iter().enumerate() {
        let path = format!("expect.signal.{index}");
        let window = (signal.from_seconds, signal.until_seconds);
        check.add(window_problem(document, &path, window, duration_seconds));
        demands(check, &path, signal, &mut rows);
        names(check, &format!("{path}.requirements"), &signal.requirements);
    }
    for (index, sequence) in expect.sequence.iter().enumerate() {
        let path = format!("expect.sequence.{index}");
        let window = (Some(sequence.from_seconds), sequence.until_seconds);
        check.add(window_problem(document, &path, window, duration_seconds));
        events(check, &path, sequence);
        let requirements = &sequence.requirements;
        names(check, &format!("{path}.requirements"), requirements);
        let path = format!("{path}.name");
        if !rows.insert(sequence.name.clone()) {
            let message = format!("there are two sequences \"{}\"", sequence.name);
            check.at(&path, message, "another name is needed");
        }
        name(check, &path, &sequence.name);
    }
}

/// Checks that a window ends after it begins, within the run.
fn window_problem(
    document: &Document<'_>,
    path: &str,
    (from, until): (Option<f64>, Option<f64>),
    duration_seconds: f64,
) -> Option<Problem> {
    let from_seconds = from.unwrap_or(0.0);
    let (key, message, label) = if from_seconds >= duration_seconds {
        let label = format!("the run ends at {duration_seconds} s");
        (
            "from_seconds",
            "the window is after the end of the run",
            label,
        )
    } else if until.is_some_and(|until| until <= from_seconds) {
        let label = format!("must be after {from_seconds} s");
        ("until_seconds", "the window ends before it begins", label)
    } else if until.is_some_and(|until| until > duration_seconds) {
        let label = format!("the run ends at {duration_seconds} s");
        ("until_seconds", "the window ends after the run", label)
    } else {
        return None;
    };
    Some(document.problem(&format!("{path}.{key}"), message, label))
}

/// Checks that there is a demand, that its limits can be met, and that no row of the verdict appears twice.
fn demands(check: &mut Check<'_>, path: &str, signal: &SignalCheck, rows: &mut BTreeSet<String>) {
    let document = check.document;
    if signal.demands().next().is_none() {
        let message = format!("nothing is demanded of `{}`", signal.name);
        let problem = document.problem(path, message, "a demand is missing");
        let help = "add stays, reaches, rate_per_second or follows";
        check.add([problem.with_help(help)]);
    }
    for demand in signal.demands() {
        let place = format!("{path}.{}", demand.key());
        if let Demand::Stays(limit) | Demand::Reaches(limit) | Demand::RatePerSecond(limit) = demand
        {
            check.add(limit_problem(document, &place, demand.key(), limit));
        }
        if !rows.insert(signal.row_name(&demand)) {
            let message = format!("`{}` of `{}` is demanded twice", demand.key(), signal.name);
            let problem = document.problem(&place, message, "in the same window as before");
            let help = "give both sides in one limit: { min = …, max = … }";
            check.add([problem.with_help(help)]);
        }
    }
}

/// Checks that each event can be recognised and has its time.
fn events(check: &mut Check<'_>, path: &str, sequence: &Sequence) {
    let document = check.document;
    for (place, event) in sequence.event.iter().enumerate() {
        let path = format!("{path}.event.{place}");
        check.add(event_problem(check, &path, event));
        if place > 0 && event.within_milliseconds.is_none() {
            let message = format!("event {} of a sequence has no time limit", place + 1);
            check.at(&path, message, "`within_milliseconds` is missing");
        }
        if let Some(limit) = event.reaches {
            let path = format!("{path}.reaches");
            check.add(limit_problem(document, &path, "reaches", limit));
        }
    }
}

fn event_problem(check: &Check<'_>, path: &str, event: &Expected) -> Option<Problem> {
    let kinds = [&event.emcy, &event.text, &event.signal];
    let given = kinds.iter().filter(|kind| kind.is_some()).count();
    let (is_signal, reaches) = (event.signal.is_some(), event.reaches.is_some());
    let has_control = |text: &String| text.contains(char::is_control);
    let at = |key: &str| format!("{path}.{key}");
    let (place, message, label) = if given != 1 {
        let message = "an event of a sequence is one of `emcy`, `text` and `signal`";
        let label = match given {
            0 => "none is given",
            _ => "more than one is given",
        };
        (path.to_owned(), message.to_owned(), label)
    } else if is_signal && !reaches {
        let message = "a signal alone is no event".to_owned();
        (path.to_owned(), message, "`reaches` is missing")
    } else if !is_signal && (reaches || event.for_milliseconds.is_some()) {
        let key = if reaches {
            "reaches"
        } else {
            "for_milliseconds"
        };
        let message = format!("`{key}` is for events of a signal");
        (at(key), message, "`signal` is missing")
    } else if event.text.as_ref().is_some_and(has_control) {
        let message = "`text` has a control character in it".to_owned();
        (at("text"), message, "one line of plain text")
    } else {
        return emergency(check, &at("emcy"), event.emcy.as_ref()?);
    };
    Some(check.document.problem(&place, message, label))
}

/// Refuses windows outside their courses: they would be judged in part only, or not at all.
pub(super) fn uncovered(document: &Document<'_>, trial: &Trial) -> Vec<Problem> {
    let checks = trial.expect.signal.iter().enumerate();
    let problems = checks.filter_map(|(index, check)| {
        let course = check.follows.as_ref()?;
        let window = check.window(&Demand::Follows(course), trial.run.duration_seconds);
        let (path, span) = (format!("expect.signal.{index}"), course.span()?);
        let (key, message) = if window.from_seconds < span.from_seconds {
            ("from_seconds", "the window begins before the course")
        } else if window.until_seconds > span.until_seconds + END_SECONDS {
            ("until_seconds", "the window ends after the course")
        } else if window.from_seconds >= window.until_seconds {
            ("follows.file", "the course lies outside the window")
        } else {
            return None;
        };
        let (first, last) = (course.rows.first()?.0, course.rows.last()?.0);
        let label = format!("the course lasts from {first} to {last} s");
        Some(document.problem(&format!("{path}.{key}"), message, label))
    });
    problems.collect()
}
