//! Checks what the schema cannot say about the plant.

use crate::document::Document;
use crate::error::Problem;
use crate::outside::Outside;
use crate::own::Section;
use crate::plant::{Heat, Mechanics, Phase, WITH_TABLE};
use crate::scenario::Scenario;

/// The tables of the SMA actuator, which no other plant has.
const WIRE_TABLES: [&str; 3] = ["plant.heat", "plant.phase", "plant.mechanics"];

/// Whether a key, as in `plant.heat.ambient_celsius`, is one of the SMA actuator's.
pub(super) fn is_about_a_wire(key: &str) -> bool {
    let mut tables = WIRE_TABLES.iter();
    tables.any(|table| {
        key.strip_prefix(table)
            .is_some_and(|rest| rest.starts_with('.'))
    })
}

/// What the schema cannot say about the plant.
pub(super) fn check(
    document: &Document<'_>,
    scenario: &Scenario,
    outside: &Outside,
) -> Vec<Problem> {
    if scenario.plant.name() == crate::plant::SMA_ACTUATOR {
        return temperatures(document, &scenario.plant.phase);
    }
    let mut problems = without_wire(document, scenario);
    problems.extend(second_plants(document, scenario, outside));
    problems
}

/// A plant that is not the SMA actuator has no wire. What is written out of a scenario has the wire's tables too, as they
/// are by default.
fn without_wire(document: &Document<'_>, scenario: &Scenario) -> Vec<Problem> {
    let (plant, name) = (&scenario.plant, scenario.plant.name());
    let is_given = [
        plant.heat != Heat::default(),
        plant.phase != Phase::default(),
        plant.mechanics != Mechanics::default(),
    ];
    let problem = |path: &str| {
        let message = format!("`{path}` is a key of the wire, and the plant is `{name}`");
        let help =
            format!("leave it out, or leave [plant.{name}] out for the shape-memory-alloy wire");
        misplaced(document, path, message, help)
    };
    let tables = WIRE_TABLES.into_iter().zip(is_given);
    tables
        .filter(|(_, is_given)| *is_given)
        .map(|(path, _)| problem(path))
        .collect()
}

fn second_plants(document: &Document<'_>, scenario: &Scenario, outside: &Outside) -> Vec<Problem> {
    let name = scenario.plant.name();
    let from_outside = outside.names(Section::Plant);
    let others = document
        .keys("plant")
        .into_iter()
        .filter(|key| *key != name && (WITH_TABLE.contains(key) || from_outside.contains(key)));
    let problems = others.map(|other| {
        let message = format!("`{other}` is a second plant beside `{name}`");
        let help = "leave one of them out".to_owned();
        misplaced(document, &format!("plant.{other}"), message, help)
    });
    problems.collect()
}

fn misplaced(document: &Document<'_>, path: &str, message: String, help: String) -> Problem {
    let span = document.key_span(path);
    let problem = document.source.problem(span, message, "has no place here");
    problem.with_help(help)
}

/// Transformation temperatures in order: Eq. (2) divides by their differences.
fn temperatures(document: &Document<'_>, phase: &Phase) -> Vec<Problem> {
    let pairs = [
        (
            "austenite_finish_celsius",
            phase.austenite_finish_celsius,
            "austenite_start_celsius",
            phase.austenite_start_celsius,
        ),
        (
            "martensite_start_celsius",
            phase.martensite_start_celsius,
            "martensite_finish_celsius",
            phase.martensite_finish_celsius,
        ),
    ];
    let is_wrong = |(_, high, _, low): &(&str, f64, &str, f64)| high <= low;
    let problem = |(name, _, below, low): (&str, f64, &str, f64)| {
        let message = format!("`{name}` must be above `{below}`");
        let path = format!("plant.phase.{name}");
        document.problem(&path, message, format!("must be above {low}"))
    };
    pairs.into_iter().filter(is_wrong).map(problem).collect()
}
