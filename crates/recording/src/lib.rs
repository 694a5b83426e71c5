//! recording

pub mod capture;
pub mod events;
pub mod gauge;
pub mod latency;
pub mod log;
mod losses;
pub mod run_folder;
pub mod session;
pub mod tap;
pub mod timeline;
pub mod traces;
pub mod truth;
