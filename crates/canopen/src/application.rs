//! The application of a device: its events and its decisions.

use std::time::Duration;

use crate::emcy::{Condition, EmergencyMessage, ErrorCode};
use crate::nmt::{NmtCommand, NmtState, NodeId};
use crate::object_dictionary::Accepted;
use crate::pdo::WaitingPdo;
use crate::services::Services;
use crate::sync::Sync;
use can::{CanFrame, Filter, Progress};

/// Loss of communication on which the device relied.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommunicationLoss {
    /// A watched node's heartbeat did not come in its time (0x1016), or the node booted.
    Heartbeat(NodeId),
    /// No SYNC for 1.5 periods (0x1006), or for the time that [`Services::set_sync_timeout_min`] allows.
    Sync,
    /// The RPDO with this number, from 1, missed its deadline (0x1400:05).
    Rpdo(u16),
    /// The CAN controller left the bus.
    BusOff,
}

impl CommunicationLoss {
    /// Returns the error to raise; `None` for bus-off, since the bus would not carry the message.
    pub(crate) fn error(self) -> Option<Condition> {
        let (code, source) = match self {
            Self::Heartbeat(node_id) => (ErrorCode::HEARTBEAT, u16::from(node_id.get())),
            Self::Sync => (ErrorCode::COMMUNICATION, 0),
            Self::Rpdo(number) => (ErrorCode::RPDO_TIMEOUT, number),
            Self::BusOff => return None,
        };
        Some(Condition { code, source })
    }
}

/// The part of a device that is no CANopen service. Every function has a default that does nothing.
///
/// All calls come from within the device's `on_frame`, `on_tick` and `on_stop`, with `services.now()` as the time. At a SYNC the
/// order is: waiting RPDO data become valid ([`Application::on_rpdo`] for each), [`Application::on_sync`] samples and applies,
/// then the TPDOs of this SYNC are packed, after [`Application::on_sampling`].
#[expect(unused_variables, reason = "the defaults do nothing")]
pub trait Application {
    /// Returns the identifiers of the frames that the device handles. By default these are all: a manager may give the device's
    /// PDOs and consumers other identifiers at any time.
    fn filters(&self) -> Vec<Filter> {
        vec![Filter::ALL, Filter::ERRORS]
    }

    /// The dictionary has its defaults again (power-on, NMT reset); the boot-up message follows, then
    /// [`Application::on_nmt_state`]. `reset` is [`NmtCommand::ResetNode`] also at power-on. A drive that was Operational
    /// takes the energy away here.
    fn on_reset(&mut self, services: &mut Services, reset: NmtCommand) {}

    /// The node's own NMT state has changed, on arrival of the command. Leaving Operational must take the energy away.
    fn on_nmt_state(&mut self, services: &mut Services, state: NmtState) {}

    /// A SYNC has arrived, or was produced by this device.
    fn on_sync(&mut self, services: &mut Services, sync: &Sync) {}

    /// TPDOs of this SYNC are about to be packed: the last chance to bring mapped objects up to date.
    fn on_sampling(&mut self, services: &mut Services) {}

    /// The data of an RPDO are in the dictionary: on arrival for types 254 and 255, at the SYNC for the others.
    fn on_rpdo(&mut self, services: &mut Services, number: u16) {}

    /// A synchronous RPDO has arrived and waits for the next SYNC. Orders that take energy away (a controlword that disables or
    /// asks for quick stop) must be obeyed here; everything else must wait.
    fn on_waiting_rpdo(&mut self, services: &mut Services, waiting: &WaitingPdo) {}

    /// A client is about to read an object: the last chance to bring it up to date.
    fn on_read(&mut self, services: &mut Services, index: u16, sub_index: u8) {}

    /// A client writes an object; existence, access, length, limits and the services' rules have been checked. The
    /// value is stored after this returns `Ok`.
    ///
    /// # Errors
    /// The application's reason to refuse.
    fn on_write(
        &mut self,
        services: &mut Services,
        index: u16,
        sub_index: u8,
        bytes: &[u8],
    ) -> Accepted {
        Ok(())
    }

    /// Communication is lost; the EMCY is queued. A drive sets its current to 0 here. The reaction by 0x1029 follows.
    fn on_communication_loss(&mut self, services: &mut Services, loss: CommunicationLoss) {}

    /// Communication is back; "no error" is queued.
    fn on_communication_recovery(&mut self, services: &mut Services, loss: CommunicationLoss) {}

    /// Another node's heartbeat, or its boot-up message as [`NmtState::Initialising`].
    fn on_heartbeat(&mut self, services: &mut Services, node_id: NodeId, state: NmtState) {}

    /// Another node's emergency.
    fn on_emergency(
        &mut self,
        services: &mut Services,
        node_id: NodeId,
        message: &EmergencyMessage,
    ) {
    }

    /// A data frame that none of the device's own services takes, such as an answer to an SDO client.
    fn on_frame(&mut self, services: &mut Services, frame: &CanFrame) {}

    /// Time has passed.
    fn on_tick(&mut self, services: &mut Services) {}

    /// Returns the time at which the application wants its next tick.
    fn next_deadline(&self) -> Option<Duration> {
        None
    }

    /// The node is asked for its safe state.
    fn on_stop(&mut self, services: &mut Services) {}

    /// Returns the progress of the application; by default it stops as soon as it is asked to.
    fn progress(&self, is_stop_asked: bool) -> Progress {
        if is_stop_asked {
            Progress::Stopped
        } else {
            Progress::Running
        }
    }
}
