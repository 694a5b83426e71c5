//! runner

pub mod commands;
pub mod console;
mod event;
pub mod exit;
pub mod observer;
pub mod play;
pub mod recordings;
pub mod run;
mod terminal;
