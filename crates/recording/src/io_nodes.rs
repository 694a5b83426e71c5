//! Check that the scenario's disturbances reach the io nodes on the bus.

use std::collections::BTreeMap;

use can::CanFrame;
use dbc::{Database, names};
use plan::ControlLoop;

/// Reader of the heartbeats of the io nodes that disturb a loop, and of the commands to them.
pub(crate) struct IoReader {
    /// Identifiers to look for, with whether such a frame came.
    seen: BTreeMap<u32, bool>,
    /// Whether an io node is missing in the database.
    is_one_missing: bool,
}

impl IoReader {
    pub(crate) fn new(database: &Database, one: &ControlLoop) -> Self {
        let mut reader = Self {
            seen: BTreeMap::new(),
            is_one_missing: false,
        };
        for change in one.trial.judged_disturbances() {
            for service in [names::HEARTBEAT, names::RPDO1] {
                match database.message(&names::message(&change.node, service)) {
                    Some(message) => drop(reader.seen.insert(message.raw_id, false)),
                    None => reader.is_one_missing = true,
                }
            }
        }
        reader
    }

    /// Returns the identifiers of the messages that it reads.
    pub(crate) fn raw_ids(&self) -> impl Iterator<Item = u32> {
        self.seen.keys().copied()
    }

    pub(crate) fn on_frame(&mut self, frame: &CanFrame) {
        if let Some(seen) = self.seen.get_mut(&frame.raw_id()) {
            *seen = true;
        }
    }

    /// Returns whether all io nodes are present and get their commands.
    pub(crate) fn is_disturbed(&self) -> bool {
        !self.is_one_missing && self.seen.values().all(|seen| *seen)
    }
}
