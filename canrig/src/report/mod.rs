//! What a run leaves behind for people and for other programs.

pub mod csv;
pub mod junit;
#[cfg(feature = "rerun")]
pub mod rerun;
pub mod terminal;
