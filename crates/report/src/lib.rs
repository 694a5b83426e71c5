//! What a run leaves behind for people and for other programs.

pub mod asc;
pub mod blf;
mod bus_timing;
mod checks;
pub mod csv;
mod files;
pub mod html;
pub mod junit;
pub mod mf4;
pub mod overview;
pub mod page;
pub mod parquet;
pub mod picture;
pub mod plot;
#[cfg(feature = "rerun")]
pub mod rerun;
pub mod terminal;
mod thin;
pub mod viewer;

pub use files::{ReportError, Run, write_all};

/// A unit of the DBC, as people write it.
fn shown_unit(unit: &str) -> &str {
    match unit {
        "degC" => "°C",
        unit => unit,
    }
}
