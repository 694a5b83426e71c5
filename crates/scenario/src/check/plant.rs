//! Checks of the plant that the schema cannot express.

use crate::document::Document;
use crate::error::Problem;
use crate::plant::{Heat, Kinetics, Phase};

/// Checks the order of the transformation temperatures: Eq. (2) divides by their differences.
///
/// `path` is the path of the table in the document.
pub(crate) fn temperatures(document: &Document<'_>, path: &str, phase: &Phase) -> Vec<Problem> {
    let (austenite, martensite) = ("austenite_start_celsius", "martensite_finish_celsius");
    let (finish, start) = (
        phase.austenite_finish_celsius,
        phase.austenite_start_celsius,
    );
    let (from, until) = (
        phase.martensite_start_celsius,
        phase.martensite_finish_celsius,
    );
    let pairs = [
        ("austenite_finish_celsius", finish, austenite, start),
        ("martensite_start_celsius", from, martensite, until),
    ];
    let wrong = pairs.into_iter().filter(|(_, high, _, low)| high <= low);
    let problems = wrong.map(|(name, _, below, low)| {
        let message = format!("`{name}` must be above `{below}`");
        document.problem(
            &format!("{path}.{name}"),
            message,
            format!("must be above {low}"),
        )
    });
    problems.collect()
}

/// Checks that air and cooling element do not keep the wire above `Mf`: a memory of turns begins with all martensite.
///
/// `path` is the path of the wire's table in the document.
pub(crate) fn cooling(
    document: &Document<'_>,
    path: &str,
    kinetics: Kinetics,
    heat: &Heat,
    phase: &Phase,
) -> Vec<Problem> {
    let highest = phase.martensite_finish_celsius;
    let cooling = [
        ("ambient_celsius", heat.ambient_celsius),
        ("cooling_element_celsius", heat.cooling_element_celsius),
    ];
    let is_wrong = |(_, celsius): &(&str, f64)| kinetics.remembers_turns() && *celsius > highest;
    let problem = |(name, _): (&str, f64)| {
        let message = format!("`{name}` must not be above `martensite_finish_celsius`");
        let label = format!("must be at most {highest}");
        let remembers = document.span(&format!("{path}.kinetics"));
        document
            .problem(&format!("{path}.heat.{name}"), message, label)
            .with_place(remembers, "remembers turns from all martensite on")
    };
    cooling.into_iter().filter(is_wrong).map(problem).collect()
}
