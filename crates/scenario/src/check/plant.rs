//! Checks of the plant that the schema cannot express.

use super::Check;
use crate::plant::{Heat, Kinetics, Phase};

/// Checks the order of the transformation temperatures: Eq. (2) divides by their differences.
///
/// `path` is the path of the table in the document.
pub(crate) fn temperatures(check: &mut Check<'_>, path: &str, phase: &Phase) {
    for [(name, _), (below, low)] in phase.out_of_order() {
        let message = format!("`{name}` must be above `{below}`");
        let label = format!("must be above {low}");
        check.at(&format!("{path}.{name}"), message, label);
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
    for (name, _) in kinetics.too_warm(heat, phase) {
        let message = format!("`{name}` must not be above `martensite_finish_celsius`");
        let label = format!("must be at most {highest}");
        let problem = document.problem(&format!("{path}.heat.{name}"), message, label);
        let remembers = document.span(&format!("{path}.kinetics"));
        check.add([problem.with_place(remembers, "remembers turns from all martensite on")]);
    }
}
