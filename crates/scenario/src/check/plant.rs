//! Checks of the plant that the schema cannot express.

use super::Check;
use crate::plant::{Heat, Kinetics, Phase};

/// Checks the order of the transformation temperatures: Eq. (2) divides by their differences.
///
/// `path` is the path of the table in the document.
pub(crate) fn temperatures(check: &mut Check<'_>, path: &str, phase: &Phase) {
    let mut in_order = |name: &str, high: f64, below: &str, low: f64| {
        if high <= low {
            let message = format!("`{name}` must be above `{below}`");
            let label = format!("must be above {low}");
            check.at(&format!("{path}.{name}"), message, label);
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
}

/// Checks that air and cooling element do not keep the wire above `Mf`: a memory of turns begins with all martensite.
///
/// `path` is the path of the wire's table in the document.
pub(crate) fn cooling(
    check: &mut Check<'_>,
    path: &str,
    kinetics: Kinetics,
    heat: &Heat,
    phase: &Phase,
) {
    let document = check.document;
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
    check.add(cooling.into_iter().filter(is_wrong).map(problem));
}
