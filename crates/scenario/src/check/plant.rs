//! Checks what the schema cannot say about the plant.

use crate::document::Document;
use crate::error::Problem;
use crate::plant::Phase;

/// Transformation temperatures in order: Eq. (2) divides by their differences.
///
/// `path` is that of the table in the document.
pub(crate) fn temperatures(document: &Document<'_>, path: &str, phase: &Phase) -> Vec<Problem> {
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
        let path = format!("{path}.{name}");
        document.problem(&path, message, format!("must be above {low}"))
    };
    pairs.into_iter().filter(is_wrong).map(problem).collect()
}
