//! Checks of the plant that the schema cannot express.

use super::Check;
use crate::plant::{Heat, Kinetics, Phase};

/// Checks the order of the transformation temperatures: Eq. (2) divides by their differences.
///
/// `path` is the path of the table in the document.
pub(crate) fn temperatures(check: &mut Check<'_>, path: &str, phase: &Phase) {
    let austenite_start = ("austenite_start_celsius", phase.austenite_start_celsius);
    let austenite_finish = ("austenite_finish_celsius", phase.austenite_finish_celsius);
    let martensite_start = ("martensite_start_celsius", phase.martensite_start_celsius);
    let martensite_finish = ("martensite_finish_celsius", phase.martensite_finish_celsius);
    for ((name, high), (below, low)) in [
        (austenite_finish, austenite_start),
        (martensite_start, martensite_finish),
    ] {
        if high <= low {
            let message = format!("`{name}` must be above `{below}`");
            let label = format!("must be above {low}");
            check.at(&format!("{path}.{name}"), message, label);
        }
    }
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
    let (document, highest) = (check.document, phase.martensite_finish_celsius);
    let temperatures = [
        ("ambient_celsius", heat.ambient_celsius),
        ("cooling_element_celsius", heat.cooling_element_celsius),
    ];
    for (name, celsius) in temperatures {
        if kinetics.remembers_turns() && celsius > highest {
            let message = format!("`{name}` must not be above `martensite_finish_celsius`");
            let label = format!("must be at most {highest}");
            let problem = document.problem(&format!("{path}.heat.{name}"), message, label);
            let remembers = document.span(&format!("{path}.kinetics"));
            check.add([problem.with_place(remembers, "remembers turns from all martensite on")]);
        }
    }
}
