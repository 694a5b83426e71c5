//! What a plan is made of, composed from the rig: a file for each kind of thing.

pub mod messages;
