//! Whether the scenario's disturbances reach a module on the bus.

use canopen::CanFrame;
use dbc::{Database, SignalMissing, signals};

/// Looks for the heartbeat of the fan and load module and for its commands.
pub(crate) struct FanReader {
    heartbeat_id: u32,
    command_id: u32,
    has_heartbeat: bool,
    has_command: bool,
}

impl FanReader {
    pub(crate) fn new(database: &Database) -> Result<Self, SignalMissing> {
        let command = signals::DISTURBANCE_MESSAGE;
        let commands = database.message(command);
        Ok(Self {
            heartbeat_id: database.require(signals::FAN_STATE)?.raw_id(),
            command_id: commands.ok_or_else(|| SignalMissing::new(command))?.raw_id,
            has_heartbeat: false,
            has_command: false,
        })
    }

    /// The identifiers of the messages that it reads.
    pub(crate) fn raw_ids(&self) -> [u32; 2] {
        [self.heartbeat_id, self.command_id]
    }

    pub(crate) fn on_frame(&mut self, frame: &CanFrame) {
        self.has_heartbeat |= frame.raw_id() == self.heartbeat_id;
        self.has_command |= frame.raw_id() == self.command_id;
    }

    /// The module is there and gets its commands.
    pub(crate) fn has_fan(&self) -> bool {
        self.has_heartbeat && self.has_command
    }
}
