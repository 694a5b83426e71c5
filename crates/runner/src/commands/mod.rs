//! The subcommands about scenarios and their recordings: of each the arguments, what it does, and its pages.

pub mod check;
pub mod compare;
pub mod examples;
pub mod export;
pub mod replay;
pub mod report;
pub mod run;
pub mod signals;
pub mod simulate;
