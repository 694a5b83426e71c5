//! Conduct of the nodes: what they say and do beside their cyclic values. Each event is rare: a state that changes, an emergency,
//! an NMT command, an object that is written. The judge reads them to find why a node stopped.

use std::time::Duration;

use can::CanFrame;
use canopen::cia402::{Command, State};
use canopen::emcy::EmergencyMessage;
use canopen::nmt::{COMMAND_ID, ERROR_CONTROL_ID};
use canopen::sdo::DEFAULT_REQUEST_ID as SDO_REQUESTS;
use canopen::{NmtCommand, NmtState, emcy};
use dbc::{Database, SignalHandle, names};
use plan::{Plan, message_of};
use scenario::node::Node;

use crate::identifiers::ByIdentifier;

/// Largest number of acts that are kept: a node that changes its state in each cycle shows what it does in the first ones.
const ACTS_MAX: usize = 100_000;
/// Client's command that begins to write an object.
const SDO_DOWNLOAD: u8 = 1;

/// Kind of act: what a node said or did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Act {
    /// It sent an emergency; `about` and `cause` are its first manufacturer bytes.
    Emergency { code: u16, about: u8, cause: u8 },
    /// Its heartbeat says a state for the first time, or a boot-up.
    Heartbeat(NmtState),
    /// Its statusword says another state; `is_asked` if its controlword does not ask for Operation enabled.
    Power { state: State, is_asked: bool },
    /// An NMT command was given to it; for all nodes, to node 0.
    Ordered(NmtCommand),
    /// One of its objects was written by SDO.
    Written { index: u16 },
}

/// Act of a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeAct {
    pub at_seconds: f64,
    pub node_id: u8,
    pub act: Act,
}

/// Kind of frame that is watched under an identifier.
enum Watched {
    Emergency(u8),
    Heartbeat(u8, Option<NmtState>),
    Status {
        drive: usize,
        word: SignalHandle,
        state: Option<State>,
    },
    Control {
        drive: usize,
        command: SignalHandle,
        bits: Option<u64>,
    },
    Orders,
    Requests(u8),
}

/// Drive of which the power state is watched.
struct WatchedDrive {
    node_id: u8,
    is_asked: bool,
}

/// Reader of what the nodes do in the scenario.
pub(crate) struct ConductReader {
    watched: ByIdentifier<Watched>,
    drives: Vec<WatchedDrive>,
    end: Duration,
    acts: Vec<NodeAct>,
}

impl ConductReader {
    /// Makes a reader of the nodes of a plan.
    pub(crate) fn new(plan: &Plan) -> Self {
        let ids = plan.rig_nodes().map(|(_, node)| node.id());
        let of_nodes = ids.flat_map(|id| {
            let number = u16::from(id);
            [
                (ERROR_CONTROL_ID + number, Watched::Heartbeat(id, None)),
                (emcy::DEFAULT_ID + number, Watched::Emergency(id)),
                (SDO_REQUESTS + number, Watched::Requests(id)),
            ]
        });
        let services = of_nodes.chain([(COMMAND_ID, Watched::Orders)]);
        let services = services.map(|(id, watched)| (u32::from(id), watched));
        let mut drives = Vec::new();
        let mut words = Vec::new();
        for one in &plan.loops {
            let drive = drives.len();
            let (database, node) = (plan.database(), one.drive());
            let (status, control) = (status(database, node), control(database, node));
            words.extend(status.map(|word| {
                let state = None;
                (word.raw_id(), Watched::Status { drive, word, state })
            }));
            words.extend(control.map(|command| {
                let bits = None;
                let watched = Watched::Control {
                    drive,
                    command,
                    bits,
                };
                (command.raw_id(), watched)
            }));
            drives.push(WatchedDrive {
                node_id: one.drive().id(),
                is_asked: true,
            });
        }
        Self {
            watched: services.chain(words).collect(),
            drives,
            end: plan.duration(),
            acts: Vec::new(),
        }
    }

    /// Takes each frame, with its scenario time; states before the scenario are known when it begins.
    #[inline]
    pub(crate) fn on_frame(&mut self, frame: &CanFrame, time: Option<Duration>) {
        if let Some(watched) = self.watched.get_mut(frame.raw_id()) {
            let time = time.filter(|time| *time < self.end);
            if let Some((node_id, act)) = read(watched, &mut self.drives, frame)
                && let Some(time) = time
                && self.acts.len() < ACTS_MAX
            {
                self.acts.push(NodeAct {
                    at_seconds: time.as_secs_f64(),
                    node_id,
                    act,
                });
            }
        }
    }

    /// Takes all acts.
    pub(crate) fn take(&mut self) -> Vec<NodeAct> {
        std::mem::take(&mut self.acts)
    }
}

/// Reads what a frame says of its node, if that is new.
#[inline]
fn read(watched: &mut Watched, drives: &mut [WatchedDrive], frame: &CanFrame) -> Option<(u8, Act)> {
    match watched {
        Watched::Status { drive, word, state } => {
            let statusword = crate::events::word(word.decode(frame)?);
            let now = State::from_statusword(statusword);
            let drive = &drives[*drive];
            if *state == now {
                return None;
            }
            let is_asked = drive.is_asked;
            *state = now;
            Some((
                drive.node_id,
                Act::Power {
                    state: now?,
                    is_asked,
                },
            ))
        }
        Watched::Control {
            drive,
            command,
            bits,
        } => {
            let now = command.bits(frame)?;
            if *bits != Some(now) {
                *bits = Some(now);
                let word = crate::events::word(command.decode(frame)?);
                drives[*drive].is_asked = Command::decode(word) != Command::EnableOperation;
            }
            None
        }
        Watched::Heartbeat(node, state) => {
            let now = NmtState::from_number(frame.data().first()? & 0x7F)?;
            let is_new = state.replace(now) != Some(now) || now == NmtState::Initialising;
            is_new.then_some((*node, Act::Heartbeat(now)))
        }
        Watched::Emergency(node) => {
            let message = EmergencyMessage::decode(frame.data())?;
            let [about, cause, ..] = message.manufacturer;
            let code = message.code.0;
            (code != 0).then_some((*node, Act::Emergency { code, about, cause }))
        }
        Watched::Orders => match frame.data() {
            [specifier, node, ..] => {
                let command = NmtCommand::from_specifier(*specifier)?;
                Some((*node, Act::Ordered(command)))
            }
            _ => None,
        },
        Watched::Requests(node) => match frame.data() {
            [specifier, low, high, ..] if specifier >> 5 == SDO_DOWNLOAD => {
                let index = u16::from_le_bytes([*low, *high]);
                Some((*node, Act::Written { index }))
            }
            _ => None,
        },
    }
}

/// The state in the statusword of a loop's drive.
fn status(database: &Database, drive: &Node) -> Option<SignalHandle> {
    let message = message_of(database, drive, names::TPDO1).ok()?;
    Some(message.handle(message.signal(names::STATUSWORD)?))
}

/// The command in the controlword of a loop's drive.
fn control(database: &Database, drive: &Node) -> Option<SignalHandle> {
    let message = message_of(database, drive, names::RPDO1).ok()?;
    Some(message.handle(message.signal(names::CONTROLWORD)?))
}
