//! Units as people write them.

/// A unit of the DBC, as people write it.
pub(crate) fn shown_unit(unit: &str) -> &str {
    match unit {
        "degC" => "°C",
        unit => unit,
    }
}
