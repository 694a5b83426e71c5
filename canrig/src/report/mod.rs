//! What a run leaves behind for people and for other programs.

pub mod csv;
pub mod junit;
pub mod terminal;
