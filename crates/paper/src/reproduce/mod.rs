//! `canrig reproduce`: plays every experiment of the paper, and further ones for the users of the bench.
//!
//! `bases` has shipped scenario files, and `families` changes them. `experiment` defines an experiment. The experiments
//! are in `response`, `cooling`, `ripple`, `robustness`, `sensitivity` and `material`, each with its runs and their
//! evaluation. `command` plays them all at once and gives the numbers (`quantity`) and figures to `page`.

mod bases;
pub mod command;
mod cooling;
pub mod experiment;
pub mod families;
mod material;
mod page;
pub mod quantity;
mod response;
mod ripple;
mod robustness;
mod sensitivity;
