//! rig

pub mod catalogue;
pub mod data_sheet;
pub mod error_frames;
pub mod external;
pub mod presence;
pub mod rig_file;
pub mod setup;
mod signal_names;

/// Longest file that a user names besides scenarios and recordings.
pub const FILE_BYTES_MAX: u64 = 1 << 20;
