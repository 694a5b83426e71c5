//! The commands that play scenarios and read run folders back.
//!
//! The input is the command line, as values that `clap` has parsed. The output is run folders, text on the terminal, and an
//! [`exit::Exit`]. [`run`] plays one scenario in any world, records it, judges it and writes its reports; `play` does so with
//! many. Events meanwhile go as [`event::RunEvent`]s to listeners. `recorded` reads a run folder back. Each command has a module
//! in [`commands`].
//!
//! All output of the bench goes through [`console`]; the crates below print nothing. This crate does not know the content of a
//! scenario, how a world plays it, how a verdict is found, nor the file formats: the crates below do. It does not know campaigns
//! and experiments either, which build on it.
pub mod commands;
pub mod console;
pub mod event;
pub mod exit;
pub mod identity;
pub mod lines;
pub mod machine;
pub mod named;
pub mod number;
pub mod observer;
pub mod output;
pub mod play;
pub mod play_record;
pub mod recorded;
pub mod run;
pub mod scenarios;
mod shipped;
mod terminal;
