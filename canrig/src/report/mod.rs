//! What a run leaves behind for people and for other programs.

pub mod asc;
pub mod blf;
mod bus_timing;
mod checks;
pub mod comparison;
pub mod coverage;
pub mod csv;
pub mod html;
pub mod junit;
pub mod mf4;
pub mod overview;
mod page;
pub mod parquet;
pub mod picture;
pub mod plot;
pub mod reproduction;
#[cfg(feature = "rerun")]
pub mod rerun;
pub mod sweep;
pub mod terminal;
mod thin;

/// A unit of the DBC, as people write it.
fn shown_unit(unit: &str) -> &str {
    match unit {
        "degC" => "°C",
        unit => unit,
    }
}
