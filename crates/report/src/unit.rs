//! Units and signals as people write them.

use dbc::Signal;

/// A unit of the DBC, as people write it.
pub(crate) fn shown_unit(unit: &str) -> &str {
    match unit {
        "degC" => "°C",
        unit => unit,
    }
}

/// What a signal is, as the title of its plot; its name where nothing is said of it.
pub(crate) fn title(signal: &Signal) -> &str {
    match signal.comment.trim_end_matches('.') {
        "" => &signal.name,
        comment => comment,
    }
}
