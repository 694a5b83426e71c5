//! Why a run failed.

use std::io;
use std::time::Duration;

use dbc::SignalMissing;
use recording::ending::EarlyEnd;
use recording::run_folder::WriteError;

use crate::coordinator::CoordinatorError;

/// How long the nodes may take until the scenario begins, on the run's clock.
pub(crate) const START_PATIENCE: Duration = Duration::from_secs(15);
/// How long a node may take to its safe state, on the run's clock.
pub(crate) const STOP_PATIENCE: Duration = Duration::from_millis(500);

/// Whose doing the end of a process was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Doing {
    /// The node could not be set up, so nothing began.
    NotSetUp,
    /// The node ended itself, with its reason.
    GaveUp,
    /// The node's code broke: a panic, a violation of memory.
    Crashed,
    /// Somebody killed the process, or the bus failed under it.
    FromOutside,
}

/// Why a run failed.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// Virtual time cannot go on.
    #[error(transparent)]
    Coordinator(#[from] CoordinatorError),
    /// The scenario did not begin.
    #[error("the scenario did not begin within {} s: the drive never reported Operation Enabled", patience.as_secs())]
    NoStart {
        /// How long was waited.
        patience: Duration,
    },
    /// A node has no safe state in time.
    #[error("the {name} did not reach its safe state within {} ms", patience.as_millis())]
    NoStop {
        /// Which node.
        name: String,
        /// How long was waited.
        patience: Duration,
    },
    /// A node cannot be built from the scenario.
    #[error("the {name} cannot be set up: {reason}")]
    Node {
        /// Which node.
        name: String,
        /// Why.
        reason: String,
    },
    /// The machine does not let a node be built now.
    #[error("the {name} cannot be set up: {what}: {source}")]
    NodeNow {
        /// Which node.
        name: String,
        /// What the machine refuses.
        what: String,
        /// Why.
        source: io::Error,
    },
    /// A process ended before its time, or badly.
    #[error("the {name} {how}{log}")]
    Process {
        /// Which process.
        name: String,
        /// How it ended.
        how: String,
        /// The end of its log, ready to print.
        log: String,
        /// Whose doing that was.
        doing: Doing,
    },
    /// A process could not be started.
    #[error("the {name} cannot be started: {source}")]
    Spawn {
        /// Which process.
        name: String,
        /// Why.
        source: io::Error,
    },
    /// The bus cannot be used.
    #[error(transparent)]
    Bus(#[from] platform::bus::BusError),
    /// No kernel CAN where it is demanded.
    #[error("--require-vcan: {0}")]
    NoKernelCan(String),
    /// A node was not heard for some time in the middle of a run.
    #[error("the {node} has been silent for {} s in the middle of the run", silence.as_secs_f64())]
    Silent {
        /// Which node.
        node: String,
        /// For how long.
        silence: Duration,
    },
    /// A node under test ended what is no run of its own, such as the pre-flight.
    #[error("{0}")]
    ByNode(EarlyEnd),
    /// The private bus cannot be made.
    #[error("no private bus: {0}")]
    Private(#[from] platform::private_bus::PrivateBusError),
    /// The embedded bus cannot be made.
    #[error(transparent)]
    Hub(#[from] platform::hub::HubError),
    /// The bench's own node failed.
    #[error("the bench's own node failed: {0}")]
    Bench(platform::real_time::RunError),
    /// A limit of the rig was violated.
    #[error("canrig stopped the {drive}: {violation}")]
    Violation {
        /// Of which drive.
        drive: String,
        /// Which limit, and by what.
        violation: String,
    },
    /// Somebody else leads on this bus.
    #[error("a second master: {0}")]
    SecondMaster(String),
    /// The bench cannot have the interface for itself.
    #[error(transparent)]
    Claim(platform::claim::ClaimError),
    /// A check before current may flow.
    #[error("the pre-flight fails: {name}: {found}")]
    Preflight {
        /// Which check.
        name: &'static str,
        /// What was found.
        found: String,
    },
    /// The DBC lacks a signal.
    #[error(transparent)]
    Signal(#[from] SignalMissing),
    /// The recording cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

impl WorldError {
    /// Whether a process was killed, or the bus failed under it.
    pub(crate) fn is_from_outside(&self) -> bool {
        matches!(self, Self::Process { doing, .. } if *doing == Doing::FromOutside)
    }

    /// Whether nothing began: a program or a plant cannot be started, or a check before the run failed.
    #[must_use]
    pub fn is_before_start(&self) -> bool {
        match self {
            Self::Node { .. }
            | Self::NodeNow { .. }
            | Self::Spawn { .. }
            | Self::Preflight { .. } => true,
            Self::Process { doing, .. } => *doing == Doing::NotSetUp,
            _ => false,
        }
    }
}
