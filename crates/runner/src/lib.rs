//! The commands that play scenarios and read run folders back.
//!
//! In comes what the command line says, as values that `clap` has parsed. Out go run folders, what people read on the terminal,
//! and an [`exit::Exit`]. [`run`] plays one scenario in any world, records it, judges it and writes its reports; `play` does so with
//! many. What happens meanwhile goes as a [`event::RunEvent`] to those who look on. `recorded` reads a run folder back. Each
//! command has a place of its own in [`commands`].
//!
//! All output of the bench goes through [`console`]; the crates below print nothing. This crate does not know what is in a
//! scenario, how a world plays it, how a verdict is found, nor what a file format looks like: the crates below do. Nor does it know of
//! campaigns and experiments, which build on it.
pub mod commands;
pub mod console;
pub mod event;
pub mod exit;
pub mod identity;
pub mod lines;
pub mod machine;
pub mod named;
pub mod observer;
pub mod output;
pub mod play;
pub mod play_record;
pub mod recorded;
pub mod run;
pub mod scenarios;
mod shipped;
mod terminal;
