//! Units and signals in the form for readers.

use dbc::Signal;

/// Returns a unit of the DBC in the form for readers.
pub fn shown_unit(unit: &str) -> &str {
    match unit {
        "degC" => "°C",
        "A^2" => "A²",
        "m/s^2" => "m/s²",
        unit => unit,
    }
}

/// Returns a signal's comment as the title of its plot, or its name if it has no comment.
pub(crate) fn title(signal: &Signal) -> &str {
    match signal.comment.trim_end_matches('.') {
        "" => &signal.name,
        comment => comment,
    }
}
