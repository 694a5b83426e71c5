//! campaigns

pub mod campaign;
pub mod distribution;
pub mod sweep;
pub mod torture;
