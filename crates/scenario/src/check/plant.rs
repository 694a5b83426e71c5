//! Checks what the schema cannot say about the plant.

use crate::document::Document;
use crate::error::Problem;
use crate::own;
use crate::plant::{Heat, Mechanics, Phase};
use crate::scenario::Scenario;

/// What the schema cannot say about the plant.
pub(super) fn check(document: &Document<'_>, scenario: &Scenario) -> Vec<Problem> {
    match scenario.plant.name() {
        crate::plant::SMA_ACTUATOR => temperatures(document, &scenario.plant.phase),
        _ => without_wire(document, scenario),
    }
}

/// A plant that is not the SMA actuator has no wire, no second plant's table, and only its own faults. What is written out
/// of a scenario has the wire's tables too, as they are by default.
fn without_wire(document: &Document<'_>, scenario: &Scenario) -> Vec<Problem> {
    let (plant, name) = (&scenario.plant, scenario.plant.name());
    let faults = plant.faults();
    let tables = [
        ("plant.heat", plant.heat != Heat::default()),
        ("plant.phase", plant.phase != Phase::default()),
        ("plant.mechanics", plant.mechanics != Mechanics::default()),
    ];
    let problem = |path: &str, message: String, help: String| {
        let span = document.key_span(path);
        let problem = document.source.problem(span, message, "has no place here");
        problem.with_help(help)
    };
    let of_the_wire = tables.into_iter().filter(|(_, is_given)| *is_given);
    let mut problems = Vec::from_iter(of_the_wire.map(|(path, _)| {
        let message = format!("`{path}` is about a wire, and the plant is `{name}`");
        let help = format!("leave it out, or leave [plant.{name}] out for the SMA actuator");
        problem(path, message, help)
    }));
    let others = document
        .keys("plant")
        .into_iter()
        .filter(|key| *key != name && (*key == "dc_motor" || own::is_plant(key)));
    problems.extend(others.map(|other| {
        let message = format!("`{other}` is a second plant beside `{name}`");
        problem(
            &format!("plant.{other}"),
            message,
            "leave one of them out".to_owned(),
        )
    }));
    let strange = document.keys("fault.plant").into_iter();
    problems.extend(strange.filter(|key| !faults.contains(key)).map(|fault| {
        let message = format!("`fault.plant.{fault}` means nothing to the plant `{name}`");
        let help = match faults {
            [] => "no fault of a plant does".to_owned(),
            known => format!("what does: {}", known.join(", ")),
        };
        problem(&format!("fault.plant.{fault}"), message, help)
    }));
    problems
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
