//! What a run leaves behind for people and for other programs.
//!
//! In comes a judged run: its setup, its frames, its timeline, its verdict ([`Run`]). Out go the files of a run folder
//! ([`write_all`]): the page, the signals as a table, the Rerun recording, the JUnit report, the verdict. While a run goes on,
//! [`viewer`] shows it. `plot`, `page` and `terminal` are the parts that pages of other crates are made of.
//!
//! It does not know how the run was played, nor which plants and laws there are: it reads names and units from the database of
//! the run. It computes no verdict, and it prints nothing: it returns texts, and why they cannot be had. No other crate names
//! the libraries of these formats (rerun, quick-junit).
mod bus_timing;
mod contour;
pub mod csv;
mod files;
pub mod html;
pub mod junit;
pub mod overview;
pub mod page;
pub mod picture;
pub mod plot;
#[cfg(feature = "rerun")]
pub mod rerun;
mod run;
pub mod terminal;
mod unit;
pub mod viewer;

pub use files::{ReportError, write_all};
pub use run::Run;
#[cfg(feature = "rerun")]
pub(crate) use unit::{shown_unit, title};
