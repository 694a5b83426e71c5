//! Checks of the plant that the schema cannot express.

use crate::document::Document;
use crate::error::Problem;
use crate::plant::{Heat, Kinetics, Phase};

/// Checks the order of the transformation temperatures: Eq. (2) divides by their differences.
///
/// `path` is the path of the table in the document.
pub(crate) fn temperatures(document: &Document<'_>, path: &str, phase: &Phase) -> Vec<Problem> {
    let mut problems = Vec::new();
    let mut in_order = |name: &str, high: f64, below: &str, low: f64| {
        if high <= low {
            let message = format!("`{name}` must be above `{below}`");
            let label = format!("must be above {low}");
            problems.push(document.problem(&format!("{path}.{name}"), message, label));
        }
    };
    let (start, finish) = ("austenite_start_celsius", "austenite_finish_celsius");
    let [above, below] = [
        phase.austenite_finish_celsius,
        phase.austenite_start_celsius,
    ];
    in_order(finish, above, start, below);
    let (start, finish) = ("martensite_start_celsius", "martensite_finish_celsius");
    let [above, below] = [
        phase.martensite_start_celsius,
        phase.martensite_finish_celsius,
    ];
    in_order(start, above, finish, below);
    problems
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
