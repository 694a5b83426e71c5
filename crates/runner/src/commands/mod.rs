//! The subcommands on scenarios and their recordings: each with its arguments, its work, and its pages.

pub mod check;
pub mod compare;
pub mod examples;
pub mod export;
pub mod replay;
pub mod report;
pub mod run;
pub mod signals;
pub mod simulate;
mod watch;
