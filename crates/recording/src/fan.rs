//! Whether the scenario's disturbances reach a module on the bus.

use canopen::CanFrame;
use dbc::names;
use rig::plan::ControlLoop;

/// Looks for the heartbeat of the fan and load module and for its commands.
pub(crate) struct FanReader {
    /// `None` without an io node.
    ids: Option<[u32; 2]>,
    has_heartbeat: bool,
    has_command: bool,
}

impl FanReader {
    pub(crate) fn new(one: &ControlLoop) -> Self {
        let io = one.nodes.io.as_ref();
        let id = |service| Some(one.message(io?, service).ok()?.raw_id);
        let ids = id(names::HEARTBEAT).zip(id(names::RPDO1));
        Self {
            ids: ids.map(|(heartbeat, command)| [heartbeat, command]),
            has_heartbeat: false,
            has_command: false,
        }
    }

    /// The identifiers of the messages that it reads.
    pub(crate) fn raw_ids(&self) -> impl Iterator<Item = u32> {
        self.ids.into_iter().flatten()
    }

    pub(crate) fn on_frame(&mut self, frame: &CanFrame) {
        let Some([heartbeat, command]) = self.ids else {
            return;
        };
        self.has_heartbeat |= frame.raw_id() == heartbeat;
        self.has_command |= frame.raw_id() == command;
    }

    /// The module is there and gets its commands.
    pub(crate) fn has_fan(&self) -> bool {
        self.has_heartbeat && self.has_command
    }
}
