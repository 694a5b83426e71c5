//! Builds the parts of a plan from the rig, one file per part.

mod drive_messages;
pub mod messages;
