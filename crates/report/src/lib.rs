//! Outputs of a run for readers and for other programs.
//!
//! The input is a judged run: its setup, its frames, its timeline, its verdict ([`Run`]). The output is the files of a run folder
//! ([`write_all`]): the page, the signals as a table, the Rerun recording, the JUnit report, the verdict. [`viewer`] shows a run
//! while it is played. `plot`, `page` and `terminal` are the parts from which other crates build pages.
//!
//! This crate does not know how the run was played, nor which plants and laws exist: it reads names and units from the database
//! of the run. It computes no verdict and prints nothing: it returns texts, or the reasons why they cannot be made. No other
//! crate names the libraries of these formats (rerun, quick-junit).
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
pub mod table;
pub mod terminal;
mod unit;
pub mod viewer;

pub use files::{ReportError, write_all};
pub use run::Run;
pub use unit::shown_unit;
#[cfg(feature = "rerun")]
pub(crate) use unit::title;
