//! The parts of a plan, composed from the rig: a file for each kind of thing.

mod drive_messages;
pub mod messages;
