//! `canrig reproduce`: every experiment of the paper, and what a user asks beyond it.
//!
//! `bases` are shipped scenario files; `families` make many scenarios of one; `experiment` says what one is, and
//! `response`, `cooling`, `ripple`, `robustness`, `sensitivity` and `material` are the experiments themselves: which runs, and what to make of
//! their recordings. `command` plays them all at once and hands the `number`s and figures to `page`.

mod bases;
pub mod command;
mod cooling;
pub mod experiment;
pub mod families;
mod material;
mod page;
pub mod quantity;
mod response;
mod result;
mod ripple;
mod robustness;
mod sensitivity;
